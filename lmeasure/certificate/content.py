"""certificate.json: the content of a certificate, made of a measurement alone, so that it can be made again and compared."""

import datetime
import hashlib
import math
import platform
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding
import numpy as np

from lmeasure.certificate.inputs import Inputs, Measured, settings_stated
from lmeasure.certificate.signature import digest
from lmeasure.core import FloatArray, Status, plug_in_version, version_of
from lmeasure.iso9283 import SCHEMA, key_of, quantity_of
from lmeasure.recording import Program
from lmeasure.text import LANGUAGES as LANGUAGES, table
from lmeasure.trajectory import AttainedPose

MOST = 10
"""Results that are shown first."""
SMALL = 0.05
"""Share of the variance [%] below which rows are shown together."""
HALF = 0.25
"""Part of the variance that is left if u is halved."""
LEAST_FACTOR = 0.2
"""Smaller than by this factor a source is not made alone: the next one has its part too."""


class Chosen(NamedTuple):
    """A figure of certificate.json, and of how many of its name it is the worst."""

    figure: Mapping[str, Any]
    of: int


def chosen(certificate: Mapping[str, Any]) -> list[Chosen]:
    """Return at most `MOST` results, the worst of each name. Names with a stated tolerance come first.

    The worst has the smallest probability to lie within its tolerance, or without a tolerance the largest magnitude. Excluded parts of the
    program have no results.
    """
    by_name: dict[str, list[Mapping[str, Any]]] = {}
    for figure in certificate["characteristics"]:
        if not figure.get("excluded"):
            by_name.setdefault(str(figure["name"]), []).append(figure)
    known = sorted((n for n in by_name if _place(n)[0] < math.inf or _held(by_name[n])), key=lambda n: (not _held(by_name[n]), _place(n)))
    return [Chosen(min(by_name[n], key=_goodness), len(by_name[n])) for n in sorted(known[:MOST], key=_place)]


def _place(name: str) -> tuple[float, str]:
    """Return the rank of a name: the most informative first; a component has the rank of its vector."""
    known = quantity_of(name)
    return (math.inf if known is None else known.summary.get(name, math.inf), name)


def _held(figures: Sequence[Mapping[str, Any]]) -> bool:
    return any("conformity" in f for f in figures)


def _goodness(figure: Mapping[str, Any]) -> tuple[float, float]:
    held = figure.get("conformity")
    return (2.0 if held is None else float(held["probability"]), -abs(float(figure["value"])))


class Gathered(NamedTuple):
    """Rows of a budget, the largest first, and those that are too small to be shown alone."""

    rows: list[Mapping[str, Any]]
    small: list[Mapping[str, Any]]

    @property
    def together(self) -> tuple[float, float]:
        """Contribution and share [%] of the small ones."""
        return math.hypot(*(row["contribution"] for row in self.small)), sum(row["share_percent"] for row in self.small)


def gathered(budget: Sequence[Mapping[str, Any]]) -> Gathered:
    """Return the rows of a budget by size."""
    rows = sorted(budget, key=lambda row: -row["share_percent"])
    large = [row for row in rows if row["share_percent"] >= SMALL]
    return Gathered(large, rows[len(large) :])


def halving(budget: Sequence[Mapping[str, Any]]) -> tuple[list[str], float]:
    """Return the fewest sources which, all this many times smaller, halve the standard uncertainty; none where it is zero."""
    rows, share = sorted(budget, key=lambda row: -row["share_percent"]), 0.0
    for i, row in enumerate(rows, 1):
        share += row["share_percent"] / 100.0
        square = (HALF - (1.0 - share)) / share if share > 0.0 else 0.0
        if square >= LEAST_FACTOR**2:
            return [str(one["source"]) for one in rows[:i]], 1.0 / math.sqrt(square)
    return [], 1.0


def correlations(figures: Sequence[Mapping[str, Any]], matrix: FloatArray | None, results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the coefficients of correlation between those of these results that have a linear law; matrix (n, n) of the first n."""
    of = {key_of(f): i for i, f in enumerate(figures[: 0 if matrix is None else len(matrix)])}
    own = [of[key_of(r)] for r in results if key_of(r) in of]
    table = [] if matrix is None else matrix[own][:, own].tolist()
    return {"results": [str(key_of(figures[i])) for i in own], "coefficients": table}


METHOD = 1
"""Raised whenever the same inputs give other results, or the same results another verdict."""


LIBRARIES = ("numpy", "scipy", "numba", "llvmlite", "pandas", "pyarrow", "pydantic", "plotly", "typst", "segno", "xlsxwriter")

PLUG_IN = "plug-in "


@cache
def sources_sha256() -> str:
    """SHA-256 over the names and digests of this package's own sources."""
    root = Path(__file__).parents[1]
    digest = hashlib.sha256()
    sources = [path for kind in ("py", "typ", "po", "css", "js", "html", "toml", "json", "npz") for path in root.rglob(f"*.{kind}")]
    for path in sorted(sources, key=lambda p: p.relative_to(root).as_posix()):
        digest.update(f"{path.relative_to(root).as_posix()} {hashlib.sha256(path.read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()


def environment(added: Iterable[str] = ()) -> dict[str, str]:
    """Versions of the program, Python and the libraries that compute or print, and the processor kernels are compiled for.

    added names the characteristics that other packages add: each has the version of its package under PLUG_IN and its name.
    """
    return {
        "lmeasure": version_of("lmeasure"),
        "lmeasure sources": sources_sha256(),
        "python": platform.python_version(),
        **{name: version_of(name) for name in LIBRARIES},
        "system": f"{platform.system()} {platform.machine()}",
        "processor": llvmlite.binding.get_host_cpu_name(),
        **{f"{PLUG_IN}{name}": plug_in_version("lmeasure.characteristics", name) for name in added},
    }


def added_in(stated: Iterable[str]) -> list[str]:
    """Return the characteristics of other packages that a certificate's environment names."""
    return [key.removeprefix(PLUG_IN) for key in stated if key.startswith(PLUG_IN)]


ID_DIGITS = 16


def now() -> str:
    """This moment, UTC, ISO 8601."""
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="microseconds").replace("+00:00", "Z")


def certificate(
    measured: Measured, inputs: Inputs, copies: Sequence[dict[str, Any]], *, created: str, language: str, environment: dict[str, str]
) -> dict[str, Any]:
    """The table of certificate.json.

    copies: {file, bytes, sha256} of the inputs in the bundle. The id is made of the content, the moment of creation included:
    the same inputs certified twice give the same figures_sha256 under two ids.
    """
    evaluation, trajectory = measured.evaluation, measured.trajectory
    figures = {
        "characteristics": [plain(c.as_dict()) for c in evaluation.characteristics],
        "excluded": [vars(e) | {"reason": str(e.reason)} for e in evaluation.excluded],
        "base_from_program": plain(evaluation.base_from_program),
    }
    details = measured.details.stated()
    main = [one.figure for one in chosen(figures)]
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "method": METHOD,
        "created": created,
        "language": language,
        "kind": "test certificate" if "accreditation" in details else "test report",
        "details": details,
        "measurement": inputs.stated(),
        "inputs": list(copies),
        "settings": settings_stated(evaluation.settings),
        "environment": environment,
        "instrument": _instrument(measured),
        "measured_with": _measured_with(measured),
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
        "notes": list(dict.fromkeys(map(str, [*measured.notes, *evaluation.notes]))),
        "findings": plain(_findings(measured)),
        **figures,
        "correlations": correlations(figures["characteristics"], evaluation.correlation, main),
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
    reported = [evaluation.covers, *(e.reason for e in evaluation.excluded), *measured.notes, *evaluation.notes]
    reported += [c.note for c in evaluation.characteristics if c.note is not None]
    reported += [row.source for c in evaluation.characteristics for row in c.budget]
    return table(list(reported))


def _instrument(measured: Measured) -> dict[str, Any] | None:
    if measured.rig is None:
        return None
    rig = measured.rig
    reported = {"rig": rig.name, "assumed": list(rig.assumed), "calibrated": measured.calibration is not None}
    return reported | {"systematic_sha256": measured.systematic_sha256}


def _measured_with(measured: Measured) -> dict[str, Any] | None:
    """Return the instrument for the reader: cables, encoders, the base of its calibration, and the distance to its limits."""
    rig, record = measured.rig, measured.calibration
    if rig is None:
        return None
    drums = [rig.point(c.from_point).drum for c in rig.cable]
    reported: dict[str, Any] = {
        "cables": len(rig.cable),
        "observation_points": len({c.from_point for c in rig.cable}),
        "passes": rig.passes,
        "counts_per_revolution": sorted({d.counts_per_revolution for d in drums}),
        "count_length_mm": sorted({d.count_length_mm for d in drums}),
        "worst_pressure_angle_deg": max((p.angle_deg for p in measured.evaluation.poses if np.isfinite(p.angle_deg)), default=None),
        "calibration": None,
    }
    if record is not None:
        reported["calibration"] = {
            "reference_poses": len({r.pose for r in record.residuals}),
            "equations": record.equations,
            "unknowns": record.unknowns,
            "residual_rms_mm": record.noise.get("residual_rms_mm"),
        }
    return plain(reported)


def commanded(program: Program) -> dict[str, Any]:
    """Return the commands, speed and load: the program's poses and paths without their times."""
    times = {"windows_s", "settling_s", "approaches", "units"}
    rows = {key: [p.model_dump(exclude=times, exclude_defaults=True) for p in getattr(program, key)] for key in ("pose", "path")}
    return plain({"load_kg": program.load_kg} | rows)


def attained(pose: AttainedPose) -> dict[str, Any]:
    """Return the part of a pose's cycles that a later certificate is compared with: their mean and covariance (0 for one cycle) of position
    [mm]."""
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
    """Return arrays, NumPy's numbers and tuples as JSON's types."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return value
