from .correction.error_map import (
    NO_POSE as NO_POSE,
    Correction as Correction,
    ErrorMap as ErrorMap,
    Limits as Limits,
    corrections as corrections,
    error_map as error_map,
    in_keep_out as in_keep_out,
    read_map as read_map,
    too_large as too_large,
    ways as ways,
    whole_turns as whole_turns,
)
from .hand_eye import StatedPoses as StatedPoses, frames as frames
from .identification.hold_out import (
    CrossValidation as CrossValidation,
    beyond as beyond,
    cross_validation as cross_validation,
    identify_with_choice as identify_with_choice,
    learning_curve as learning_curve,
    worth_freeing as worth_freeing,
)
from .identification.identify import (
    FAMILIES as FAMILIES,
    HALF as HALF,
    Identified as Identified,
    Settings as Settings,
    check_foreign as check_foreign,
    family as family,
    freed as freed,
    identify as identify,
    predict as predict,
    unmoved_in as unmoved_in,
)
from .identification.measurements import Measurements as Measurements, Noted as Noted
from .identification.observability import Plan as Plan, planned as planned, to_plan as to_plan, unknown_frames as unknown_frames
from .identification.reach import REGULAR as REGULAR, Allowed as Allowed, PredictionMap as PredictionMap, workspace as workspace
from .identification.read_measurements import (
    read_joint_log as read_joint_log,
    read_measurements as read_measurements,
    read_robot_measurements as read_robot_measurements,
)
from .identification.record import (
    IdentifiedRobot as IdentifiedRobot,
    corrected as corrected,
    nominal_frames as nominal_frames,
    prediction_columns as prediction_columns,
    read_identified as read_identified,
    record as record,
    summary as summary,
    write_record as write_record,
)
from .identification.slips import mended as mended
from .model import RobotModel as RobotModel, joint_columns as joint_columns
from .parallel.dyads import Dyad as Dyad, Minimax as Minimax, all_fitted as all_fitted, minimax as minimax, misses as misses
from .parallel.file import ParallelFile as ParallelFile
from .parallel.limits import PathLimits as PathLimits, checked as checked, hooke_joints as hooke_joints
from .parallel.model import nearness as nearness
from .parallel.study import (
    Grid as Grid,
    MechanismOutline as MechanismOutline,
    Turns as Turns,
    Workspace as Workspace,
    at_poses as at_poses,
    completions as completions,
    described as described,
    mechanism_outline as mechanism_outline,
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
from .serial import SerialRobot as SerialRobot
from .simulated import (
    GRAVITY_M_S2 as GRAVITY_M_S2,
    RATED_LOAD_KG as RATED_LOAD_KG,
    RATED_SPEED_MM_S as RATED_SPEED_MM_S,
    Command as Command,
    Mounted as Mounted,
    Performance as Performance,
    Role as Role,
    SimulatedRobot as SimulatedRobot,
    cell_robot as cell_robot,
    nominal_robot as nominal_robot,
)
from .urdf import read_urdf as read_urdf, write_urdf as write_urdf
