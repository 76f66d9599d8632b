"""Least squares over named parameters: values, intervals, what the data can't tell.

`calibrate` is the public function; diagnoses fit with the same residuals, priors and discrepancies.
"""
