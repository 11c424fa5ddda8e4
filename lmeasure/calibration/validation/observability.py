"""Unobservable directions: per observation point those in which only the prior speaks, in numbers and words."""

from collections.abc import Iterable

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.estimation import Parameters, by_owner
from lmeasure.recording import Poses
from lmeasure.rig import PLACE, TABLE, Observed, Rig, Unobservable
from lmeasure.text import Message, joined, message, texts

_UNITS = {p.key: p.unit for p in TABLE if f"parameter.{p.key}" in texts("en")} | {"zero_deg": "deg", "zero_mm": "mm"}


def lines_of_sight(rig: Rig, cables: Iterable[Observed], poses: Poses) -> dict[str, FloatArray]:
    """(3,) unit vectors, base frame, from the cables' observation points towards the middle of the poses."""
    middle = poses.rows[:, :3].mean(axis=0)
    ways = {c.from_point: middle - np.array(rig.point(c.from_point).position_mm) for c in cables if c.from_point}
    return {name: way / max(float(np.linalg.norm(way)), 1e-9) for name, way in ways.items()}


def unobservable_directions(unknowns: Parameters, silent: FloatArray, sight: dict[str, FloatArray]) -> list[Unobservable]:
    """Return the undetermined directions of each owner of unknowns, strongest first, then shared ones (`estimation.observability`).

    silent (k, p): orthonormal directions that the data do not determine, in prior widths. sight (3,) is the unit vector from each
    observation point towards the middle of its poses.
    """
    out = []
    for found in by_owner(unknowns, silent):
        change = found.weight * unknowns.width
        determined = [
            _text(owner, [unknowns.names[i].rsplit(".", 1)[1] for i in own], change[own], found.weight[own], sight.get(owner))
            for owner, own in found.parts(unknowns)
        ]
        of = unknowns.of(found.owner) if found.alone else range(len(unknowns.names))
        direction = {unknowns.names[i]: float(found.weight[i]) for i in of}
        out.append(Unobservable(point=found.owner, direction=direction, text=message("calibration.silent", what=joined(determined))))
    return out


def _text(owner: str, keys: list[str], change: FloatArray, vector: FloatArray, sight: FloatArray | None) -> Message:
    """Return the text of joint motions and their sizes (one prior standard uncertainty along the direction) that change no count."""
    by_key = dict(zip(keys, change, strict=True))
    parts: list[Message | tuple[Message, ...]] = []
    move = np.array([by_key.get(k, 0.0) for k in PLACE])
    length = float(np.linalg.norm(move))
    place = [i for i, k in enumerate(keys) if k in PLACE]
    if place and float(np.linalg.norm(vector[place])) > 0.1:
        along = abs(float(move @ sight)) / length if sight is not None else 0.0
        way = "along" if along > 0.9 else "across" if along < 0.4 else "askew"
        parts.append(message(f"calibration.silent.{way}", mm=length, **dict(zip("xyz", (move / length).tolist(), strict=True))))
    turns = []
    for key, value, weight in zip(keys, change, vector, strict=True):
        if key not in PLACE and abs(weight) > 0.1:
            unit = f"_{_UNITS[key]}" if _UNITS.get(key) else ""
            name = message(f"parameter.{key}") if key in _UNITS else key
            turns.append(message(f"calibration.silent.changes{unit}", name=name, value=float(value)))
    if turns:
        parts.append(tuple(turns))
    what = parts[0] if len(parts) == 1 else message("calibration.silent.moves_while", moves=parts[0], turns=parts[1]) if parts else ""
    alone = "_changes" if turns and len(parts) == 1 else ""
    return message(f"calibration.silent.owner{alone}", owner=owner, what=what)
