"""lmeasure: cables, drums and encoders as a 6-DOF metrology instrument.

Counts -> lengths -> poses -> accuracy -> certificate. The stages (`calibrate`, `reconstruct`, `zone`, `evaluate`, `certify` ...) take files
or objects; `plot` draws any of them. Everything public is a name of this package; each is imported when it is first used, so that
`import lmeasure` costs nothing. All errors are `LMeasureError`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from lmeasure.errors import LMeasureError

if TYPE_CHECKING:
    from lmeasure.accuracy import limit_from_accuracy, read_zone, scan_zone, write_zone
    from lmeasure.acquisition.logfiles import read_frames
    from lmeasure.calibration import Calibration, Campaign, read_campaign
    from lmeasure.calibration import Settings as CalibrationSettings
    from lmeasure.calibration_record import CalibrationRecord, read_calibration_record, write_calibration_record
    from lmeasure.certification import Evaluation
    from lmeasure.certification import Settings as CertificationSettings
    from lmeasure.certification.sealed import Certificate
    from lmeasure.conventions import angles_from_rotation, rotation_from_angles
    from lmeasure.counts import Counts, read_counts, write_counts
    from lmeasure.drum import DrumMeasurement, read_drums, with_drums
    from lmeasure.lengths import Lengths, lengths_from_counts, read_lengths, span_lengths, write_lengths
    from lmeasure.linkage.noun import Described
    from lmeasure.pipeline import (
        calibrate,
        certify,
        evaluate,
        place,
        plan_poses,
        plan_program,
        plot,
        read_log,
        reconstruct,
        simulate,
        structure,
        verify,
        zone,
    )
    from lmeasure.poses import Poses, poses_from_rows, read_poses, write_poses
    from lmeasure.program import Program, read_program, write_program
    from lmeasure.rig import Rig, read_rig, rig_from_dict, write_rig
    from lmeasure.robots.identify import identify
    from lmeasure.run import Run, read_run, write_run
    from lmeasure.trajectory import PoseCovariances, Trajectory, covariances, read_trajectory, write_trajectory

__all__ = [
    "Calibration",
    "CalibrationRecord",
    "CalibrationSettings",
    "Campaign",
    "Certificate",
    "CertificationSettings",
    "Counts",
    "Described",
    "DrumMeasurement",
    "Evaluation",
    "LMeasureError",
    "Lengths",
    "PoseCovariances",
    "Poses",
    "Program",
    "Rig",
    "Run",
    "Trajectory",
    "angles_from_rotation",
    "calibrate",
    "certify",
    "covariances",
    "evaluate",
    "identify",
    "lengths_from_counts",
    "limit_from_accuracy",
    "place",
    "plan_poses",
    "plan_program",
    "plot",
    "poses_from_rows",
    "read_calibration_record",
    "read_campaign",
    "read_counts",
    "read_drums",
    "read_frames",
    "read_lengths",
    "read_log",
    "read_poses",
    "read_program",
    "read_rig",
    "read_run",
    "read_trajectory",
    "read_zone",
    "reconstruct",
    "rig_from_dict",
    "rotation_from_angles",
    "scan_zone",
    "simulate",
    "span_lengths",
    "structure",
    "verify",
    "with_drums",
    "write_calibration_record",
    "write_counts",
    "write_lengths",
    "write_poses",
    "write_program",
    "write_rig",
    "write_run",
    "write_trajectory",
    "write_zone",
    "zone",
]

_HOMES = {
    "accuracy": (
        "limit_from_accuracy",
        "read_zone",
        "scan_zone",
        "write_zone",
    ),
    "acquisition.logfiles": ("read_frames",),
    "calibration": (
        "Calibration",
        "Campaign",
        "Settings as CalibrationSettings",
        "read_campaign",
    ),
    "calibration_record": (
        "CalibrationRecord",
        "read_calibration_record",
        "write_calibration_record",
    ),
    "certification": (
        "Evaluation",
        "Settings as CertificationSettings",
    ),
    "certification.sealed": ("Certificate",),
    "conventions": (
        "angles_from_rotation",
        "rotation_from_angles",
    ),
    "counts": (
        "Counts",
        "read_counts",
        "write_counts",
    ),
    "drum": (
        "DrumMeasurement",
        "read_drums",
        "with_drums",
    ),
    "lengths": (
        "Lengths",
        "lengths_from_counts",
        "read_lengths",
        "span_lengths",
        "write_lengths",
    ),
    "linkage.noun": ("Described",),
    "pipeline": (
        "calibrate",
        "certify",
        "evaluate",
        "place",
        "plan_poses",
        "plan_program",
        "plot",
        "read_log",
        "reconstruct",
        "simulate",
        "structure",
        "verify",
        "zone",
    ),
    "poses": (
        "Poses",
        "poses_from_rows",
        "read_poses",
        "write_poses",
    ),
    "program": (
        "Program",
        "read_program",
        "write_program",
    ),
    "rig": (
        "Rig",
        "read_rig",
        "rig_from_dict",
        "write_rig",
    ),
    "robots.identify": ("identify",),
    "run": (
        "Run",
        "read_run",
        "write_run",
    ),
    "trajectory": (
        "PoseCovariances",
        "Trajectory",
        "covariances",
        "read_trajectory",
        "write_trajectory",
    ),
}
"""Names by the module that has them; `A as B` is A there and B here."""
_HOME = {text.split(" as ")[-1]: (f"lmeasure.{module}", text.split(" as ")[0]) for module, names in _HOMES.items() for text in names}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from lmeasure.extras import version_of

        return version_of("lmeasure")
    if name not in _HOME:
        raise AttributeError(f"module 'lmeasure' has no attribute {name!r}")
    module, own = _HOME[name]
    value = getattr(import_module(module), own)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
