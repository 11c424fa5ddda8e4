"""Unstated sizes of errors, estimated together: of drums, pulleys and attachment points by groups, and of reference poses.

Typical sizes are priors. The residuals determine the sizes of this rig: all parts of one kind are pooled, and the restricted likelihood
decides between the kinds (`estimation.variance_components`). Sizes that the residuals do not determine stay typical. The change of the fit
by other probable sizes is added to its covariance.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.calibration.solve.noise import ASSUMED
from lmeasure.calibration.solve.reference_field import fields
from lmeasure.calibration.solve.unknowns import TRAVEL, Model, doubt_of, factor_of
from lmeasure.core import FloatArray
from lmeasure.estimation import Fit, Sizes, fit, sizes
from lmeasure.rig import TYPICAL_SIZES, Rig
from lmeasure.sensors import BACKLASH, Variable

ROUNDS = 4
SWEEPS = 40
NEAR = 3.0
"""Standard uncertainties by which a fit may move while its laws stay the same."""
PLAY = "play"
CLEARLY = 1.5
"""Stated sizes from which an estimated band replaces the stated one."""


@dataclass(frozen=True)
class Sized:
    """A model with estimated sizes and its fit.

    size: in units of the typical ones, by the code of the kind, `PLAY`, "position", "rotation", or the name of a field. play: of each drum,
    by its point. shift (P + q,): from the fit's unknowns to their mean over all probable sizes, and the mean of unsolved dimensions; spread
    (P + q, k): columns whose squares are a covariance of both by unknown sizes.
    """

    model: Model
    fit: Fit
    size: dict[str, float]
    play: dict[str, float]
    shift: FloatArray
    spread: FloatArray

    def mean(self, found: Fit) -> Fit:
        """Return the fit at the mean of its unknowns over all probable sizes, with their covariance."""
        P = len(found.theta)
        theta, own = found.theta + self.shift[:P], self.spread[:P]
        return replace(found, theta=theta, residuals=self.model.residuals(theta), covariance=found.covariance + own @ own.T)

    @property
    def rows(self) -> tuple[dict[str, object], ...]:
        """Return a row for each kind of part with an unstated size."""
        sizes = {v.kind: self.size[v.kind.code if v.kind.adds else PLAY] for v in self.model.variables if v.assumed and v.kind != BACKLASH}
        return tuple({"what": k.said, "typical": TYPICAL_SIZES[k.key].size, "times": times} for k, times in sizes.items())


def with_estimated_sizes(model: Model, found: Fit, seed: int = 0) -> Sized | None:
    """The model and its fit under the sizes that its residuals show; None where every size is stated."""
    if not (any(v.assumed for v in model.variables) or smooth(model)):
        return None
    begun: Sizes | None = None
    moved = math.inf
    # the first rounds need the mode alone; errors far from the typical ones move the fit, and with it their laws
    for sweeps in (*(0,) * ROUNDS, SWEEPS):
        if not sweeps and moved < NEAR:
            continue
        V, parts = _components(model, found)
        drawn = sizes(found.residuals, found.determined, V, list(parts.values()), begun=begun, sweeps=sweeps, seed=seed)
        now = _sized(model, dict(zip(parts, drawn.size.tolist(), strict=True)))
        other = fit(now, found.theta, found.prior_everywhere, near=True)
        moved = float(np.max(np.abs(other.theta - found.theta) / np.sqrt(np.diag(other.covariance))))
        found, begun = other, drawn
    size = dict(zip(parts, drawn.size.tolist(), strict=True))
    play = _play(now, found)
    if play:
        size[PLAY] = math.sqrt(0.5) * math.hypot(size[PLAY], size.pop(TRAVEL))
    return Sized(now, found, size, play, *_moments(model, found, drawn))


def _play(model: Model, found: Fit) -> dict[str, float]:
    """Root mean square of half the band of each drum in units of the typical one, under a fit with estimated sizes."""
    band, out = model.doubted_play_mm, dict[str, float]()
    if not band.any():
        return out
    own = model.sizes[TRAVEL] * model.travel_shifts(band)
    z = -own.T @ np.linalg.solve(found.V, found.residuals)
    left = 1.0 - np.einsum("ed,ed->d", own, np.linalg.solve(found.V, own - found.jacobian @ (found.gain @ own)))
    for cable, square in zip(model.campaign.drums, z**2 + left.clip(0.0), strict=True):
        size = math.hypot(model.sizes[PLAY], model.sizes[TRAVEL] * math.sqrt(square))
        out[cable.from_point] = max(size, out.get(cable.from_point, 0.0))
    return out


def with_play(rig: Rig, variables: list[Variable], play: dict[str, float]) -> Rig:
    """Return the rig with the estimated play of each drum stated if it was unstated, or is clearly larger than stated."""
    every = [(v, factor_of(v, {v.kind.code: play[v.owner]})) for v in variables if v.kind.adds is None and v.owner in play]
    own = {(v.owner, v.kind.key): v.u * factor for v, factor in every if v.assumed or factor > CLEARLY}
    points = [
        p.model_copy(update={"drum": p.drum.model_copy(update={key: u for (owner, key), u in own.items() if owner == p.name})})
        for p in rig.observation_point
    ]
    return rig.model_copy(update={"observation_point": tuple(points)})


def _components(model: Model, found: Fit) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return the (e, e) covariance of the residuals by statements and nominal values, and those by typical sizes of each group."""
    theta, silent = found.theta, found.undetermined
    V = model.with_noise(model.noise.bare()).without_assumed().covariance(theta) + silent @ silent.T
    absent = model.noise.absent if model.places_known else ()
    typical, out = model.with_sizes({}), dict[str, FloatArray]()
    shifts, of = typical.unsolved_shifts(theta), _columns(typical)
    for code in dict.fromkeys(v.kind.code for v in of):
        own = shifts * [doubt_of(v) * (v.kind.code == code) for v in of]
        out[code] = own @ own.T
    band = model.doubted_play_mm * math.sqrt(0.5)
    if band.any():
        # how the cables came to the poses is not known: the band has both laws in equal parts
        out[PLAY], out[TRAVEL] = model.play_covariance(band), model.travel_covariance(band)
    J = model.pose_jacobian(theta) if absent else np.zeros((model.equations, 0, 6))
    visits = model.campaign.reference_of[:, None] == np.arange(len(model.campaign.poses))
    for name in absent:
        own = J[:, :, 3:] * ASSUMED[name] if name == "position" else J[:, :, :3] * ASSUMED[name]
        own = np.einsum("eni,nr->eri", own, visits).reshape(len(own), -1)
        out[name] = own @ own.T
    return V, out | fields(model.poses(theta), model.pose_jacobian(theta)) if smooth(model) else out


def smooth(model: Model) -> bool:
    """Return whether the errors of the reference poses may be smooth over them: not those of poses that are stated to be exact."""
    source, poses = model.campaign.source, model.campaign.poses
    exact = not poses.absent and not poses.covariances.any()
    unstated = source == "unknown" and model.campaign.rig.unstated == "typical" and not exact
    return not model.pose_unknowns and (source == "robot" or unstated)


def _columns(model: Model) -> list[Variable]:
    """The variable of each column of `unsolved_shifts`."""
    return [v for v in model.unsolved.variables for _ in v.names]


def _sized(model: Model, size: dict[str, float]) -> Model:
    """The model with sizes in units of the typical ones."""
    half = {name: math.sqrt(0.5) * size[name] for name in (PLAY, TRAVEL) if name in size}
    every = size | {v.kind.code: half[PLAY] for v in model.variables if v.kind.adds is None} | half
    noise = model.noise
    if noise.absent and model.places_known:
        own = [ASSUMED[name] * size.get(name, 0.0) for name in ("position", "rotation")]
        noise = noise.bare().widened(*own)
    return model.with_sizes(every).with_noise(noise)


def _moments(model: Model, found: Fit, drawn: Sizes) -> tuple[FloatArray, FloatArray]:
    """Return the (P + q,) mean shift of unknowns and unsolved dimensions over probable sizes, and (P + q, k) their changes with k other
    sizes, times the root of their weights."""
    V, parts = _components(model, found)
    typical = model.with_sizes({})
    C, of, J, r = typical.unsolved_shifts(found.theta), _columns(typical), found.determined, found.residuals
    back = found.directions[found.known].T * found.problem.parameters.width[:, None]
    u = np.array([v.u for v in of])
    moved, covariances = [], np.array(list(parts.values()))
    for size in drawn.draws:
        scale = np.array([factor_of(v, dict(zip(parts, size.tolist(), strict=True))) for v in of])
        E = np.linalg.inv(V + np.tensordot(size**2, covariances, 1))
        step = -np.linalg.solve(J.T @ E @ J, J.T @ E @ r)
        z = -(C * scale).T @ E @ (r + J @ step)
        moved.append(np.r_[back @ step[: back.shape[1]], step[back.shape[1] :], u * scale * z])
    every = np.array(moved)
    mean = every.mean(axis=0)
    return mean, np.asarray(((every - mean) / np.sqrt(len(every))).T)
