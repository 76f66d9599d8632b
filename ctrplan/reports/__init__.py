"""Pictures and pages of plans, diagnoses, studies, calibrations and designs.

Pages stand alone: one file, nothing loaded from anywhere.
"""
