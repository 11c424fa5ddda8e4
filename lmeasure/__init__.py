"""lmeasure: cables, drums and encoders as a 6-DOF metrology instrument.

Counts -> lengths -> poses -> accuracy -> certificate. Everything public is a name of this package; each is imported when it is first used,
so that `import lmeasure` costs nothing. All errors are `LMeasureError`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from lmeasure.errors import LMeasureError

if TYPE_CHECKING:
    from lmeasure.accuracy import limit_from_accuracy, read_zone, scan_zone, write_zone
    from lmeasure.calibration import Calibration, Campaign, calibrate, read_campaign
    from lmeasure.calibration_record import CalibrationRecord, read_calibration_record, write_calibration_record
    from lmeasure.conventions import angles_from_rotation, rotation_from_angles
    from lmeasure.counts import Counts, read_counts, write_counts
    from lmeasure.drum import DrumMeasurement, read_drums, with_drums
    from lmeasure.lengths import Lengths, lengths_from_counts, read_lengths, write_lengths
    from lmeasure.poses import Poses, poses_from_rows, read_poses, write_poses
    from lmeasure.rig import Rig, read_rig, rig_from_dict, write_rig
    from lmeasure.run import Run, read_run, write_run
    from lmeasure.trajectory import PoseCovariances, Trajectory, covariances, read_trajectory, reconstruct, write_trajectory

__all__ = [
    "Calibration",
    "CalibrationRecord",
    "Campaign",
    "Counts",
    "DrumMeasurement",
    "LMeasureError",
    "Lengths",
    "PoseCovariances",
    "Poses",
    "Rig",
    "Run",
    "Trajectory",
    "angles_from_rotation",
    "calibrate",
    "covariances",
    "lengths_from_counts",
    "limit_from_accuracy",
    "poses_from_rows",
    "read_calibration_record",
    "read_campaign",
    "read_counts",
    "read_drums",
    "read_lengths",
    "read_poses",
    "read_rig",
    "read_run",
    "read_trajectory",
    "read_zone",
    "reconstruct",
    "rig_from_dict",
    "rotation_from_angles",
    "scan_zone",
    "with_drums",
    "write_calibration_record",
    "write_counts",
    "write_lengths",
    "write_poses",
    "write_rig",
    "write_run",
    "write_trajectory",
    "write_zone",
]

_HOMES = {
    "accuracy": ("limit_from_accuracy", "read_zone", "scan_zone", "write_zone"),
    "calibration": ("Calibration", "Campaign", "calibrate", "read_campaign"),
    "calibration_record": ("CalibrationRecord", "read_calibration_record", "write_calibration_record"),
    "conventions": ("angles_from_rotation", "rotation_from_angles"),
    "counts": ("Counts", "read_counts", "write_counts"),
    "drum": ("DrumMeasurement", "read_drums", "with_drums"),
    "lengths": ("Lengths", "lengths_from_counts", "read_lengths", "write_lengths"),
    "poses": ("Poses", "poses_from_rows", "read_poses", "write_poses"),
    "rig": ("Rig", "read_rig", "rig_from_dict", "write_rig"),
    "run": ("Run", "read_run", "write_run"),
    "trajectory": ("PoseCovariances", "Trajectory", "covariances", "read_trajectory", "reconstruct", "write_trajectory"),
}
_HOME = {name: f"lmeasure.{module}" for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("lmeasure")
    if name not in _HOME:
        raise AttributeError(f"module 'lmeasure' has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
