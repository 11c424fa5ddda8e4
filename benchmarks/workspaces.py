"""Workspaces of mechanisms beside brute force: every node of a grid judged by formulas that share nothing with the program, and volumes.

    python benchmarks/workspaces.py [--poses 2000000] [--write]

The brute force reads robot.toml by itself and knows a leg as a drawing shows it: a carriage by the angle between two circles, a hinged one
by the vertical plane through it, an arm by the law of cosines, a strut by its length, a slider by a quadratic. Limits are joints', gaps',
cones', the centre of mass and the distance from singular poses. Its volume is that of random places; the grid's can be off by half of the
cells at the boundary at most, which is its error here. Robots of fewer freedoms are in `workspaces_few_freedoms`.
"""

import math
import sys
import tomllib
from collections.abc import Callable
from importlib.resources import files
from typing import Any, NamedTuple

import numpy as np
import workspaces_few_freedoms
from numpy.typing import NDArray
from study import options, show

from lmeasure.core import se3
from lmeasure.robots import ParallelFile, Turns, any_shipped, checked, over_grid

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
SEED = 20


class Case(NamedTuple):
    """A robot, its grid (least, most, step) along x, y, z [mm], its turn about the vertical [deg] or None for any."""

    robot: str
    x: tuple[float, float, float]
    y: tuple[float, float, float]
    z: tuple[float, float, float]
    yaw: float | None = 0.0


CASES = (
    Case("rotopod", (-200, 200, 10), (-200, 200, 10), (955, 980, 1)),
    Case("rotopod", (-200, 200, 10), (-200, 200, 10), (955, 980, 1), 25.0),
    Case("rotopod", (-200, 200, 20), (-200, 200, 20), (958, 978, 2), None),
    Case("four-chains", (-150, 150, 10), (-150, 150, 10), (20, 200, 10)),
    Case("four-chains-arms", (-150, 150, 10), (-150, 150, 10), (20, 260, 10)),
    Case("logos", (-500, 500, 25), (-500, 500, 25), (400, 1000, 25)),
    Case("logos", (-500, 500, 25), (-500, 500, 25), (400, 1000, 25), 20.0),
    Case("three-prr", (-250, 250, 5), (-250, 250, 5), (-1, 1, 1), 10.0),
)


class Reported(NamedTuple):
    """A robot of fewer freedoms, the grid (least, most, step) of what it is told, their unit, and which of them by brute force it can
    take: `workspaces_few_freedoms`."""

    robot: str
    axes: tuple[tuple[float, float, float], ...]
    unit: str
    can: Callable[[dict[str, Any], FloatArray], BoolArray]


REPORTED = (
    Reported("crank-platform", ((-8, 8, 1), (-8, 8, 1), (180, 206, 2)), "deg deg mm", workspaces_few_freedoms.crank_platform),
    Reported("seven-link", ((30, 200, 0.5),), "mm", workspaces_few_freedoms.seven_link),
)
MOST_TOLD = 5000
"""Random values of what these are told: each is looked for by itself."""


def kept(data: dict[str, Any], places: FloatArray, yaw: float) -> BoolArray:
    """(N,) whether the platform, turned by yaw [rad] about the vertical, may be at places (N, 3)."""
    c, s = math.cos(yaw), math.sin(yaw)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    limits = data.get("limits", {})
    points = np.array([leg["platform_mm"] for leg in data["leg"]])
    size = max(np.linalg.norm(points - points.mean(axis=0), axis=1).max(), 1.0)
    good = np.ones(len(places), np.bool_)
    rows, legs, feet = [], [], []
    carriages: list[FloatArray] = []
    for leg, point in zip(data["leg"], points @ turn.T, strict=True):
        at = places + point
        directions = []
        if leg["type"] == "plane":
            good &= np.abs(at[:, 2] - leg.get("height_mm", 0.0)) < 1e-6
            directions.append(np.tile([0.0, 0.0, 1.0], (len(at), 1)))
        else:
            foot, inside, across = FEET[leg["type"]](leg, at, carriages)
            good &= inside
            away = at - foot
            legs.append(away)
            feet.append(foot)
            if across is not None:
                directions.append(across)
            reach = away / np.linalg.norm(away, axis=1)[:, None]
            directions.append(reach)
            if leg["type"] == "radial-arm":
                directions[-1] = upper_arm(leg, foot, at)
        rows += [np.column_stack([np.cross(np.tile(point, (len(at), 1)), d) / size, d]) for d in directions]
    matrix = np.nan_to_num(np.stack(rows, axis=1))
    values = np.linalg.svd(matrix, compute_uv=False)
    good &= values[:, -1] > limits.get("singular", 1e-3) * values[:, 0]
    tilt = [np.degrees(np.arccos(leg[:, 2] / np.linalg.norm(leg, axis=1))) for leg in legs]
    # level platforms: both cones are about the same vertical
    for key in ("base_cone_deg", "platform_cone_deg"):
        if key in limits:
            good &= np.max(tilt, axis=0) <= limits[key] + 1e-9
    if carriages and ("least_gap_deg" in limits or "most_gap_deg" in limits):
        good &= spaced(np.degrees(np.array(carriages).T), limits)
    if "mass_mm" in limits:
        centre = places + turn @ np.array(limits["mass_mm"])
        corners = np.stack(feet, axis=1)[:, :, :2] - centre[:, None, :2]
        around = np.sort(np.arctan2(corners[..., 1], corners[..., 0]), axis=1)
        # over a polygon is who sees its corners all round
        steps = np.diff(np.column_stack([around, around[:, :1] + 2.0 * np.pi]), axis=1)
        good &= steps.max(axis=1) < np.pi
    return good


def spaced(angles: FloatArray, limits: dict[str, Any]) -> BoolArray:
    """(N,) whether carriages (N, n) [deg], listed as they stand round the guide, keep their gaps."""
    gap = (np.roll(angles, -1, axis=1) - angles + 180.0) % 360.0 - 180.0
    gap = np.where(gap < 0.0, gap + 360.0, gap)
    least, most = limits.get("least_gap_deg", 0.0), limits.get("most_gap_deg", 360.0)
    return np.asarray(((gap >= least - 1e-9) & (gap <= most + 1e-9)).all(axis=1) & (np.abs(gap.sum(axis=1) - 360.0) < 1.0))


def within(value: FloatArray, low: float, high: float) -> BoolArray:
    return np.asarray((value >= low - 1e-9) & (value <= high + 1e-9))


def turned(leg: dict[str, Any], angle: FloatArray) -> BoolArray:
    """Whether an angle [rad], by any whole turns, is within a joint's limits."""
    low, high = leg.get("min_deg", -360.0), leg.get("max_deg", 360.0)
    degrees = np.degrees(angle) - leg.get("offset_deg", 0.0)
    return np.asarray((degrees - low) % 360.0 <= high - low + 1e-9) if high - low < 360.0 else np.isfinite(degrees)


def carriage(leg: dict[str, Any], at: FloatArray, carriages: list[FloatArray]) -> tuple[FloatArray, BoolArray, None]:
    ring, rod, height = leg["ring_mm"], leg["rod_mm"], leg.get("height_mm", 0.0)
    far = np.hypot(at[:, 0], at[:, 1])
    flat = rod**2 - (at[:, 2] - height) ** 2
    cosine = (ring**2 + far**2 - flat) / (2.0 * ring * far)
    meets = (flat > 0.0) & (np.abs(cosine) <= 1.0)
    half = np.arccos(np.clip(cosine, -1.0, 1.0))
    angle = np.arctan2(at[:, 1], at[:, 0]) + (half if leg.get("elbow", 1) == 2 else -half)
    carriages.append(angle)
    foot = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), np.full(len(at), height)])
    return foot, meets & turned(leg, angle), None


def radial(leg: dict[str, Any], at: FloatArray, carriages: list[FloatArray]) -> tuple[FloatArray, BoolArray, FloatArray]:
    ring, height = leg["ring_mm"], leg.get("height_mm", 0.0)
    angle = np.arctan2(at[:, 1], at[:, 0])
    carriages.append(angle)
    foot = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), np.full(len(at), height)])
    far = np.linalg.norm(at - foot, axis=1)
    across = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(len(at))])
    good = turned(leg, angle)
    if leg["type"] == "radial":
        slide = far - leg.get("slide_offset_mm", 0.0)
        return foot, good & within(slide, leg["slide_min_mm"], leg["slide_max_mm"]), across
    lift = np.degrees(arm_lift(leg, foot, at)) - leg.get("lift_deg", 0.0)
    low, high = leg.get("lift_min_deg", -360.0), leg.get("lift_max_deg", 360.0)
    middle = 0.5 * (low + high)
    lift = middle + (lift - middle + 180.0) % 360.0 - 180.0
    return foot, good & within(lift, low, high), across


def arm_lift(leg: dict[str, Any], foot: FloatArray, at: FloatArray) -> FloatArray:
    """[rad] of the lower arm above the way inwards, by the law of cosines; NaN where the arms do not reach."""
    inward = np.hypot(foot[:, 0], foot[:, 1]) - np.hypot(at[:, 0], at[:, 1])
    up = at[:, 2] - foot[:, 2]
    far, lower, upper = np.hypot(inward, up), leg["lower_mm"], leg["upper_mm"]
    with np.errstate(invalid="ignore"):
        half = np.arccos((lower**2 + far**2 - upper**2) / (2.0 * lower * far))
    return np.asarray(np.arctan2(up, inward) + (half if leg.get("elbow", 2) == 2 else -half))


def upper_arm(leg: dict[str, Any], foot: FloatArray, at: FloatArray) -> FloatArray:
    """(N, 3) direction from the elbow to the platform."""
    lift = arm_lift(leg, foot, at)
    outward = foot / np.hypot(foot[:, 0], foot[:, 1])[:, None]
    outward[:, 2] = 0.0
    elbow = foot + leg["lower_mm"] * (-np.cos(lift)[:, None] * outward + np.sin(lift)[:, None] * [0.0, 0.0, 1.0])
    return np.asarray((at - elbow) / leg["upper_mm"])


def strut(leg: dict[str, Any], at: FloatArray, carriages: list[FloatArray]) -> tuple[FloatArray, BoolArray, None]:
    foot = np.tile(np.array(leg["base_mm"]), (len(at), 1))
    value = (np.linalg.norm(at - foot, axis=1) - leg.get("offset_mm", 0.0)) / leg.get("scale", 1.0)
    return foot, within(value, leg["min_mm"], leg["max_mm"]), None


def slider(leg: dict[str, Any], at: FloatArray, carriages: list[FloatArray]) -> tuple[FloatArray, BoolArray, None]:
    azimuth, elevation = math.radians(leg["azimuth_deg"]), math.radians(leg.get("elevation_deg", 0.0))
    way = np.array([math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation), math.sin(elevation)])
    begin = np.array(leg["base_mm"])
    off = at - begin
    along = off @ way
    square = leg["rod_mm"] ** 2 - ((off**2).sum(axis=1) - along**2)
    part = np.sqrt(np.maximum(square, 0.0)) * (1.0 if leg.get("elbow", 1) == 2 else -1.0)
    value = along + part
    return begin + value[:, None] * way, (square >= 0.0) & within(value, leg["min_mm"], leg["max_mm"]), None


FEET = {"carriage": carriage, "radial": radial, "radial-arm": radial, "strut": strut, "slider": slider}
YAWS = 72


def read(robot: str) -> dict[str, Any]:
    """robot.toml as it comes along."""
    return tomllib.loads(files("lmeasure.robots").joinpath(f"shipped/{robot}.toml").read_text(encoding="utf-8"))


def judged(data: dict[str, Any], places: FloatArray, yaw: float | None) -> BoolArray:
    """(N,) at a turn [deg], or at any of `YAWS` round the vertical."""
    yaws = 2.0 * np.pi / YAWS * np.arange(YAWS) if yaw is None else np.array([math.radians(yaw)])
    return np.logical_or.reduce([kept(data, places, float(y)) for y in yaws])


def beside(case: Case, poses: int) -> tuple[int, int, float, float, float, float]:
    """Nodes, of which judged otherwise, volume of the grid and its error, volume of random places and its standard uncertainty [mm^3]."""
    data = read(case.robot)
    axes = tuple(np.arange(a, b + 0.5 * step, step) for a, b, step in case[1:4])
    half = math.radians(case.yaw or 0.0) / 2.0
    file = any_shipped(case.robot)
    assert isinstance(file, ParallelFile)
    turn = np.array([0.0, 0.0, math.sin(half), math.cos(half)])
    found = over_grid(file, (axes[0], axes[1], axes[2]), turn, Turns(yaw_free=case.yaw is None)).found
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    parts = np.array_split(nodes, max(1, len(nodes) // 100_000))
    own = np.concatenate([judged(data, part, case.yaw) for part in parts]).reshape(found.inside.shape)
    padded = np.pad(found.inside, 1)
    flat = case.robot == "three-prr"
    ways = [0, 1] if flat else [0, 1, 2]
    differs = np.zeros_like(padded)
    for axis in ways:
        for shift in (-1, 1):
            differs |= padded != np.roll(padded, shift, axis)
    cell = float(np.prod([axis[1] - axis[0] for axis in axes]))
    boundary = int(differs.sum())
    rng = np.random.default_rng(SEED)
    low, high = (np.array([axis[end] + sign * 0.5 * (axis[1] - axis[0]) for axis in axes]) for end, sign in ((0, -1.0), (-1, 1.0)))
    if flat:
        low[2] = high[2] = 0.0
    share, count = 0, 0
    while count < poses:
        places = rng.uniform(low, high, (min(100_000, poses - count), 3))
        share, count = share + int(judged(data, places, case.yaw).sum()), count + len(places)
    box = float(np.prod((high - low)[ways])) * (cell / float(np.prod([axes[a][1] - axes[a][0] for a in ways])))
    part = share / count
    error = 0.5 * boundary * cell / (2.0 if flat else 1.0)
    return (nodes.shape[0], int((own != found.inside).sum()), found.size[1], error, part * box, box * math.sqrt(part * (1 - part) / count))


def taken(robot: str, reported: FloatArray) -> BoolArray:
    """(N,) whether by the program it can take told (N, k): turns about x and y [deg] and z, or x [mm], as from home."""
    file = any_shipped(robot)
    assert isinstance(file, ParallelFile)
    model, delta = file.model, np.zeros((len(reported), 6))
    if reported.shape[1] == 3:
        delta[:, :2] = np.radians(reported[:, :2])
    arguments = se3.displaced(np.tile(model.home, (len(reported), 1)), delta)
    arguments[:, 2 if reported.shape[1] == 3 else 0] = reported[:, -1]
    poses = model.nearest(arguments)
    lost = np.isnan(poses[:, :1])
    return checked(model, file.limits, np.where(lost, model.home, poses)).all & ~lost[:, 0]


def beside_reported(case: Reported, poses: int) -> tuple[int, int, float, float, float, float]:
    """As `beside`, sizes in the units of what is told."""
    data, axes = read(case.robot), tuple(np.arange(a, b + 0.5 * step, step) for a, b, step in case.axes)
    scale = np.array([np.radians(1.0)] * 2 + [1.0]) if len(axes) == 3 else np.ones(1)
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))
    inside, own = taken(case.robot, nodes), case.can(data, nodes * scale)
    padded = np.pad(inside.reshape([len(axis) for axis in axes]), 1)
    differs = np.logical_or.reduce([padded != np.roll(padded, shift, axis) for axis in range(len(axes)) for shift in (-1, 1)])
    steps = np.array([step for _, _, step in case.axes])
    cell, box = float(np.prod(steps)), float(np.prod([len(axis) * step for axis, step in zip(axes, steps, strict=True)]))
    low, high = (np.array([axis[end] for axis in axes]) + way * 0.5 * steps for end, way in ((0, -1.0), (-1, 1.0)))
    places = np.random.default_rng(SEED).uniform(low, high, (min(poses, MOST_TOLD), len(axes)))
    part = float(case.can(data, places * scale).mean())
    u = box * math.sqrt(part * (1.0 - part) / len(places))
    return len(nodes), int((own != inside).sum()), float(inside.sum()) * cell, 0.5 * float(differs.sum()) * cell, part * box, u


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--poses", type=int, default=2_000_000)
    arguments = parser.parse_args()
    lines = ["| robot | turn | nodes | judged otherwise | volume, litres | at most off by | random places, litres | standard uncertainty |"]
    lines.append("|---" * 8 + "|")
    print("\n".join(lines))
    bad = False
    for case in CASES:
        fewer = arguments.poses // YAWS if case.yaw is None else arguments.poses
        nodes, other, volume, error, random, u = beside(case, max(fewer, 1000))
        turn = "any" if case.yaw is None else f"{case.yaw:g} deg"
        sizes = " | ".join(f"{v / 1e6:.4f}" for v in (volume, error, random, u))
        lines.append(f"| {case.robot} | {turn} | {nodes} | {other} | {sizes} |")
        print(lines[-1], flush=True)
        bad |= other > 0 or abs(volume - random) > error + 3.0 * u
    head = "| robot | unit | nodes | judged otherwise | size | at most off by | of random ones | standard uncertainty |"
    lines += [
        "",
        "Of what robots of fewer freedoms are told: tilts and height of the crank platform, x of the body on five rods.",
        "",
        head,
    ]
    lines.append("|---" * 8 + "|")
    for reported in REPORTED:
        nodes, other, volume, error, random, u = beside_reported(reported, arguments.poses)
        sizes = " | ".join(f"{v:.2f}" for v in (volume, error, random, u))
        lines.append(f"| {reported.robot} | {reported.unit} | {nodes} | {other} | {sizes} |")
        print(lines[-1], flush=True)
        bad |= other > 0 or abs(volume - random) > error + 3.0 * u
    run = f"`python benchmarks/workspaces.py --poses {arguments.poses} --write`, seed {SEED}."
    show(arguments, f"# Workspaces beside brute force\n\n{run}\n\n" + "\n".join(lines), "workspaces")
    sys.exit(1 if bad else 0)


if __name__ == "__main__":
    main()
