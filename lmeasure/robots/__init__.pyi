from .base_mount import Mounted as Mounted
from .correction.correction import (
    NO_POSE as NO_POSE,
    Correction as Correction,
    Limits as Limits,
    corrections as corrections,
    in_keep_out as in_keep_out,
    too_large as too_large,
    ways as ways,
    whole_turns as whole_turns,
)
from .correction.error_map import ErrorMap as ErrorMap, error_map as error_map, read_map as read_map
from .hand_eye import GivenPoses as GivenPoses, frames as frames
from .identification.hold_out import (
    HeldOut as HeldOut,
    beyond as beyond,
    held_out as held_out,
    identify_with_choice as identify_with_choice,
    learning_curve as learning_curve,
    worth_freeing as worth_freeing,
)
from .identification.identify import (
    FAMILIES as FAMILIES,
    Identified as Identified,
    Settings as Settings,
    check_foreign as check_foreign,
    family as family,
    freed as freed,
    identify as identify,
    predict as predict,
    unmoved_in as unmoved_in,
)
from .identification.inputs import given as given
from .identification.measurements import Measurements as Measurements, Noted as Noted
from .identification.observability import unknown_frames as unknown_frames
from .identification.outliers import HALF as HALF
from .identification.plan import Plan as Plan, planned as planned, to_plan as to_plan
from .identification.reach import REGULAR as REGULAR, Allowed as Allowed, PredictionMap as PredictionMap, workspace as workspace
from .identification.read_measurements import read_measurements as read_measurements
from .identification.read_record import IdentifiedRobot as IdentifiedRobot, read_identified as read_identified
from .identification.record import (
    corrected as corrected,
    nominal_frames as nominal_frames,
    prediction_columns as prediction_columns,
    record as record,
    summary as summary,
    write_record as write_record,
)
from .identification.slips import mended as mended
from .model import RobotModel as RobotModel, joint_columns as joint_columns
from .parallel.dyads import Dyad as Dyad, Minimax as Minimax, all_fitted as all_fitted, minimax as minimax, misses as misses
from .parallel.file import ParallelFile as ParallelFile
from .parallel.jacobians import nearness as nearness
from .parallel.limits import PathLimits as PathLimits, checked as checked, hooke_joints as hooke_joints
from .parallel.outline import Drawn as Drawn, drawn as drawn
from .parallel.study import (
    Grid as Grid,
    Turns as Turns,
    Workspace as Workspace,
    at_poses as at_poses,
    completions as completions,
    described as described,
    motion as motion,
    over_drives as over_drives,
    over_grid as over_grid,
)
from .platform import PlatformFile as PlatformFile
from .robot import (
    SCHEMA as SCHEMA,
    AnyRobot as AnyRobot,
    Robot as Robot,
    any_shipped as any_shipped,
    read_robot as read_robot,
    shipped_names as shipped_names,
    write_robot as write_robot,
)
from .serial_robot import SerialRobot as SerialRobot
from .simulated import (
    GRAVITY_M_S2 as GRAVITY_M_S2,
    RATED_LOAD_KG as RATED_LOAD_KG,
    RATED_SPEED_MM_S as RATED_SPEED_MM_S,
    Command as Command,
    Performance as Performance,
    Role as Role,
    SimulatedRobot as SimulatedRobot,
    cell_robot as cell_robot,
    nominal_robot as nominal_robot,
)
from .urdf import read_urdf as read_urdf, write_urdf as write_urdf
