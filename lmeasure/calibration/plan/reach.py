"""Possible reference poses: the robot's box and tilts, and the poses at which every cable can be trusted."""

import math
from dataclasses import dataclass
from itertools import combinations, permutations, product

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, CalibrationError, FloatArray, conventions, se3
from lmeasure.kernels import BASE_XYZ, GUIDE_XYZ, RADIUS, counts_from_changes, least_clearances, span_lengths, wrap_geometry
from lmeasure.rig import Cable, Rig
from lmeasure.sensors import effects_of, zero_at
from lmeasure.text import message

TO_THE_EDGE = 1.25
"""Factor that stretches Sobol points, which are then cut to the unit cube: a fifth of the candidates' coordinates lie on the region's edge,
where the most informative poses are."""

AXIS_RADII = 2.0
"""An attachment point nearer to the swivel axis than this many pulley radii has no lever to turn the pulley into its plane."""


@dataclass(frozen=True)
class Region:
    """A box of the tool origin and tilts about an orientation.

    low, high (3,) [mm, base frame]; each component of the rotation vector of the tilt [base axes] lies within +-tilt_rad; quaternion
    x, y, z, w (4,) is the orientation that is tilted; angles: the convention in which poses are typed into a controller, to 0.1 mm and
    0.01 degrees, None where they are not. CalibrationError when the box is empty or the tilt makes no sense.
    """

    low: FloatArray
    high: FloatArray
    tilt_rad: float
    quaternion: FloatArray
    angles: str | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite([self.low, self.high]).all() and (self.low <= self.high).all()):
            raise CalibrationError(message("error.the_box_from_to", low=self.low.tolist(), high=self.high.tolist()))
        if not 0.0 <= self.tilt_rad <= math.pi / 2:
            raise CalibrationError(message("error.a_tilt_of_degrees", tilt_rad=math.degrees(self.tilt_rad)))

    @property
    def active(self) -> BoolArray:
        """(6,) True for the coordinates that have a range."""
        return np.concatenate([self.high > self.low, np.full(3, self.tilt_rad > 0.0)])

    @property
    def centre(self) -> FloatArray:
        """(7,) the pose in the middle."""
        return self.rows(np.full((1, 6), 0.5))[0]

    def rows(self, unit: FloatArray) -> FloatArray:
        """(n, 7) poses of (n, 6) coordinates in the unit cube, place, then tilt, as they can be typed."""
        place = self.low + unit[:, :3] * (self.high - self.low)
        turned = Rotation.from_rotvec((2.0 * unit[:, 3:] - 1.0) * self.tilt_rad) * Rotation.from_quat(self.quaternion)
        if self.angles is None:
            return se3.pose(place, turned)
        typed = conventions.rounded_angles(self.angles, conventions.angles_from_rotation(self.angles, turned))
        return se3.pose(self._typed(place), conventions.rotation_from_angles(self.angles, typed))

    def _typed(self, place: FloatArray) -> FloatArray:
        """Positions (n, 3) to 0.1 mm, within the box where it holds such values."""
        steps = np.rint(10.0 * place)
        least, most = np.ceil(10.0 * self.low - 1e-6), np.floor(10.0 * self.high + 1e-6)
        return np.where(least <= most, np.clip(steps, least, most), steps) / 10.0

    def unit(self, rows: FloatArray) -> FloatArray:
        """(n, 6) coordinates of (n, 7) poses, outside the unit cube for poses outside; 0.5 where there is no range."""
        size = np.where(self.high > self.low, self.high - self.low, 1.0)
        place = np.where(self.high > self.low, (rows[:, :3] - self.low) / size, 0.5)
        vectors = (se3.rotation(rows) * Rotation.from_quat(self.quaternion).inv()).as_rotvec()
        tilt = vectors / (2.0 * self.tilt_rad) + 0.5 if self.tilt_rad > 0.0 else np.full_like(vectors, 0.5)
        return np.column_stack([place, tilt])

    def candidates(self, log2: int, rng: np.random.Generator) -> FloatArray:
        """(2^log2, 6) scrambled Sobol coordinates, stretched so that many lie on the edges."""
        unit = scipy.stats.qmc.Sobol(6, scramble=True, rng=rng).random_base2(log2)
        unit = np.clip(0.5 + TO_THE_EDGE * (unit - 0.5), 0.0, 1.0)
        return np.where(self.active, unit, 0.5)

    def corners(self) -> FloatArray:
        """(64, 6) coordinates of all corners of the box with all corners of the tilts, fewer where a coordinate has no range."""
        ends = [(0.0, 1.0) if a else (0.5,) for a in self.active]
        return np.array(list(product(*ends)))


@dataclass(frozen=True)
class Limits:
    """Limits that keep a cable taut and its length defined.

    max_wrap_deg: largest angle wrapped on the swivel pulley; beyond 180 the free span turns back across the incoming cable. min_span_mm:
    shortest free span; min and max length_mm: from B to the attachment point, within the drum's capacity. clearance_mm: least distance
    between free spans, and from a free span to another cable's pulley. min_tension_n: least tension at the drum, if the rig states its
    tension. singular_deg: least distance to orientations whose angles are not unique in the rig's convention, at which controllers show
    arbitrary angles.
    """

    max_wrap_deg: float = 170.0
    min_span_mm: float = 100.0
    max_length_mm: float = math.inf
    clearance_mm: float = 10.0
    min_tension_n: float = 0.0
    singular_deg: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.max_wrap_deg <= 360.0:
            raise CalibrationError(message("error.a_wrap_limit_of", max_wrap_deg=self.max_wrap_deg))
        if not 0.0 <= self.min_span_mm < self.max_length_mm:
            raise CalibrationError(message("error.cables_of_to_mm", min_span_mm=self.min_span_mm, max_length_mm=self.max_length_mm))
        if not self.clearance_mm >= 0.0:
            raise CalibrationError(message("error.a_clearance_of_mm", clearance_mm=self.clearance_mm))
        if not self.min_tension_n >= 0.0:
            raise CalibrationError(message("error.a_least_tension_of", min_tension_n=self.min_tension_n))
        if not 0.0 <= self.singular_deg < 90.0:
            raise CalibrationError(message("error.degrees_from_singular_angles", singular_deg=self.singular_deg))


class Usable:
    """Distinguish usable poses from those where a cable would be slack, wrapped too far, or crossed."""

    REASONS = (
        message("calibration.cable_too_short_too"),
        message("calibration.cable_near_swivel_axis"),
        message("calibration.wrapped_too_far"),
        message("calibration.cables_crossing"),
        message("calibration.slack_cable"),
        message("calibration.angles_near_singular"),
    )

    def __init__(self, rig: Rig, cables: tuple[Cable, ...], limits: Limits, start: FloatArray) -> None:
        """start (7,): the pose at which the drums have the tension that the rig states for k = 0."""
        self._rows, self._limits, self._angles = rig.cable_rows(cables), limits, rig.angles
        drums = [rig.point(c.from_point).drum for c in cables]
        self._tension = np.array([math.nan if d.cable_tension_n is None else d.cable_tension_n for d in drums])
        self._rise = np.array([(d.cable_tension_n_per_m or 0.0) / 1000.0 for d in drums])
        self._begun = span_lengths(self._rows, np.ascontiguousarray(start[None, :]))[0]
        self._effects, self._start = effects_of(rig, cables), start
        together = [(i, j) for i, j in permutations(range(len(cables)), 2) if cables[i].passage == cables[j].passage]
        # cables to one attachment point, or from one pulley, meet there by design
        spans = [
            (i, j)
            for i, j in combinations(range(len(cables)), 2)
            if (i, j) in set(together) and cables[i].to_point != cables[j].to_point and cables[i].from_point != cables[j].from_point
        ]
        strangers = [(i, j) for i, j in together if cables[i].from_point != cables[j].from_point]
        self._pairs = np.array(spans, dtype=np.int64).reshape(-1, 2)
        self._strangers = np.array(strangers, dtype=np.int64).reshape(-1, 2)

    def broken(self, rows: FloatArray) -> BoolArray:
        """(n, 6) True where a pose (n, 7) breaks the limit that `REASONS` names."""
        rows = np.ascontiguousarray(rows)
        centre, tangent, attachment, wrap = wrap_geometry(self._rows, rows)
        span = np.linalg.norm(attachment - tangent, axis=2)
        length = span + self._rows[:, RADIUS] * wrap
        away = attachment - self._rows[:, BASE_XYZ]
        across = np.sqrt(np.maximum(np.sum(away**2, axis=2) - np.einsum("nmi,mi->nm", away, self._rows[:, GUIDE_XYZ]) ** 2, 0.0))
        clearance = least_clearances(centre, tangent, attachment, self._rows[:, RADIUS].copy(), self._pairs, self._strangers)
        # comparisons are written so that a NaN, a cable that cannot run, breaks them
        return np.column_stack(
            [
                ~((span >= self._limits.min_span_mm) & (length <= self._limits.max_length_mm)).all(axis=1),
                ~((across >= AXIS_RADII * self._rows[:, RADIUS]) | (self._rows[:, RADIUS] == 0.0)).all(axis=1),
                ~(wrap <= math.radians(self._limits.max_wrap_deg)).all(axis=1),
                ~(clearance >= self._limits.clearance_mm),
                self._slack(rows).any(axis=1),
                conventions.from_singular_deg(self._angles, se3.rotation(rows)) < self._limits.singular_deg,
            ]
        )

    def _slack(self, rows: FloatArray) -> BoolArray:
        """(n, m) True where the tension that the rig states for a cable does not hold it."""
        change = span_lengths(self._rows, rows) - self._begun
        # NaN without a stated tension, or where the cable cannot run, which other limits report
        slack = self._tension + self._rise * change <= self._limits.min_tension_n
        if self._effects is not None:
            n, m = change.shape
            zero = zero_at(self._start, m, self._effects.reference_c)
            counts = counts_from_changes(self._rows, change)
            excess = self._effects.excess(self._rows, zero, rows, counts, temperature_c=np.full((n, m), self._effects.reference_c))
            slack |= ~np.isfinite(excess) & np.isfinite(counts)
        return np.asarray(slack)

    def __call__(self, rows: FloatArray) -> BoolArray:
        """(n,) True for usable poses."""
        return np.asarray(~self.broken(rows).any(axis=1))
