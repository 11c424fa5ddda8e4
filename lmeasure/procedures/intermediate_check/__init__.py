"""The intermediate check of an instrument between two calibrations: closures within their stated uncertainties, or else the part that has
moved.

`check_instrument` takes a run of minutes in which the robot goes to some positions, returns to them and ends at the first one.
"""
