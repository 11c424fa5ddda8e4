"""Time of a run: stamps that jitter, an even clock, repeated passes."""
