"""What the counts cannot tell: per observation point the directions in which only the prior speaks, in numbers and words."""

from collections.abc import Iterable

import numpy as np

from lmeasure.arrays import FloatArray
from lmeasure.calibration_record import Unobservable
from lmeasure.estimation import Parameters
from lmeasure.observation.parameters import PLACE, TABLE
from lmeasure.poses import Poses
from lmeasure.rig import Cable, Rig

SAME = ": the counts stay the same, only the prior holds it"
SHARE = 0.3  # of a direction that several points share, from which a point's part is told
_WORDS = {p.key: (p.words, p.unit) for p in TABLE if p.words}


def lines_of_sight(rig: Rig, cables: Iterable[Cable], poses: Poses) -> dict[str, FloatArray]:
    """(3,) unit vectors, base frame, from the cables' observation points towards the middle of the poses."""
    middle = poses.rows[:, :3].mean(axis=0)
    ways = {c.from_point: middle - np.array(rig.point(c.from_point).position_mm) for c in cables}
    return {name: way / max(float(np.linalg.norm(way)), 1e-9) for name, way in ways.items()}


def unobservable_directions(unknowns: Parameters, silent: FloatArray, sight: dict[str, FloatArray]) -> list[Unobservable]:
    """The undetermined directions of each owner of unknowns, strongest first.

    silent (k, p): orthonormal directions of which the data say nothing, in prior widths. Their subspace of all unknowns together has
    no preferred basis, and would mix points; the projector onto it has: its block for one point has an eigenvalue near 1 for each
    direction of that point alone. What is left is spread over several points, and is listed under the one that moves most. sight (3,) is
    the unit vector from each observation point towards the middle of its poses.
    """
    projector = silent.T @ silent
    out = []
    for owner in dict.fromkeys(unknowns.owner(i) for i in range(len(unknowns.names))):
        own = unknowns.of(owner)
        values, vectors = np.linalg.eigh(projector[np.ix_(own, own)])
        for value, vector in sorted(zip(values, vectors.T, strict=True), key=lambda pair: -pair[0]):
            if value < 0.5:
                continue
            change = vector * unknowns.width[own]
            if change[np.argmax(np.abs(vector))] < 0:
                vector, change = -vector, -change
            keys = [unknowns.names[i].rsplit(".", 1)[1] for i in own]
            direction = {unknowns.names[i]: float(v) for i, v in zip(own, vector, strict=True)}
            out.append(Unobservable(point=owner, direction=direction, text=_text(owner, keys, change, vector, sight.get(owner)) + SAME))
    alone = np.array([[u.direction.get(name, 0.0) for name in unknowns.names] for u in out]).reshape(-1, len(unknowns.names))
    _, _, spread = np.linalg.svd(silent - silent @ alone.T @ alone)
    return out + [_spread(unknowns, vector, sight) for vector in spread[: max(0, len(silent) - len(out))]]


def _spread(unknowns: Parameters, vector: FloatArray, sight: dict[str, FloatArray]) -> Unobservable:
    """A direction (p,) in prior widths that several points share."""
    weight = {owner: float(np.linalg.norm(vector[unknowns.of(owner)])) for owner in map(unknowns.owner, range(len(vector)))}
    parts: list[str] = []
    for owner in sorted(weight, key=lambda name: -weight[name]):
        own = unknowns.of(owner)
        if weight[owner] > SHARE or not parts:
            keys = [unknowns.names[i].rsplit(".", 1)[1] for i in own]
            parts.append(_text(owner, keys, vector[own] * unknowns.width[own], vector[own], sight.get(owner)))
    direction = {name: float(v) for name, v in zip(unknowns.names, vector, strict=True)}
    return Unobservable(point=max(weight, key=lambda name: weight[name]), direction=direction, text="; ".join(parts) + SAME)


def _text(owner: str, keys: list[str], change: FloatArray, vector: FloatArray, sight: FloatArray | None) -> str:
    """What moves together by how much (one prior standard uncertainty along the direction) without changing a count."""
    by_key = dict(zip(keys, change, strict=True))
    parts = []
    move = np.array([by_key.get(k, 0.0) for k in PLACE])
    length = float(np.linalg.norm(move))
    place = [i for i, k in enumerate(keys) if k in PLACE]
    if place and float(np.linalg.norm(vector[place])) > 0.1:
        along = abs(float(move @ sight)) / length if sight is not None else 0.0
        way = "along its line of sight" if along > 0.9 else "across its line of sight" if along < 0.4 else "askew to its line of sight"
        unit = ", ".join(f"{c:.2f}" for c in move / length)
        parts.append(f"moves {length:.3g} mm {way} ({unit})")
    turns = []
    for key, value, weight in zip(keys, change, vector, strict=True):
        if key in _WORDS and abs(weight) > 0.1:
            name, unit = _WORDS[key]
            turns.append(f"{name} changes by {value:+.3g} {unit}".rstrip())
    if turns:
        parts.append(", ".join(turns))
    return f"{owner} " + " while ".join(parts)
