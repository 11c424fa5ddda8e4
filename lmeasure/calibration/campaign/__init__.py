"""Campaigns: a nominal rig, reference poses and counts, read from a folder."""
