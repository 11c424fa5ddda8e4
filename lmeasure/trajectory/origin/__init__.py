"""Origins of a run's channels without a stated start."""
