"""Legs between Hooke joints: how far each leg turns about itself, how far its joints bend, and limits of both (thesis 5.8)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.text import message


def hooke_turns(e: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the signed rotations (...,) [rad] of legs with unit directions e (..., 3) about themselves. The zero is where the crosses with
    the first axes low and high (..., 3) are parallel: atan2(e . (e x low) x (e x high), (e x low) . (e x high))."""
    one, other = np.cross(e, low), np.cross(e, high)
    return np.asarray(np.arctan2((e * np.cross(one, other)).sum(axis=-1), (one * other).sum(axis=-1)))


@dataclass(frozen=True)
class HookeJoints:
    """Legs between Hooke joints. legs (k,): their numbers; base_axes, platform_axes (k, 3): unit vectors of the first axes, in the frames
    of the base and the platform; turn_rad, bend_rad: largest rotation of a leg about itself and largest bend of a joint; None: no limit."""

    legs: Sequence[int]
    base_axes: FloatArray
    platform_axes: FloatArray
    turn_rad: float | None = None
    bend_rad: float | None = None

    def turns(self, directions: FloatArray, rotations: FloatArray) -> FloatArray:
        """(..., k) rotations [rad] of the legs at unit directions (..., m, 3) and rotations (..., 3, 3) base_from_platform."""
        return hooke_turns(directions[..., self.legs, :], self.base_axes, self._high(rotations))

    def _high(self, rotations: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("...ij,kj->...ki", rotations, self.platform_axes))

    def names(self, called: Sequence[str]) -> tuple[str, ...]:
        """Names of the limits, in the order of `values`; called: the links' names."""
        own = [called[i] for i in self.legs]
        turn = () if self.turn_rad is None else tuple(message("linkages.leg_turn", name=n) for _ in (1, -1) for n in own)
        bend = () if self.bend_rad is None else tuple(message("linkages.hooke_bend", name=n) for _ in range(4) for n in own)
        return turn + bend

    def values(self, directions: FloatArray, rotations: FloatArray) -> FloatArray:
        """(..., j) of each limit, smooth, positive where it is kept: rotations in rad, bends by their sines."""
        e, high = directions[..., self.legs, :], self._high(rotations)
        out = [np.zeros((*directions.shape[:-2], 0))]
        if self.turn_rad is not None:
            turn = hooke_turns(e, self.base_axes, high)
            out += [self.turn_rad - turn, self.turn_rad + turn]
        if self.bend_rad is not None:
            sines = [(e * self.base_axes).sum(axis=-1), (e * high).sum(axis=-1)]
            out += [np.sin(self.bend_rad) - sign * s for s in sines for sign in (1.0, -1.0)]
        return np.concatenate(out, axis=-1)
