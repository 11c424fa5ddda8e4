"""Solve a campaign: coarse points, LP-search, least squares, and the record of the result."""
