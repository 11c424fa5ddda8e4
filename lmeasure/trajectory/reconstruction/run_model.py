"""Model of a run: the scheme of its cables, physical effects, its start, clocks and temperature, as one frozen value.

The scheme states the freedoms that a rig's cables measure, and those that a constraint fixes. The correction removes temperature, stretch
and sag: it gives the changes of a rig without them, and their uncertainty.
"""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray, RigError, se3
from lmeasure.kernels import ATTACHMENT_XYZ, COMPLIANCE, KIND, span_rows
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.sensors import MAX_ROUNDS, REFERENCE_C, Effects, Lengths, Zero, effects_of, zero_at
from lmeasure.text import Message, message
from lmeasure.trajectory.uncertainty.sources import PassClock, loose_zeros

FREEDOMS = ("rx", "ry", "rz", "x", "y", "z")
"""Components of the twist (omega; v) in base axes, v at the tool origin."""

CONSTRAINTS = {"planar": ("rz", "x", "y"), "vertical-axis": ("rz", "x", "y", "z")}
"""Freedoms under each constraint of a rig: a stage in the base XY plane, a tool whose axis stays vertical (SCARA)."""

CABLES_FOR_A_POINT = 3


@dataclass(frozen=True)
class Scheme:
    """Solved freedoms. rows (m, columns) of the kernels, of all channels (`Rig.observed`); free: the components of the twist that can
    change; point: the one attachment point whose position is measured when orientation is not, else None; held: the freedoms that a
    constraint fixes."""

    rows: FloatArray
    free: tuple[str, ...]
    point: str | None = None
    held: str = ""
    constraint: str = ""
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)  # Of that point in the tool frame
    six: bool = field(init=False)  # Six cables to a free body and nothing else: as many equations as unknowns, the screw method proper
    free_index: IntArray = field(init=False)  # (f,) indices of the free components
    redundancy: int = field(init=False)  # Channels beyond the least number

    def __post_init__(self) -> None:
        six = len(self.rows) == len(self.free) == len(FREEDOMS) and not self.rows[:, KIND].any()
        object.__setattr__(self, "six", six)
        object.__setattr__(self, "free_index", np.array([FREEDOMS.index(name) for name in self.free], dtype=np.int64))
        object.__setattr__(self, "redundancy", len(self.rows) - len(self.free))

    def start_of(self, start: FloatArray) -> FloatArray:
        """The start pose (7,); of the attachment point where only that is measured."""
        if self.point is None:
            return start
        return np.concatenate([se3.apply(start, self.place), [0.0, 0.0, 0.0, 1.0]])


def scheme_of(rig: Rig, start: FloatArray, constraint: str | None = None) -> Scheme:
    """Return the scheme of a rig; a constraint given here replaces the rig's. start (7,) decides the freedoms that too few cables leave
    unmeasured. RigError if the cables cannot determine the pose: too few, naming the freedoms, or to attachment points on one line."""
    held = constraint or rig.constraint
    rows, used = rig.cable_rows(rig.observed), sorted({c.to_point for c in rig.observed if c.to_point})
    m = len(rows)
    has = {"name": rig.name, "m": m, "channels": "cables" if m == len(rig.cable) else "channels"}
    if held is not None:
        if held not in CONSTRAINTS:
            raise RigError(message("error.constraint_is_not_one", held=held, constraints=", ".join(CONSTRAINTS)))
        free = CONSTRAINTS[held]
        if m < len(free):
            raise RigError(message("error.rig_has_constraint_leaves", **has, held=held, n=len(free), free=", ".join(free)))
        return Scheme(rows, free, held=", ".join(f for f in FREEDOMS if f not in free), constraint=held)
    if len(used) == 1 and not rig.measures_turns:
        if m < CABLES_FOR_A_POINT:
            raise RigError(message("error.rig_has_to_its", **has, used=used[0], cables_for_a_point=CABLES_FOR_A_POINT))
        rows[:, ATTACHMENT_XYZ] = 0.0
        return Scheme(rows, FREEDOMS[3:], point=used[0], place=rig.tool[used[0]])
    if m < len(FREEDOMS):
        lacks = {"n_freedoms": len(FREEDOMS) - m, "unmeasured": _unmeasured(rows, start)}
        raise RigError(message("error.rig_has_and_leaves", **has, **lacks, constraints=" or ".join(repr(c) for c in CONSTRAINTS)))
    if not rig.measures_turns:
        rig.require_spread()
    return Scheme(rows, FREEDOMS)


def _unmeasured(rows: FloatArray, start: FloatArray) -> str:
    """The twists that no cable sees, as turns about an axis or shifts along it, tool origin taken as the place of the axis."""
    J = span_rows(rows, start)
    size = max(float(np.linalg.norm(rows[:, ATTACHMENT_XYZ], axis=1).max()), 1.0)
    _, _, V = np.linalg.svd(J * np.repeat([1.0 / size, 1.0], 3))
    texts = []
    for twist in V[len(rows) :]:
        # in units of the platform: a turn of 1/size rad moves its rim by 1 mm
        k = int(np.argmax([np.linalg.norm(twist[:3]), np.linalg.norm(twist[3:])]))
        axis = twist[3 * k : 3 * k + 3] / np.linalg.norm(twist[3 * k : 3 * k + 3])
        axis = axis if axis[np.argmax(np.abs(axis))] > 0 else -axis
        kind = "a turn about" if k == 0 else "a shift along"
        texts.append(f"{kind} ({', '.join(f'{a:.2f}' for a in axis)})")
    return " and ".join(texts)


SETTLED_MM = 1e-10


class Correction:
    """Removes temperature, stretch and sag from the changes of a run that starts at a pose (7,); temperature_c: at the start, if known."""

    def __init__(self, effects: Effects, scheme: Scheme, start: FloatArray, temperature_c: float | None) -> None:
        self._effects, self._scheme, self._start, self._temperature_c = effects, scheme, start, temperature_c

    @property
    def thermal(self) -> bool:
        """Return whether temperature has an effect."""
        return self._effects.thermal

    @property
    def notes(self) -> tuple[Message, ...]:
        """Return a note if the rig states thermal effects without a known temperature."""
        if self._effects.thermal and self._temperature_c is None:
            return (message("temperature.not_stated", reference_c=self._effects.reference_c),)
        return ()

    def corrected(self, lengths: Lengths, solve: Callable[[FloatArray], FloatArray]) -> Lengths:
        """The lengths with changes to which the rig's plain geometry belongs; solve gives the poses (n, 7) of changes (n, m). The excess
        depends on the pose, by a strain's part of it: pose and excess are found in turn, which gains three digits a round."""
        m = lengths.lengths
        counts = lengths.counts[:, :m]
        zero, warm = self._situation(counts, None if lengths.temperature_c is None else lengths.temperature_c[:, :m])
        rows, change = self._scheme.rows[:m], lengths.change_mm
        excess = np.zeros_like(change)
        for _ in range(MAX_ROUNDS):
            poses = solve(change - excess)
            found = self._effects.checked_excess(rows, zero, poses, counts, temperature_c=warm)
            moved = np.abs(found - excess[:, :m])
            # without a pose the last one stays: the sample has its status from its neighbours
            excess[:, :m] = np.where(np.isfinite(found), found, excess[:, :m])
            if not np.nanmax(moved, initial=0.0) > SETTLED_MM:
                break
        return replace(lengths, change_mm=change - excess)

    @property
    def sources(self) -> int:
        """Return how many variables are uncertain."""
        effects = self._effects
        thermal = 2 if effects.u_temperature_k > 0.0 and effects.thermal else 0
        return len(effects.moved) + thermal + int((effects.u_tension_change_n * effects.rows[:, COMPLIANCE] > 0.0).sum())

    def shifts(self, poses: FloatArray, counts: FloatArray, temperature_c: FloatArray | None) -> FloatArray:
        """(n, m, q) changes of the modelled lengths by one standard uncertainty of each property, of the temperature at the start and
        later, and of each cable's tension, at (n, 7) poses, counts (n, m) and temperatures (n, m)."""
        zero, warm = self._situation(counts, temperature_c)
        rows = self._scheme.rows[: counts.shape[1]]
        given = rows, zero, poses, counts
        by_temperature = self._effects.temperature_shifts(*given, temperature_c=warm)
        out = [*self._effects.property_shifts(*given, temperature_c=warm), *(by_temperature or ())]
        friction = self._effects.tension_shift(rows, poses)
        if friction is not None:
            out += [friction * own for own, u in zip(np.eye(friction.shape[1]), self._effects.u_tension_change_n, strict=True) if u > 0.0]
        return np.moveaxis(np.array(out).reshape(len(out), *counts.shape), 0, 2)

    def reference_shift(self, poses: FloatArray, counts: FloatArray, temperature_c: FloatArray | None, kelvin: float) -> FloatArray:
        """Return (n, m) changes of the modelled lengths if the rig has its dimensions at a temperature that is so much lower."""
        zero, warm = self._situation(counts, temperature_c)
        rows = self._scheme.rows[: counts.shape[1]]
        warmer = replace(zero, temperature_c=zero.temperature_c + kelvin)
        higher = self._effects.excess(rows, warmer, poses, counts, temperature_c=warm + kelvin)
        return higher - self._effects.excess(rows, zero, poses, counts, temperature_c=warm)

    def _situation(self, counts: FloatArray, temperature_c: FloatArray | None) -> tuple[Zero, FloatArray]:
        """Return the run's start, and the temperatures (n, m) of its samples."""
        start = self._effects.reference_c if self._temperature_c is None else self._temperature_c
        known = np.nan if temperature_c is None else temperature_c
        warm = np.where(np.isfinite(known), known, np.full(counts.shape, start))
        return zero_at(self._start, counts.shape[1], start), warm


@dataclass(frozen=True, eq=False)
class RunModel:
    """Model of a run before its counts are read.

    start (7,): pose at which the counters were zeroed, or the found beginning of the run; begun (m,): changes of the channels at such a
    found pose, else None. constraint replaces the rig's. u_start, assumed_start: as in `StartErrors`; exact: whether an unstated
    temperature is exact; clocks: those of each pass's time against pass 1's; repeatability_mm: standard deviation, per axis, of the robot
    between passes; temperature_c: as stated for the start, measured_c: that of the counts there, each None if unknown.
    """

    rig: Rig
    start: FloatArray
    calibration: CalibrationRecord | None = None
    constraint: str | None = None
    _: KW_ONLY
    u_start: tuple[float, ...] = (0.0, 0.0)
    assumed_start: tuple[str, ...] = ("", "", "")
    exact: bool = True
    clocks: tuple[PassClock, ...] = ()
    repeatability_mm: float = 0.0
    temperature_c: float | None = None
    measured_c: float | None = None
    begun: FloatArray | None = None

    @cached_property
    def scheme(self) -> Scheme:
        """Return the unknowns. RigError when the rig's cables do not determine the pose."""
        return scheme_of(self.rig, self.start, self.constraint)

    @cached_property
    def zero_pose(self) -> FloatArray:
        """Return the start pose (7,) as the scheme takes it."""
        return self.scheme.start_of(self.start)

    @cached_property
    def correction(self) -> Correction | None:
        """Return the correction for the physical effects that the rig states, if it states any."""
        effects = effects_of(self.rig)
        return None if effects is None else Correction(effects, self.scheme, self.zero_pose, self.temperature_stated_c)

    @cached_property
    def loose_zeros(self) -> IntArray:
        """Return the channels whose zeros only a run determines. TrajectoryError where the others do not determine the pose."""
        return loose_zeros(self.rig, self.calibration, len(self.scheme.free))

    @cached_property
    def absolute(self) -> BoolArray:
        """Return (m,) which channels have absolute readings, counted from no pose."""
        return np.array([self.rig.counter(o).absolute for o in self.rig.observed])

    @property
    def temperature_stated_c(self) -> float | None:
        """Return the temperature at the start as stated or as the counts have it; None where it is not known."""
        return self.measured_c if self.temperature_c is None else self.temperature_c

    @property
    def reference_c(self) -> float | None:
        """Return the temperature at which the rig has its dimensions; None if its calibration does not state it."""
        if self.calibration is not None:
            return self.calibration.temperature_c
        return REFERENCE_C if self.rig.reference_temperature_c is None else self.rig.reference_temperature_c

    @cached_property
    def temperatures_assumed(self) -> tuple[str, ...]:
        """Return the typical sizes of the cables' temperature and expansion, if unstated."""
        if self.temperature_stated_c is None:
            return () if self.exact else ("temperature_c",)
        if self.rig.unstated == "exact":
            return ()
        expands = self.correction is not None and self.correction.thermal
        return ("calibration.temperature_c",) * (self.reference_c is None) + ("cable_expansion_per_k",) * (not expands)
