"""Configurations that reach a target, and what they are worth."""
