from .curve.curve import Curve as Curve, Instants as Instants, motion_of_curve as motion_of_curve, write_curve as write_curve
from .curve.curve_errors import ErrorsOfCurve as ErrorsOfCurve, finer_trajectory as finer_trajectory
from .curve.fit import reconstruct_curve as reconstruct_curve
from .curve.joint_log import JointLog as JointLog
from .curve.stream import CurveStream as CurveStream
from .faults.consistency import collect_epochs as collect_epochs
from .faults.continuity import shifted as shifted
from .faults.redundancy import (
    Epochs as Epochs,
    Faults as Faults,
    Redundancy as Redundancy,
    faults_shown as faults_shown,
    proposed_returns as proposed_returns,
)
from .faults.rest_evidence import SUSPECTED as SUSPECTED
from .faults.rests import SETTLED as SETTLED, VISIT_LAG_S as VISIT_LAG_S, RestFinder as RestFinder
from .files.foreign_trajectory import Stated as Stated, kind_of as kind_of, read_trajectory as read_trajectory
from .files.trajectory import Summary as Summary, Trajectory as Trajectory
from .files.write import write_trajectory as write_trajectory
from .motion.attained_poses import (
    LAG_S as LAG_S,
    LEAST_S as LEAST_S,
    AttainedPose as AttainedPose,
    Frame as Frame,
    attain as attain,
    in_frame as in_frame,
    mean_pose as mean_pose,
    moved as moved,
    rests as rests,
    scatter as scatter,
    settled as settled,
    window as window,
    worst_angle as worst_angle,
)
from .motion.motion import FULL as FULL, WIDEST_S as WIDEST_S, Motion as Motion, motion_of as motion_of, write_motion as write_motion
from .motion.spectrum import Vibration as Vibration
from .motion.vibration import averaged as averaged, kept_on as kept_on, with_rest as with_rest
from .origin.origins import estimate_origins as estimate_origins
from .origin.start import enough_absolute as enough_absolute
from .reconstruction.live import LivePose as LivePose, PoseWatch as PoseWatch
from .reconstruction.run_model import FREEDOMS as FREEDOMS, RunModel as RunModel
from .reconstruction.runs import (
    Each as Each,
    can_stream as can_stream,
    covariances as covariances,
    prepare as prepare,
    reconstruct as reconstruct,
    reconstruct_in_parts as reconstruct_in_parts,
    reconstruct_stream as reconstruct_stream,
)
from .reconstruction.screw_method import (
    Reconstruction as Reconstruction,
    reconstruction_of as reconstruction_of,
    zero_readings as zero_readings,
)
from .time.passes import Alignment as Alignment, align as align
from .time.stamps import Stamps as Stamps, stamps_of as stamps_of
from .uncertainty.assumed import Assumed as Assumed, Statement as Statement, radii_95 as radii_95
from .uncertainty.budget import RESTORED_ORIGIN as RESTORED_ORIGIN, Budget as Budget, PoseCovariances as PoseCovariances
from .uncertainty.pose_errors import (
    ErrorModel as ErrorModel,
    ErrorsOfFile as ErrorsOfFile,
    ErrorsOfRun as ErrorsOfRun,
    ErrorSource as ErrorSource,
    PoseErrors as PoseErrors,
)
from .uncertainty.rounding import (
    kept_over as kept_over,
    of_crossings as of_crossings,
    of_dwells as of_dwells,
    of_neighbours as of_neighbours,
    phases as phases,
    roundings as roundings,
)
from .uncertainty.sources import (
    NEAR_RAD as NEAR_RAD,
    UNKNOWN_MM as UNKNOWN_MM,
    Situation as Situation,
    zero_columns as zero_columns,
    zeros_of as zeros_of,
)
