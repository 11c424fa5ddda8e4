"""The interim check of an instrument between two calibrations: what must close and does, within what is stated, and what has moved if not.

`check_instrument` takes a run of minutes in which the robot goes to some places, comes back to them and ends where it began.
"""
