"""Poses of a run together with what all of its readings share and nobody knows: where counters were zeroed, say."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.rig import Parameter
from lmeasure.sensors.channel import Observation, differences, predictions, rows, values, variances
from lmeasure.sensors.solver import ALL, Solved, nowhere, solve_poses, twists

MOST_STEPS = 20
SETTLED = 1e-6  # of a standard uncertainty


class Joint(NamedTuple):
    """channels with the values found; covariance (q, q) of the parameters asked for, in their order and units; poses as `solve_poses` with
    these values taken as exact: `shared_errors` has the rest."""

    channels: list[Any]
    covariance: FloatArray
    poses: Solved


def solve_jointly(
    channels: Sequence[Observation], readings: FloatArray, starts: FloatArray, unknown: Sequence[str], *, free: IntArray = ALL
) -> Joint:
    """Parameters unknown (q,) by their names, each with its prior, and the poses of all samples, from readings (n, m); starts as in
    `solve_poses`, near enough for the samples that are to have a part in it.

    Gauss and Newton's method with the poses eliminated: of the readings of a sample counts what no motion of the tool could make up for.
    """
    found, at = list(channels), np.array(np.broadcast_to(starts, (len(readings), 7)))
    own = {q.name: q for o in channels for q in o.parameters}
    before = np.array([own[name].value for name in unknown])
    p, u, weight = before.copy(), np.array([own[name].prior_u for name in unknown]), 1.0 / np.sqrt(variances(channels))
    solved = nowhere(np.zeros(len(at), np.int64))._replace(poses=at)
    for _ in range(MOST_STEPS):
        ok = np.isfinite(solved.poses[:, 0])
        at[ok] = solved.poses[ok]
        used = np.isfinite(readings[ok])
        r = np.where(used, differences(found, readings[ok], predictions(found, at[ok])), 0.0) * weight
        J = rows(found, at[ok]) * weight[:, None]
        A = np.stack([_by(o, at[ok], unknown) for o in found], axis=1) * weight[:, None] * used[:, :, None]
        G = twists(found, at[ok], used, free) / weight
        # a sample whose readings tell no pose, in a gap, says nothing of what all share
        told = np.isfinite(G).all(axis=(1, 2))
        r, J, A, G, used = r[told], J[told], A[told], G[told], used[told]
        # A less what the poses follow of it
        A -= J @ (G @ A) * used[:, :, None]
        information = np.einsum("nmq,nmr->qr", A, A) * np.outer(u, u) + np.eye(len(u))
        step = u * np.linalg.solve(information, np.einsum("nmq,nm->q", A, r) * u - (p - before) / u)
        covariance = np.linalg.inv(information) * np.outer(u, u)
        p = p + step
        found = [with_values(o, dict(zip(unknown, p, strict=True))) for o in found]
        solved = solve_poses(found, readings, at, free)
        if (np.abs(step) <= SETTLED * np.sqrt(np.diag(covariance))).all():
            break
    return Joint(found, covariance, solved)


def with_values(observation: Any, by_name: dict[str, float]) -> Any:
    """A channel, a dataclass, whose parameters have these values."""
    own: tuple[Parameter, ...] = observation.parameters
    return replace(observation, parameters=tuple(replace(q, value=float(by_name.get(q.name, q.value))) for q in own))


def _by(observation: Observation, poses: FloatArray, names: Sequence[str]) -> FloatArray:
    """(n, q) derivatives of its readings by the parameters of these names."""
    own, out = [q.name for q in observation.parameters], np.zeros((len(poses), len(names)))
    mine = [i for i, name in enumerate(names) if name in own]
    if mine:
        out[:, mine] = observation.gradient(poses, values(observation))[:, [own.index(names[i]) for i in mine]]
    return out
