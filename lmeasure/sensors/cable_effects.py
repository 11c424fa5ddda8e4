"""Physical effects on a rig's cables, with their keys, effects on lengths and uncertainties: temperature, stretch, sag, and imperfect parts
(`sensors.imperfect_parts`)."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from lmeasure import kernels
from lmeasure.core import BoolArray, FloatArray, GeometryError
from lmeasure.rig import Cable, Drum, Rig
from lmeasure.sensors.imperfect_parts import Parts, parts_of
from lmeasure.text import message

GRAVITY = 9.80665  # standard gravity [m/s^2]; it differs by 0.3 % between equator and pole
REFERENCE_C = 20.0  # ISO 1:2022

_EXPANSIONS = [kernels.CABLE_EXPANSION, kernels.DRUM_EXPANSION, kernels.FRAME_EXPANSION]


@dataclass(frozen=True)
class Zero:
    """Zero of the equations of m cables: pose (m, 7), true count (m,) and temperature (m,) [deg C]."""

    poses: FloatArray
    counts: FloatArray
    temperature_c: FloatArray


def zero_at(pose: FloatArray, cables: int, temperature_c: float) -> Zero:
    """All counters zeroed at one pose (7,)."""
    return Zero(np.tile(pose, (cables, 1)), np.zeros(cables), np.full(cables, temperature_c))


@dataclass(frozen=True)
class Effects:
    """The effects on m cables.

    rows (m, columns) of `kernels.effects`; reference_c; moved: for each uncertain property the rows one standard uncertainty above and
    below; u_temperature_k; u_tension_change_n (m,).
    """

    rows: FloatArray
    cables: tuple[str, ...]
    reference_c: float
    moved: tuple[tuple[FloatArray, FloatArray], ...]
    u_temperature_k: float
    u_tension_change_n: FloatArray
    parts: Parts | None = None

    @property
    def physical(self) -> bool:
        """Return whether temperature, tension or weight has an effect."""
        return bool(self.rows[:, [*_EXPANSIONS, kernels.COMPLIANCE, kernels.WEIGHT]].any())

    @property
    def thermal(self) -> bool:
        """Return whether temperature has an effect."""
        return bool(self.rows[:, _EXPANSIONS].any())

    def excess(self, cable_rows: FloatArray, zero: Zero, poses: FloatArray, counts: FloatArray, *, temperature_c: FloatArray) -> FloatArray:
        """Return the (n, m) effects on modelled minus measured changes [mm], at (n, 7) poses, true counts and temperatures (n, m).

        F(P) - F(P0) + excess = D(k) - D(k0) with F and D of `kernels.cable` for cable_rows (m, columns). NaN where pose or count is NaN and
        if a cable cannot run or carries no tension.
        """
        if not self.physical:
            assert self.parts is not None
            return self.parts.excess(cable_rows, (zero.poses, zero.counts), poses, counts)
        out = self._excess(self.rows, cable_rows, zero, poses, counts, temperature_c)
        return out if self.parts is None else out + self.parts.excess(cable_rows, (zero.poses, zero.counts), poses, counts)

    def checked_excess(
        self, cable_rows: FloatArray, zero: Zero, poses: FloatArray, counts: FloatArray, *, temperature_c: FloatArray
    ) -> FloatArray:
        """`excess`; GeometryError names the sample and cable where there is none."""
        out = self.excess(cable_rows, zero, poses, counts, temperature_c=temperature_c)
        bad = ~np.isfinite(out) & np.isfinite(poses[:, :1]) & np.isfinite(counts)
        if bad.any():
            i, j = (int(x) for x in np.argwhere(bad)[0])
            rise = self.rows[j, kernels.TENSION_RISE] * cable_rows[j, kernels.COUNT_LENGTH] * counts[i, j]
            tension = float(self.rows[j, kernels.TENSION] + rise)
            raise GeometryError(message("error.sample_cable_with_n", i=i, cables=self.cables[j], tension=tension))
        return out

    def _excess(
        self, rows: FloatArray, cable_rows: FloatArray, zero: Zero, poses: FloatArray, counts: FloatArray, temperature_c: FloatArray
    ) -> FloatArray:
        warmer = zero.temperature_c - self.reference_c, temperature_c - self.reference_c
        given = (np.ascontiguousarray(values) for values in (zero.poses, zero.counts, poses, counts, *warmer))
        return np.asarray(kernels.excesses(cable_rows, rows, *given))

    def property_shifts(
        self, cable_rows: FloatArray, zero: Zero, poses: FloatArray, counts: FloatArray, *, temperature_c: FloatArray
    ) -> Iterator[FloatArray]:
        """(n, m) changes of the excess by one standard uncertainty of each property of cables and frame: errors shared by all samples."""
        for above, below in self.moved:
            given = cable_rows, zero, poses, counts, temperature_c
            yield (self._excess(above, *given) - self._excess(below, *given)) / 2.0

    def temperature_shifts(
        self, cable_rows: FloatArray, zero: Zero, poses: FloatArray, counts: FloatArray, *, temperature_c: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """(n, m) changes of the excess by one standard uncertainty of the temperature at the zero pose, and of that at the sample."""
        u = self.u_temperature_k
        if not (u > 0.0 and self.thermal):
            return None

        def at(first: float, later: float) -> FloatArray:
            begun = Zero(zero.poses, zero.counts, zero.temperature_c + first)
            return self._excess(self.rows, cable_rows, begun, poses, counts, temperature_c + later)

        return (at(u, 0.0) - at(-u, 0.0)) / 2.0, (at(0.0, u) - at(0.0, -u)) / 2.0

    def tension_shift(self, cable_rows: FloatArray, poses: FloatArray) -> FloatArray | None:
        """Return the (n, m) extra length of each free cable if its tension is one standard uncertainty above the drum's law. It is another
        error at each cable and at each stop, as friction turns with the direction of motion."""
        per_mm = self.u_tension_change_n * self.rows[:, kernels.COMPLIANCE]
        if not per_mm.any():
            return None
        to_pulley = np.hypot(cable_rows[:, kernels.TANGENT], cable_rows[:, kernels.AXIAL]) + self.rows[:, kernels.GUIDE_LENGTH]
        return np.asarray((kernels.span_lengths(cable_rows, np.ascontiguousarray(poses)) + to_pulley) * per_mm)


def effects_of(rig: Rig, cables: tuple[Cable, ...] | None = None, *, with_parts: bool = True) -> Effects | None:
    """Return the effects that a rig's keys state for the given cables, default all; None without any."""
    chosen = rig.cable if cables is None else cables
    drums = [rig.point(c.from_point).drum for c in chosen]
    rows = np.array([_row(drum, rig) for drum in drums]).reshape(len(chosen), kernels.EFFECT_COLUMNS)
    rows[:, kernels.TENSION] += rows[:, kernels.TENSION_RISE] * rig.paid_out(chosen) * [drum.count_length_mm for drum in drums]
    parts = parts_of(rig, chosen) if with_parts else None
    if not (rows[:, [*_EXPANSIONS, kernels.COMPLIANCE, kernels.WEIGHT]] != 0.0).any() and parts is None:
        return None
    reference = REFERENCE_C if rig.reference_temperature_c is None else rig.reference_temperature_c
    change = np.array([drum.u_cable_tension_change_n or 0.0 for drum in drums])
    moved = []
    for point in dict.fromkeys(c.from_point for c in chosen):
        own = np.array([c.from_point == point for c in chosen])
        for column, low, high in _ranges(rig.point(point).drum):
            moved.append((_with(rows, own, column, high), _with(rows, own, column, low)))
    if rig.frame_expansion_per_k is not None and rig.u_frame_expansion_per_k:
        every, u = np.ones(len(chosen), dtype=bool), rig.u_frame_expansion_per_k
        value = rig.frame_expansion_per_k
        moved.append((_with(rows, every, kernels.FRAME_EXPANSION, value + u), _with(rows, every, kernels.FRAME_EXPANSION, value - u)))
    return Effects(rows, tuple(c.name for c in chosen), reference, tuple(moved), rig.u_temperature_k or 0.0, change, parts)


def _row(drum: Drum, rig: Rig) -> list[float]:
    return [
        drum.cable_expansion_per_k or 0.0,
        drum.drum_expansion_per_k or 0.0,
        rig.frame_expansion_per_k or 0.0,
        0.0 if drum.cable_stiffness_n is None else 1.0 / drum.cable_stiffness_n,
        (drum.cable_mass_kg_per_m or 0.0) * GRAVITY / 1000.0,
        drum.cable_tension_n or 0.0,
        (drum.cable_tension_n_per_m or 0.0) / 1000.0,
        np.nan if drum.winding_tension_n is None else drum.winding_tension_n,
        drum.guide_length_mm or 0.0,
    ]


def _ranges(drum: Drum) -> Iterator[tuple[int, float, float]]:
    """Yield (column, value minus u, value plus u) of uncertain values."""
    if drum.cable_expansion_per_k is not None and drum.u_cable_expansion_per_k:
        u = drum.u_cable_expansion_per_k
        yield kernels.CABLE_EXPANSION, drum.cable_expansion_per_k - u, drum.cable_expansion_per_k + u
    if drum.cable_stiffness_n is not None and drum.u_cable_stiffness_n:
        # linear in 1/EA
        u = drum.u_cable_stiffness_n / drum.cable_stiffness_n**2
        yield kernels.COMPLIANCE, 1.0 / drum.cable_stiffness_n - u, 1.0 / drum.cable_stiffness_n + u
    if drum.cable_mass_kg_per_m is not None and drum.u_cable_mass_kg_per_m:
        value, u = drum.cable_mass_kg_per_m * GRAVITY / 1000.0, drum.u_cable_mass_kg_per_m * GRAVITY / 1000.0
        yield kernels.WEIGHT, value - u, value + u
    if drum.cable_tension_n is not None and drum.u_cable_tension_n:
        u = drum.u_cable_tension_n
        yield kernels.TENSION, drum.cable_tension_n - u, drum.cable_tension_n + u


def _with(rows: FloatArray, which: BoolArray, column: int, value: float) -> FloatArray:
    out = rows.copy()
    out[which, column] = value
    return out
