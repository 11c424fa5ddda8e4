"""Find what a run's channels count from, where nobody stated its start."""
