"""The trajectory as a curve in continuous time."""
