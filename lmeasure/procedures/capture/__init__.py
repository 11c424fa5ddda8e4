"""Reference poses counted over a bus: a person or a robot's program goes through them, and a calibration folder is what is left.

The folder is the state: every reading stands in its `counts.csv` as soon as it is taken, and a session begun again goes on from there.
"""
