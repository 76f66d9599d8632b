"""Figures and tables of the paper, each module a part of its Section IV."""
