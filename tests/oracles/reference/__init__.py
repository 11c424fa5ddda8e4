"""A second solver for channels of any kind, plain NumPy: what the compiled kernels, production's only solver, are compared with.

`channel` says what every kind provides (`Observation`); `cable`, `swivel`, `inclination` and `distance` are kinds; `solver` and
`continuation` find poses, `zone_map` and `calibration` follow from the same rows.
"""
