"""The result over the range of what nobody measured: where a point would be found for every value of its assumed quantities."""

from dataclasses import dataclass

import numpy as np
import scipy.optimize
from scipy.stats import qmc

from lmeasure.calibration.solve.unknowns import Model
from lmeasure.core import FloatArray
from lmeasure.rig import PLACE

SAMPLES_LOG2 = 6
FITS_MM = 0.05  # residual up to which an assumed set of values is held possible


@dataclass(frozen=True)
class Range:
    """Spread of a point's position over its assumed values: low, high (3,) [mm, base frame]; how many tried sets fit the counts."""

    point: str
    low: FloatArray
    high: FloatArray
    fitting: int
    tried: int


def position_range(model: Model, point: str, theta: FloatArray, seed: int) -> Range | None:
    """Position of a point, solved anew with its other values held at each of 64 Sobol sets within sqrt(3) prior widths of the nominal.

    theta (p,) is the result of the calibration: where to start, and the first of the sets. None when nothing but the position is
    unknown, or no set fits.
    """
    unknowns = model.parameters
    own = unknowns.of(point)
    place = [i for i in own if unknowns.names[i].rsplit(".", 1)[1] in PLACE]
    held = [i for i in own if i not in place]
    if not held or len(place) != 3:
        return None
    unit = qmc.Sobol(len(held), scramble=True, rng=np.random.default_rng([seed, 7])).random_base2(SAMPLES_LOG2)
    found = [theta[place]] if np.abs(model.residuals(theta)).max() < FITS_MM else []
    for sample in unit:
        fixed = theta.copy()
        fixed[held] = unknowns.nominal[held] + np.sqrt(3.0) * (2 * sample - 1) * unknowns.width[held]

        def full(position: FloatArray, fixed: FloatArray = fixed) -> FloatArray:
            out = fixed.copy()
            out[place] = position
            return out

        solution = scipy.optimize.least_squares(
            lambda position, full=full: model.residuals(full(position)),
            theta[place],
            jac=lambda position, full=full: model.jacobian(full(position))[:, place],
            method="lm" if model.equations >= 3 else "trf",
            max_nfev=100,
        )
        if np.abs(solution.fun).max() < FITS_MM:
            found.append(solution.x)
    if not found:
        return None
    return Range(point, np.min(found, axis=0), np.max(found, axis=0), len(found), len(unit) + 1)
