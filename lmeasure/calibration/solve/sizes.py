"""Sizes of what nobody stated, estimated together: errors of drums, pulleys and attachment points by groups, and of reference poses.

A typical size says how large such errors may be. How large they are in this rig its residuals show: all parts of one kind are pooled, and
the restricted likelihood decides between the kinds (`estimation.variance_components`). What the residuals do not show keeps its typical
size. How the fit would move with other probable sizes is added to its covariance.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.calibration.solve.noise import ASSUMED
from lmeasure.calibration.solve.reference_field import fields
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.core import FloatArray
from lmeasure.estimation import Fit, Sizes, fit, sizes
from lmeasure.rig import Rig
from lmeasure.sensors import Unsolved, Variable

ROUNDS = 2
PLAY = "play"


@dataclass(frozen=True)
class Sized:
    """A model with estimated sizes and its fit.

    size: in units of the typical ones, by the code of the kind, `PLAY`, "position", "rotation", or the name of a field. spread (P + q, k):
    columns whose squares are a covariance of the unknowns and of what is not solved, by what is not known of the sizes.
    """

    model: Model
    fit: Fit
    size: dict[str, float]
    spread: FloatArray


def with_estimated_sizes(model: Model, found: Fit, seed: int = 0) -> Sized | None:
    """The model and its fit under the sizes that its residuals show; None where every size is stated."""
    if not (any(v.assumed for v in model.variables) or smooth(model)):
        return None
    absent = model.noise.absent if model.places_known else ()
    stated = model.with_noise(model.noise.bare()).with_sizes({v.kind.code: 0.0 for v in model.variables})
    now = model
    for _ in range(ROUNDS):
        parts = _parts(model, found.theta, absent)
        silent = found.undetermined
        V = stated.covariance(found.theta) + silent @ silent.T
        drawn = sizes(found.residuals, found.determined, V, list(parts.values()), seed=seed)
        now = _sized(model, dict(zip(parts, drawn.size.tolist(), strict=True)))
        found = fit(now, found.theta, found.prior_everywhere, near=True)
    size = dict(zip(parts, drawn.size.tolist(), strict=True))
    return Sized(now, found, size, _spread(model, found, V, parts, drawn))


def with_play(rig: Rig, variables: list[Variable], size: float | None) -> Rig:
    """The rig with the estimated size of play stated where it was assumed."""
    if size is None:
        return rig
    own = {(v.owner, v.kind.key): v.u * size for v in variables if v.assumed and v.kind.adds is None}
    points = [
        p.model_copy(update={"drum": p.drum.model_copy(update={key: u for (owner, key), u in own.items() if owner == p.name})})
        for p in rig.observation_point
    ]
    return rig.model_copy(update={"observation_point": tuple(points)})


def _parts(model: Model, theta: FloatArray, absent: tuple[str, ...]) -> dict[str, FloatArray]:
    """(e, e) covariances by typical sizes of each group."""
    typical, out = model.with_sizes({}), dict[str, FloatArray]()
    shifts, of = typical.unsolved_shifts(theta), _columns(typical)
    for code in dict.fromkeys(v.kind.code for v in of if v.assumed):
        own = shifts[:, [v.assumed and v.kind.code == code for v in of]]
        out[code] = own @ own.T
    play = [v for v in model.variables if v.assumed and v.kind.adds is None]
    if play:
        band = Unsolved(model.campaign.rig, play, model.campaign.drums).play_mm
        # encoders of angles have none
        out[PLAY] = model.play_covariance(np.r_[band, np.zeros(len(model.campaign.cables) - len(band))])
    J = model.pose_jacobian(theta) if absent else np.zeros((model.equations, 0, 6))
    visits = model.campaign.reference_of[:, None] == np.arange(len(model.campaign.poses))
    for name in absent:
        own = J[:, :, 3:] * ASSUMED[name] if name == "position" else J[:, :, :3] * ASSUMED[name]
        own = np.einsum("eni,nr->eri", own, visits).reshape(len(own), -1)
        out[name] = own @ own.T
    return out | fields(model.campaign.source, model.poses(theta), model.pose_jacobian(theta)) if smooth(model) else out


def smooth(model: Model) -> bool:
    """Whether the errors of the reference poses may be smooth over them."""
    source = model.campaign.source
    return not model.pose_unknowns and (source == "robot" or (source == "unknown" and model.campaign.rig.unstated == "typical"))


def _columns(model: Model) -> list[Variable]:
    """The variable of each column of `unsolved_shifts`."""
    return [v for v in model.unsolved.variables for _ in v.names]


def _sized(model: Model, size: dict[str, float]) -> Model:
    """The model with sizes in units of the typical ones."""
    every = {v.kind.code: size.get(PLAY, 1.0) for v in model.variables if v.kind.adds is None} | size
    noise = model.noise
    if noise.absent and model.places_known:
        own = [ASSUMED[name] * size.get(name, 0.0) for name in ("position", "rotation")]
        noise = noise.bare().widened(*own)
    return model.with_sizes(every).with_noise(noise)


def _spread(model: Model, found: Fit, V: FloatArray, parts: dict[str, FloatArray], drawn: Sizes) -> FloatArray:
    """(P + q, k) how the unknowns and what is not solved move with k other sizes, times the root of their weights."""
    typical = model.with_sizes({})
    C, of, J, r = typical.unsolved_shifts(found.theta), _columns(typical), found.determined, found.residuals
    back = found.directions[found.known].T * found.problem.parameters.width[:, None]
    u = np.array([v.u for v in of])
    moved, covariances = [], np.array(list(parts.values()))
    for size in drawn.draws:
        scale = np.array([size[list(parts).index(v.kind.code)] if v.assumed else 1.0 for v in of])
        E = np.linalg.inv(V + np.tensordot(size**2, covariances, 1))
        step = -np.linalg.solve(J.T @ E @ J, J.T @ E @ r)
        z = -(C * scale).T @ E @ (r + J @ step)
        moved.append(np.r_[back @ step[: back.shape[1]], step[back.shape[1] :], u * scale * z])
    every = np.array(moved)
    return np.asarray(((every - drawn.weight @ every) * np.sqrt(drawn.weight)[:, None]).T)
