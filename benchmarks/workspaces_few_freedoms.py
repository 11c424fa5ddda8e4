"""Brute force for mechanisms of fewer than six freedoms: which commanded coordinates they can take (`workspaces.py`).

Nothing is shared with the program. The crank platform is given a height and a normal: for every turn about it the first two plain rods are
two circles of the platform's place in the plane, the third tells which turns close, and cranks follow by the law of cosines. The body on
five rods is given x: it is led there from home in steps of a tenth of a millimetre, and the way of its point summed up.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
TURN_DEG, TURNS = 60.0, 241
"""Turns about the normal that are looked at, from home's, and how many each way together."""
HALVINGS = 45
FINE_MM = 0.1


def crank_platform(data: dict[str, Any], reported: FloatArray) -> BoolArray:
    """(N,) whether it can take told (N, 3): the rotation vector's x and y [rad] of its normal from the vertical, and its height [mm]."""
    out = np.zeros(len(reported), np.bool_)
    for i, one in enumerate(reported):
        pose = _closed(data, _tilted(one[0], one[1]), float(one[2]))
        out[i] = pose is not None and _cranks_can(data, *pose)
    return out


def _tilted(rx: float, ry: float) -> FloatArray:
    """(3, 3) the turn by (rx, ry, 0), by Rodrigues' formula."""
    angle = math.hypot(rx, ry)
    if angle == 0.0:
        return np.eye(3)
    k = np.array([[0.0, 0.0, ry], [0.0, 0.0, -rx], [-ry, rx, 0.0]]) / angle
    return np.asarray(np.eye(3) + math.sin(angle) * k + (1.0 - math.cos(angle)) * k @ k)


def _places(data: dict[str, Any], tilt: FloatArray, z: float, turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(k, 2, 2) both places x, y that the first two plain rods leave at turns (k,) [rad], and (k, 2) by how much the third is too long."""
    plain = [leg for leg in data["leg"] if leg["type"] == "rod"]
    c, s = np.cos(turn), np.sin(turn)
    centres, squares = [], []
    for leg in plain:
        x, y, up = leg["platform_mm"]
        arm = np.stack([c * x - s * y, s * x + c * y, np.full_like(c, up)], axis=-1) @ tilt.T
        centres.append(np.array(leg["base_mm"][:2]) - arm[:, :2])
        squares.append(leg["rod_mm"] ** 2 - (z + arm[:, 2] - leg["base_mm"][2]) ** 2)
    way = centres[1] - centres[0]
    far = (way**2).sum(axis=1)
    part = 0.5 * (1.0 + (squares[0] - squares[1]) / far)
    with np.errstate(invalid="ignore"):
        off = np.sqrt(squares[0] / far - part**2)
    across = np.column_stack([-way[:, 1], way[:, 0]])
    both = np.stack([centres[0] + part[:, None] * way + sign * off[:, None] * across for sign in (1.0, -1.0)], axis=1)
    return both, ((both - centres[2][:, None]) ** 2).sum(axis=2) - squares[2][:, None]


def _closed(data: dict[str, Any], tilt: FloatArray, z: float) -> tuple[FloatArray, FloatArray] | None:
    """Rotation (3, 3) and place (3,) nearest to home that all plain rods allow; None where they allow none."""
    quaternion = data["home"]["quaternion_xyzw"]
    home = 2.0 * math.atan2(quaternion[2], quaternion[3])
    turns = home + np.radians(np.linspace(-TURN_DEG, TURN_DEG, TURNS))
    lacks = _places(data, tilt, z, turns)[1]
    with np.errstate(invalid="ignore"):
        at, which = np.nonzero(lacks[1:] * lacks[:-1] < 0.0)
    if not len(at):
        return None
    low, high, begin = turns[at], turns[at + 1], lacks[at, which]
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        same = _places(data, tilt, z, middle)[1][np.arange(len(at)), which] * begin > 0.0
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    places = _places(data, tilt, z, low)[0][np.arange(len(at)), which]
    best = int(np.argmin(np.hypot(*places.T) / 100.0 + np.abs(low - home)))
    c, s = math.cos(low[best]), math.sin(low[best])
    return tilt @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), np.array([*places[best], z])


def _cranks_can(data: dict[str, Any], turn: FloatArray, place: FloatArray) -> bool:
    """Whether every crank reaches, within its limits, and the six rods hold the platform."""
    points = np.array([leg["platform_mm"] for leg in data["leg"]])
    size = float(np.linalg.norm(points - points.mean(axis=0), axis=1).max())
    rows = []
    for leg in data["leg"]:
        arm = turn @ np.array(leg["platform_mm"])
        foot = np.array(leg["base_mm"])
        if leg["type"] == "crank":
            azimuth = math.radians(leg["azimuth_deg"])
            out, along = np.array([math.cos(azimuth), math.sin(azimuth), 0.0]), np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
            away = place + arm - foot
            side, up = float(away @ along), float(away[2])
            far, crank = math.hypot(side, up), leg["crank_mm"]
            cosine = (crank**2 + far**2 - leg["rod_mm"] ** 2 + float(away @ out) ** 2) / (2.0 * crank * far)
            if abs(cosine) > 1.0:
                return False
            angle = math.atan2(side, up) + (1.0 if leg["elbow"] == 2 else -1.0) * math.acos(cosine)
            if not leg["min_deg"] - 1e-9 <= math.degrees(angle) <= leg["max_deg"] + 1e-9:
                return False
            foot = foot + crank * (math.sin(angle) * along + math.cos(angle) * np.array([0.0, 0.0, 1.0]))
        way = place + arm - foot
        way /= np.linalg.norm(way)
        rows.append([*np.cross(arm, way) / size, *way])
    values = np.linalg.svd(np.array(rows), compute_uv=False)
    return bool(values[-1] > data.get("limits", {}).get("singular", 1e-3) * values[0])


def seven_link(data: dict[str, Any], reported: FloatArray) -> BoolArray:
    """(N,) whether it can take told (N, 1): x [mm], along its way from home."""
    x, along = _way(data, float(reported.min()), float(reported.max()))
    driver = next(leg for leg in data["leg"] if leg["type"] == "way")
    gone = np.interp(reported[:, 0], x, along, left=np.nan, right=np.nan)
    return np.asarray((gone >= driver["min_mm"]) & (gone <= driver["max_mm"]))


def _way(data: dict[str, Any], least: float, most: float) -> tuple[FloatArray, FloatArray]:
    """x of the driven point's places along the way, ascending, and how far each lies from home [mm]; as far as the rods allow."""
    rods = [leg for leg in data["leg"] if leg["type"] == "rod"]
    base, points = (np.array([leg[key] for leg in rods]) for key in ("base_mm", "platform_mm"))
    lengths = np.array([leg["rod_mm"] for leg in rods])
    sides: list[list[FloatArray]] = []
    for end in (least, most):
        place, turn = np.array(data["home"]["position_mm"]), _matrix(data["home"]["quaternion_xyzw"])
        count = max(2, math.ceil(abs(end - place[0]) / FINE_MM))
        way: list[FloatArray] = []
        for x in np.linspace(place[0], end, count):
            for _ in range(30):
                span = place + points @ turn.T - base
                far = np.linalg.norm(span, axis=1)
                d = span / far[:, None]
                rows = np.vstack([np.column_stack([np.cross(points @ turn.T, d), d]), [0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
                step = np.linalg.solve(rows, np.append(lengths - far, x - place[0]))
                place, turn = place + step[3:], _small(step[:3]) @ turn
                if np.abs(step).max() < 1e-11:
                    break
            else:
                break
            way.append(place.copy())
        sides.append(way)
    back, forth = (np.array(way) for way in sides)
    gone = [np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))]) for way in (back, forth)]
    return np.concatenate([back[:0:-1, 0], forth[:, 0]]), np.concatenate([-gone[0][:0:-1], gone[1]])


def _matrix(quaternion: list[float]) -> FloatArray:
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _small(vector: FloatArray) -> FloatArray:
    """(3, 3) the turn by a rotation vector."""
    x, y, z = vector
    angle = float(np.linalg.norm(vector))
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-12:
        return np.eye(3) + k
    return np.asarray(np.eye(3) + math.sin(angle) / angle * k + (1.0 - math.cos(angle)) / angle**2 * k @ k)
