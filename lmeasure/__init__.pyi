__all__: list[str]
__version__: str
from .accuracy import (
    limit_from_accuracy as limit_from_accuracy,
)
from .accuracy import (
    read_zone as read_zone,
)
from .accuracy import (
    scan_zone as scan_zone,
)
from .accuracy import (
    write_zone as write_zone,
)
from .acquisition import (
    read_frames as read_frames,
)
from .api import (
    analyse_structure as analyse_structure,
)
from .api import (
    calibrate as calibrate,
)
from .api import (
    certify as certify,
)
from .api import (
    evaluate as evaluate,
)
from .api import (
    place as place,
)
from .api import (
    plan_poses as plan_poses,
)
from .api import (
    plan_program as plan_program,
)
from .api import (
    plot as plot,
)
from .api import (
    read_log as read_log,
)
from .api import (
    reconstruct as reconstruct,
)
from .api import (
    simulate as simulate,
)
from .api import (
    verify as verify,
)
from .api import (
    zone as zone,
)
from .calibration import (
    Calibration as Calibration,
)
from .calibration import (
    CalibrationSettings as CalibrationSettings,
)
from .calibration import (
    Campaign as Campaign,
)
from .calibration import (
    read_campaign as read_campaign,
)
from .certificate import (
    Certificate as Certificate,
)
from .core import (
    LMeasureError as LMeasureError,
)
from .core import (
    angles_from_rotation as angles_from_rotation,
)
from .core import (
    rotation_from_angles as rotation_from_angles,
)
from .iso9283 import (
    CertificationSettings as CertificationSettings,
)
from .iso9283 import (
    Evaluation as Evaluation,
)
from .recording import (
    Counts as Counts,
)
from .recording import (
    Poses as Poses,
)
from .recording import (
    Program as Program,
)
from .recording import (
    Run as Run,
)
from .recording import (
    poses_from_rows as poses_from_rows,
)
from .recording import (
    read_counts as read_counts,
)
from .recording import (
    read_poses as read_poses,
)
from .recording import (
    read_program as read_program,
)
from .recording import (
    read_run as read_run,
)
from .recording import (
    write_counts as write_counts,
)
from .recording import (
    write_poses as write_poses,
)
from .recording import (
    write_program as write_program,
)
from .recording import (
    write_run as write_run,
)
from .rig import (
    CalibrationRecord as CalibrationRecord,
)
from .rig import (
    DrumMeasurement as DrumMeasurement,
)
from .rig import (
    Rig as Rig,
)
from .rig import (
    read_calibration_record as read_calibration_record,
)
from .rig import (
    read_drums as read_drums,
)
from .rig import (
    read_rig as read_rig,
)
from .rig import (
    rig_from_dict as rig_from_dict,
)
from .rig import (
    with_drums as with_drums,
)
from .rig import (
    write_calibration_record as write_calibration_record,
)
from .rig import (
    write_rig as write_rig,
)
from .robots import (
    identify as identify,
)
from .sensors import (
    Lengths as Lengths,
)
from .sensors import (
    lengths_from_counts as lengths_from_counts,
)
from .sensors import (
    read_lengths as read_lengths,
)
from .sensors import (
    span_lengths as span_lengths,
)
from .sensors import (
    write_lengths as write_lengths,
)
from .structure import (
    Described as Described,
)
from .trajectory import (
    PoseCovariances as PoseCovariances,
)
from .trajectory import (
    Trajectory as Trajectory,
)
from .trajectory import (
    covariances as covariances,
)
from .trajectory import (
    read_trajectory as read_trajectory,
)
from .trajectory import (
    write_trajectory as write_trajectory,
)
