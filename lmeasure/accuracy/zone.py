"""Accuracy zone: where in the cell the instrument can be believed (thesis Rashoyan 2021, 5.7)."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure import files
from lmeasure.accuracy.bodies import Body, body_rows
from lmeasure.accuracy.refinement import refined_volume
from lmeasure.accuracy.scan import Plan, Progress, block_order, chunk_size, digest_of, run, with_positions
from lmeasure.calibration_record import CalibrationRecord
from lmeasure.errors import AccuracyError, FileFormatError, GeometryError
from lmeasure.kernels import zone as kernels
from lmeasure.lengths import cable_covariance, count_variance, span_lengths
from lmeasure.rig import Rig

FloatArray = NDArray[np.float64]

SCHEMA = "lmeasure.zone/1"
MAX_NODES = 100_000_000
DIMS = ("x", "y", "z")

REASONS = (
    "cable_cannot_run",
    "singular",
    "pressure_angle",
    "cable_too_short",
    "cable_too_long",
    "u95_position",
    "u95_rotation",
    "u95_attachment",
    "wrap",
    "clearance",
    "other_assembly",
    "near_singular",
)
"""Why a node is not in the zone, in the order of the bits of `rejected_because`."""


@dataclass(frozen=True)
class Limits:
    """What a pose must keep to lie in the zone; None asks nothing.

    angle_deg: pressure-angle analogue; length_mm: shortest and longest cable, B to attachment point; u95_mm, u95_rotation_deg,
    u95_attachment_mm: 95 % radii of the tool origin, the rotation vector and the worst attachment point; wrap_deg: largest wrapped angle;
    clearance_mm: least distance between cables and from cable to body; one_assembly: the determinant keeps its sign;
    singularity: least `singularity_distance`.
    """

    angle_deg: float = 60.0
    length_mm: tuple[float, float] | None = None
    u95_mm: float | None = None
    u95_rotation_deg: float | None = None
    u95_attachment_mm: float | None = None
    wrap_deg: float | None = None
    clearance_mm: float | None = None
    one_assembly: bool = False
    singularity: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.angle_deg <= 90.0:
            raise AccuracyError(f"a pressure-angle limit of {self.angle_deg:g} degrees: it must lie in (0, 90]")
        if self.length_mm is not None and not 0.0 <= self.length_mm[0] < self.length_mm[1]:
            raise AccuracyError(f"cable lengths of {self.length_mm[0]:g} to {self.length_mm[1]:g} mm: the limits must rise from 0 or more")
        for name in ("u95_mm", "u95_rotation_deg", "u95_attachment_mm", "wrap_deg", "clearance_mm", "singularity"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < math.inf:
                raise AccuracyError(f"{name} = {value:g}: a limit must be a number, 0 or more")

    @property
    def needs_all(self) -> bool:
        """Whether the radii of rotation and attachment points are asked for."""
        return self.u95_rotation_deg is not None or self.u95_attachment_mm is not None


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
    limits: Limits | None = None,
    full: bool = False,
    bodies: Sequence[Body] = (),
    start: FloatArray | None = None,
    spacing_mm: tuple[float, float, float] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    checkpoint: Path | None = None,
    refine: float | None = None,
) -> xr.Dataset:
    """Worst pressure angle and uncertainty over the orientations, at each node of a box, and what lies within the limits.

    x, y, z: nodes of the tool origin [mm, base frame]; rotations: base_from_tool orientations, all tried at each node. In the zone is a
    node where every orientation keeps the limits: limit_deg and length_limits, or all that `Limits` knows when `limits` is given.
    bodies are what the cables must not touch. start (7,) is the pose at which the counters are zeroed; spacing_mm the volume's step along
    an axis with a single node; refine asks for the volume within the box to this relative change (0.002, say), by cutting the cells along
    the zone's edge (`accuracy.refinement.refined_volume`); workers, scheduler and checkpoint are those of `accuracy.scan.run`.

    u95_position_mm is the radius of the sphere at the tool origin that holds 95 % of the Gaussian with the covariance from
    independent counts of +-1/2 (variance c^2/12) and, when given, the calibration's. A length is counted from the start pose: a zone
    has no run yet, so its default is the box's centre with the mean orientation.

    Returns a dataset over x, y, z with `worst_pressure_angle_deg` (90 where a cable cannot run or the pose is singular),
    `u95_position_mm` (infinite there), `shortest_cable_mm`, `longest_cable_mm`, `largest_wrap_deg`, `assembly` (sign of the determinant, 0
    where it changes), `singularity_distance` (1/|J^-1| by Frobenius, J with moments divided by the platform's size: the least
    singular value lies between it and 2.45 times it); with `full`, `u95_rotation_deg` and `u95_attachment_mm`; `clearance_mm` when
    bodies or a clearance are given; `in_zone` (0/1), `rejected_because` (bits of `REASONS`) and attributes. Raises RigError for a rig that
    cannot tell a pose, AccuracyError for a box or a limit that makes no sense, GeometryError when a calibration is linked and a
    cable cannot run at the start pose.
    """
    limits = limits or Limits(limit_deg, length_limits)
    axes = [np.atleast_1d(np.asarray(a, dtype=np.float64)) for a in (x, y, z)]
    _check(axes)
    spacing = _spacing(axes, spacing_mm)
    full = full or limits.needs_all
    if start is None:
        start = np.concatenate([[0.5 * (a[0] + a[-1]) for a in axes], rotations.mean().as_quat()])
    positions = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    near = bool(bodies) or limits.clearance_mm is not None
    plan = make_plan(rig, calibration, positions, rotations, start, full=full, near=near, bodies=bodies)
    way: dict[str, Any] = {"workers": workers, "scheduler": scheduler}
    figures, flags = run(plan, progress, checkpoint=checkpoint, **way)
    data = xr.Dataset(
        {
            name: (DIMS, values.reshape([len(a) for a in axes]), _about(*ABOUT[name]))
            for name, values in named_figures(figures, flags, full, near).items()
        }
        | {"quaternion_xyzw": (("orientation", "component"), plan.quaternions, _about("orientations base_from_tool", "1"))},
        coords={
            name: (name, values, _about(f"{name} of the tool origin, base frame", "mm")) for name, values in zip(DIMS, axes, strict=True)
        },
        attrs={
            "schema": SCHEMA,
            "rig": rig.name,
            "node_spacing_mm": list(spacing),
            "u95_covers": covers(calibration),
            "zero_pose_xyz_mm_qxyzw": [float(v) for v in start],
            "plan_sha256": plan.digest(),
        },
    )
    zone = within(data, limits)
    if refine is None:
        return zone

    def inside(points: FloatArray) -> NDArray[np.bool_]:
        named = named_figures(*run(with_positions(plan, points), **way), full, near)
        return np.asarray(broken_limits(named, limits, zone.attrs["assembly_sign"])[0] == 0)

    return zone.assign_attrs(refined_volume(zone["in_zone"].values.astype(bool), axes, inside, refine))


def make_plan(
    rig: Rig,
    calibration: CalibrationRecord | None,
    positions: FloatArray,
    rotations: Rotation,
    start: FloatArray,
    *,
    full: bool = False,
    near: bool = False,
    bodies: Sequence[Body] = (),
) -> Plan:
    """The scan of (n, 3) positions [mm] at all rotations; see `scan_zone` for the rest and what is raised."""
    rig.require_pose()
    if rotations.single or len(rotations) == 0:
        raise AccuracyError("the orientations must be a list of at least one rotation")
    factor = covariance_factor(rig, calibration)
    if factor.shape[1]:
        try:
            span_lengths(rig, start[None, :])
        except GeometryError as error:
            raise GeometryError(f"the calibration's part needs the pose at which the counters are zeroed: {error}") from None
    # cables that share a point, or run in different passes, cannot touch elsewhere
    pairs = [
        (i, j)
        for (i, a), (j, b) in itertools.combinations(enumerate(rig.cable), 2)
        if near and a.from_point != b.from_point and a.to_point != b.to_point and a.passage == b.passage
    ]
    used = sorted({c.to_point for c in rig.cable}) if full else []
    rows, quaternions = rig.cable_rows(), np.ascontiguousarray(rotations.as_quat())
    return Plan(
        cables=rows,
        positions=positions,
        quaternions=quaternions,
        variance=count_variance(rig),
        scales=rig.scales(),
        factor=factor,
        start=np.asarray(start, dtype=np.float64),
        points=np.array([rig.tool[name] for name in used], dtype=np.float64).reshape(-1, 3),
        pairs=np.array(pairs, dtype=np.int64).reshape(-1, 2),
        bodies=body_rows(bodies),
        order=block_order(rows, positions, quaternions),
        nodes_per_chunk=chunk_size(len(quaternions)),
    )


def named_figures(figures: FloatArray, flags: NDArray[np.int64], full: bool, near: bool) -> dict[str, NDArray[Any]]:
    """(n,) arrays by the dataset's names, of the kernels' (F, n) figures and (n,) flags."""
    f = dict(zip(kernels.FIGURES, figures, strict=True))
    out = {
        "worst_pressure_angle_deg": np.degrees(np.arccos(1.0 / np.sqrt(f["speed2"]))),
        "u95_position_mm": f["u95_position"],
        "shortest_cable_mm": np.where(np.isfinite(f["shortest"]), f["shortest"], np.nan),
        "longest_cable_mm": f["longest"],
        "largest_wrap_deg": np.degrees(f["wrap"]),
        "singularity_distance": 1.0 / np.sqrt(f["norm2"]),
        "assembly": np.where(f["determinant_low"] > 0, 1, np.where(f["determinant_high"] < 0, -1, 0)).astype(np.int8),
        "flags": flags,
    }
    if full:
        out |= {"u95_rotation_deg": np.degrees(f["u95_rotation"]), "u95_attachment_mm": f["u95_attachment"]}
    return out | {"clearance_mm": f["clearance"]} if near else out


ABOUT = {
    "worst_pressure_angle_deg": ("largest pressure-angle analogue, worst over the orientations", "degree"),
    "u95_position_mm": ("radius at the tool origin that holds 95 %, worst over the orientations", "mm"),
    "u95_rotation_deg": ("radius of the rotation vector that holds 95 %, worst over the orientations", "degree"),
    "u95_attachment_mm": ("radius at the worst attachment point that holds 95 %, worst over the orientations", "mm"),
    "shortest_cable_mm": ("shortest cable, B to attachment point", "mm"),
    "longest_cable_mm": ("longest cable, B to attachment point", "mm"),
    "largest_wrap_deg": ("largest angle that a cable wraps around its swivel pulley", "degree"),
    "singularity_distance": ("least 1/|J^-1|, J with moments divided by the platform's size", "1"),
    "clearance_mm": ("least distance between cables, and from cable to body", "mm"),
    "assembly": ("sign of the determinant, 0 where it changes", "1"),
    "flags": ("cable cannot run 1, singular 2", "1"),
}


def covers(calibration: CalibrationRecord | None) -> str:
    """What the uncertainties hold, in words."""
    if calibration is None:
        return "counts of +-1/2 (variance c^2/12 each) only: the rig links no calibration"
    return (
        "counts of +-1/2 (variance c^2/12 each) and the linked calibration's covariance, of the change of each length since the counters "
        "were zeroed at zero_pose_xyz_mm_qxyzw"
    )


def broken_limits(figures: Mapping[str, NDArray[Any]], limits: Limits, sign: int | None = None) -> tuple[NDArray[np.int32], int]:
    """Bits of `REASONS` for arrays of figures named as in the dataset, with `flags`; and the assembly's sign.

    The assembly that `one_assembly` keeps is the given sign, or that of most places without another fault.
    """
    flags = figures["flags"]
    shortest, longest = limits.length_mm or (0.0, math.inf)
    nothing = np.zeros(flags.shape, bool)

    def over(name: str, limit: float | None) -> NDArray[np.bool_]:
        return nothing if limit is None else ~(figures[name] <= limit)

    def under(name: str, limit: float | None) -> NDArray[np.bool_]:
        return nothing if limit is None else ~(figures[name] >= limit)

    broken = [
        flags & kernels.CANNOT_RUN != 0,
        flags & kernels.SINGULAR != 0,
        over("worst_pressure_angle_deg", limits.angle_deg),
        figures["shortest_cable_mm"] < shortest,
        figures["longest_cable_mm"] > longest,
        over("u95_position_mm", limits.u95_mm),
        over("u95_rotation_deg", limits.u95_rotation_deg),
        over("u95_attachment_mm", limits.u95_attachment_mm),
        over("largest_wrap_deg", limits.wrap_deg),
        under("clearance_mm", limits.clearance_mm),
        nothing,
        under("singularity_distance", limits.singularity),
    ]
    if sign is None:
        sign = 1 if figures["assembly"][~np.any(broken, axis=0)].sum() >= 0 else -1
    if limits.one_assembly:
        broken[REASONS.index("other_assembly")] = figures["assembly"] != sign
    return sum((mask.astype(np.int32) << bit for bit, mask in enumerate(broken)), np.zeros(flags.shape, np.int32)), sign


def within(data: xr.Dataset, limits: Limits) -> xr.Dataset:
    """The dataset with the limits applied: in_zone, rejected_because, volume."""
    because, sign = broken_limits({str(name): values.values for name, values in data.data_vars.items()}, limits)
    inside = because == 0
    masks = np.array([1 << bit for bit in range(len(REASONS))], np.int32)
    out = data.assign(
        in_zone=(DIMS, inside.astype(np.int8), _about("1 where every orientation is within every limit", "1")),
        rejected_because=(
            DIMS,
            because,
            _about("limits broken at some orientation", "1") | {"flag_masks": masks, "flag_meanings": " ".join(REASONS)},
        ),
    )
    named = {f"limit_{name}": value for name, value in asdict(limits).items() if value is not None and value is not False}
    out = out.assign_attrs(
        {"limit_deg": float(limits.angle_deg)}
        | {name: list(value) if isinstance(value, tuple) else float(value) for name, value in named.items()}
        | {
            "zone_volume_mm3": float(inside.sum() * math.prod(data.attrs["node_spacing_mm"])),
            "nodes_in_zone": int(inside.sum()),
            "assemblies_in_zone": len(np.unique(data["assembly"].values[inside])),
            "assembly_sign": sign,
        }
    )
    return out.assign_attrs(result_sha256=digest_of({str(name): out[name].values for name in sorted(map(str, out.data_vars))}))


def _about(text: str, units: str) -> dict[str, Any]:
    return {"long_name": text, "units": units}


def _check(axes: Sequence[FloatArray]) -> None:
    for name, values in zip(DIMS, axes, strict=True):
        if values.ndim != 1 or not len(values) or not np.isfinite(values).all() or (np.diff(values) <= 0).any():
            raise AccuracyError(f"the nodes along {name} must be finite and rise")
        if len(values) > 2 and np.ptp(np.diff(values)) > 1e-6 * (values[-1] - values[0]):
            raise AccuracyError(f"the nodes along {name} must be equally spaced")
    if math.prod(len(a) for a in axes) > MAX_NODES:
        raise AccuracyError(f"the box has {math.prod(len(a) for a in axes)} nodes; at most {MAX_NODES} are scanned at once")


def _spacing(axes: Sequence[FloatArray], given: tuple[float, float, float] | None) -> tuple[float, float, float]:
    """Step of each axis [mm]; a single node has the given step, or none (0)."""
    steps = [(a[-1] - a[0]) / (len(a) - 1) if len(a) > 1 else (given[i] if given else 0.0) for i, a in enumerate(axes)]
    return float(steps[0]), float(steps[1]), float(steps[2])


def reasons(zone: xr.Dataset) -> dict[str, int]:
    """How many nodes each of `REASONS` takes from the zone; a node may have several."""
    because = zone["rejected_because"].values
    return {reason: int((because >> bit & 1).sum()) for bit, reason in enumerate(REASONS)}


def summary(zone: xr.Dataset) -> str:
    """A few lines for a person: how much of the box is in the zone, the best node, why the rest is not."""
    angle, inside = zone["worst_pressure_angle_deg"], zone["in_zone"].values.astype(bool)
    if "refined_volume_mm3" in zone.attrs:
        a = zone.attrs
        change = f"{a['refined_volume_change_mm3'] / 1e9:.2g} m^3 at the last step"
        lines_refined = [f"volume within the box, edge refined: {a['refined_volume_mm3'] / 1e9:.6g} m^3 (changed by {change})"]
    else:
        lines_refined = []
    best = np.unravel_index(int(np.argmin(angle.values)), angle.shape)
    where = ", ".join(f"{name} {float(zone[name][i]):g}" for name, i in zip("xyz", best, strict=True))
    lines = [
        f"{inside.sum()} of {inside.size} nodes are in the zone ({zone.sizes['orientation']} orientations each, within "
        f"{zone.attrs['limit_deg']:g} deg): {zone.attrs['zone_volume_mm3'] / 1e9:.6g} m^3",
        *lines_refined,
        f"smallest worst pressure angle {float(angle.values[best]):.2f} deg at {where} mm",
    ]
    if inside.any():
        u95 = zone["u95_position_mm"].values[inside]
        lines.append(f"95 % radius at the tool origin in the zone: {u95.min():.4g} to {u95.max():.4g} mm")
    if zone.attrs["assemblies_in_zone"] > 1:
        lines.append("the zone holds more than one assembly: between its parts the cables do not determine the pose (--one-assembly)")
    if rejected := [f"{reason.replace('_', ' ')} {n}" for reason, n in reasons(zone).items() if n]:
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
