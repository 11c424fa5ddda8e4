"""Validate a calibration: residuals, slips, hold-out, explanations of a misfit."""
