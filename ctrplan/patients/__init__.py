"""A patient's case: from scans and points to a certified plan, step by step, each step's result a file to be edited."""

from __future__ import annotations
