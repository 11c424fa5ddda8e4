"""certificate.json: everything a certificate says, made of a measurement and nothing else, so that it can be made again and compared."""

import datetime
from collections.abc import Sequence
from typing import Any

import numpy as np

from lmeasure.catalogue import LANGUAGES as LANGUAGES
from lmeasure.certification.canonical import digest
from lmeasure.certification.evaluate import SCHEMA
from lmeasure.certification.measure import Inputs, Measured, settings_stated
from lmeasure.certification.method import METHOD
from lmeasure.findings import Finding, recognised
from lmeasure.program import Program
from lmeasure.status import Status
from lmeasure.trajectory.attained import AttainedPose

ID_DIGITS = 16


def now() -> str:
    """This moment, UTC, ISO 8601."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def certificate(
    measured: Measured,
    inputs: Inputs,
    copies: Sequence[dict[str, Any]],
    *,
    created: str,
    language: str,
    environment: dict[str, str],
    method: int = METHOD,
) -> dict[str, Any]:
    """The table of certificate.json.

    copies: {file, bytes, sha256} of the inputs in the bundle. method: another than today's whose figures are the same. The id is made of
    the content, the moment of creation included: the same inputs certified twice give the same figures_sha256 under two ids.
    """
    evaluation, trajectory = measured.evaluation, measured.trajectory
    figures = {
        "characteristics": [plain(c.as_dict()) for c in evaluation.characteristics],
        "excluded": [vars(e) | {"reason": str(e.reason)} for e in evaluation.excluded],
        "base_from_program": plain(evaluation.base_from_program),
    }
    details = measured.details.stated()
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "method": method,
        "created": created,
        "language": language,
        "kind": "test certificate" if "accreditation" in details else "test report",
        "details": details,
        "measurement": inputs.stated(),
        "inputs": list(copies),
        "settings": settings_stated(evaluation.settings),
        "environment": environment,
        "instrument": _instrument(measured),
        "trajectory": {
            "samples": len(trajectory.time_s),
            "ok": int((trajectory.status == Status.OK).sum()),
            "start_s": float(trajectory.time_s[0]) if len(trajectory.time_s) else 0.0,
            "end_s": float(trajectory.time_s[-1]) if len(trajectory.time_s) else 0.0,
        },
        "angles": evaluation.angles,
        "uncertainty_covers": str(evaluation.covers),
        "program": commanded(measured.program),
        "attained": [attained(pose) for pose in evaluation.poses],
        "notes": list(dict.fromkeys([*measured.notes, *evaluation.notes])),
        "findings": plain(_findings(measured)),
        **figures,
        "figures_sha256": digest(figures),
    }
    return {"schema": SCHEMA, "id": identification(content)} | content


def identification(content: dict[str, Any]) -> str:
    """The id of a certificate from all else in it."""
    value = digest({key: v for key, v in content.items() if key != "id"})[:ID_DIGITS].upper()
    return f"LM-{value[:8]}-{value[8:]}"


def _findings(measured: Measured) -> list[dict[str, Any]]:
    """The texts of the certificate as codes with values, each once."""
    evaluation = measured.evaluation
    told = [evaluation.covers, *(e.reason for e in evaluation.excluded), *measured.notes, *evaluation.findings]
    told += [c.note for c in evaluation.characteristics if c.note is not None]
    found = (text if isinstance(text, Finding) else recognised(text) for text in dict.fromkeys(told))
    return [f.stated() for f in found if f is not None]


def _instrument(measured: Measured) -> dict[str, Any] | None:
    if measured.rig is None:
        return None
    rig = measured.rig
    told = {"rig": rig.name, "assumed": list(rig.assumed), "calibrated": measured.calibration is not None}
    return told | {"systematic_sha256": measured.systematic_sha256}


def commanded(program: Program) -> dict[str, Any]:
    """What was commanded, at what speed and load: the program's poses and paths without their times."""
    times = {"windows_s", "settling_s", "approaches", "units"}
    rows = {key: [p.model_dump(exclude=times, exclude_defaults=True) for p in getattr(program, key)] for key in ("pose", "path")}
    return plain({"load_kg": program.load_kg} | rows)


def attained(pose: AttainedPose) -> dict[str, Any]:
    """What of a pose's cycles a later certificate can be compared with: their mean and covariance (0 for one cycle) of position [mm]."""
    positions = pose.poses[:, :3]
    covariance = np.cov(positions.T) if len(positions) > 1 else np.zeros((3, 3))
    return {
        "pose": pose.name,
        "cycles": len(positions),
        "commanded_mm": plain(pose.commanded[:3]),
        "mean_mm": plain(positions.mean(axis=0)),
        "covariance_mm2": plain(covariance),
    }


def plain(value: Any) -> Any:
    """Arrays, NumPy's numbers and tuples as what JSON knows."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value
