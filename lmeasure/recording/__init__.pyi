from .counts import (
    Counts as Counts,
    RateEvidence as RateEvidence,
    Unwrapped as Unwrapped,
    WidthEvidence as WidthEvidence,
    closure_counts as closure_counts,
    read_counts as read_counts,
    read_counts_in_pieces as read_counts_in_pieces,
    unwrap as unwrap,
    write_counts as write_counts,
)
from .pose_table import read_pose_table as read_pose_table
from .poses import (
    AXIS_COLUMNS as AXIS_COLUMNS,
    POSITION_COLUMNS as POSITION_COLUMNS,
    UNIT_TOLERANCE as UNIT_TOLERANCE,
    Poses as Poses,
    joined as joined,
    pose_columns as pose_columns,
    poses_from_rows as poses_from_rows,
    read_poses as read_poses,
    write_poses as write_poses,
)
from .program import (
    CommandedPath as CommandedPath,
    CommandedPose as CommandedPose,
    Compliance as Compliance,
    Distance as Distance,
    Drift as Drift,
    Posing as Posing,
    Program as Program,
    Tolerance as Tolerance,
    Windows as Windows,
    read_program as read_program,
    write_program as write_program,
)
from .run import (
    SCHEMA as SCHEMA,
    Recorded as Recorded,
    Run as Run,
    RunHead as RunHead,
    known as known,
    notes_of as notes_of,
    read_run as read_run,
    read_run_head as read_run_head,
    recording_at as recording_at,
    write_run as write_run,
)
from .start import (
    StatedStart as StatedStart,
    start_from_text as start_from_text,
    start_of_rig as start_of_rig,
    start_uncertainty as start_uncertainty,
    stated_start as stated_start,
)
