"""The number of the method by which results are computed from the same inputs."""

METHOD = 1
"""Raised whenever the same inputs give other results, or the same results another verdict."""
