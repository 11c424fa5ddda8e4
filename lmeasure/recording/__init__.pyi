from .counts import (
    Counts as Counts,
)
from .counts import (
    RateEvidence as RateEvidence,
)
from .counts import (
    Unwrapped as Unwrapped,
)
from .counts import (
    WidthEvidence as WidthEvidence,
)
from .counts import (
    closure_counts as closure_counts,
)
from .counts import (
    read_counts as read_counts,
)
from .counts import (
    read_counts_in_pieces as read_counts_in_pieces,
)
from .counts import (
    unwrap as unwrap,
)
from .counts import (
    write_counts as write_counts,
)
from .pose_table import (
    read_pose_table as read_pose_table,
)
from .poses import (
    AXIS_COLUMNS as AXIS_COLUMNS,
)
from .poses import (
    POSITION_COLUMNS as POSITION_COLUMNS,
)
from .poses import (
    UNIT_TOLERANCE as UNIT_TOLERANCE,
)
from .poses import (
    Poses as Poses,
)
from .poses import (
    joined as joined,
)
from .poses import (
    pose_columns as pose_columns,
)
from .poses import (
    poses_from_rows as poses_from_rows,
)
from .poses import (
    read_poses as read_poses,
)
from .poses import (
    write_poses as write_poses,
)
from .program import (
    CommandedPath as CommandedPath,
)
from .program import (
    CommandedPose as CommandedPose,
)
from .program import (
    Compliance as Compliance,
)
from .program import (
    Distance as Distance,
)
from .program import (
    Drift as Drift,
)
from .program import (
    Posing as Posing,
)
from .program import (
    Program as Program,
)
from .program import (
    Tolerance as Tolerance,
)
from .program import (
    Windows as Windows,
)
from .program import (
    read_program as read_program,
)
from .program import (
    write_program as write_program,
)
from .recording import (
    Recorded as Recorded,
)
from .recording import (
    notes_of as notes_of,
)
from .recording import (
    recording_at as recording_at,
)
from .run import (
    SCHEMA as SCHEMA,
)
from .run import (
    Run as Run,
)
from .run import (
    RunHead as RunHead,
)
from .run import (
    known as known,
)
from .run import (
    read_run as read_run,
)
from .run import (
    read_run_head as read_run_head,
)
from .run import (
    write_run as write_run,
)
from .start import (
    StatedStart as StatedStart,
)
from .start import (
    start_from_text as start_from_text,
)
from .start import (
    start_of_rig as start_of_rig,
)
from .start import (
    start_uncertainty as start_uncertainty,
)
from .start import (
    stated_start as stated_start,
)
