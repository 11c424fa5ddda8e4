"""Temperature, stretch and sag in a run: the changes a rig without them would have shown, and what they leave uncertain."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.kernels import COMPLIANCE
from lmeasure.rig import Rig
from lmeasure.sensors import MAX_ROUNDS, Effects, Lengths, Zero, effects_of, zero_at, zero_temperature
from lmeasure.text import Message, message
from lmeasure.trajectory.reconstruction.scheme import Scheme

SETTLED_MM = 1e-10


class Correction:
    """The effects on a run that starts at a pose (7,); temperature_c is that of the start, or None where only the counts state one."""

    def __init__(self, effects: Effects, scheme: Scheme, start: FloatArray, temperature_c: float | None) -> None:
        self._effects, self._scheme, self._start = effects, scheme, start
        self._temperature_c = temperature_c

    def notes(self) -> tuple[Message, ...]:
        """What is to be said of it."""
        if self._effects.thermal and self._temperature_c is None:
            return (message("temperature.not_stated", reference_c=self._effects.reference_c),)
        return ()

    def corrected(self, lengths: Lengths, solve: Callable[[FloatArray], FloatArray]) -> Lengths:
        """The lengths with changes to which the rig's plain geometry belongs; solve gives the poses (n, 7) of changes (n, m).

        The excess depends on the pose, by a strain's part of it: pose and excess are found in turn, which gains three digits a round.
        """
        if self._temperature_c is None:
            self._temperature_c = zero_temperature(lengths, None)
        m = lengths.lengths
        counts = lengths.counts[:, :m]
        zero, warm = self._situation(counts, None if lengths.temperature_c is None else lengths.temperature_c[:, :m])
        rows, change = self._scheme.rows[:m], lengths.change_mm
        excess = np.zeros_like(change)
        for _ in range(MAX_ROUNDS):
            poses = solve(change - excess)
            found = self._effects.checked_excess(rows, zero, poses, counts, temperature_c=warm)
            moved = np.abs(found - excess[:, :m])
            # where no pose was found the last one stays: the sample has its status from what its neighbours say
            excess[:, :m] = np.where(np.isfinite(found), found, excess[:, :m])
            if not np.nanmax(moved, initial=0.0) > SETTLED_MM:
                break
        return replace(lengths, change_mm=change - excess)

    @property
    def sources(self) -> int:
        """How many variables are uncertain."""
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

    def _situation(self, counts: FloatArray, temperature_c: FloatArray | None) -> tuple[Zero, FloatArray]:
        """Where the run starts, and the temperatures (n, m) of its samples."""
        start = self._effects.reference_c if self._temperature_c is None else self._temperature_c
        warm = np.full(counts.shape, start)
        if temperature_c is not None:
            warm = np.where(np.isfinite(temperature_c), temperature_c, start)
        return zero_at(self._start, counts.shape[1], start), warm


def correction_of(rig: Rig, scheme: Scheme, start: FloatArray, temperature_c: float | None) -> Correction | None:
    """The correction of a rig that states effects, else None; start (7,) as the scheme takes it, temperature_c there."""
    effects = effects_of(rig)
    return None if effects is None else Correction(effects, scheme, start, temperature_c)
