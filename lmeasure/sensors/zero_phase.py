"""Where within a count the counters were zeroed, which nobody knows: the phases, what they make of the lengths, and draws of them.

An incremental counter that is set to zero shows 0 wherever within a count it stands: recorded = round(count_sign * scale * k + phase), the
phase uniform within half a recorded count. It is one draw for all rows until the counter is zeroed again (`Rig.zeroings`); a drum may state
that its zero is exact.
"""

import numpy as np

from lmeasure.core import BoolArray, FloatArray
from lmeasure.rig import Observed, Rig
from lmeasure.sensors.lengths import count_variance, rounding_variance


def zeroed_exactly(rig: Rig, cables: tuple[Observed, ...] | None = None) -> BoolArray:
    """(m,) whether a recorded count of zero is k = 0 exactly; an absolute encoder is not zeroed at all."""
    chosen = rig.cable if cables is None else cables
    return np.array([rig.counter(c).zero_exact or rig.counter(c).absolute for c in chosen], dtype=np.bool_)


def drawn_phases(rig: Rig, rng: "np.random.Generator", cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """(m,) where within a recorded count the cables' counters were zeroed: one draw within +-1/2 for each zeroing, 0 for one that is
    exact."""
    of = rig.zeroings(cables)
    drawn = rng.uniform(-0.5, 0.5, len(np.unique(of)))[of]
    return np.where(zeroed_exactly(rig, cables), 0.0, drawn)


def phase_variance(rig: Rig, cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """(m,) variance [mm^2] of a length by where within a count its counter was zeroed: uniform within half a recorded count, the same for
    all rows counted from one zeroing (`Rig.zeroings`); 0 where the zero is exact."""
    return np.where(zeroed_exactly(rig, cables), 0.0, rounding_variance(rig, cables))


def phase_columns(rig: Rig, cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """(m, z) what one standard deviation of the phase of each zeroing, none that is exact, makes of the lengths [mm]."""
    u_mm, of = np.sqrt(phase_variance(rig, cables)), rig.zeroings(cables)
    return np.where(of[:, None] == np.unique(of[u_mm > 0.0]), u_mm[:, None], 0.0)


def length_variance(rig: Rig, cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """(m,) variance [mm^2] of a single length: of the count and of where it was zeroed."""
    return count_variance(rig, cables) + phase_variance(rig, cables)
