"""Identify a robot: find its parameters from joint values and measured places."""
