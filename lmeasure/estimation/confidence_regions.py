"""95 % regions of estimated values: to second order of the model, and from the real distribution of the errors.

A value that the data see weakly drags others along a curve: the truth lies in a banana, and the ellipsoid of the linearised model is far
thinner. Let x be the components of a deviation of the truth from the result along the principal directions of the linear covariance, in
their standard uncertainties, U the left singular vectors of the whitened Jacobian and H the second derivatives of the whitened residuals by
x. The truth is where the residuals are the noise e, so U'e = x + U'H[x, x]/2, hence

    x = xi - U'H[xi, xi]/2 + third order,    xi = U'e.

(The part of H across the tangent plane multiplies residuals of the order of the noise and is omitted: Bates and Watts, 1980, find it
negligible beside the part in the plane, as it is here.) In a silent direction xi is the nominal value's own error, one prior standard
uncertainty. The mean square of the second-order part is added to the linear covariance; xi and its even part do not correlate.

xi itself is drawn from the distributions of the data (JCGM 101): rounding is uniform, and a Gaussian 95 % region would hold 97.5 % of three
rounding errors and nearly all of six; the rest is Gaussian; a noise level estimated from few residuals makes it Student's.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, symmetric_root
from lmeasure.estimation.least_squares import Whitened
from lmeasure.estimation.problem import Fit

DRAWS = 4096
JOINT_DRAWS = 2048
PROBABILITY = 0.95
BENT = 3.0
"""Bend from which the reader is warned: in some direction the truth strays ten times the linear variance."""


@dataclass(frozen=True)
class Regions:
    """Regions that contain the truth with 95 %.

    covariance (p, p) of the values, second order included, in their units; factor: the values v with (v - result)' covariance^-1 (v -
    result) <= factor^2 are the joint region; U95 (p,) half width of each value's own interval; bend: root mean square of the second-order
    part in the direction where it is largest in linear standard uncertainties.
    """

    covariance: FloatArray
    factor: float
    U95: FloatArray
    bend: float


def regions(fit: Fit, seed: int, freedom: int | None = None) -> Regions:
    """The 95 % regions of a fit. freedom: degrees of freedom of a noise level that was estimated from the residuals, None when stated."""
    rng = np.random.default_rng([seed, 11])
    width = fit.problem.parameters.width
    xi, second, axes = _drawn(fit, rng) if fit.eliminated is None else _drawn_with_nuisance(fit, *fit.eliminated, rng)
    draws = len(xi)
    second *= np.sqrt(fit.excess)
    inner = np.eye(xi.shape[1]) + second.T @ second / draws
    scale = np.sqrt(fit.excess) * width[:, None] * axes
    covariance = scale @ inner @ scale.T
    student = np.ones((draws, 1)) if freedom is None else np.sqrt(max(freedom, 1) / rng.chisquare(max(freedom, 1), (draws, 1)))
    x = student * xi + student**2 * second
    squares = np.einsum("na,na->n", x, np.linalg.solve(inner, x.T).T)
    factor, widths = float(np.sqrt(np.quantile(squares, PROBABILITY))), np.quantile(np.abs(x @ scale.T), PROBABILITY, axis=0)
    bent = float(np.sqrt(np.linalg.eigvalsh(inner)[-1] - 1.0))
    return Regions(np.asarray((covariance + covariance.T) / 2), factor, np.asarray(widths), bent)


def _drawn(fit: Fit, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(n, p) deviations of first and of second order, in units of the axes (p, p) in prior widths."""
    w = Whitened(fit.problem, fit.V)
    parameters = fit.problem.parameters
    z = (fit.theta - parameters.nominal) / parameters.width
    J = w.jacobian(z)
    # weights of data and prior in each principal direction, and its standard uncertainty in prior widths
    data, prior, sigma = fit.gains
    axes = fit.directions.T * sigma
    along = J @ fit.directions.T
    U = np.divide(along, fit.s, out=np.zeros_like(along), where=data > 0)
    xi = (w.whiten(_noise(fit, rng)).T @ U) * (data / sigma) + rng.normal(size=(DRAWS, len(z))) @ fit.directions.T * (prior / sigma)
    second = np.zeros_like(xi)
    by_direction = _second_derivatives(w, z, axes)
    for k in np.flatnonzero(data > 0):
        B = np.tensordot(U[:, k], by_direction, 1) * (data[k] / sigma[k])
        second[:, k] = -0.5 * np.einsum("na,na->n", xi @ B, xi)
    return xi, second, axes


def _drawn_with_nuisance(
    fit: Fit, follows: FloatArray, held: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the same of the parameters, k of them beside the motions of the gauge, where there are nuisance parameters: axes (p, k). With
    r = e at the truth, d = K e + first order of the fixed values, and K r = 0 at the result, K J being the projector onto what the data
    determine, the second order is -K H[d, d]/2; H[d, d] = r(x + d) + r(x - d) - 2 r(x) is taken from the residuals themselves."""
    own, residuals = fit.problem.own, fit.problem.residuals
    every = follows @ _noise(fit, rng)[:, :JOINT_DRAWS] + held @ rng.normal(size=(held.shape[1], JOINT_DRAWS))
    H = np.array([residuals(fit.theta + d) + residuals(fit.theta - d) for d in every.T]).T - 2.0 * fit.residuals[:, None]
    width, k = fit.problem.parameters.width[:, None], own - fit.motions
    first, second = every[:own] / width, -0.5 * follows[:own] @ H / width
    values, vectors = np.linalg.eigh(fit.covariance[:own, :own] / fit.excess / (width * width.T))
    axes = vectors[:, -k:] * np.sqrt(values[-k:])
    back = (vectors[:, -k:] / np.sqrt(values[-k:])).T
    return (back @ first).T, (back @ second).T, axes


def _noise(fit: Fit, rng: np.random.Generator) -> FloatArray:
    """Return (e, DRAWS) errors of the residuals with covariance V: uniform if stated (`Problem.uniform`), the rest Gaussian."""
    rounding, zeros = fit.problem.uniform()
    rest = fit.V - np.diag(rounding) - zeros @ zeros.T
    out = rng.uniform(-1.0, 1.0, (len(rest), DRAWS)) * np.sqrt(3.0 * rounding)[:, None]
    out += np.sqrt(3.0) * zeros @ rng.uniform(-1.0, 1.0, (zeros.shape[1], DRAWS))
    if np.abs(rest).max(initial=0.0) > 1e-12 * np.diag(fit.V).max(initial=0.0):
        out += symmetric_root(rest) @ rng.normal(size=(len(rest), DRAWS))
    return np.asarray(out)


def _second_derivatives(w: Whitened, z: FloatArray, axes: FloatArray) -> FloatArray:
    """(e, p, p) second derivatives of the whitened residuals along the columns of axes (p, p), each the mean over plus and minus its
    length: one standard uncertainty, so that they describe the valley and not its lowest point."""
    H = np.stack([(w.jacobian(z + a) - w.jacobian(z - a)) @ axes / 2 for a in axes.T], axis=1)
    return np.asarray((H + H.transpose(0, 2, 1)) / 2)
