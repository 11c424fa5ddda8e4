from .faults.consistency import (
    collected as collected,
)
from .faults.redundancy import (
    Epochs as Epochs,
)
from .faults.redundancy import (
    Redundancy as Redundancy,
)
from .faults.reliability import (
    Faults as Faults,
)
from .faults.reliability import (
    faults_shown as faults_shown,
)
from .faults.rest_evidence import (
    SUSPECTED as SUSPECTED,
)
from .faults.suspicion import (
    shifted as shifted,
)
from .faults.visits import (
    SETTLED as SETTLED,
)
from .faults.visits import (
    VISIT_LAG_S as VISIT_LAG_S,
)
from .faults.visits import (
    RestFinder as RestFinder,
)
from .files.foreign_trajectory import (
    Stated as Stated,
)
from .files.foreign_trajectory import (
    kind_of as kind_of,
)
from .files.foreign_trajectory import (
    read_trajectory as read_trajectory,
)
from .files.trajectory import (
    Summary as Summary,
)
from .files.trajectory import (
    Trajectory as Trajectory,
)
from .files.write import (
    write_trajectory as write_trajectory,
)
from .motion.attained_poses import (
    AttainedPose as AttainedPose,
)
from .motion.attained_poses import (
    Frame as Frame,
)
from .motion.attained_poses import (
    attain as attain,
)
from .motion.attained_poses import (
    mean_pose as mean_pose,
)
from .motion.attained_poses import (
    moved as moved,
)
from .motion.attained_poses import (
    scatter as scatter,
)
from .motion.attained_poses import (
    window as window,
)
from .motion.attained_poses import (
    worst_angle as worst_angle,
)
from .motion.motion import (
    FULL as FULL,
)
from .motion.motion import (
    WIDEST_S as WIDEST_S,
)
from .motion.motion import (
    Motion as Motion,
)
from .motion.motion import (
    motion_of as motion_of,
)
from .motion.motion import (
    write_motion as write_motion,
)
from .motion.rests import (
    LAG_S as LAG_S,
)
from .motion.rests import (
    LEAST_S as LEAST_S,
)
from .motion.rests import (
    rests as rests,
)
from .motion.rests import (
    settled as settled,
)
from .motion.spectrum import (
    Vibration as Vibration,
)
from .motion.vibration import (
    averaged as averaged,
)
from .motion.vibration import (
    with_rest as with_rest,
)
from .origin.origins import (
    learn as learn,
)
from .reconstruction.live import (
    LivePose as LivePose,
)
from .reconstruction.live import (
    PoseWatch as PoseWatch,
)
from .reconstruction.live import (
    enough_absolute as enough_absolute,
)
from .reconstruction.preparation import (
    prepared as prepared,
)
from .reconstruction.runs import (
    reconstruct as reconstruct,
)
from .reconstruction.scheme import (
    FREEDOMS as FREEDOMS,
)
from .reconstruction.screw_method import (
    Reconstruction as Reconstruction,
)
from .reconstruction.stream import (
    Each as Each,
)
from .reconstruction.stream import (
    can_stream as can_stream,
)
from .reconstruction.stream import (
    reconstruct_stream as reconstruct_stream,
)
from .time.passes import (
    Alignment as Alignment,
)
from .time.passes import (
    align as align,
)
from .time.stamps import (
    Stamps as Stamps,
)
from .time.stamps import (
    stamps_of as stamps_of,
)
from .uncertainty.budget import (
    RESTORED_ORIGIN as RESTORED_ORIGIN,
)
from .uncertainty.budget import (
    Budget as Budget,
)
from .uncertainty.pose_covariances import (
    PoseCovariances as PoseCovariances,
)
from .uncertainty.pose_errors import (
    ErrorModel as ErrorModel,
)
from .uncertainty.pose_errors import (
    ErrorsOfFile as ErrorsOfFile,
)
from .uncertainty.pose_errors import (
    ErrorsOfRun as ErrorsOfRun,
)
from .uncertainty.pose_errors import (
    PoseErrors as PoseErrors,
)
from .uncertainty.rounding import (
    kept_over as kept_over,
)
from .uncertainty.rounding import (
    of_crossings as of_crossings,
)
from .uncertainty.rounding import (
    of_dwells as of_dwells,
)
from .uncertainty.rounding import (
    of_neighbours as of_neighbours,
)
from .uncertainty.rounding import (
    phases as phases,
)
from .uncertainty.rounding import (
    roundings as roundings,
)
from .uncertainty.run_covariances import (
    covariances as covariances,
)
from .uncertainty.sources import (
    NEAR_RAD as NEAR_RAD,
)
from .uncertainty.sources import (
    UNKNOWN_MM as UNKNOWN_MM,
)
from .uncertainty.sources import (
    zero_columns as zero_columns,
)
from .uncertainty.sources import (
    zeros_of as zeros_of,
)
