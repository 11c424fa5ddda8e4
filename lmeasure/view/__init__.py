"""Stages as a rerun recording (.rrd), written by columns.

Every figure is logged as its stage gave it; nothing is computed here but shapes to draw. Space is in metres (rerun keeps it as float32: the
record of truth is Parquet), scalars carry their unit in the name. Unknown values are empty or NaN, never the last good picture.

Entities
--------
/world/rig/...                  observation points, directions of the guides; /world/nominal/... the same before calibration
/world/cables/<cable>           from B along the wrapped arc over the tangent point to the attachment point
/world/pulleys, /world/tangent_points, /world/platform
/world/tool                     base_from_tool over time; /world/path the whole way; /world/truth where it is known
/world/zone/inside, /outside    nodes coloured by their worst pressure angle
/position_mm, /errors           measurements: values with their variances, drawn as bands
/residual_mm/<cable>, /worst_pressure_angle_deg, /u_position_mm, /u_rotation_rad, /counts/pass<n>/<channel>
/calibration_residual_mm/<channel>   on the timeline `pose`
/status (text log), /status_lane, /notes
/<group>/<name>                 values of a command that is about no run, with their bands (`scene`); /world/commanded, /world/attained

Timelines: `time` (seconds of the run) and `sample` (its row), `pose` (number of the reference pose, from 1), or `row`.
"""

import os

import lazy_loader

# rerun's own message about files that it cannot write would repeat ours; rerun reads this when it is first loaded
os.environ.setdefault("RUST_LOG", "warn,re_log_encoding=off,re_sdk=off")
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
