"""A robot with errors of its own, of a known kind and drawn size, on its way through a program, for `certificate_coverage.py`."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from lmeasure.recording import Program

FloatArray = NDArray[np.float64]

START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
HALF = 180.0  # mm, of the cube
CUBE = {
    "P1": (0.0, 0.0, 0.0),
    "P2": (0.8 * HALF, 0.8 * HALF, 0.8 * HALF),
    "P3": (-0.8 * HALF, 0.8 * HALF, 0.8 * HALF),
    "P4": (-0.8 * HALF, -0.8 * HALF, -0.8 * HALF),
    "P5": (0.8 * HALF, -0.8 * HALF, -0.8 * HALF),
}
CYCLES, DRIFT_CYCLES, PATH_CYCLES, FEW = 30, 10, 5, 3
RATE_HZ = 250.0
FINER = 16
"""Times that a move is sampled as often for its truth."""
SPEED = 250.0
TURN = Rotation.from_rotvec([0.0, 0.0, 0.15])


@dataclass(frozen=True)
class Robot:
    """What a robot does wrong: offsets and scatter [mm, rad], lag of paths [mm], rounding of corners, swing, drift, compliance [mm/N]."""

    offset_mm: float
    scatter_mm: float
    offset_rad: float
    scatter_rad: float
    path_mm: float
    swing_mm: float
    drift_mm: float
    compliance: float


def draw_robot(rng: np.random.Generator) -> Robot:
    """Errors from far below the instrument's to far above."""

    def between(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    return Robot(
        between(0.005, 0.5),
        between(0.002, 0.05),
        between(1e-5, 1e-3),
        between(5e-6, 3e-4),
        between(0.02, 1.0),
        between(0.2, 2.0),
        between(0.01, 0.2),
        between(1e-3, 1e-2),
    )


class Motion:
    """A motion as it is put together: times and true poses of its samples, and the same with what lies between the samples of moves from
    rest to rest; windows as pieces are added."""

    def __init__(self) -> None:
        self.sampled: list[tuple[FloatArray, FloatArray]] = [(np.zeros(1), START[None, :])]
        self.true = list(self.sampled)
        self.now = 0.0

    def add(self, poses: FloatArray) -> tuple[float, float]:
        """A piece sampled at the rate, two seconds after the last; the window that holds it."""
        times = self.now + 2.0 + np.arange(len(poses)) / RATE_HZ
        self.sampled.append((times, poses))
        self.true.append((times, poses))
        self.now = float(times[-1])
        return float(times[0]), float(times[-1])

    def add_move(self, at: Callable[[FloatArray], FloatArray], seconds: float) -> tuple[float, float]:
        """The same of a move, poses (n, 7) at times (n,) [s] from its beginning; in truth it is finer than its samples."""
        steps = round(seconds * RATE_HZ)
        window = self.add(at(np.arange(steps + 1) / RATE_HZ))
        fine = np.arange(steps * FINER + 1) / (RATE_HZ * FINER)
        self.true[-1] = (window[0] + fine, at(fine))
        return window


def posed(position: FloatArray, turn: FloatArray) -> FloatArray:
    """(n, 7) poses from positions (n, 3) and rotation vectors (n, 3) [rad]."""
    return np.column_stack([position, Rotation.from_rotvec(turn).as_quat()])


def robot_motion(robot: Robot, rng: np.random.Generator) -> tuple[Motion, Program]:
    """The motion of one campaign of a robot, and the program with its windows."""
    motion = Motion()
    poses, dwell = [], np.ones((3, 1))
    offsets = {name: (robot.offset_mm * rng.normal(size=3), robot.offset_rad * rng.normal(size=3)) for name in CUBE}

    def attained(name: str, extra: FloatArray) -> tuple[FloatArray, FloatArray]:
        off, turn = offsets[name]
        place = np.array(CUBE[name]) + off + extra + robot.scatter_mm * rng.normal(size=3)
        return place, turn + robot.scatter_rad * rng.normal(size=3)

    approach = {a: robot.offset_mm * 0.3 * rng.normal(size=3) for a in "xyz"}
    drift = robot.drift_mm * rng.normal(size=3)
    windows: dict[str, list[tuple[float, float]]] = {name: [] for name in CUBE}
    for j in range(CYCLES):
        for name in CUBE:
            extra = approach["xyz"[j % 3]] if name == "P1" else drift * (j // DRIFT_CYCLES) if name == "P5" else np.zeros(3)
            place, turn = attained(name, extra)
            windows[name].append(motion.add(posed(dwell * place, dwell * turn)))
    settling, posings = [], []
    rest_s, moving_s, swing_hz = rng.uniform(0.04, 0.06), rng.uniform(0.25, 0.45), rng.uniform(7.0, 11.0)
    for _ in range(FEW):
        place, turn = attained("P2", np.zeros(3))
        other, _ = attained("P3", np.zeros(3))

        def settle(t: FloatArray, place: FloatArray = place, turn: FloatArray = turn) -> FloatArray:
            swing = 5.0 * robot.swing_mm * np.exp(-t / 0.06) * np.cos(2 * np.pi * swing_hz * t)
            return posed(place + np.array([1.0, 0.4, 0.0]) * swing[:, None], np.tile(turn, (len(t), 1)))

        def move(t: FloatArray, place: FloatArray = place, other: FloatArray = other, turn: FloatArray = turn) -> FloatArray:
            part = np.clip((t - rest_s) / moving_s, 0.0, 1.0)[:, None]
            return posed(place + part**3 * (10.0 + part * (6.0 * part - 15.0)) * (other - place), np.tile(turn, (len(t), 1)))

        settling.append(motion.add_move(settle, 0.6))
        posings.append(motion.add_move(move, 0.6))
    forces = np.array([[f if a == i else 0.0 for i in range(3)] for a in range(3) for f in (-50.0, 0.0, 50.0)])
    stiff = robot.compliance * (np.eye(3) + 0.1 * rng.normal(size=(3, 3)))
    loads = []
    for force in forces:
        place, turn = attained("P1", stiff @ force)
        loads.append(motion.add(posed(dwell * place, dwell * turn)))
    for name, position in CUBE.items():
        entry: dict[str, object] = {"name": name, "position_mm": position, "quaternion_xyzw": (0.0, 0.0, 0.0, 1.0)}
        entry |= {"windows_s": windows[name]}
        if name == "P1":
            entry |= {"approaches": ["xyz"[j % 3] for j in range(CYCLES)], "units": [f"robot {j % 2}" for j in range(CYCLES)]}
        if name == "P2":
            entry |= {"settling_s": settling, "limit_band_mm": 0.15}
        poses.append(entry)
    program = Program.model_validate(
        {
            "schema": "lmeasure.program/1",
            "pose": poses,
            "path": [line(motion, robot, rng), rectangle(motion, robot, rng), weave(motion, robot, rng)],
            "drift": [{"pose": "P5", "group": DRIFT_CYCLES}],
            "posing": [{"from": "P2", "to": "P3", "windows_s": posings, "limit_band_mm": 0.15}],
            "compliance": [{"pose": "P1", "windows_s": loads, "force_n": [tuple(f) for f in forces.tolist()]}],
        }
    )
    return motion, program


def waves(robot: Robot, rng: np.random.Generator, ways: FloatArray) -> Callable[[], FloatArray]:
    """Deviations (k, 3) of a path: the same waves in every cycle, with some that are new each time."""
    phases, lengths = rng.uniform(0, 2 * np.pi, 3), rng.uniform(60.0, 200.0, 3)
    same = robot.path_mm * (0.5 * rng.normal(size=3) + np.sin(ways[:, None] * 2 * np.pi / lengths + phases))

    def cycle() -> FloatArray:
        new = robot.scatter_mm * (rng.normal(size=3) + np.sin(ways[:, None] / 30.0 + rng.uniform(0, 6, 3)))
        return np.asarray(same + new)

    return cycle


def line(motion: Motion, robot: Robot, rng: np.random.Generator) -> dict[str, object]:
    """A line while the tool turns, at a speed that is a little off and fluctuates."""
    start, end = np.array([-HALF, -0.5 * HALF, 0.0]), np.array([HALF, 0.5 * HALF, 0.3 * HALF])
    length = float(np.linalg.norm(end - start))
    windows = []
    off, first = 1.0 + 0.02 * rng.normal(), -8.0 + SPEED / RATE_HZ * rng.random()
    n = int((length + 20.0) / SPEED * RATE_HZ / 0.9)
    t = np.arange(n) / RATE_HZ
    deviation, turn = None, robot.offset_rad * rng.normal(size=3)
    for _ in range(PATH_CYCLES):
        speed = SPEED * off * (1.0 + 0.002 * rng.normal())
        way = first + speed * t + 0.02 * SPEED / 8.0 * np.sin(8.0 * t + 0.3 * rng.normal())
        if deviation is None:
            deviation = waves(robot, rng, way)
        part = np.clip(way / length, 0.0, 1.0)[:, None]
        ideal = start + (way / length)[:, None] * (end - start)
        windows.append(motion.add(posed(ideal + deviation(), part * TURN.as_rotvec() + turn + robot.scatter_rad * rng.normal(size=3))))
    quaternions = {"quaternion_xyzw": (0.0, 0.0, 0.0, 1.0), "end_quaternion_xyzw": tuple(TURN.as_quat().tolist())}
    ends = {"start_mm": tuple(start.tolist()), "end_mm": tuple(end.tolist())}
    return {"name": "line", "kind": "linear", "speed_mm_s": SPEED, "windows_s": windows} | quaternions | ends


def rectangle(motion: Motion, robot: Robot, rng: np.random.Generator) -> dict[str, object]:
    """A rectangle whose corners are rounded off, taken slowly and swung out behind."""
    corners = 0.6 * HALF * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    side = 1.2 * HALF
    fine = np.arange(-30.0, 4 * side + 30.0, 0.02)
    from_corner = (fine + 0.5 * side) % side - 0.5 * side
    slower = rng.uniform(0.2, 0.6) * np.exp(-((from_corner / 10.0) ** 2))
    seconds = cumulative_trapezoid(1.0 / (0.5 * SPEED * (1.0 - slower)), fine, initial=0.0)
    begin, end = np.interp([-8.0, 4 * side + 8.0], fine, seconds)
    way = np.interp(np.arange(begin, end, 1.0 / RATE_HZ) + rng.random() / RATE_HZ, seconds, fine)
    units = np.roll(corners, -1, axis=0) - corners
    units = units / np.linalg.norm(units, axis=1)[:, None]
    k = np.clip((fine // side).astype(int), 0, 3)
    behind = fine - k * side
    ideal = corners[k] + behind[:, None] * units[k]
    swings = robot.path_mm * np.exp(-behind / 15.0) * np.sin(behind / 5.0) * (k > 0)
    round_mm, windows = rng.uniform(1.0, 4.0), []
    for _ in range(FEW):
        swing = (1.0 + 0.05 * rng.normal()) * swings
        place = gaussian_filter1d(ideal + swing[:, None] * units[k - 1], round_mm / 0.02, axis=0)
        sampled = CubicSpline(fine, place)(way) + robot.scatter_mm * rng.normal(size=3)
        windows.append(motion.add(posed(sampled, np.zeros_like(sampled))))
    kind = {"name": "rectangle", "kind": "rectangular", "stabilisation_mm": 0.5, "speed_mm_s": 0.5 * SPEED, "windows_s": windows}
    return kind | {"corners_mm": [tuple(c) for c in corners.tolist()]}


def weave(motion: Motion, robot: Robot, rng: np.random.Generator) -> dict[str, object]:
    """A weave along a line, with a stroke and a way that are a little off."""
    start, end = np.array([-100.0, 0.0, 50.0]), np.array([100.0, 0.0, 50.0])
    way = np.arange(-5.0, 205.0, 0.4 * SPEED / RATE_HZ) + 0.4 * SPEED / RATE_HZ * rng.random()
    stroke, distance = 8.0 + robot.path_mm * 0.3 * rng.normal(), 20.0 * (1 + 0.01 * rng.normal())
    windows = []
    for _ in range(FEW):
        y = 0.5 * stroke * np.sin(2 * np.pi * way / distance)
        place = np.column_stack([start[0] + way, y, np.full(len(way), start[2])]) + robot.scatter_mm * rng.normal(size=3)
        windows.append(motion.add(posed(place, np.zeros_like(place))))
    ends = {"start_mm": tuple(start.tolist()), "end_mm": tuple(end.tolist()), "weave_stroke_mm": 8.0, "weave_distance_mm": 20.0}
    return {"name": "weave", "kind": "linear", "speed_mm_s": 0.4 * SPEED, "windows_s": windows} | ends
