"""Figures that are read from the motion itself: settling (7.4, 7.5), stabilisation length (8.5) and posing time (9).

Their limits are crossed or their extremes taken between samples: `motion` says how a motion is read there, and what the counts make it err
by. Errors common to the run cancel in distances from where the robot stands; deviations from a commanded path have them, of a fitted
frame those of the base's.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.certification import iso9283_path, iso9283_time
from lmeasure.certification.attained import window
from lmeasure.certification.characteristic import Characteristic
from lmeasure.certification.corners import Corner, at_corner
from lmeasure.certification.motion import MARGIN, Motion, Reading, Stretch, Told
from lmeasure.certification.paths import Crossings
from lmeasure.certification.uncertainty import NORMAL_95
from lmeasure.errors import CertificationError
from lmeasure.program import CommandedPath, CommandedPose, Posing, Program
from lmeasure.trajectory import Trajectory


class NotReachedError(CertificationError):
    """A limit that the robot does not reach: its figure is left out of the certificate, and the certificate says so."""


def samples_of(program: Program, trajectory: Trajectory) -> IntArray:
    """(k,) samples at whose errors `settling` and `posing` look: the places in their windows."""
    asked = [(f"pose {p.name}, settling", w) for p in program.pose for w in p.settling_s]
    asked += [(f"posing {p.name}", w) for p in program.posing for w in p.windows_s]
    parts = [window(trajectory, *w, what) for what, w in asked]
    return np.array([part.start + i for part in parts for i in (0, Stretch.rested(part.stop - part.start)[0])], dtype=np.int64)


def settling(pose: CommandedPose, band_mm: float | None, motion: Motion) -> list[Characteristic]:
    """t_s and OV of a pose with settling_s: mean and largest of its cycles. band_mm: the pose's repeatability, for want of limit_band_mm.

    CertificationError when no band is known or the robot never comes to rest within it.
    """
    band = pose.limit_band_mm or band_mm
    if band is None:
        raise CertificationError(f"pose {pose.name}: settling_s needs limit_band_mm, or two cycles for the pose's repeatability")

    def both(time_s: FloatArray, from_rest: FloatArray) -> FloatArray:
        distance = _distance(from_rest)
        times = iso9283_time.stabilisation_time(time_s, distance, band)
        return np.stack([times, iso9283_time.excursion(distance, band)], axis=-1)

    def largest(excursions: FloatArray, axis: int = -1) -> FloatArray:
        return iso9283_time.overshoot(excursions, band, axis)

    names = [f"pose {pose.name}, settling {cycle}" for cycle in range(1, len(pose.settling_s) + 1)]
    cycles = [motion.stretch(*w, what, begins=False) for what, w in zip(names, pose.settling_s, strict=True)]
    farthest = max(float(_distance(s.poses[:, :3] - s.poses[s.places[-1], :3].mean(axis=0)).max()) for s in cycles)
    told = motion.read(cycles, Reading(both, _distance, band, np.array([_longest(cycles), farthest]), largest=True))
    for what, (start, end), value in zip(names, pose.settling_s, told.values, strict=True):
        if not np.isfinite(value).all():
            raise NotReachedError(f"{what}: the robot does not come to rest within {band:.4g} mm in the window [{start:g}, {end:g}] s")
    note = f"limit band {band:.4g} mm" + ("" if pose.limit_band_mm else ", the pose's repeatability")
    of_pose = partial(_over_cycles, told, pose=pose.name, note=note)
    overshoot = of_pose(1, "OV", "7.5", "mm", over=largest, above=band)
    if overshoot.u95 >= band:
        # no draw errs by a band but those that never leave it again: then all of it may be none
        overshoot = replace(overshoot, u95=max(overshoot.u95, overshoot.value))
    return [of_pose(0, "t_s", "7.4", "s"), overshoot]


def posing(asked: Posing, band_mm: float | None, motion: Motion) -> list[Characteristic]:
    """t_min of a move between two poses, mean of its cycles; band_mm: repeatability of the pose at its end, for want of limit_band_mm."""
    band = asked.limit_band_mm or band_mm
    if band is None:
        raise CertificationError(f"posing {asked.name}: needs limit_band_mm, or two cycles of {asked.to_pose} for its repeatability")

    def time(time_s: FloatArray, from_start: FloatArray, from_rest: FloatArray) -> FloatArray:
        return iso9283_time.posing_time(time_s, _distance(from_start), _distance(from_rest), band)[..., None]

    names = [f"posing {asked.name}, cycle {cycle}" for cycle in range(1, len(asked.windows_s) + 1)]
    cycles = [motion.stretch(*w, what, begins=True) for what, w in zip(names, asked.windows_s, strict=True)]
    told = motion.read(cycles, Reading(time, _distance, band, np.array([_longest(cycles)])))
    for what, (start, end), value in zip(names, asked.windows_s, told.values, strict=True):
        if not np.isfinite(value).all():
            raise NotReachedError(f"{what}: the window [{start:g}, {end:g}] s holds no move from rest to rest within {band:.4g} mm")
    note = f"limit band {band:.4g} mm; from the beginning of the motion, not from the command"
    return [_over_cycles(told, 0, "t_min", "9", "s", pose=asked.name, note=note)]


def stabilisation(crossed: Crossings, corner: Corner, path: CommandedPath, motion: Motion) -> list[Characteristic]:
    """SPL behind a corner, mean of the cycles, of a path with stabilisation_mm."""
    limit = path.stabilisation_mm
    assert limit is not None

    def length(_: FloatArray, from_corner: FloatArray) -> FloatArray:
        return iso9283_path.stabilisation_length(from_corner @ corner.outgoing, deviation(from_corner), limit)[..., None]

    def deviation(from_corner: FloatArray) -> FloatArray:
        along = from_corner @ corner.outgoing
        return np.where(along >= 0.0, _distance(from_corner - along[..., None] * corner.outgoing), 0.0)

    cycles = []
    for number, cycle in enumerate(crossed.cycles, 1):
        passing = at_corner(cycle, corner, f"path {path.name}, cycle {number}")
        part = slice(max(passing.behind.start - MARGIN, 0), passing.behind.stop)
        place = np.array([passing.behind.start - part.start])
        cycles.append(Stretch(cycle.samples[part], cycle.time_s[part], cycle.poses[part], (place,)))
    never = np.array([0.5 * corner.after_mm])
    told = motion.read(cycles, Reading(length, deviation, limit, never, origin=corner.place))
    for number, value in enumerate(told.values, 1):
        if not np.isfinite(value).all():
            raise NotReachedError(
                f"path {path.name}, cycle {number}: corner {corner.number}: the robot is not back within {limit:g} mm half way to the next"
            )
    return [_over_cycles(told, 0, "SPL", "8.5", "mm", path=path.name, part=f"corner {corner.number}", note=f"back within {limit:g} mm")]


def _distance(vectors: FloatArray) -> FloatArray:
    """Their lengths."""
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


def _longest(cycles: list[Stretch]) -> float:
    """How long [s] the longest lasts."""
    return max(float(s.time_s[-1] - s.time_s[0]) for s in cycles)


def _over_cycles(
    told: Told,
    figure: int,
    name: str,
    clause: str,
    unit: str,
    *,
    note: str,
    over: Callable[..., FloatArray] = np.mean,
    above: float = -np.inf,
    pose: str | None = None,
    path: str | None = None,
    part: str | None = None,
) -> Characteristic:
    """A characteristic of figures taken over the cycles, of which those above a value are alike; another run errs anew."""
    u95, value = told.u95(figure, over, above), float(over(told.values[:, figure]))
    return Characteristic(name, clause, value, unit, u95, False, len(told.values), pose, path, part, u95 / NORMAL_95, 0.0, note=note)
