"""Formulas of ISO 9283:1998, one function for each characteristic."""
