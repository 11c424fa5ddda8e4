"""Reference poses counted over a bus: a user or a robot's program goes through them, and the result is a calibration folder.

The folder is the state: every reading is in its `counts.csv` as soon as it is taken, and a new session continues from there.
"""
