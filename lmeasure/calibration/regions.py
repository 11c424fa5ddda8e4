"""95 % regions of calibrated values: to second order of the model, and from the distribution that the counts' errors really have.

A guide angle that the counts see weakly drags the point along a curve: the truth lies in a banana, and the ellipsoid of the
linearised model is far thinner. Let x be the components of a deviation of the truth from the result along the principal directions of the
linear covariance, in their standard uncertainties, U the left singular vectors of the whitened Jacobian and H the second derivatives of the
whitened residuals by x. The truth is the rig at which the residuals are the noise e, so U'e = x + U'H[x, x]/2, hence

    x = xi - U'H[xi, xi]/2 + third order,    xi = U'e.

(The part of H across the tangent plane multiplies residuals of the order of the noise and is left out: Bates and Watts, 1980, find
it negligible beside the part in the plane, as it is here.) In a silent direction xi is the nominal value's own error, one prior standard
uncertainty. The mean square of the second-order part is added to the linear covariance; xi and its even part do not correlate.

xi itself is drawn from what the data are (JCGM 101): rounding to whole counts is uniform, as is where within a count a counter was zeroed,
and a Gaussian 95 % region would hold 97.5 % of three rounding errors and nearly all of six; reference poses are Gaussian; a noise level
estimated from few residuals makes it Student's.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.arrays import BoolArray, FloatArray
from lmeasure.calibration.joint import Joint
from lmeasure.calibration.refine import Fit, Whitened
from lmeasure.calibration.unknowns import Model

DRAWS = 4096
JOINT_DRAWS = 2048
PROBABILITY = 0.95
BENT = 3.0
"""Bend from which the reader is warned: in some direction the truth strays ten times the linear variance."""


@dataclass(frozen=True)
class Regions:
    """Where the truth is with 95 %.

    covariance (p, p) of the values, second order included, in their units; factor: the values v with
    (v - result)' covariance^-1 (v - result) <= factor^2 are the joint region; U95 (p,) half width of each value's own interval;
    bend: root mean square of the second-order part in the direction where it is largest in linear standard uncertainties.
    """

    covariance: FloatArray
    factor: float
    U95: FloatArray
    bend: float


def regions(model: Model, fit: Fit, seed: int, freedom: int | None = None) -> Regions:
    """The 95 % regions of a fit. freedom: degrees of freedom of a noise level that was estimated from the residuals, None when stated."""
    rng = np.random.default_rng([seed, 11])
    width = model.rig.width
    xi, second, axes = _drawn_jointly(model, fit, rng) if isinstance(fit, Joint) else _drawn(model, fit, rng)
    draws = len(xi)
    second *= np.sqrt(fit.excess)
    inner = np.eye(xi.shape[1]) + second.T @ second / draws
    scale = np.sqrt(fit.excess) * width[:, None] * axes
    covariance = scale @ inner @ scale.T
    student = np.ones((draws, 1)) if freedom is None else np.sqrt(max(freedom, 1) / rng.chisquare(max(freedom, 1), (draws, 1)))
    x = student * xi + student**2 * second
    squares = np.einsum("na,na->n", x, np.linalg.solve(inner, x.T).T)
    return Regions(
        np.asarray((covariance + covariance.T) / 2),
        float(np.sqrt(np.quantile(squares, PROBABILITY))),
        np.asarray(np.quantile(np.abs(x @ scale.T), PROBABILITY, axis=0)),
        float(np.sqrt(np.linalg.eigvalsh(inner)[-1] - 1.0)),
    )


def _drawn(model: Model, fit: Fit, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n, p) deviations of first and of second order, in units of the axes (p, p) in prior widths."""
    w = Whitened(model, fit.V)
    z = (fit.theta - model.unknowns.nominal) / model.unknowns.width
    J = w.jacobian(z)
    # weights of data and prior in each principal direction, and its standard uncertainty in prior widths
    data, prior, sigma = fit.gains
    axes = fit.directions.T * sigma
    U = J @ fit.directions.T / np.where(data > 0, fit.s, 1.0) * (data > 0)
    xi = (w.whiten(_noise(model, fit, rng)).T @ U) * (data / sigma) + rng.normal(size=(DRAWS, len(z))) * (prior / sigma)
    second = np.zeros_like(xi)
    by_direction = _second_derivatives(w, z, axes)
    for k in np.flatnonzero(data > 0):
        B = np.tensordot(U[:, k], by_direction, 1) * (data[k] / sigma[k])
        second[:, k] = -0.5 * np.einsum("na,na->n", xi @ B, xi)
    return xi, second, axes


def _drawn_jointly(model: Model, fit: Joint, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The same of the rig's values, k of them beside the motions of the whole, where poses were unknown too: axes (p, k).

    With r = e at the truth, d = K e + first order of what is held, and K r = 0 at the result, K J being the projector onto what the data
    determine, the second order is -K H[d, d]/2; H[d, d] = r(x + d) + r(x - d) - 2 r(x) is taken from the residuals themselves.
    """
    own = len(fit.s)
    every = fit.follows @ _noise(model, fit, rng)[:, :JOINT_DRAWS] + fit.held @ rng.normal(size=(fit.held.shape[1], JOINT_DRAWS))
    H = np.array([model.residuals(fit.theta + d) + model.residuals(fit.theta - d) for d in every.T]).T - 2.0 * fit.residuals[:, None]
    width, k = model.rig.width[:, None], own - fit.motions
    first, second = every[:own] / width, -0.5 * fit.follows[:own] @ H / width
    values, vectors = np.linalg.eigh(fit.covariance[:own, :own] / fit.excess / (width * width.T))
    axes = vectors[:, -k:] * np.sqrt(values[-k:])
    back = (vectors[:, -k:] / np.sqrt(values[-k:])).T
    return (back @ first).T, (back @ second).T, axes


def whole_counts(model: Model) -> BoolArray:
    """(e,) whether the recorded count behind each residual is a whole number."""
    return model.whole(model.pose_index, model.cable_index)


def _noise(model: Model, fit: Fit, rng: np.random.Generator) -> FloatArray:
    """(e, DRAWS) errors of the residuals [mm] with covariance V: uniform where counts are rounded, and, shared by residuals, for where
    within a count their counters were zeroed; the rest Gaussian."""
    own, shared, uniform = model.readings
    rounding, zeros = np.where(whole_counts(model), own, 0.0), shared[:, uniform]
    rest = fit.V - np.diag(rounding) - zeros @ zeros.T
    out = rng.uniform(-1.0, 1.0, (len(rest), DRAWS)) * np.sqrt(3.0 * rounding)[:, None]
    out += np.sqrt(3.0) * zeros @ rng.uniform(-1.0, 1.0, (zeros.shape[1], DRAWS))
    if np.abs(rest).max(initial=0.0) > 1e-12 * np.diag(fit.V).max(initial=0.0):
        values, vectors = np.linalg.eigh(rest)
        out += (vectors * np.sqrt(np.maximum(values, 0.0))) @ rng.normal(size=(len(rest), DRAWS))
    return np.asarray(out)


def _second_derivatives(w: Whitened, z: FloatArray, axes: FloatArray) -> FloatArray:
    """(e, p, p) second derivatives of the whitened residuals along the columns of axes (p, p), each the mean over plus and minus its
    length: one standard uncertainty, so that they describe the valley and not its lowest point."""
    H = np.stack([(w.jacobian(z + a) - w.jacobian(z - a)) @ axes / 2 for a in axes.T], axis=1)
    return np.asarray((H + H.transpose(0, 2, 1)) / 2)
