"""Correct a robot's commands by its identified model or by a map of measured errors."""
