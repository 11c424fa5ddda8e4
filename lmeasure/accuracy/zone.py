"""Accuracy zone: where in the cell the instrument can be believed (thesis Rashoyan 2021, 5.7)."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure import files
from lmeasure.calibration_record import CalibrationRecord
from lmeasure.errors import AccuracyError, FileFormatError, GeometryError
from lmeasure.kernels import zone as kernels
from lmeasure.lengths import cable_covariance, count_variance, span_lengths
from lmeasure.rig import Rig

FloatArray = NDArray[np.float64]
Progress = Callable[[int, int], None]

SCHEMA = "lmeasure.zone/1"
MAX_NODES = 100_000_000
POSES_PER_CHUNK = 100_000

REASONS = ("cable_cannot_run", "singular", "pressure_angle", "cable_too_short", "cable_too_long", "u95_position")
"""Why a node is not in the zone, in the order of the bits of `rejected_because`."""


def axis(start: float, stop: float, step: float) -> FloatArray:
    """Nodes from start to stop, both included; AccuracyError when the step does not divide the way."""
    if not (math.isfinite(start) and math.isfinite(stop) and math.isfinite(step) and step > 0.0 and stop >= start):
        raise AccuracyError(f"{start:g}:{stop:g}:{step:g}: must be finite, with start <= stop and step > 0")
    steps = (stop - start) / step
    if steps > MAX_NODES or abs(steps - round(steps)) > 1e-6 * max(1.0, steps):
        raise AccuracyError(f"{start:g}:{stop:g}:{step:g}: the step does not divide the way from start to stop, both ends included")
    return np.linspace(start, stop, round(steps) + 1)


def tilts(tilt_rad: float, steps: int, base: Rotation | None = None) -> Rotation:
    """Orientations Exp(a, b, c) R0: each component of the rotation vector [rad, base frame] over equal steps from -tilt to +tilt; one
    step means 0. R0 defaults to the identity."""
    if steps < 1 or not 0.0 <= tilt_rad <= math.pi:
        raise AccuracyError(f"tilts of {tilt_rad:g} rad in {steps} steps: the tilt must lie in [0, pi] and there must be a step")
    values = np.linspace(-tilt_rad, tilt_rad, steps) if steps > 1 else np.zeros(1)
    vectors = np.stack(np.meshgrid(values, values, values, indexing="ij"), axis=-1).reshape(-1, 3)
    turned = Rotation.from_rotvec(vectors)
    return turned if base is None else turned * base


def covariance_factor(rig: Rig, calibration: CalibrationRecord | None) -> FloatArray:
    """(6 * 13, r) factor F of the cables' parameters' covariance F F^T [mm, rad]; r = 0 without a record."""
    covariance = cable_covariance(rig, calibration)
    width = np.sqrt(np.diag(covariance))
    # the same parameter stands at every cable that shares it: factor what is left, in units of its own width
    scaled = covariance / np.outer(np.where(width > 0, width, 1.0), np.where(width > 0, width, 1.0))
    values, vectors = np.linalg.eigh(scaled)
    kept = values > 1e-14 * max(values[-1], 0.0) if values[-1] > 0 else np.zeros(len(values), bool)
    return np.ascontiguousarray(width[:, None] * vectors[:, kept] * np.sqrt(values[kept]))


def scan_zone(
    rig: Rig,
    calibration: CalibrationRecord | None,
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
    rotations: Rotation,
    limit_deg: float = 60.0,
    length_limits: tuple[float, float] | None = None,
    progress: Progress | None = None,
    *,
    u95_limit_mm: float | None = None,
    start: FloatArray | None = None,
    spacing_mm: tuple[float, float, float] | None = None,
) -> xr.Dataset:
    """Worst pressure angle and uncertainty over the orientations, at each node of a box, and what lies within the limits.

    x, y, z: nodes of the tool origin [mm, base frame]; rotations: base_from_tool orientations, all tried at each node. In the zone is a
    node whose worst pressure angle is at most limit_deg, whose cables stay within length_limits (shortest, longest, B to
    attachment point [mm]) and whose 95 % radius is at most u95_limit_mm, at every orientation.

    u95_position_mm is the radius of the sphere at the tool origin that holds 95 % of the Gaussian with the covariance from
    independent counts of +-1/2 (variance c^2/12) and, when given, the calibration's. A length is counted from the pose at which the
    counters are zeroed, start (7,): a zone has no run yet, so the default is the box's centre with the mean orientation.
    spacing_mm is needed for the volume only where an axis has a single node.

    Returns a dataset over x, y, z with `worst_pressure_angle_deg` (90 where a cable cannot run or the pose is singular),
    `u95_position_mm` (infinite there), `shortest_cable_mm`, `longest_cable_mm`, `in_zone` (0/1), `rejected_because` (bits of
    `REASONS`) and attributes. Raises RigError for a rig that cannot tell a pose, AccuracyError for a box or a limit that makes no
    sense, GeometryError when a calibration is linked and a cable cannot run at the start pose.
    """
    rig.require_pose()
    axes = [np.atleast_1d(np.asarray(a, dtype=np.float64)) for a in (x, y, z)]
    _check(axes, rotations, limit_deg, length_limits, u95_limit_mm)
    spacing = _spacing(axes, spacing_mm)
    if start is None:
        start = np.concatenate([[0.5 * (a[0] + a[-1]) for a in axes], rotations.mean().as_quat()])
    factor = covariance_factor(rig, calibration)
    if factor.shape[1]:
        try:
            span_lengths(rig, start[None, :])
        except GeometryError as error:
            raise GeometryError(f"the calibration's part needs the pose at which the counters are zeroed: {error}") from None
    shape = tuple(len(a) for a in axes)
    positions = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    quaternions = np.ascontiguousarray(rotations.as_quat())
    parts = []
    stride = max(1, POSES_PER_CHUNK // len(quaternions))
    for first in range(0, len(positions), stride):
        chunk = positions[first : first + stride]
        parts.append(kernels.scan(rig.cable_rows(), chunk, quaternions, count_variance(rig), rig.scales(), factor, start))
        if progress:
            progress(min(first + stride, len(positions)), len(positions))
    angle, u95, shortest, longest, flags = (np.concatenate(column).reshape(shape) for column in zip(*parts, strict=True))
    dims = ("x", "y", "z")
    data = xr.Dataset(
        {
            "worst_pressure_angle_deg": (
                dims,
                np.degrees(angle),
                _about("largest pressure-angle analogue over the orientations", "degree"),
            ),
            "u95_position_mm": (dims, u95, _about("radius at the tool origin that holds 95 %, worst over the orientations", "mm")),
            "shortest_cable_mm": (dims, np.where(np.isfinite(shortest), shortest, np.nan), _about("shortest cable, B to attachment", "mm")),
            "longest_cable_mm": (dims, longest, _about("longest cable, B to attachment point", "mm")),
            "flags": (dims, flags),
            "quaternion_xyzw": (("orientation", "component"), quaternions, _about("orientations base_from_tool", "1")),
        },
        coords={
            name: (name, values, _about(f"{name} of the tool origin, base frame", "mm")) for name, values in zip(dims, axes, strict=True)
        },
        attrs={
            "schema": SCHEMA,
            "rig": rig.name,
            "node_spacing_mm": list(spacing),
            "u95_covers": _covers(calibration),
            "zero_pose_xyz_mm_qxyzw": [float(v) for v in start],
        },
    )
    return _within(data, limit_deg, length_limits, u95_limit_mm)


def _covers(calibration: CalibrationRecord | None) -> str:
    if calibration is None:
        return "counts of +-1/2 (variance c^2/12 each) only: the rig links no calibration"
    return (
        "counts of +-1/2 (variance c^2/12 each) and the linked calibration's covariance, of the change of each length since the counters "
        "were zeroed at zero_pose_xyz_mm_qxyzw"
    )


def _within(data: xr.Dataset, limit_deg: float, length_limits: tuple[float, float] | None, u95_limit_mm: float | None) -> xr.Dataset:
    """The dataset with the limits applied: in_zone, rejected_because and the volume."""
    shortest, longest = length_limits if length_limits else (0.0, math.inf)
    flags = data["flags"].values
    broken = (
        flags & kernels.CANNOT_RUN != 0,
        flags & kernels.SINGULAR != 0,
        ~(data["worst_pressure_angle_deg"].values <= limit_deg),
        data["shortest_cable_mm"].values < shortest,
        data["longest_cable_mm"].values > longest,
        ~(data["u95_position_mm"].values <= u95_limit_mm) if u95_limit_mm is not None else np.zeros(flags.shape, bool),
    )
    because = sum((mask.astype(np.int32) << bit for bit, mask in enumerate(broken)), np.zeros(flags.shape, np.int32))
    dims = ("x", "y", "z")
    out = data.drop_vars("flags").assign(
        in_zone=(dims, (because == 0).astype(np.int8), _about("1 where every orientation is within every limit", "1")),
        rejected_because=(
            dims,
            because,
            _about("limits broken at some orientation", "1")
            | {"flag_masks": np.array([1 << bit for bit in range(len(REASONS))], np.int32), "flag_meanings": " ".join(REASONS)},
        ),
    )
    inside = int((because == 0).sum())
    limits: dict[str, Any] = {"limit_deg": float(limit_deg)}
    if length_limits:
        limits["length_limits_mm"] = [float(v) for v in length_limits]
    if u95_limit_mm is not None:
        limits["u95_limit_mm"] = float(u95_limit_mm)
    return out.assign_attrs(limits | {"zone_volume_mm3": inside * math.prod(data.attrs["node_spacing_mm"]), "nodes_in_zone": inside})


def _about(text: str, units: str) -> dict[str, Any]:
    return {"long_name": text, "units": units}


def _check(
    axes: Sequence[FloatArray],
    rotations: Rotation,
    limit_deg: float,
    length_limits: tuple[float, float] | None,
    u95_limit_mm: float | None,
) -> None:
    for name, values in zip("xyz", axes, strict=True):
        if values.ndim != 1 or not len(values) or not np.isfinite(values).all() or (np.diff(values) <= 0).any():
            raise AccuracyError(f"the nodes along {name} must be finite and rise")
        if len(values) > 2 and np.ptp(np.diff(values)) > 1e-6 * (values[-1] - values[0]):
            raise AccuracyError(f"the nodes along {name} must be equally spaced")
    if math.prod(len(a) for a in axes) > MAX_NODES:
        raise AccuracyError(f"the box has {math.prod(len(a) for a in axes)} nodes; at most {MAX_NODES} are scanned at once")
    if rotations.single or len(rotations) == 0:
        raise AccuracyError("the orientations must be a list of at least one rotation")
    if not 0.0 < limit_deg <= 90.0:
        raise AccuracyError(f"a pressure-angle limit of {limit_deg:g} degrees: it must lie in (0, 90]")
    if length_limits is not None and not 0.0 <= length_limits[0] < length_limits[1]:
        raise AccuracyError(f"cable lengths of {length_limits[0]:g} to {length_limits[1]:g} mm: the limits must rise from 0 or more")
    if u95_limit_mm is not None and not u95_limit_mm > 0.0:
        raise AccuracyError(f"a 95 % radius of {u95_limit_mm:g} mm: the limit must be positive")


def _spacing(axes: Sequence[FloatArray], given: tuple[float, float, float] | None) -> tuple[float, float, float]:
    """Step of each axis [mm]; a single node has the given step, or none (0)."""
    steps = [(a[-1] - a[0]) / (len(a) - 1) if len(a) > 1 else (given[i] if given else 0.0) for i, a in enumerate(axes)]
    return float(steps[0]), float(steps[1]), float(steps[2])


def summary(zone: xr.Dataset) -> str:
    """A few lines for a person: how much of the box is in the zone, the best node, why the rest is not."""
    angle, inside = zone["worst_pressure_angle_deg"], zone["in_zone"].values.astype(bool)
    best = np.unravel_index(int(np.argmin(angle.values)), angle.shape)
    where = ", ".join(f"{name} {float(zone[name][i]):g}" for name, i in zip("xyz", best, strict=True))
    lines = [
        f"{inside.sum()} of {inside.size} nodes are in the zone ({zone.sizes['orientation']} orientations each, within "
        f"{zone.attrs['limit_deg']:g} deg): {zone.attrs['zone_volume_mm3'] / 1e9:.6g} m^3",
        f"smallest worst pressure angle {float(angle.values[best]):.2f} deg at {where} mm",
    ]
    if inside.any():
        u95 = zone["u95_position_mm"].values[inside]
        lines.append(f"95 % radius at the tool origin in the zone: {u95.min():.4g} to {u95.max():.4g} mm")
    because = zone["rejected_because"].values
    counts = {reason: int((because >> bit & 1).sum()) for bit, reason in enumerate(REASONS)}
    if rejected := [f"{reason.replace('_', ' ')} {n}" for reason, n in counts.items() if n]:
        lines.append("rejected nodes by reason: " + ", ".join(rejected))
    return "\n".join([*lines, f"the 95 % radius covers {zone.attrs['u95_covers']}"])


def write_zone(path: Path, zone: xr.Dataset) -> None:
    """Write netCDF-4, whole or not at all."""
    with files.whole(path) as temporary:
        zone.to_netcdf(temporary, engine="h5netcdf", format="NETCDF4")


def read_zone(path: Path) -> xr.Dataset:
    """Read what `write_zone` wrote, into memory; FileFormatError names the file and what it lacks."""
    files.read_bytes(path)
    try:
        with xr.open_dataset(path, engine="h5netcdf") as stored:
            data = stored.load()
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise FileFormatError(f"{path}: cannot be read as netCDF: {' '.join(str(error).split())}") from error
    if data.attrs.get("schema") != SCHEMA:
        raise FileFormatError(f"{path}: schema = {data.attrs.get('schema')!r}; this program reads {SCHEMA!r}")
    return data
