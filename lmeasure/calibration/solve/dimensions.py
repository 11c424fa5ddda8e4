"""Estimates from a campaign for dimensions with a stated uncertainty that are not solved: length of a count, pitch of a groove,
attachments.

In the least squares they are errors of the residuals, r = r(theta) + C z with z of unit variance, so that V = R + C C'. At the optimum the
remaining residuals determine z as well: its conditional mean is -C' V^-1 r, and with K the gain of the fit (Henderson, Biometrics 31, 1975)

    cov(z) = I - C' V^-1 (I - J K) C,        cov(theta, z) = -K C        (true minus found),

the same as solving for them with their stated uncertainties as priors. The calibrated rig needs these values: its points compensate a wrong
drum.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.calibration.solve.sizes import Sized
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.core import FloatArray
from lmeasure.estimation import Fit
from lmeasure.rig import Dimension, Rig, value_of, with_values

SINGULAR = 1e-12


@dataclass(frozen=True)
class Dimensions:
    """Names (s) and corrections (s,) of dimensions, their stated standard uncertainties (s,), covariance (s, s) and that with the fit's
    values of the rig (p, s), in the units of the names; residuals (e,) of the fit with the corrections [mm]."""

    names: tuple[str, ...]
    correction: FloatArray
    stated: FloatArray
    covariance: FloatArray
    with_values: FloatArray
    residuals: FloatArray

    def entries(self, rig: Rig) -> tuple[Dimension, ...]:
        """Return the entries of the record; rig has the corrected values."""
        u = np.sqrt(np.diag(self.covariance))
        return tuple(
            Dimension(
                name=name,
                value=value_of(rig, name) or 0.0,
                u=float(u[i]),
                prior_u=float(self.stated[i]),
                covariance=tuple(map(float, [*self.with_values[:, i], *self.covariance[:, i]])),
            )
            for i, name in enumerate(self.names)
        )


def dimensions_of(model: Model, found: Fit, sized: Sized | None, *, corrected: bool = True) -> Dimensions:
    """Return a fit's estimates of the dimensions and parts that its rig states or assumes to be uncertain.

    Nothing is corrected if the residuals are larger than any explanation, or if only chosen groups are solved (corrected). sized: estimates
    of sizes without a statement.
    """
    u = np.array([v.u for v in model.unsolved.variables for _ in v.names])
    names = model.unsolved.names
    if not names:
        return Dimensions((), u, u, np.empty((0, 0)), np.empty((model.own, 0)), found.residuals)
    C = model.unsolved_shifts(found.theta)
    follows = found.gain @ C
    r = found.residuals if sized is None else found.residuals + found.jacobian @ sized.shift[: len(found.theta)]
    z, covariance = np.zeros(len(u)), np.eye(len(u))
    if found.excess == 1.0 and corrected:
        z = -C.T @ np.linalg.solve(found.V, r) if sized is None else sized.shift[len(found.theta) :] / u
        left = C - found.jacobian @ follows
        covariance = covariance - C.T @ np.linalg.solve(found.V, left)
        covariance = _possible(found.covariance[: model.own, : model.own], -follows[: model.own], (covariance + covariance.T) / 2)
    spread = np.zeros((len(found.theta) + len(u), 0)) if sized is None else sized.spread
    own, others = spread[len(found.theta) :], spread[: model.own]
    return Dimensions(names, u * z, u, covariance * np.outer(u, u) + own @ own.T, -follows[: model.own] * u + others @ own.T, r + C @ z)


def _possible(T: FloatArray, X: FloatArray, Z: FloatArray) -> FloatArray:
    """Z (s, s), widened where rounding or a direction that only a prior holds leaves [[T, X], [X', Z]] no covariance."""
    width = np.sqrt(np.maximum(np.diag(T), 1e-300))
    own = X / width[:, None]
    # a frame that is chosen leaves directions of no variance but rounding
    least = own.T @ np.linalg.pinv(T / np.outer(width, width), rcond=SINGULAR, hermitian=True) @ own
    least = (least + least.T) / 2
    values, vectors = np.linalg.eigh(Z - least)
    return np.asarray(least + (vectors * np.maximum(values, 0.0)) @ vectors.T)


def with_dimensions(rig: Rig, found: Dimensions) -> Rig:
    """The rig with corrected dimensions."""
    if not found.names:
        return rig
    return with_values(rig, {name: (value_of(rig, name) or 0.0) + by for name, by in zip(found.names, found.correction, strict=True)})
