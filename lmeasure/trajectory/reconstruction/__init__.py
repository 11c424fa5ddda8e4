"""Reconstruct poses from counts by the screw method: whole runs, streams, live."""
