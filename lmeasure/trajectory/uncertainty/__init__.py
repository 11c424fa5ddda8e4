"""Uncertainty of a run's poses: sources, budget, covariances."""
