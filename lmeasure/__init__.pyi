__all__: list[str]
__version__: str
from .accuracy import limit_from_accuracy as limit_from_accuracy, read_zone as read_zone, scan_zone as scan_zone, write_zone as write_zone
from .acquisition import read_frames as read_frames
from .api import (
    analyse_structure as analyse_structure,
    calibrate as calibrate,
    certify as certify,
    evaluate as evaluate,
    place as place,
    plan_poses as plan_poses,
    plan_program as plan_program,
    plot as plot,
    read_log as read_log,
    reconstruct as reconstruct,
    reconstruct_curve as reconstruct_curve,
    simulate as simulate,
    verify as verify,
    zone as zone,
)
from .calibration import (
    Calibration as Calibration,
    CalibrationSettings as CalibrationSettings,
    Campaign as Campaign,
    read_campaign as read_campaign,
)
from .certificate import Certificate as Certificate
from .core import LMeasureError as LMeasureError, angles_from_rotation as angles_from_rotation, rotation_from_angles as rotation_from_angles
from .iso9283 import CertificationSettings as CertificationSettings, Evaluation as Evaluation
from .recording import (
    Counts as Counts,
    Poses as Poses,
    Program as Program,
    Run as Run,
    poses_from_rows as poses_from_rows,
    read_counts as read_counts,
    read_poses as read_poses,
    read_program as read_program,
    read_run as read_run,
    write_counts as write_counts,
    write_poses as write_poses,
    write_program as write_program,
    write_run as write_run,
)
from .rig import (
    CalibrationRecord as CalibrationRecord,
    DrumMeasurement as DrumMeasurement,
    Rig as Rig,
    read_calibration_record as read_calibration_record,
    read_drums as read_drums,
    read_rig as read_rig,
    rig_from_dict as rig_from_dict,
    with_drums as with_drums,
    write_calibration_record as write_calibration_record,
    write_rig as write_rig,
)
from .robots import identify as identify
from .sensors import (
    Lengths as Lengths,
    lengths_from_counts as lengths_from_counts,
    read_lengths as read_lengths,
    span_lengths as span_lengths,
    write_lengths as write_lengths,
)
from .structure import Described as Described
from .trajectory import (
    Curve as Curve,
    CurveStream as CurveStream,
    Instants as Instants,
    PoseCovariances as PoseCovariances,
    Trajectory as Trajectory,
    covariances as covariances,
    read_trajectory as read_trajectory,
    write_curve as write_curve,
    write_trajectory as write_trajectory,
)
