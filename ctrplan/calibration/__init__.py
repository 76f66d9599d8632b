"""Least squares over named parameters: values, intervals, what the data can't tell."""
