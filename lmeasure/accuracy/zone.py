"""Accuracy zone: where in the cell the instrument can be believed (thesis Rashoyan 2021, 5.7).

The zone's volume comes from a coarse grid, in which only cells along the zone's edge are refined.
"""

import itertools
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure import sensors
from lmeasure.accuracy.limits import Body, Limits, body_rows, broken_limits
from lmeasure.accuracy.readings import determined, readings_of
from lmeasure.accuracy.scan import Plan, Progress, block_order, chunk_size, run
from lmeasure.accuracy.zone_dataset import ABOUT, DIMS, SCHEMA, about, with_faults, within
from lmeasure.core import MAX_LENGTH_MM, AccuracyError, BoolArray, FloatArray, GeometryError, IntArray, LMeasureError, covariance_root, se3
from lmeasure.kernels import COUNT_LENGTH, FIGURES, counts_from_changes, length_gradients, span_lengths as cable_kernels_span_lengths
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.text import Message, message, table
from lmeasure.trajectory import NEAR_RAD, Assumed, Budget, RunModel, Situation, zero_readings, zeros_of

if TYPE_CHECKING:
    import xarray as xr


MOST_PARTS = 16
POINTS_AT_ONCE = 400_000


def refined_volume(inside: BoolArray, axes: list[FloatArray], ask: Callable[[FloatArray], BoolArray], tolerance: float) -> dict[str, float]:
    """Volume of the zone within the box of the nodes, and how much the last refinement changed it. inside (nx, ny, nz): nodes in the zone;
    axes: their coordinates [mm]; ask: whether (n, 3) places are in the zone. A cell of eight nodes counts whole or not at all when all its
    nodes and those of its neighbours agree; the others are cut into 2, 4, 8 and 16 parts a side, each judged by its middle, until the
    volume changes by less than the tolerance (relative). Returns the attributes refined_volume_mm3, refined_volume_change_mm3 (the last
    change), refined_parts (parts a side)."""
    steps = [np.diff(a) for a in axes]
    if any(len(s) == 0 for s in steps):
        return {"refined_volume_mm3": 0.0, "refined_volume_change_mm3": 0.0, "refined_parts": 1}
    corners = [inside[i : i + inside.shape[0] - 1, j : j + inside.shape[1] - 1, k : k + inside.shape[2] - 1]
               for i in (0, 1) for j in (0, 1) for k in (0, 1)]  # fmt: skip
    some, every = np.any(corners, axis=0), np.all(corners, axis=0)
    # a neighbour's edge may bulge into a cell whose own nodes agree
    mixed = _spread(some & ~every) | (_spread(some) & ~some)
    cell = steps[0][:, None, None] * steps[1][None, :, None] * steps[2][None, None, :]
    whole = float(cell[every & ~mixed].sum())
    cut = np.argwhere(mixed)
    low = np.column_stack([axes[d][cut[:, d]] for d in range(3)])
    size = np.column_stack([steps[d][cut[:, d]] for d in range(3)])
    volume = whole + float((cell * np.mean(corners, axis=0))[mixed].sum())
    change, parts = abs(volume), 1
    while parts < MOST_PARTS and change > tolerance * max(volume, 1e-300):
        parts *= 2
        finer = whole + _judged(low, size, parts, ask)
        change, volume = abs(finer - volume), finer
    return {"refined_volume_mm3": volume, "refined_volume_change_mm3": change, "refined_parts": parts}


def _spread(mask: BoolArray) -> BoolArray:
    """The mask and its six neighbours."""
    out = mask.copy()
    for axis in range(3):
        first, last = [slice(None)] * 3, [slice(None)] * 3
        first[axis], last[axis] = slice(None, -1), slice(1, None)
        out[tuple(first)] |= mask[tuple(last)]
        out[tuple(last)] |= mask[tuple(first)]
    return out


def _judged(low: FloatArray, size: FloatArray, parts: int, ask: Callable[[FloatArray], BoolArray]) -> float:
    """Volume of the parts whose middle is in the zone."""
    middle = (np.arange(parts) + 0.5) / parts
    fraction = np.stack(np.meshgrid(middle, middle, middle, indexing="ij"), axis=-1).reshape(-1, 3)
    total = 0.0
    stride = max(1, POINTS_AT_ONCE // len(fraction))
    for first in range(0, len(low), stride):
        at, extent = low[first : first + stride], size[first : first + stride]
        points = (at[:, None] + fraction[None] * extent[:, None]).reshape(-1, 3)
        hits = ask(points).reshape(len(at), -1).mean(axis=1)
        total += float((hits * extent.prod(axis=1)).sum())
    return total


MAX_NODES = 100_000_000
MAX_ORIENTATIONS = 100_000
SAMPLED = 500  # poses of a scan with a computation of their own, where a result cannot be carried from node to node


def axis(start: float, stop: float, step: float) -> FloatArray:
    """Nodes from start to stop, both included; AccuracyError when the step does not divide the way, or it leads beyond a kilometre."""
    if max(abs(start), abs(stop)) > MAX_LENGTH_MM:
        raise AccuracyError(message("error.lies_beyond", start=start, stop=stop, step=step, max_length_mm=MAX_LENGTH_MM))
    if not (math.isfinite(start) and math.isfinite(stop) and math.isfinite(step) and step > 0.0 and stop >= start):
        raise AccuracyError(message("error.must_be_finite_with", start=start, stop=stop, step=step))
    steps = (stop - start) / step
    if steps > MAX_NODES or abs(steps - round(steps)) > 1e-6 * max(1.0, steps):
        raise AccuracyError(message("error.the_step_does_not", start=start, stop=stop, step=step))
    return np.linspace(start, stop, round(steps) + 1)


def tilts(tilt_rad: float, steps: int, base: Rotation | None = None) -> Rotation:
    """Orientations Exp(a, b, c) R0: each component of the rotation vector [rad, base frame] over equal steps from -tilt to +tilt; one
    step means 0, as a tilt of 0 does. R0 defaults to the identity."""
    if steps < 1 or not 0.0 <= tilt_rad <= math.pi:
        raise AccuracyError(message("error.tilts_of_rad_in", tilt_rad=tilt_rad, steps=steps))
    if steps**3 > MAX_ORIENTATIONS:
        raise AccuracyError(message("error.steps_of_each_tilt", steps=steps, steps2=steps**3, max_orientations=MAX_ORIENTATIONS))
    values = np.linspace(-tilt_rad, tilt_rad, steps) if steps > 1 and tilt_rad > 0.0 else np.zeros(1)
    vectors = np.stack(np.meshgrid(values, values, values, indexing="ij"), axis=-1).reshape(-1, 3)
    turned = Rotation.from_rotvec(vectors)
    return turned if base is None else turned * base


def covariance_factor(rig: Rig, calibration: CalibrationRecord | None) -> FloatArray:
    """(13 m, r) factor F of the cables' parameters' covariance F F^T [mm, rad]; r = 0 without a record."""
    covariance = sensors.cable_covariance(rig, calibration)
    return covariance_root(covariance, np.sqrt(np.diag(covariance)))


@dataclass(frozen=True, kw_only=True)
class Scan:
    """Settings of a zone: mapped quantities and their computation.

    bodies: obstacles that the cables must not touch; start (7,): the pose at which the counters are zeroed; spacing_mm: the volume's step
    along an axis with a single node; refine: wanted relative change of the volume within the box (such as 0.002); cells along the zone's
    edge are cut (`refined_volume`); reliability: also map the detectable faults (`zone_dataset.with_faults`); workers, scheduler,
    checkpoint: as in `accuracy.scan.run`.
    """

    limits: Limits = field(default_factory=Limits)
    full: bool = False
    bodies: tuple[Body, ...] = ()
    start: FloatArray | None = None
    spacing_mm: tuple[float, float, float] | None = None
    workers: int | None = None
    scheduler: str | None = None
    checkpoint: Path | None = None
    refine: float | None = None
    reliability: bool = False


def scan_zone(
    rig: Rig,
    calibration: CalibrationRecord | None,
    *,
    x: FloatArray,
    y: FloatArray,
    z: FloatArray,
    rotations: Rotation,
    limit_deg: float = 60.0,
    length_limits: tuple[float, float] | None = None,
    progress: Progress | None = None,
    limits: Limits | None = None,
    full: bool = False,
    bodies: Sequence[Body] = (),
    start: FloatArray | None = None,
    spacing_mm: tuple[float, float, float] | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    checkpoint: Path | None = None,
    refine: float | None = None,
) -> "xr.Dataset":
    """Map an accuracy zone with each setting as an argument; `zone` has the shorter form.

    Parameters
    ----------
    rig
        The rig.
    calibration
        Its calibration record, or None.
    x, y, z
        (n,) nodes of the tool origin, base frame [mm].
    rotations
        Orientations base_from_tool that are tried at each node.
    limit_deg
        Largest pressure angle [deg], if `limits` is not given.
    length_limits
        Shortest and longest cable [mm], if `limits` is not given.
    progress
        Called with (done, total).
    limits
        All limits as one value.
    full
        True also maps the uncertainties of rotation and attachment points.
    bodies
        Bodies that cables must not touch.
    start
        (7,) pose at which the counters are zeroed.
    spacing_mm
        Step along axes that have one node.
    workers, scheduler, checkpoint
        Processes, address of a Dask scheduler, file to resume from.
    refine
        Relative accuracy of the volume for which cells at the edge are divided.

    Returns
    -------
    xarray.Dataset
        As `zone` returns it.

    Raises
    ------
    AccuracyError
        If a limit makes no sense.

    Examples
    --------
    >>> from scipy.spatial.transform import Rotation
    >>> nodes = np.array([0.0, 100.0])
    >>> lm.scan_zone(rig, None, x=nodes, y=nodes, z=nodes, rotations=Rotation.identity(1)).in_zone.shape
    (2, 2, 2)
    """
    limits = limits or Limits(limit_deg, length_limits)
    scan = Scan(limits=limits, full=full, bodies=tuple(bodies), start=start, spacing_mm=spacing_mm, refine=refine)
    scan = replace(scan, workers=workers, scheduler=scheduler, checkpoint=checkpoint)
    return map_zone(rig, calibration, (x, y, z), rotations, scan=scan, progress=progress)


def map_zone(
    rig: Rig,
    calibration: CalibrationRecord | None,
    nodes: tuple[FloatArray, FloatArray, FloatArray],
    rotations: Rotation,
    *,
    scan: Scan | None = None,
    progress: Progress | None = None,
) -> "xr.Dataset":
    """Map the worst pressure angle and uncertainty over the orientations at each node of a box, and the nodes within the limits.

    nodes: of the tool origin [mm, base frame] along x, y, z; rotations: base_from_tool orientations, all tried at each node. In the zone is
    a node where every orientation keeps the limits.

    u95_position_mm is the radius of the sphere at the tool origin that holds 95 % of the Gaussian with the covariance from independent
    counts of +-1/2 (variance c^2/12), as much again for the sub-count offset at zeroing unless that is exact (`zero_exact`), the stated
    errors of dimensions that are not solved (`lmeasure.sensors.stated_errors`) and those of a calibration. A length is counted from the
    start pose: a zone has no run yet, so its default is the box's centre with the mean orientation.

    Returns a dataset over x, y, z with `worst_pressure_angle_deg` (90 where a cable cannot run or the pose is singular), `u95_position_mm`
    (infinite there), `shortest_cable_mm`, `longest_cable_mm`, `largest_wrap_deg`, `assembly` (of six cables: sign of the determinant, 0
    where it changes), `singularity_distance` (1/|J^-1| by Frobenius, of more than six 1/|J^+|, J with moments divided by the platform's
    size: the least singular value lies between it and 2.45 times it); with `full`, `u95_rotation_deg` and `u95_attachment_mm`;
    `clearance_mm` when bodies or a clearance are given; `in_zone` (0/1), `rejected_because` (bits of `REASONS`) and attributes. Raises
    RigError for a rig that cannot determine a pose, AccuracyError for a box or a limit that makes no sense, GeometryError when a
    calibration is linked and a cable cannot run at the start pose.
    """
    scan = scan or Scan()
    limits, refine = scan.limits, scan.refine
    axes = [np.atleast_1d(np.asarray(a, dtype=np.float64)) for a in nodes]
    _check(axes)
    if refine is not None and not 0.0 < refine < 1.0:
        raise AccuracyError(message("error.refine_the_relative_change", refine=refine))
    spacing = _spacing(axes, scan.spacing_mm)
    full = scan.full or limits.needs_all
    start = scan.start
    if start is None:
        start = np.concatenate([[0.5 * (a[0] + a[-1]) for a in axes], rotations.mean().as_quat()])
    positions = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    near = bool(scan.bodies) or limits.clearance_mm is not None
    plan = make_plan(rig, calibration, positions, rotations, start=start, full=full, near=near, bodies=scan.bodies)
    way: dict[str, Any] = {"workers": scan.workers, "scheduler": scan.scheduler}

    def named(found: tuple[FloatArray, IntArray]) -> dict[str, NDArray[Any]]:
        return named_figures(*found, full=full, near=near, six=plan.six)

    import xarray as xr

    rig = rig.zeroed_at(start)
    covered, assumed = covers(rig, calibration), assumed_in_zone(rig, calibration, positions, rotations, start=start)
    shape, figures = [len(a) for a in axes], named(run(fewest_directions(plan), progress, checkpoint=scan.checkpoint, **way))
    variables: dict[str, Any] = {name: (DIMS, values.reshape(shape), about(*ABOUT[name])) for name, values in figures.items()}
    turned = ("orientation", "component"), plan.quaternions, about("orientations base_from_tool", "1")
    coords = {name: (name, values, about(f"{name} of the tool origin, base frame", "mm")) for name, values in zip(DIMS, axes, strict=True)}
    attrs: dict[str, Any] = {"schema": SCHEMA, "rig": rig.name, "node_spacing_mm": list(spacing), "u95_covers": str(covered)}
    attrs |= {"zero_pose_xyz_mm_qxyzw": [float(v) for v in start], "u95_assumed_mm": assumed.part_mm}
    attrs |= {"assumed": "\n".join(assumed.lines), "assumed_figures": json.dumps(assumed.figures())}
    attrs |= {"messages": json.dumps(table([covered, assumed.lines]), ensure_ascii=False), "plan_sha256": plan.digest()}
    data = xr.Dataset(variables | {"quaternion_xyzw": turned}, coords=coords, attrs=attrs)
    if scan.reliability:
        channels = plan.channels or readings_of(rig, calibration, start, plan.variance - sensors.length_variance(rig))
        data = with_faults(data, rig, channels, positions)
    zone = within(data, limits)
    if refine is None:
        return zone

    def inside(points: FloatArray) -> BoolArray:
        figures = named(run(replace(plan, positions=np.ascontiguousarray(points)), **way))
        return np.asarray(broken_limits(figures, limits, zone.attrs["assembly_sign"])[0] == 0)

    return zone.assign_attrs(refined_volume(zone["in_zone"].values.astype(bool), axes, inside, refine))


def make_plan(
    rig: Rig,
    calibration: CalibrationRecord | None,
    positions: FloatArray,
    rotations: Rotation,
    *,
    start: FloatArray,
    full: bool = False,
    near: bool = False,
    bodies: Sequence[Body] = (),
) -> Plan:
    """Return the scan of (n, 3) positions [mm] at all rotations; see `map_zone` for the other parameters and errors."""
    rig = rig.zeroed_at(start)
    if not rig.sensors:
        rig.require_pose(redundant=True)
    if rotations.single or len(rotations) == 0:
        raise AccuracyError(message("error.the_orientations_must_be"))
    factor = covariance_factor(rig, calibration)
    if factor.shape[1]:
        try:
            sensors.span_lengths(rig, start[None, :])
        except GeometryError as error:
            raise GeometryError(message("error.the_calibration_s_part", error=error)) from None
    # cables that share a point, or run in different passes, cannot touch elsewhere
    pairs = [
        (i, j)
        for (i, a), (j, b) in itertools.combinations(enumerate(rig.cable), 2)
        if near and a.from_point != b.from_point and a.to_point != b.to_point and a.passage == b.passage
    ]
    used = sorted({c.to_point for c in rig.cable}) if full else []
    rows, quaternions = rig.cable_rows(), np.ascontiguousarray(rotations.as_quat())
    variance, drums = sensors.length_variance(rig), drum_variance(rig, calibration, positions, rotations, start=start)
    law = variance + drums, np.sqrt(variance.min() / variance), rig.scales(), factor, np.asarray(start, dtype=np.float64)
    points = np.array([rig.tool[name] for name in used], dtype=np.float64).reshape(-1, 3)
    around = points, np.array(pairs, dtype=np.int64).reshape(-1, 2), body_rows(bodies)
    order, channels = block_order(rows, positions, quaternions), readings_of(rig, calibration, start, drums) if rig.sensors else None
    return Plan(rows, positions, quaternions, *law, *around, order, chunk_size(len(quaternions)), channels)


def at_pose(plan: Plan, rig: Rig, calibration: CalibrationRecord | None, pose: FloatArray) -> Plan:
    """Return the plan of one pose (7,) alone: its lengths vary by drums as they have turned there, not by the mean over a scan."""
    positions, quaternions = pose[None, :3], pose[None, 3:]
    drums = drum_variance(rig, calibration, positions, Rotation.from_quat(quaternions), start=plan.start)
    channels = plan.channels and replace(plan.channels, drums=np.append(drums, np.zeros(len(plan.channels.drums) - len(drums))))
    return replace(plan, positions=positions, quaternions=quaternions, variance=sensors.length_variance(rig) + drums, channels=channels)


def drum_variance(
    rig: Rig, calibration: CalibrationRecord | None, positions: FloatArray, rotations: Rotation, *, start: FloatArray
) -> FloatArray:
    """Return the (m,) variance [mm^2] of the lengths from run-out and play of drums and pulleys, as stated by the rig or left by a
    calibration. It is the mean over poses of the scan: drum and pulley may turn many times from the start to a pose. Correlations with
    guides and points in the calibration are ignored, which makes it larger."""
    effects = sensors.Unsolved(rig, sensors.of_record(rig, calibration))
    # the position within the band of known play at zeroing is unknown
    known = sensors.every_part(rig, rig.cable).values[:, sensors.PLAY] * rig.cable_rows()[:, COUNT_LENGTH] / rig.scales()
    if not effects:
        return np.asarray(known**2)
    begun = sensors.span_lengths(rig, start[None, :])
    poses = sampled(positions, rotations)
    rows = rig.cable_rows()
    lengths = cable_kernels_span_lengths(rows, poses)
    runs = np.isfinite(lengths).all(axis=1)
    counts = counts_from_changes(rows, np.ascontiguousarray(lengths[runs] - begun))
    shifts = effects.shifts(rows, sensors.zero_at(start, len(rows), 0.0), poses[runs], counts)
    # one play where it was zeroed, one at the pose
    return np.asarray((shifts**2).sum(axis=2).mean(axis=0) if runs.any() else 0.0) + 2.0 * effects.play_mm**2 + known**2


def dimension_variance(plan: Plan) -> FloatArray:
    """Return the variance [mm^2] of each cable's length, (m,), by the uncertain parameters of a plan's rig: the mean over its poses."""
    since = _parameter_changes(plan, plan.positions)
    if not since.size:
        return np.zeros(len(plan.cables))
    errors = np.einsum("nmw,mwr->nmr", since, plan.factor.reshape(len(plan.cables), -1, plan.factor.shape[1]))
    return np.asarray((errors**2).sum(axis=2).mean(axis=0))


def _parameter_changes(plan: Plan, positions: FloatArray) -> FloatArray:
    """(n, m, WIDTH) derivatives of the lengths' changes since the start by the parameters at poses from all over a plan's scan of
    positions; no pose (n = 0) of a plan without uncertain parameters, or where no cable can run."""
    poses, rows, start = sampled(positions, Rotation.from_quat(plan.quaternions)), plan.cables, plan.start[None]
    lengths, begun = cable_kernels_span_lengths(rows, poses), cable_kernels_span_lengths(rows, start)
    runs = np.isfinite(lengths).all(axis=1) & bool(plan.factor.shape[1])
    counts = counts_from_changes(rows, np.ascontiguousarray(lengths[runs] - begun))
    here = length_gradients(rows, poses[runs], counts, plan.scales)
    return here - length_gradients(rows, start, np.zeros((1, len(rows))), plan.scales)


NEGLIGIBLE = 1e-14
"""Part of a length's own variance that directions left out of a factor may have."""
BETWEEN = 4.0
"""Times more than at the sampled poses that variance is taken to be at any pose between them."""


def fewest_directions(plan: Plan) -> Plan:
    """Return the plan with each cable's parameters in the fewest directions that matter at its poses, for a faster scan with the same U95.

    With the kept part A of the lengths' errors and the rest E, whose covariance E E^T <= e^2 D for the lengths' own D, any pose has
    D + (A + E)(A + E)^T <= (1 + e + e^2)(D + A A^T): variances and factor grow by that, so that U95 never shrinks, and by e/2 < 4e-7 (six
    cables) at most. The errors of m cables add up to E E^T <= m diag(E E^T).
    """
    # several orientations at each of few positions
    since = _parameter_changes(plan, np.repeat(plan.positions, -(-SAMPLED // len(plan.positions)), axis=0))
    if plan.channels is not None or not since.size:
        return plan
    m = len(plan.cables)
    factor, rest = plan.factor.reshape(m, -1, plan.factor.shape[1]).copy(), 0.0
    for j in range(m):
        whole, limit = since[:, j] @ factor[j], NEGLIGIBLE * plan.variance[j]
        # parameters whose parts together are too small, at a quarter of the limit, and their gradients need not be computed
        parts = np.abs(since[:, j]).max(axis=0) * np.linalg.norm(factor[j], axis=1)
        order = np.argsort(parts)
        factor[j, order[np.cumsum(parts[order]) ** 2 <= 0.25 * limit]] = 0.0
        _, _, directions = np.linalg.svd(since[:, j] @ factor[j], full_matrices=False)
        for rank in range(len(directions)):
            fewer = factor[j] @ directions[:rank].T @ directions[:rank]
            if ((whole - since[:, j] @ fewer) ** 2).sum(axis=1).max() <= limit:
                factor[j] = fewer
                break
        rest = max(rest, float(((whole - since[:, j] @ factor[j]) ** 2).sum(axis=1).max() / plan.variance[j]))
    e = math.sqrt(BETWEEN * m * rest)
    growth = 1.0 + e + e * e
    return replace(plan, factor=factor.reshape(plan.factor.shape) * math.sqrt(growth), variance=plan.variance * growth)


def assumed_in_zone(
    rig: Rig, calibration: CalibrationRecord | None, positions: FloatArray, rotations: Rotation, *, start: FloatArray, share: float = 0.5
) -> Assumed:
    """Return the part of U95 from typical sizes that are not stated, at the best share of a scan's positions. Start and temperature are a
    run's."""
    model = RunModel(rig.zeroed_at(start), start, calibration)
    try:
        budget = Budget(model)
    except LMeasureError:
        return Assumed()
    rows, poses = model.scheme.rows, sampled(positions, rotations)
    changes = sensors.span_rows(rows, poses)[0] - zero_readings(model, rows, model.zero_pose)
    runs = np.isfinite(changes).all(axis=1)
    if not runs.any():
        return Assumed()
    poses, counts = poses[runs], counts_from_changes(rows, np.ascontiguousarray(changes[runs]))
    nothing = np.zeros_like(counts)
    found = budget.of(Situation(np.zeros(len(poses)), poses, counts, nothing), compiled=False)
    spread = np.einsum("nii->n", (found.random + found.systematic)[:, 3:, 3:])
    determines = np.isfinite(spread)
    if not determines.any():
        return Assumed()
    well = determines & (spread <= np.quantile(spread[determines], share))
    return budget.assumed(Situation(np.zeros(int(well.sum())), poses[well], counts[well], nothing[well]), places=True)


def sampled(positions: FloatArray, rotations: Rotation) -> FloatArray:
    """(n, 7) poses from all over a scan, at most `SAMPLED` of them: places at equal steps, orientations in turn."""
    chosen = positions[:: -(-len(positions) // SAMPLED)]
    turns = rotations.as_quat()
    return np.ascontiguousarray(np.column_stack([chosen, turns[np.arange(len(chosen)) % len(turns)]]))


def named_figures(figures: FloatArray, flags: IntArray, *, full: bool, near: bool, six: bool) -> dict[str, NDArray[Any]]:
    """(n,) arrays by the dataset's names, of the kernels' (F, n) figures and (n,) flags; of more than six cables, whose rows have no
    determinant, no assembly."""
    f = dict(zip(FIGURES, figures, strict=True))
    out = {
        "worst_pressure_angle_deg": np.degrees(np.arccos(1.0 / np.sqrt(f["speed2"]))),
        "u95_position_mm": f["u95_position"],
        "shortest_cable_mm": np.where(np.isfinite(f["shortest"]), f["shortest"], np.nan),
        "longest_cable_mm": f["longest"],
        "largest_wrap_deg": np.degrees(f["wrap"]),
        "singularity_distance": 1.0 / np.sqrt(f["norm2"]),
        "flags": flags,
    }
    if six:
        out["assembly"] = np.where(f["determinant_low"] > 0, 1, np.where(f["determinant_high"] < 0, -1, 0)).astype(np.int8)
    if full:
        out |= {"u95_rotation_deg": np.degrees(f["u95_rotation"]), "u95_attachment_mm": f["u95_attachment"]}
    return out | {"clearance_mm": f["clearance"]} if near else out


def covers(rig: Rig, calibration: CalibrationRecord | None) -> Message:
    """Return the sources that the uncertainties cover."""
    exact = sensors.zeroed_exactly(rig)
    counts = message("covers.counts" if exact.all() else "covers.counts_some_phase" if exact.any() else "covers.counts_phase")
    zeros = zeros_of(rig, calibration)
    if zeros.any():
        counts = message("covers.zeros_first_order" if zeros.max() > NEAR_RAD else "covers.zeros", counts=counts)
    unsolved = sensors.stated(rig, None, () if calibration is None else calibration.names)
    also = tuple(dict.fromkeys(v.kind.said for v in unsolved if not v.assumed))
    parts = [message("accuracy.rig_states", what=also)] if also else []
    parts += [message("covers.of.assumed")] if any(v.assumed for v in unsolved) else []
    parts += [message("covers.calibration")] if calibration is not None else []
    if not parts:
        return message("accuracy.only_rig_links_no", counts=counts)
    both = reduce(lambda first, then: message("covers.two", first=first, then=then), parts)
    code = "covers.change_uncalibrated" if calibration is None else "covers.change"
    return message(code, parts=message("covers.both", counts=counts, parts=both))


def _check(axes: Sequence[FloatArray]) -> None:
    for name, values in zip(DIMS, axes, strict=True):
        if values.ndim != 1 or not len(values) or not np.isfinite(values).all() or (np.diff(values) <= 0).any():
            raise AccuracyError(message("error.the_nodes_along_must", name=name))
        if len(values) > 2 and np.ptp(np.diff(values)) > 1e-6 * (values[-1] - values[0]):
            raise AccuracyError(message("error.the_nodes_along_must_be", name=name))
    if math.prod(len(a) for a in axes) > MAX_NODES:
        raise AccuracyError(message("error.the_box_has_nodes", prod=math.prod(len(a) for a in axes), max_nodes=MAX_NODES))


def _spacing(axes: Sequence[FloatArray], given: tuple[float, float, float] | None) -> tuple[float, float, float]:
    """Step of each axis [mm]; a single node has the given step, or none (0)."""
    steps = [(a[-1] - a[0]) / (len(a) - 1) if len(a) > 1 else (given[i] if given else 0.0) for i, a in enumerate(axes)]
    return float(steps[0]), float(steps[1]), float(steps[2])


NODES = 20  # About how many steps the longest side has
FLATTEST = 0.5  # Least side of the box, relative to its longest one. Points on one wall or ceiling leave the tool room on both sides
LEAST_MM = 1000.0  # The longest side at least

Range = tuple[float, float, float]


def box_around(rig: Rig) -> tuple[Range, Range, Range]:
    """Return (start, stop, step) along x, y, z [mm, base frame]: the box of the observation points and of the base frame's origin, at the
    robot's foot. Its edges are whole multiples of one step: 1, 2 or 5 times a power of ten."""
    points = np.array([(0.0, 0.0, 0.0), *(rig.point(name).position_mm for name in dict.fromkeys(c.from_point for c in rig.cable))])
    low, high = points.min(axis=0), points.max(axis=0)
    longest = max(float((high - low).max()), LEAST_MM)
    half = 0.5 * np.maximum(high - low, FLATTEST * longest)
    half[np.argmax(high - low)] = 0.5 * longest
    step, middle = _round(longest / NODES), 0.5 * (low + high)
    first, last = np.floor((middle - half) / step) * step, np.ceil((middle + half) / step) * step
    x, y, z = ((float(a), float(b), step) for a, b in zip(first, last, strict=True))
    return x, y, z


def _round(value: float) -> float:
    """The least 1, 2 or 5 with zeros that is not below the value."""
    ten = 10.0 ** math.floor(math.log10(value))
    return next(ten * m for m in (1.0, 2.0, 5.0, 10.0) if ten * m >= value * (1.0 - 1e-9))


CHUNK = 4096


class Ellipsoids(NamedTuple):
    """covariance (n, 3, 3) [mm^2] of the tool origin, base axes; weakest (n,) index of the cable with the largest pressure angle, angle_deg
    (n,) that angle. Where a cable cannot run or the pose is singular: NaN, 0 and 90."""

    covariance: FloatArray
    weakest: IntArray
    angle_deg: FloatArray


def ellipsoids(rig: Rig, calibration: CalibrationRecord | None, places: FloatArray, turn: Rotation, *, start: FloatArray) -> Ellipsoids:
    """Return the ellipsoids at (n, 3) places of the tool origin [mm] at one orientation base_from_tool, by the laws of
    `accuracy.zone.map_zone`; start (7,): pose at which the counters are zeroed."""
    rig = rig.zeroed_at(start)
    drums = drum_variance(rig, calibration, places, Rotation.from_quat([turn.as_quat()]), start=start)
    readings, poses = readings_of(rig, calibration, start, drums), se3.pose(places, turn)
    covariance, weakest, angle = np.full((len(poses), 3, 3), np.nan), np.zeros(len(poses), dtype=np.int64), np.full(len(poses), 90.0)
    for first in range(0, len(poses), CHUNK):
        found = determined(readings, poses[first : first + CHUNK])
        known = first + np.flatnonzero(found.known)
        covariance[known] = found.covariance[:, 3:, 3:]
        cables = found.speed[:, : readings.cables]
        weakest[known] = cables.argmax(axis=1)
        angle[known] = np.degrees(np.arccos(1.0 / np.maximum(cables.max(axis=1), 1.0)))
    return Ellipsoids(covariance, weakest, angle)
