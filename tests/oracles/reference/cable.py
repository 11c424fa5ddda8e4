"""A cable that a drum pays out: the length from the observation point over the swivel pulley to the attachment point."""

from dataclasses import dataclass
from math import inf
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from lmeasure.core import FloatArray
from lmeasure.kernels import BY_ALPHA, BY_ATTACHMENT, BY_AXIAL, BY_BASE, BY_BETA, BY_PITCH, BY_RADIUS, BY_SCALE, BY_TANGENT, WIDTH
from lmeasure.rig import FACTORS, Parameter
from lmeasure.sensors.wrap import Drum, Span, by_guide, guide, span
from reference.channel import arms, by_point, row_of, values

ZERO = WIDTH
PLACE, ANGLES, ATTACHMENT = slice(0, BY_BASE + 3), slice(BY_ALPHA, BY_BETA + 1), slice(BY_ATTACHMENT, BY_ATTACHMENT + 3)
OF_DRUM = [BY_SCALE, BY_TANGENT, BY_AXIAL, BY_PITCH]
UNITS = np.append(FACTORS, 1.0)
"""(14,) mm or rad of one unit of each parameter."""


@dataclass(frozen=True, eq=False)
class CableLength:
    """The cable [mm] that has left the drum since its counter was zeroed, less the zero.

    parameters (14,): those of `parameters.TABLE`, and the zero [mm]. zeroed_at (7,): the pose where the counter was zeroed, the zero being
    a fraction of a count; without it the zero is the whole length that was out there. The drum makes counts k to a length D(k); a reading
    is the counts' length by the drum as `parameters` state it, whatever values p are tried.
    """

    name: str
    parameters: tuple[Parameter, ...]
    variance: float
    count_length_mm: float = 1.0
    counts_per_revolution: float = 1.0
    zeroed_at: FloatArray | None = None
    period: ClassVar[float] = inf

    @property
    def point(self) -> FloatArray:
        """(3,) the attachment point, tool frame."""
        return values(self)[ATTACHMENT]

    def readings(self, recorded: ArrayLike, sign: int = 1) -> FloatArray:
        """(n,) readings [mm] from recorded counts, unwrapped (n,)."""
        stated = values(self)
        return self._drum(stated).paid_out(np.asarray(recorded, dtype=np.float64) * sign / stated[BY_SCALE])

    def predict(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n,) readings [mm]."""
        change, stated = self._change(poses, p), values(self)
        if np.array_equal(p[OF_DRUM], stated[OF_DRUM]):
            return change
        return self._drum(stated).paid_out(self._drum(p).counts(change) * p[BY_SCALE] / stated[BY_SCALE])

    def row(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n, 6) by the motion."""
        arm, found = self._span(poses, p)
        return row_of(arm, found.direction) * self._gain(poses, p)

    def gradient(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n, 14) by the parameters."""
        out = np.zeros((len(poses), len(UNITS)))
        out[:, : ATTACHMENT.stop] = self._of_length(poses, p)
        if self.zeroed_at is not None:
            out[:, : ATTACHMENT.stop] -= self._of_length(self.zeroed_at[None], p)
        out[:, ZERO] = -1.0
        drum = self._drum(p)
        k = drum.counts(self._change(poses, p))
        a0, a = drum.axial_mm, drum.axial_mm + drum.travel_mm * k
        h0, h = (np.maximum(np.hypot(drum.tangent_mm, v), 1e-300) for v in (a0, a))
        # at the same length: what D(k) loses is made up by more counts
        out[:, BY_TANGENT], out[:, BY_AXIAL] = drum.tangent_mm / h - drum.tangent_mm / h0, a / h - a0 / h0
        out[:, BY_PITCH] = a / h * k / self.counts_per_revolution
        out[:, BY_SCALE] = drum.slope(k) * k / p[BY_SCALE]
        return out * self._gain(poses, p) * UNITS

    def _span(self, poses: FloatArray, p: FloatArray) -> tuple[FloatArray, Span]:
        arm = arms(poses, p[ATTACHMENT])
        return arm, span(poses[:, :3] + arm - p[PLACE], guide(*np.radians(p[ANGLES]))[0], p[BY_RADIUS])

    def _change(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n,) D of the counts at the poses."""
        begun = 0.0 if self.zeroed_at is None else self._span(self.zeroed_at[None], p)[1].length[0]
        return self._span(poses, p)[1].length - begun - p[ZERO]

    def _of_length(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n, 12) derivatives of the length alone by the first twelve parameters, mm and rad."""
        arm, found = self._span(poses, p)
        out = np.zeros((len(poses), ATTACHMENT.stop))
        out[:, PLACE] = -found.direction
        out[:, ANGLES] = by_guide(guide(*np.radians(p[ANGLES])), poses[:, :3] + arm - p[PLACE], found.direction)
        out[:, BY_RADIUS] = found.angle - found.sine
        out[:, ATTACHMENT] = by_point(poses, found.direction)
        return out

    def _drum(self, p: FloatArray) -> Drum:
        return Drum(p[BY_TANGENT], p[BY_AXIAL], p[BY_PITCH] / self.counts_per_revolution, self.count_length_mm)

    def _gain(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n, 1) what the reading changes by per mm that the cable does."""
        stated = values(self)
        if np.array_equal(p[OF_DRUM], stated[OF_DRUM]):
            return np.ones((1, 1))
        k, factor = self._drum(p).counts(self._change(poses, p)), p[BY_SCALE] / stated[BY_SCALE]
        return (self._drum(stated).slope(k * factor) * factor / self._drum(p).slope(k))[:, None]
