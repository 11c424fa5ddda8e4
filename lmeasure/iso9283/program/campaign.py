"""The tests of ISO 9283:1998 as a robot runs them: the program with the measured parts, and the list of commands for it."""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.accuracy import extent, read_zone
from lmeasure.core import CONVENTIONS, MAX_LENGTH_MM, CertificationError, FloatArray
from lmeasure.recording import CommandedPath, CommandedPose, Compliance, Distance, Drift, Posing, Program
from lmeasure.robots import GRAVITY_M_S2, Command, Performance
from lmeasure.text import message

PLANES = ("C1-C2-C7-C8", "C2-C3-C8-C5", "C3-C4-C5-C6", "C4-C1-C6-C7")
POSES = ("P1", "P2", "P3", "P4", "P5")
INSET = 0.1
"""Distance of P2 to P5 from the ends of a diagonal, as a part of it."""
_CORNERS = np.array([[1, 1, -1], [1, -1, -1], [-1, -1, -1], [-1, 1, -1], [1, 1, 1], [1, -1, 1], [-1, -1, 1], [-1, 1, 1]], dtype=np.float64)


@dataclass(frozen=True)
class Cube:
    """A cube with edges along the base axes: centre (3,) [mm], edge [mm], and the plane that holds the poses."""

    centre: FloatArray
    edge_mm: float
    plane: str = PLANES[0]

    def __post_init__(self) -> None:
        if self.plane not in PLANES:
            raise CertificationError(message("error.plane_the_standard_s", plane=self.plane, planes=", ".join(PLANES)))
        # written so that NaN is refused
        if not (self.edge_mm > 0.0 and float(np.abs(self.centre).max()) + self.edge_mm <= MAX_LENGTH_MM):
            raise CertificationError(message("error.a_cube_of_mm", edge_mm=self.edge_mm, max_length_mm=MAX_LENGTH_MM))

    def corner(self, number: int) -> FloatArray:
        """Corner C1 to C8 (3,) [mm]."""
        return np.asarray(self.centre + 0.5 * self.edge_mm * _CORNERS[number - 1])

    def points(self) -> dict[str, FloatArray]:
        """P1 in the middle, P2 to P5 one after the other around the plane: at the diagonals' ends next to its first, fourth, third and
        second corner."""
        first, second, third, fourth = (self.corner(int(name[1])) for name in self.plane.split("-"))
        return {"P1": self.centre} | {
            name: (1.0 - INSET) * corner + INSET * (2.0 * self.centre - corner)
            for name, corner in zip(POSES[1:], (first, fourth, third, second), strict=True)
        }

    @property
    def normal(self) -> FloatArray:
        """Unit normal (3,) of the plane."""
        p = self.points()
        out = np.cross(p["P2"] - p["P1"], p["P3"] - p["P1"])
        return np.asarray(out / np.linalg.norm(out))


def largest_cube(low: Sequence[float], high: Sequence[float], plane: str = PLANES[0]) -> Cube:
    """The largest cube in the middle of a box, from its low and high corner (3,) [mm]."""
    first, last = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
    if first.shape != (3,) or last.shape != (3,):
        raise CertificationError(message("error.a_box_needs_three"))
    if not (last - first > 0.0).all():
        raise CertificationError(message("error.the_box_has_no"))
    return Cube(0.5 * (first + last), float((last - first).min()), plane)


def cube_in_zone(path: Path, plane: str = PLANES[0]) -> Cube:
    """The largest cube of nodes in the accuracy zone of a file; CertificationError when none fits."""
    found = extent(read_zone(path)).cube
    if found is None:
        raise CertificationError(message("error.no_cube_fits_into", where=path))
    return Cube(found[0], found[1], plane)


TESTS = ("pose", "approach", "stabilisation", "drift", "path", "reorientation", "posing", "compliance", "weaving")
CYCLES = {"pose": 30, "approach": 30, "stabilisation": 3, "path": 10, "reorientation": 10, "posing": 3, "compliance": 3, "weaving": 3}
"""Number of cycles of each test; the drift test has groups of ten cycles."""
MOST_CYCLES = 10_000
LONGEST_DRIFT_S = 100.0 * 3600.0


@dataclass(frozen=True)
class Tests:
    """Tests and their settings.

    tests: names of `TESTS`; quaternion (4,): the tool's orientation, base frame; speed_mm_s: rated speed between poses, path_speed_mm_s: on
    paths; speeds_percent of them and loads_kg: conditions of the pose and path tests, the first for all others; dwell_s: rest at a measured
    pose, without its first settle_s; cycles: other numbers than the standard's `CYCLES`; drift_s: duration of the drift test,
    drift_every_s: from group to group; weave_mm: stroke and way of one weave; limit_band_mm: about a pose at rest, within which the robot
    has arrived (settling and posing); angles: convention of component-wise angles.
    """

    __test__ = False  # no test of pytest's

    tests: tuple[str, ...] = TESTS
    quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    speed_mm_s: float = 1000.0
    path_speed_mm_s: float = 500.0
    speeds_percent: tuple[float, ...] = (100.0, 50.0, 10.0)
    loads_kg: tuple[float, ...] = (0.0,)
    dwell_s: float = 1.5
    settle_s: float = 0.5
    cycles: dict[str, int] = field(default_factory=dict)
    drift_s: float = 8.0 * 3600.0
    drift_every_s: float = 600.0
    weave_mm: tuple[float, float] = (10.0, 10.0)
    limit_band_mm: float = 0.1
    angles: str | None = None

    def __post_init__(self) -> None:
        for name in (*self.tests, *self.cycles):
            if name not in TESTS:
                raise CertificationError(message("error.there_is_no_test", name=name, tests=", ".join(TESTS)))
        for what, given in (("test", self.tests), ("speed", self.speeds_percent), ("load", self.loads_kg)):
            if not given:
                raise CertificationError(message("error.there_must_be_a"))
            if len(set(given)) < len(given):
                raise CertificationError(message("error.a_is_given_twice", what=what, given=", ".join(map(str, given))))
        if not abs(math.hypot(*self.quaternion) - 1.0) <= 1e-6:
            raise CertificationError(message("error.quaternion_is_not_of", quaternion=", ".join(f"{q:g}" for q in self.quaternion)))
        if self.angles is not None and self.angles not in CONVENTIONS:
            raise CertificationError(message("error.angles_is_not_one", angles=self.angles, conventions=", ".join(CONVENTIONS)))
        positive = (
            self.speed_mm_s,
            self.path_speed_mm_s,
            *self.speeds_percent,
            self.drift_s,
            self.drift_every_s,
            *self.weave_mm,
            self.limit_band_mm,
        )
        if not all(0.0 < v < math.inf for v in positive) or not all(0.0 <= v < math.inf for v in self.loads_kg):
            raise CertificationError(message("error.speeds_times_and_lengths"))
        if not 0.0 <= self.settle_s < self.dwell_s < math.inf:
            rest = message("iso.rest_of", dwell_s=self.dwell_s)
            raise CertificationError(message("error.leaves_nothing_to_measure", rest=rest, settle_s=self.settle_s))
        if any(not 2 <= n <= MOST_CYCLES for n in self.cycles.values()):
            raise CertificationError(message("error.each_test_needs_two", most_cycles=MOST_CYCLES))
        if self.drift_s > LONGEST_DRIFT_S:
            raise CertificationError(
                message("error.a_drift_test_of", drift_s=self.drift_s / 3600.0, longest_drift_s=LONGEST_DRIFT_S / 3600.0)
            )
        if max(self.speeds_percent) > 100.0:
            raise CertificationError(message("error.a_speed_of_is", speeds_percent=max(self.speeds_percent)))

    @property
    def first(self) -> dict[str, float]:
        """The first condition, that of all tests but pose and path."""
        return {"speed_percent": self.speeds_percent[0], "load_kg": self.loads_kg[0]}

    def at(self, rated_mm_s: float) -> float:
        """A rated speed at the first condition [mm/s]."""
        return 0.01 * self.speeds_percent[0] * rated_mm_s

    def count(self, test: str) -> int:
        """Return how many cycles a test has."""
        return self.cycles.get(test, CYCLES[test])


APPROACHES = ("x", "y", "z")
FROM_THREE_SIDES = ("P1", "P2", "P4")
POSING_MM = (-1.0, 2.0, -5.0, 10.0, -20.0, 50.0, -100.0, 200.0, -500.0, 1000.0)
TURN_RAD = math.radians(10.0)
"""Turn to both sides on a path with reorientation."""
LARGE_CIRCLE, SMALL_CIRCLE = 0.8, 0.08
"""Diameters, of the cube's edge."""
APPROACH = 0.2
"""Length of an approach along an axis, of the cube's edge."""
CIRCLE_STEPS = 720
"""Straight pieces of a circle as it is run: a thousandth of a millimetre off it at 100 mm."""
LOAD_STEPS = 10
DRIFT_GROUP = 10
SWING_S = 1.0
"""Duration of one swing of a dither: slow for servos."""
LARGEST_DITHER_MM = 0.1
"""Along each axis, up to which the robot counts as at rest."""
SWINGS = 2
"""Least number of swings in a rest."""
_TURNS = np.array([2, 3, 6, 9, 10, 14, 15, 18, 21, 22, 24]) / 24.0
"""Parts of a swing after which triangular waves of one, two and three periods turn, and its end."""
EDGE_S = 0.15
"""Part of a dither at either end, where the robot speeds up and slows down."""


@dataclass(frozen=True)
class Campaign:
    """A program that has not run, and the commands that run it from rest at `start` (7,)."""

    program: Program
    commands: tuple[Command, ...]
    start: FloatArray


def campaign(cube: Cube, tests: Tests) -> Campaign:
    """The tests in the cube, one after the other, beginning and ending at P1."""
    points = {name: np.array([*p, *tests.quaternion]) for name, p in cube.points().items()}
    parts = [_PARTS[test](cube, tests, points) for test in TESTS if test in tests.tests]
    tables: dict[str, tuple[object, ...]] = {}
    for part in parts:
        for key, rows in part.tables.items():
            tables[key] = (*tables.get(key, ()), *rows)
    program = Program.model_validate({"schema_": "lmeasure.program/1", "name": "ISO 9283 test cube", "angles": tests.angles, **tables})
    home = Command(points["P1"][None], tests.at(tests.speed_mm_s), 0.0)
    return Campaign(program, (*(c for part in parts for c in part.commands), home), points["P1"])


def dithered(plan: Campaign, size: float, settle_s: float) -> Campaign:
    """Return the campaign with slow swings by size [mm] to both sides along x, y and z about each measured pose, after a rest of settle_s.

    Rounded counts of a swing average below the count; those of a rest do not. In one period there are one, two and three triangular waves
    along the axes, so every channel moves, by straight lines at one speed. CertificationError if the rests are too short, or the swings so
    large that the robot does not count as at rest.
    """
    if not 0.0 < size <= LARGEST_DITHER_MM:
        raise CertificationError(message("error.dither_size", size=size, largest=LARGEST_DITHER_MM))
    waves = np.arange(1.0, 4.0)
    away = size * 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * _TURNS[:, None] * waves))
    speed = 4.0 * size * float(np.linalg.norm(waves)) / SWING_S
    commands: list[Command] = []
    swinging = set()
    for command in plan.commands:
        if command.role != "pose" or not command.target:
            commands.append(command)
            continue
        swings = math.floor((command.dwell_s - settle_s) / SWING_S + 1e-9)
        if swings < SWINGS:
            raise CertificationError(message("error.dither_short", dwell_s=command.dwell_s, least_s=settle_s + SWINGS * SWING_S))
        poses = np.tile(command.poses[-1], (swings * len(_TURNS), 1))
        poses[:, :3] += np.tile(away, (swings, 1))
        commands.append(replace(command, dwell_s=settle_s, target=""))
        commands.append(replace(command, poses=poses, speed_mm_s=speed, dwell_s=0.0, role="dither"))
        swinging.add(command.target)
    stated = {"dither_mm": (size, size, size), "dither_s": SWING_S}
    poses_of = tuple(p.model_copy(update=stated) if p.name in swinging else p for p in plan.program.pose)
    return Campaign(plan.program.model_copy(update={"pose": poses_of}), tuple(commands), plan.start)


@dataclass(frozen=True)
class _Part:
    """One test: tables of the program, and the commands."""

    tables: dict[str, tuple[object, ...]]
    commands: tuple[Command, ...]


_Points = dict[str, FloatArray]


def _conditions(tests: Tests) -> Iterator[tuple[str, float, float]]:
    """Yield the ends of names, the speed [%] and the load [kg]; the first condition has the plain names."""
    for i, (load, percent) in enumerate(itertools.product(tests.loads_kg, tests.speeds_percent)):
        words = [f"{percent:g} %"] if percent != tests.speeds_percent[0] else []
        words += [f"{load:g} kg"] if load != tests.loads_kg[0] else []
        yield f" at {', '.join(words)}" if i else "", percent, load


def _pose(name: str, row: FloatArray, **more: object) -> CommandedPose:
    return CommandedPose(name=name, position_mm=tuple(float(v) for v in row[:3]), quaternion_xyzw=tuple(float(v) for v in row[3:]), **more)  # type: ignore[arg-type]


def _to(row: FloatArray, tests: Tests, target: str = "", **more: object) -> Command:
    """A straight way to a pose, with a rest when it is measured."""
    given: dict[str, object] = {"speed_mm_s": tests.at(tests.speed_mm_s), "dwell_s": tests.dwell_s if target else 0.0}
    return Command(row[None], **(given | {"load_kg": tests.loads_kg[0]} | more), target=target)  # type: ignore[arg-type]


def _poses(cube: Cube, tests: Tests, points: _Points) -> _Part:
    """6.7, 7.2.1, 7.2.2, 7.3: P5 to P1 in turn, all in one direction; the distance of P2 and P4."""
    n, rows, commands, distances = tests.count("pose"), [], [], []
    for ending, percent, load in _conditions(tests):
        rows += [_pose(name + ending, points[name], cycles=n, speed_percent=percent, load_kg=load) for name in POSES]
        distances.append(Distance(from_pose="P2" + ending, to_pose="P4" + ending))
        speed = 0.01 * percent * tests.speed_mm_s
        commands += [
            _to(points[name], tests, name + ending, cycle=cycle, speed_mm_s=speed, load_kg=load)
            for cycle in range(1, n + 1)
            for name in reversed(POSES)
        ]
    return _Part({"pose": tuple(rows), "distance": tuple(distances)}, tuple(commands))


def _approaches(cube: Cube, tests: Tests, points: _Points) -> _Part:
    """7.2.3: P1, P2 and P4, each reached along the three axes in turn, from the cube's middle."""
    n, rows, commands = tests.count("approach"), [], []
    for name in FROM_THREE_SIDES:
        title, inward = f"{name} from three sides", np.sign(cube.centre - points[name][:3])
        rows.append(_pose(title, points[name], cycles=3 * n, approaches=APPROACHES * n, **tests.first))
        for cycle in range(1, n + 1):
            for axis in range(3):
                before = points[name].copy()
                before[axis] += (inward[axis] or 1.0) * APPROACH * cube.edge_mm
                commands += [_to(before, tests), _to(points[name], tests, title, cycle=cycle)]
    return _Part({"pose": tuple(rows)}, tuple(commands))


def _stabilisation(cube: Cube, tests: Tests, points: _Points) -> _Part:
    """7.4, 7.5: P1 from P2."""
    n, title = tests.count("stabilisation"), "P1 settling"
    commands = [c for i in range(1, n + 1) for c in (_to(points["P2"], tests), _to(points["P1"], tests, title, role="settling", cycle=i))]
    return _Part({"pose": (_pose(title, points["P1"], cycles=n, limit_band_mm=tests.limit_band_mm, **tests.first),)}, tuple(commands))


def _drift(cube: Cube, tests: Tests, points: _Points) -> _Part:
    """7.6: P1 from P2 ten times in a row, in between P2 to P5 without a rest."""
    title, groups = "P1 drift", 1 + round(tests.drift_s / tests.drift_every_s)
    around = tuple(_to(points[name], tests) for name in reversed(POSES[1:]))
    once = _seconds((_to(points["P2"], tests), _to(points["P1"], tests, title)), points["P1"])
    circuit = _seconds(around, points["P2"])
    fill = max(0, round((tests.drift_every_s - DRIFT_GROUP * once) / circuit))
    commands: list[Command] = []
    for group in range(groups):
        for i in range(1, DRIFT_GROUP + 1):
            commands += [_to(points["P2"], tests), _to(points["P1"], tests, title, cycle=group * DRIFT_GROUP + i)]
        commands += around * (fill if group < groups - 1 else 0)
    row = _pose(title, points["P1"], cycles=groups * DRIFT_GROUP, **tests.first)
    return _Part({"pose": (row,), "drift": (Drift(pose=title, group=DRIFT_GROUP),)}, tuple(commands))


def _paths(cube: Cube, tests: Tests, points: _Points) -> _Part:
    """8.2, 8.3, 8.5, 8.6: a line, a rectangle with four corners, a large and a small circle."""
    p = {name: row[:3] for name, row in points.items()}
    normal, along = cube.normal, p["P2"] - p["P1"]
    shapes: dict[str, dict[str, object]] = {
        "line": {"kind": "linear", "start_mm": p["P2"], "end_mm": p["P4"]},
        "rectangle": {"kind": "rectangular", "corners_mm": [p[name] for name in POSES[1:]]},
    }
    for name, part in (("large circle", LARGE_CIRCLE), ("small circle", SMALL_CIRCLE)):
        radius = 0.5 * part * cube.edge_mm
        start = p["P1"] + radius * along / np.linalg.norm(along)
        shapes[name] = {"kind": "circular", "centre_mm": p["P1"], "normal": normal, "radius_mm": radius, "start_mm": start}
    n, rows, commands = tests.count("path"), [], []
    for ending, percent, load in _conditions(tests):
        speed = 0.01 * percent * tests.path_speed_mm_s
        for name, shape in shapes.items():
            row = _path(name + ending, shape, cycles=n, speed_mm_s=speed, speed_percent=percent, load_kg=load, quaternion=tests.quaternion)
            rows.append(row)
            commands += _along(row, tests, n, load_kg=load)
    return _Part({"path": tuple(rows)}, tuple(commands))


def _reorientations(cube: Cube, tests: Tests, points: _Points) -> _Part:
    """8.4: the line while the tool turns by 10 degrees to both sides, about each axis of the base."""
    n, rows, commands = tests.count("reorientation"), [], []
    shape = {"kind": "linear", "start_mm": points["P2"][:3], "end_mm": points["P4"][:3]}
    for axis, name in enumerate("xyz"):
        turn = TURN_RAD * np.eye(3)[axis]
        first, last = ((Rotation.from_rotvec(t) * Rotation.from_quat(tests.quaternion)).as_quat() for t in (-turn, turn))
        title = f"line turning about {name}"
        speed = tests.at(tests.path_speed_mm_s)
        row = _path(title, shape, cycles=n, speed_mm_s=speed, quaternion=first, end=last, **tests.first)
        rows.append(row)
        commands += _along(row, tests, n)
    return _Part({"path": tuple(rows)}, tuple(commands))


def _weaving(cube: Cube, tests: Tests, points: _Points) -> _Part:
    """11: a zigzag in the plane along the line."""
    n, (stroke, way) = tests.count("weaving"), tests.weave_mm
    start, end = points["P2"][:3], points["P4"][:3]
    # whole weaves, so that the line ends on its axis
    length = float(np.linalg.norm(end - start))
    whole = math.floor(length / way)
    if whole < 1:
        raise CertificationError(message("error.a_weave_of_mm", way=way, length=length))
    shape = {"kind": "linear", "start_mm": start, "end_mm": start + (end - start) * (whole * way / length)}
    row = _path(
        "weave", shape, cycles=n, speed_mm_s=0.1 * tests.path_speed_mm_s, load_kg=tests.loads_kg[0], quaternion=tests.quaternion,
        weave_stroke_mm=stroke, weave_distance_mm=way,
    )  # fmt: skip
    return _Part({"path": (row,)}, tuple(_along(row, tests, n, across=np.cross(cube.normal, (end - start) / length))))


def _posing(cube: Cube, tests: Tests, points: _Points) -> _Part:
    """9: to and fro along the plane's diagonal through P2, by ever larger steps."""
    n = tests.count("posing")
    direction = (points["P2"][:3] - cube.centre) / np.linalg.norm(points["P2"][:3] - cube.centre)
    reach = float(np.linalg.norm(points["P2"][:3] - cube.centre))
    places = itertools.takewhile(lambda at: abs(at) <= reach, np.cumsum(POSING_MM))
    rows = {"posing 0": points["P1"]}
    for at in places:
        row = points["P1"].copy()
        row[:3] += at * direction
        rows[f"posing {at:+g}"] = row
    names = list(rows)
    posings = [Posing(from_pose=a, to_pose=b, limit_band_mm=tests.limit_band_mm) for a, b in itertools.pairwise(names)]
    commands: list[Command] = []
    for cycle in range(1, n + 1):
        commands.append(_to(rows[names[0]], tests, dwell_s=tests.dwell_s))
        commands += [_to(rows[p.to_pose], tests, p.name, role="posing", cycle=cycle) for p in posings]
    poses = tuple(_pose(name, row, **tests.first) for name, row in rows.items())
    return _Part({"pose": poses, "posing": tuple(posings)}, tuple(commands))


def _compliance(cube: Cube, tests: Tests, points: _Points) -> _Part:
    """10: at P1, forces along the axes in both directions, in tenths of the weight of the largest load."""
    title, full = "P1 loaded", GRAVITY_M_S2 * max(tests.loads_kg)
    if full == 0.0:
        raise CertificationError(message("error.the_compliance_test_needs"))
    directions = [sign * np.eye(3)[axis] for axis in range(3) for sign in (1.0, -1.0)]
    once = [full * i / LOAD_STEPS * d for d in directions for i in range(LOAD_STEPS + 1)]
    forces = [f for _ in range(tests.count("compliance")) for f in once]
    commands = [_to(points["P1"], tests)]
    commands += [_to(points["P1"], tests, title, role="compliance", cycle=i, force_n=f, load_kg=0.0) for i, f in enumerate(forces, 1)]
    table = Compliance(pose=title, force_n=tuple((float(f[0]), float(f[1]), float(f[2])) for f in forces))
    return _Part({"pose": (_pose(title, points["P1"], load_kg=0.0),), "compliance": (table,)}, tuple(commands))


def _path(name: str, shape: Mapping[str, object], **more: object) -> CommandedPath:
    quaternion, end = more.pop("quaternion"), more.pop("end", None)
    vectors = {key: _tuples(value) for key, value in shape.items()}
    extra = {} if end is None else {"end_quaternion_xyzw": _tuples(end)}
    return CommandedPath(name=name, quaternion_xyzw=_tuples(quaternion), **vectors, **extra, **more)  # type: ignore[arg-type]


def _tuples(value: object) -> object:
    """Arrays as the tuples of floats that a program holds."""
    if isinstance(value, np.ndarray):
        return tuple(float(v) for v in value)
    return tuple(_tuples(v) for v in value) if isinstance(value, list | tuple) else value


def _along(
    path: CommandedPath, tests: Tests, cycles: int, *, across: FloatArray | None = None, load_kg: float | None = None
) -> list[Command]:
    """Return the commands to the start of the path and a rest, then along it, in all cycles."""
    assert path.speed_mm_s is not None
    corners, quaternion = path.corners(), np.array(path.quaternion_xyzw)
    speed = path.speed_mm_s
    if path.kind == "circular":
        corners = path.points(2.0 * math.pi * float(path.radius_mm or 0.0) / CIRCLE_STEPS)
    if across is not None and path.weave_stroke_mm is not None and path.weave_distance_mm is not None:
        corners, speed = _zigzag(corners, across, stroke=path.weave_stroke_mm, way=path.weave_distance_mm, speed=speed)
    rows = np.column_stack([corners, np.tile(quaternion, (len(corners), 1))])
    if path.end_quaternion_xyzw is not None:
        rows[-1, 3:] = path.end_quaternion_xyzw
    load = tests.loads_kg[0] if load_kg is None else load_kg
    return [
        command
        for cycle in range(1, cycles + 1)
        for command in (
            _to(rows[0], tests, dwell_s=tests.settle_s, load_kg=load),
            Command(rows[1:], speed, tests.settle_s, path.name, "path", cycle, load_kg=load),
        )
    ]


def _zigzag(ends: FloatArray, across: FloatArray, *, stroke: float, way: float, speed: float) -> tuple[FloatArray, float]:
    """(k, 3) corners of a weave about the line between the ends, and the speed on it that makes the given one along the line."""
    length = float(np.linalg.norm(ends[1] - ends[0]))
    at = np.concatenate([[0.0], np.arange(0.25 * way, length, 0.5 * way), [length]])
    side = np.concatenate([[0.0], 0.5 * stroke * np.where(np.arange(len(at) - 2) % 2, -1.0, 1.0), [0.0]])
    corners = ends[0] + at[:, None] * (ends[1] - ends[0]) / length + side[:, None] * across
    return corners, speed * math.hypot(way, 2.0 * stroke) / way


def _seconds(commands: Sequence[Command], start: FloatArray) -> float:
    return sum(float(d.sum()) for d in _durations(commands, start)) + sum(c.dwell_s for c in commands)


def _durations(commands: Sequence[Command], start: FloatArray) -> Iterator[FloatArray]:
    for command in commands:
        yield command.durations(start)
        start = command.poses[-1]


def duration_s(plan: Campaign) -> float:
    """Seconds of all ways at their speeds and all rests, without the time to speed up and slow down."""
    return _seconds(plan.commands, plan.start)


_PARTS: dict[str, Callable[[Cube, Tests, _Points], _Part]] = {
    "pose": _poses,
    "approach": _approaches,
    "stabilisation": _stabilisation,
    "drift": _drift,
    "path": _paths,
    "reorientation": _reorientations,
    "posing": _posing,
    "compliance": _compliance,
    "weaving": _weaving,
}


def timed(program: Program, performance: Performance, settle_s: float) -> Program:
    """The program with the windows in which a robot ran it.

    A pose is measured from settle_s after its setpoint arrived until the rest ends; settling and posing from the departure to the end of
    the rest; a path from its departure until settle_s after its setpoint arrived; a dither without its ends.
    """
    windows: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for command, span in zip(performance.commands, performance.spans, strict=True):
        at_rest, whole = (span.arrival_s + settle_s, span.end_s), (span.begin_s, span.end_s)
        ways = {
            "pose": {"pose": at_rest},
            "settling": {"pose": at_rest, "settling": whole},
            "compliance": {"compliance": at_rest},
            "posing": {"posing": whole},
            "path": {"path": (span.begin_s, min(at_rest[0], span.end_s))},
            "dither": {"pose": (span.begin_s + EDGE_S, span.arrival_s - EDGE_S)},
        }
        for kind, window in ways[command.role].items() if command.target else ():
            windows.setdefault((kind, command.target), []).append(window)
    return program.with_windows(windows)
