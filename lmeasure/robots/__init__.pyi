from .base_mount import (
    Mounted as Mounted,
)
from .correction.correction import (
    NO_POSE as NO_POSE,
)
from .correction.correction import (
    Correction as Correction,
)
from .correction.correction import (
    Limits as Limits,
)
from .correction.correction import (
    corrections as corrections,
)
from .correction.correction import (
    in_keep_out as in_keep_out,
)
from .correction.correction import (
    too_large as too_large,
)
from .correction.correction import (
    ways as ways,
)
from .correction.correction import (
    whole_turns as whole_turns,
)
from .correction.error_map import (
    ErrorMap as ErrorMap,
)
from .correction.error_map import (
    error_map as error_map,
)
from .correction.read_map import (
    read_map as read_map,
)
from .hand_eye import (
    GivenPoses as GivenPoses,
)
from .hand_eye import (
    frames as frames,
)
from .identification.hold_out import (
    HeldOut as HeldOut,
)
from .identification.hold_out import (
    beyond as beyond,
)
from .identification.hold_out import (
    held_out as held_out,
)
from .identification.hold_out import (
    learning_curve as learning_curve,
)
from .identification.hold_out import (
    worth_freeing as worth_freeing,
)
from .identification.identify import (
    FAMILIES as FAMILIES,
)
from .identification.identify import (
    Identified as Identified,
)
from .identification.identify import (
    Settings as Settings,
)
from .identification.identify import (
    check_foreign as check_foreign,
)
from .identification.identify import (
    family as family,
)
from .identification.identify import (
    freed as freed,
)
from .identification.identify import (
    identify as identify,
)
from .identification.identify import (
    predict as predict,
)
from .identification.identify import (
    unmoved_in as unmoved_in,
)
from .identification.inputs import (
    given as given,
)
from .identification.measurements import (
    Measurements as Measurements,
)
from .identification.model_choice import (
    identify_with_choice as identify_with_choice,
)
from .identification.notes import (
    Noted as Noted,
)
from .identification.observability import (
    unknown_frames as unknown_frames,
)
from .identification.outliers import (
    HALF as HALF,
)
from .identification.plan import (
    Plan as Plan,
)
from .identification.plan import (
    planned as planned,
)
from .identification.plan import (
    to_plan as to_plan,
)
from .identification.prediction_map import (
    PredictionMap as PredictionMap,
)
from .identification.prediction_map import (
    workspace as workspace,
)
from .identification.reach import (
    REGULAR as REGULAR,
)
from .identification.reach import (
    Allowed as Allowed,
)
from .identification.read_measurements import (
    read_measurements as read_measurements,
)
from .identification.read_record import (
    IdentifiedRobot as IdentifiedRobot,
)
from .identification.read_record import (
    read_identified as read_identified,
)
from .identification.record import (
    corrected as corrected,
)
from .identification.record import (
    nominal_frames as nominal_frames,
)
from .identification.record import (
    prediction_columns as prediction_columns,
)
from .identification.record import (
    record as record,
)
from .identification.record import (
    summary as summary,
)
from .identification.record import (
    write_record as write_record,
)
from .identification.slips import (
    mended as mended,
)
from .model import (
    RobotModel as RobotModel,
)
from .parallel.file import (
    ParallelFile as ParallelFile,
)
from .parallel.limits import (
    checked as checked,
)
from .parallel.mechanisms.dyads import (
    Dyad as Dyad,
)
from .parallel.mechanisms.dyads import (
    Minimax as Minimax,
)
from .parallel.mechanisms.dyads import (
    all_fitted as all_fitted,
)
from .parallel.mechanisms.dyads import (
    minimax as minimax,
)
from .parallel.mechanisms.dyads import (
    misses as misses,
)
from .parallel.mechanisms.dyads import (
    turned as turned,
)
from .parallel.mechanisms.jacobians import (
    nearness as nearness,
)
from .parallel.mechanisms.study import (
    Workspace as Workspace,
)
from .parallel.outline import (
    Drawn as Drawn,
)
from .parallel.outline import (
    drawn as drawn,
)
from .parallel.study import (
    Grid as Grid,
)
from .parallel.study import (
    at_poses as at_poses,
)
from .parallel.study import (
    completions as completions,
)
from .parallel.study import (
    described as described,
)
from .parallel.study import (
    motion as motion,
)
from .parallel.study import (
    over_grid as over_grid,
)
from .platform import (
    PlatformFile as PlatformFile,
)
from .robot import (
    SCHEMA as SCHEMA,
)
from .robot import (
    AnyRobot as AnyRobot,
)
from .robot import (
    Robot as Robot,
)
from .robot import (
    any_shipped as any_shipped,
)
from .robot import (
    read_robot as read_robot,
)
from .robot import (
    shipped_names as shipped_names,
)
from .robot import (
    write_robot as write_robot,
)
from .serial_robot import (
    SerialRobot as SerialRobot,
)
from .simulated.arm import (
    GRAVITY_M_S2 as GRAVITY_M_S2,
)
from .simulated.arm import (
    Performance as Performance,
)
from .simulated.arm import (
    SimulatedRobot as SimulatedRobot,
)
from .simulated.cell_robot import (
    RATED_LOAD_KG as RATED_LOAD_KG,
)
from .simulated.cell_robot import (
    RATED_SPEED_MM_S as RATED_SPEED_MM_S,
)
from .simulated.cell_robot import (
    cell_robot as cell_robot,
)
from .simulated.cell_robot import (
    nominal_robot as nominal_robot,
)
from .simulated.commands import (
    Command as Command,
)
from .simulated.commands import (
    Role as Role,
)
from .urdf import (
    read_urdf as read_urdf,
)
from .urdf import (
    write_urdf as write_urdf,
)
