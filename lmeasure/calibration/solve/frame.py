"""Motions of rig and poses as a whole, which lengths cannot determine, and the frame that is chosen instead.

The frame is the one in which the squared shifts from the nominal rig, in units of their prior widths, or of the positions from the stated
ones, are least (decision 12). With G(x) (q, 6) the derivatives of the unknowns by the six motions and x(nominal) their shifts the choice is
the condition c = G'D(x - nominal) = 0, D the weights. A deviation dx of free length has the shift -G (C G)^-1 C dx that brings it back to
the frame, C = dc/dx: the S-transformation (Baarda 1973). C differs from G'D by the errors of the nominal rig or of the stated poses.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.calibration.solve.residuals import Frame
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.core import FloatArray, IntArray, se3
from lmeasure.estimation import Parameters
from lmeasure.kernels import guide_direction
from lmeasure.rig import GUIDE, PLACE
from lmeasure.sensors import guide as guide_frame

MAX_STEPS = 50
SETTLED = 1e-12


def model_of(campaign: Campaign, unknowns: Parameters, free: tuple[int, ...] = (), frame: Frame | None = None) -> Model:
    """The problem of a campaign, whose poses are unknown too in those of `unknowns.COMPONENTS` that are free; where positions are, a frame
    is chosen."""
    model = Model(campaign, unknowns, free=free, frame=frame if 3 in free else None)
    if model.frame is not None:
        model.gauge = Chosen(model, model.frame)
    return model


@dataclass(frozen=True)
class Chosen:
    """The frame of a model as its problem's gauge."""

    model: Model
    frame: Frame

    @property
    def keeps_prior(self) -> bool:
        """Return whether the priors of the rig choose its frame."""
        return self.frame == "rig"

    def motions(self, theta: FloatArray) -> FloatArray:
        """(P, g) `motions`."""
        return motions(self.model, theta) @ free_motions(self.model)

    def settled(self, theta: FloatArray) -> FloatArray:
        """(P,) `in_frame`."""
        return in_frame(self.model, theta, self.frame)

    def projection(self, theta: FloatArray) -> FloatArray:
        """(P, P) `to_frame`."""
        return to_frame(self.model, theta, self.frame)


def _places(model: Model) -> tuple[FloatArray, FloatArray]:
    """(q, 3) indices of the coordinates of the observation points, and (q, 2) of their guide angles, among the unknowns; both are
    solved for."""
    at = {name: i for i, name in enumerate(model.parameters.names)}
    points = dict.fromkeys(c.from_point for c in model.campaign.drums)
    place, guide = (np.array([[at[f"{p}.{key}"] for key in keys] for p in points]) for keys in (PLACE, GUIDE))
    return place, guide


def _zeros(model: Model) -> tuple[IntArray, IntArray]:
    """(s,) indices of the zeros of swivels among the unknowns, and (s, 2) of the guide angles that each is counted from."""
    at = {name: i for i, name in enumerate(model.parameters.names)}
    every = {f"{c.channel}.zero_deg": c.from_point for c in model.campaign.cables if not c.is_cable and c.from_point}
    found = [(at[name], [at[f"{point}.{key}"] for key in GUIDE]) for name, point in every.items() if name in at]
    return np.array([i for i, _ in found], dtype=np.int64), np.array([g for _, g in found], dtype=np.int64).reshape(len(found), 2)


def free_motions(model: Model) -> FloatArray:
    """Return (6, g) turns about the base axes and shifts that no residual determines. An encoder with a known vertical (an inclinometer, or
    a swivel with an exact zero) leaves only turns about it; else all are free."""
    names, ways = model.parameters.names, []
    for c in model.campaign.cables:
        counter = model.campaign.rig.counter(c)
        up = getattr(counter, "up", None)
        if up is not None:
            ways.append(np.array(up) / np.linalg.norm(up))
        elif counter.absolute and f"{c.channel}.{counter.zero}" not in names:
            ways.append(np.array([0.0, 0.0, 1.0]))
    if not ways:
        return np.eye(6)
    held = np.vstack([np.eye(3) - np.outer(way, way) for way in ways])
    return scipy.linalg.block_diag(scipy.linalg.null_space(held, rcond=1e-6), np.eye(3))


def _turned_zeros(alpha: FloatArray, beta: FloatArray) -> FloatArray:
    """Return the (s, 3) derivatives of swivels' zeros [rad] by turns of everything about the base axes [rad]. A turn twists a guide's frame
    by w.u about u, its angles alone by -sin(alpha) dbeta (`kernels.angles`); the reading stays the same, so the zero takes the
    difference."""
    return np.stack([-np.sin(beta) / np.cos(alpha), -np.cos(beta) / np.cos(alpha), np.zeros_like(beta)], axis=1)


def _turned_guides(alpha: FloatArray, beta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(q, 3) derivatives of alpha and of beta [rad] by turns of the guide's direction about the base axes [rad]."""
    s, c, t = np.sin(beta), np.cos(beta), np.tan(alpha)
    zero = np.zeros_like(s)
    return np.stack([-c, s, zero], axis=1), np.stack([-t * s, -t * c, zero - 1.0], axis=1)


def motions(model: Model, theta: FloatArray) -> FloatArray:
    """Return (p + d n, 6) derivatives of the unknowns, in their units, by three turns [rad] about the base frame's origin and three shifts
    [mm] of rig and poses together. Observation points and guides move; parameters of the tool or of a drum stay."""
    out = np.zeros((len(theta), 6))
    place, guide = _places(model)
    out[place] = se3.at_points(theta[place])[:, 3:]
    for i, by_turn in enumerate(_turned_guides(*np.radians(theta[guide]).T)):
        out[guide[:, i], :3] = np.degrees(by_turn)
    zeros, of = _zeros(model)
    out[zeros, :3] = np.degrees(_turned_zeros(*np.radians(theta[of]).T))
    rows, shifts = model.poses(theta), model.shifts(theta)
    every = np.zeros((len(rows), 6, 6))
    every[:, :3, :3] = np.degrees(np.linalg.inv(se3.left_jacobians(shifts[:, :3])))
    every[:, 3:] = se3.at_points(rows[:, :3] + model.arms)[:, 3:]
    out[model.own :] = every[model.at[:, None], model.free].reshape(-1, 6)
    return out


def moved(model: Model, theta: FloatArray, move: FloatArray) -> FloatArray:
    """The unknowns when rig and poses are turned by move (3) [rad] about the base frame's origin and then shifted by move (3) [mm]."""
    turn, shift = Rotation.from_rotvec(move[:3]), move[3:]
    out = theta.copy()
    place, guide = _places(model)
    out[place] = turn.apply(theta[place]) + shift
    zeros, of = _zeros(model)
    before = [guide_frame(*np.radians(theta[own])) for own in of]
    for a, b in guide:
        u = turn.apply(guide_direction(math.radians(theta[a]), math.radians(theta[b])))
        alpha, beta = math.degrees(math.asin(max(-1.0, min(1.0, u[2])))), math.degrees(math.atan2(-u[0], -u[1]))
        # on the branch of the earlier angle
        out[a], out[b] = alpha, beta + 360.0 * round((theta[b] - beta) / 360.0)
    for zero, own, frame in zip(zeros, of, before, strict=True):
        carried, new = turn.apply(frame[1]), guide_frame(*np.radians(out[own]))
        out[zero] += math.degrees(math.atan2(carried @ new[2], carried @ new[1]))
    rows, stated = model.poses(theta), model.campaign.poses.rows
    turned = (turn * se3.rotation(rows) * se3.rotation(stated).inv()).as_rotvec()
    every = np.column_stack([np.degrees(turned), turn.apply(rows[:, :3] + model.arms) + shift - model.arms - stated[:, :3]])
    out[model.own :] = every[model.at[:, None], model.free].reshape(-1)
    return out


def _weights(model: Model, frame: Frame) -> FloatArray:
    """(p + d n,) weight of each unknown's squared shift in the choice of the frame."""
    out = np.zeros(len(model.names))
    if frame == "rig":
        out[: model.own] = model.parameters.width**-2.0
    else:
        out[model.own :].reshape(-1, len(model.free))[:, model.free >= 3] = 1.0
    return out


def in_frame(model: Model, theta: FloatArray, frame: Frame) -> FloatArray:
    """The same rig and poses moved as a whole to where the weighted squared shifts are least (Gauss-Newton over the six motions)."""
    root, free = np.sqrt(_weights(model, frame)), free_motions(model)
    for _ in range(MAX_STEPS):
        G = motions(model, theta) @ free * root[:, None]
        size = np.linalg.norm(G, axis=0)
        move = np.linalg.lstsq(G / size, -root * (theta - model.start))[0] / size
        theta = moved(model, theta, free @ move)
        if float(np.linalg.norm(move * size)) < SETTLED * max(1.0, float(np.linalg.norm(root * (theta - model.start)))):
            break
    return theta


def to_frame(model: Model, theta: FloatArray, frame: Frame) -> FloatArray:
    """(P, P) S-transformation of deviations of the unknowns theta, which lie in the frame, P = p + d n."""
    free = free_motions(model)
    G, C = motions(model, theta) @ free, free.T @ condition(model, theta, frame)
    return np.asarray(np.eye(len(theta)) - G @ np.linalg.solve(C @ G, C))


def condition(model: Model, theta: FloatArray, frame: Frame) -> FloatArray:
    """(6, P) derivatives of the six conditions G'D(theta - nominal) = 0 by the unknowns, in units of the motions."""
    weight = _weights(model, frame)
    away = weight * (theta - model.start)
    C = (motions(model, theta) * weight[:, None]).T
    place, guide = _places(model)
    if frame == "poses":
        first = model.own + np.flatnonzero(model.free == 3)[0]
        place = first + np.arange(3) + len(model.free) * np.arange(len(model.at))[:, None]
    # the derivative of (axis x B)'x by B is x cross axis
    for axis in range(3):
        C[axis, place] += np.cross(away[place], np.eye(3)[axis])
    if frame == "rig":
        alpha, beta = np.radians(theta[guide]).T
        by_alpha, by_beta = away[guide].T
        s, c, t = np.sin(beta), np.cos(beta), np.tan(alpha)
        C[:2, guide[:, 0]] -= by_beta * (1.0 + t**2) * np.array([s, c])
        C[:2, guide[:, 1]] += by_alpha * np.array([s, c]) + by_beta * t * np.array([-c, s])
        zeros, of = _zeros(model)
        for zero, (a, b) in zip(away[zeros], of, strict=True):
            alpha, beta = math.radians(theta[a]), math.radians(theta[b])
            s, c, cos = math.sin(beta), math.cos(beta), math.cos(alpha)
            C[:2, a] -= zero * math.tan(alpha) / cos * np.array([s, c])
            C[:2, b] += zero / cos * np.array([-c, s])
    return np.asarray(C)
