"""Simulated robots: a controller's commands, and an arm with errors."""
