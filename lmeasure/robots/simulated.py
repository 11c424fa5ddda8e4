"""A simulated robot at work: its commands, where an arm with errors, servos and heat really goes, and the arm of the simulated cell."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np
from scipy.signal import cont2discrete, lfilter
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, IntArray, RobotError, se3
from lmeasure.robots.model import Place, RobotModel
from lmeasure.robots.parallel.model import Parallel
from lmeasure.robots.platform import Platform
from lmeasure.robots.robot import Payload, Robot, shipped
from lmeasure.robots.serial import SerialArm, SerialRobot
from lmeasure.text import message

COARSE = 10
"""Samples of a motion between those whose poses are found from home; the others are found from these."""
NONE: IntArray = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Mounted:
    """base (7,): cell_from_base; tool (7,): flange_from_tool. Lengths do not grow."""

    robot: RobotModel
    base: FloatArray
    tool: FloatArray

    @property
    def axes_count(self) -> int:
        """Return the number of joints."""
        return len(self.robot.joint_names)

    def flange(self, poses: FloatArray) -> FloatArray:
        """(N, 7) base_from_flange at tool poses (N, 7) in the cell."""
        back = se3.compose(se3.inverse(self.base), poses)
        return se3.compose(back, se3.inverse(self.tool))

    def placed(self, flange: FloatArray) -> FloatArray:
        """(N, 7) tool poses in the cell at base_from_flange (N, 7)."""
        return se3.compose(self.base, se3.compose(flange, self.tool))

    def follow(self, poses: FloatArray, start: FloatArray) -> FloatArray:
        """(N, n) joint values along tool poses (N, 7), beginning near start (n,); RobotError names the first sample out of reach."""
        flange, robot = self.flange(poses), self.robot
        if isinstance(robot, Parallel):
            return robot.follow(flange, start)
        if isinstance(robot, Platform):
            joints = (robot.lengths(flange) - robot.offset) / robot.scale
            beyond = (joints < robot.low) | (joints > robot.high)
            apart = ~robot.assembled(flange)
            if apart.any():
                raise RobotError(message("error.sample_takes_a_rod_out", sample=int(np.argmax(apart))), int(np.argmax(apart)))
            if beyond.any():
                sample = int(np.argmax(beyond.any(axis=1)))
                leg = int(np.argmax(beyond[sample]))
                raise RobotError(
                    message("error.sample_would_be_at", sample=sample, joint_names=robot.joint_names[leg], joints=joints[sample, leg]),
                    sample,
                )
            return np.asarray(joints)
        if isinstance(robot, SerialRobot) and robot.arm.is_elbow:
            return replace(robot.arm, tool=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])).follow(flange, start)
        raise RobotError(message("error.robot_paths_are_followed", name=robot.name))

    def forward(self, joints: FloatArray, growth: FloatArray | float = 0.0) -> FloatArray:
        """(N, 7) tool poses in the cell at the joint values (N, n) of a motion; RobotError names the first sample that has none."""
        robot = self.robot
        if isinstance(robot, Parallel):
            far = robot.forward(joints[::COARSE])
            self._say(far, COARSE)
            flange, same = robot.beside(joints, np.repeat(far, COARSE, axis=0)[: len(joints)])
            if not same.all():  # it moves far between: each by its own way from home
                flange[~same] = robot.forward(joints[~same])
        else:
            flange = robot.forward(joints)
        self._say(flange, 1)
        return self.placed(flange)

    def deflection(self, joints: FloatArray, stiffness: FloatArray, force: FloatArray, points: FloatArray) -> FloatArray:
        """Return (N, n) rad or mm by which forces (N, 3) [N] at points (N, 3) [mm], both in the cell's axes, move joints of the stiffness
        (n,)."""
        _, by_joints, _ = self.robot.derivatives(joints, None, NONE)
        turn = se3.matrices(self.base)
        own, at = force @ turn, (points - self.base[:3]) @ turn
        moved = by_joints[:, :, 3:] + np.cross(by_joints[:, :, :3], at[:, None])
        return np.asarray(np.einsum("njc,nc->nj", moved, own) / stiffness)

    def _say(self, flange: FloatArray, every: int) -> None:
        lost = np.isnan(flange[:, 0])
        if lost.any():
            raise RobotError(message("error.sample_no_pose_of", every=every * int(np.argmax(lost)), name=self.robot.name))


Role = Literal["pose", "settling", "path", "posing", "compliance", "dither"]


@dataclass(frozen=True)
class Command:
    """Go from where the tool is through (k, 7) poses [mm, base frame] at a constant speed, and rest at the last.

    target: the pose, path, posing or loaded pose (role) of the program that is measured, empty on the way to one; cycle counts from 1. The
    tool origin runs straight between the poses; where only the orientation changes, it turns at rotation_rad_s. A dither is small swings
    about the pose at which the tool rests. load_kg hangs from the tool, force_n (3,) [N, base frame] pulls at it.
    """

    poses: FloatArray
    speed_mm_s: float
    dwell_s: float = 0.0
    target: str = ""
    role: Role = "pose"
    cycle: int = 1
    rotation_rad_s: float = 1.0
    load_kg: float = 0.0
    force_n: FloatArray = field(default_factory=lambda: np.zeros(3))

    def durations(self, start: FloatArray) -> FloatArray:
        """(k,) seconds of the ways to its poses, the first from `start` (7,): the slower of shift and turn."""
        rows = np.concatenate([start[None], self.poses])
        shift = np.linalg.norm(np.diff(rows[:, :3], axis=0), axis=1)
        turn = (se3.rotation(rows[:-1]).inv() * se3.rotation(rows[1:])).magnitude()
        return np.asarray(np.maximum(shift / self.speed_mm_s, turn / self.rotation_rad_s))


GRAVITY_M_S2 = 9.80665
MAX_SAMPLES = 50_000_000
APPROACH_S = 0.05
"""Before its arrival, the time over which a joint's direction decides on which side its backlash lies."""
BETWEEN = 101
"""Joint values of a way that are looked at before it is gone."""


Mechanics: TypeAlias = SerialArm | Mounted
"""Moving robot: an arm by itself, or a robot of any kind on its base."""


@dataclass(frozen=True)
class SimulatedRobot:
    """A robot whose controller knows the nominal arm while the arm was built otherwise; joints are six, or as many as it has.

    rest (6,): joint angles it starts near; ramp_s: the setpoints, of constant speed, are averaged over these two spans, which gives them
    finite acceleration and jerk and rounds corners; natural_rad_s, damping (6,): each joint's servo is a linear second-order system
    behind its setpoint; joint_noise_rad (6,): standard deviation of a joint's error, drawn once for each command; backlash_rad
    (6,): a joint stops short by half of it, on the side it came from; stiffness_n_mm_rad (6,); growth: relative growth of the links'
    lengths in the end, with the time constant growth_s.
    """

    nominal: Mechanics
    built: Mechanics
    rest: FloatArray
    ramp_s: tuple[float, float]
    natural_rad_s: FloatArray
    damping: FloatArray
    joint_noise_rad: FloatArray
    backlash_rad: FloatArray
    stiffness_n_mm_rad: FloatArray
    growth: float = 0.0
    growth_s: float = 3600.0

    def perform(
        self,
        commands: Sequence[Command],
        start: FloatArray,
        rate_hz: float,
        rng: np.random.Generator,
        *,
        since_s: float = 0.0,
        progress: Callable[[int, int], None] | None = None,
    ) -> "Performance":
        """Carry out the commands from rest at the pose `start` (7,), since_s after the robot was cold; RobotError names the command that
        the arm cannot reach."""
        setpoints, spans = _setpoints(commands, start, self.ramp_s, rate_hz)
        requested = self._joints(commands, setpoints, spans, rate_hz)
        return self._gone(commands, setpoints, spans, requested, rate_hz, rng, since_s=since_s, progress=progress)

    def drive(
        self, joints: FloatArray, names: Sequence[str], rate_hz: float, rng: np.random.Generator, *, rates: FloatArray, dwell_s: float
    ) -> "Performance":
        """Drive all joints together to one row of joints (k, n) after the other, evenly, none faster than rates (n,) a second, with a
        rest at each; it begins at the first, and goes over where it rests where the straight way has no poses. RobotError names a sample
        whose joint values have none."""
        spans, knots, rows = [], [0.0], [joints[0]]
        for row in joints:
            begin = knots[-1]
            if not self._there(rows[-1], row):
                knots.append(begin + float(np.abs((self.rest - rows[-1]) / rates).max()))
                rows.append(self.rest)
            arrival = knots[-1] + float(np.abs((row - rows[-1]) / rates).max())
            spans.append(Span(begin, arrival + sum(self.ramp_s), arrival + sum(self.ramp_s) + dwell_s))
            knots += [arrival, spans[-1].end_s]
            rows += [row, row]
        requested = _sampled(knots, np.array(rows), self.ramp_s, rate_hz)
        setpoints = self.nominal.forward(requested)
        ends = np.searchsorted(np.arange(len(requested)) / rate_hz, [s.end_s + 1e-9 for s in spans], side="right") - 1
        commands = [Command(setpoints[end][None], np.inf, dwell_s, name) for name, end in zip(names, ends, strict=True)]
        return self._gone(commands, setpoints, spans, requested, rate_hz, rng)

    def _there(self, begin: FloatArray, end: FloatArray) -> bool:
        """Return whether all joint values (n,) between two have a pose, nominal and built."""
        way = begin + np.linspace(0.0, 1.0, BETWEEN)[:, None] * (end - begin)
        try:
            for robot in (self.nominal, self.built):
                robot.forward(way)
        except RobotError:
            return False
        return True

    def _gone(
        self,
        commands: Sequence[Command],
        setpoints: FloatArray,
        spans: Sequence["Span"],
        requested: FloatArray,
        rate_hz: float,
        rng: np.random.Generator,
        *,
        since_s: float = 0.0,
        progress: Callable[[int, int], None] | None = None,
    ) -> "Performance":
        """Return the robot's motion with requested joint values (n, axes)."""
        n = len(requested)
        time_s = np.arange(n) / rate_hz
        out = np.empty((n, 7))
        joints = self._servo(requested, rate_hz)
        errors = self._errors(requested, commands, spans, rate_hz, rng)
        first = np.concatenate([[0], [math.ceil(span.begin_s * rate_hz) for span in spans[1:]], [n]]).astype(int)
        for i, command in enumerate(commands):
            part = slice(first[i], first[i + 1])
            turned = joints[part] + errors[part]
            pull = command.force_n - np.array([0.0, 0.0, GRAVITY_M_S2 * command.load_kg])
            if pull.any():
                at = setpoints[part, :3]
                turned += self.built.deflection(turned, self.stiffness_n_mm_rad, np.broadcast_to(pull, at.shape), at)
            out[part] = self.built.forward(turned, -self.growth * np.expm1(-(since_s + time_s[part]) / self.growth_s))
            if progress is not None:
                progress(i + 1, len(commands))
        return Performance(time_s, setpoints, out, tuple(commands), tuple(spans), requested)

    def _joints(self, commands: Sequence[Command], setpoints: FloatArray, spans: Sequence["Span"], rate_hz: float) -> FloatArray:
        try:
            return self.nominal.follow(setpoints, self.rest)
        except RobotError as error:
            if error.sample is None:
                raise
            number = int(np.searchsorted([math.ceil(s.begin_s * rate_hz) for s in spans], error.sample, side="right")) - 1
            command = commands[max(number, 0)]
            raise RobotError(
                message(
                    "error.command_cycle", value=max(number, 0) + 1, target=command.target or "on the way", cycle=command.cycle, error=error
                )
            ) from None

    def _servo(self, requested: FloatArray, rate_hz: float) -> FloatArray:
        """(n, 6) joint angles that follow the setpoints, at rest before the first sample; setpoints run straight between samples."""
        out = np.empty_like(requested)
        for i, (w, z) in enumerate(zip(self.natural_rad_s, self.damping, strict=True)):
            numerator, denominator, _ = cont2discrete(([w * w], [1.0, 2.0 * z * w, w * w]), 1.0 / rate_hz, method="foh")
            out[:, i] = requested[0, i] + lfilter(numerator[0], denominator, requested[:, i] - requested[0, i])
        return out

    def _errors(
        self, requested: FloatArray, commands: Sequence[Command], spans: Sequence["Span"], rate_hz: float, rng: np.random.Generator
    ) -> FloatArray:
        """(n, 6) errors of the joints: drawn once for each command, taken up while it moves, kept while it rests or swings."""
        axes = self.nominal.axes_count
        noise = rng.normal(size=(len(spans), axes)) * self.joint_noise_rad
        knots, values = [0.0], [np.zeros(axes)]
        for command, span, drawn in zip(commands, spans, noise, strict=True):
            if command.role == "dither":
                continue
            end = min(round(span.arrival_s * rate_hz), len(requested) - 1)
            before = max(round((span.arrival_s - sum(self.ramp_s) - APPROACH_S) * rate_hz), 0)
            way = requested[end] - requested[before]
            side = np.where(np.abs(way) > 1e-9, np.sign(way), 0.0)
            knots += [span.begin_s, span.arrival_s]
            values += [values[-1], drawn - 0.5 * self.backlash_rad * side]
        time_s, table = np.arange(len(requested)) / rate_hz, np.array(values)
        return np.column_stack([np.interp(time_s, knots, table[:, i]) for i in range(axes)])


@dataclass(frozen=True)
class Span:
    """Times [s] of a command: it begins to move, its setpoint arrives, its rest ends."""

    begin_s: float
    arrival_s: float
    end_s: float


@dataclass(frozen=True)
class Performance:
    """Commands carried out: (n,) times [s], (n, 7) commanded and true poses, the times of each command, and the controller's joint values
    (n, joints)."""

    time_s: FloatArray
    commanded: FloatArray
    poses: FloatArray
    commands: tuple[Command, ...]
    spans: tuple[Span, ...]
    requested: FloatArray


def _setpoints(
    commands: Sequence[Command], start: FloatArray, ramp_s: tuple[float, float], rate_hz: float
) -> tuple[FloatArray, list[Span]]:
    """(n, 7) commanded poses: straight at constant speed from pose to pose, then averaged over both ramps; and the spans.

    Orientations are averaged as rotation vectors from the start's.
    """
    reference = se3.rotation(start)
    ramp = sum(ramp_s)
    knots, rows, spans = [0.0], [start], []
    for command in commands:
        times = knots[-1] + np.cumsum(command.durations(rows[-1]))
        spans.append(Span(knots[-1], float(times[-1]) + ramp, float(times[-1]) + ramp + command.dwell_s))
        knots += [*(float(t) for t in times), spans[-1].end_s]
        rows += [*command.poses, command.poses[-1]]
    table = np.array(rows)
    vectors = (se3.rotation(table) * reference.inv()).as_rotvec()
    smooth = _sampled(knots, np.column_stack([table[:, :3], vectors]), ramp_s, rate_hz)
    return se3.pose(smooth[:, :3], Rotation.from_rotvec(smooth[:, 3:]) * reference), spans


def _sampled(knots: Sequence[float], table: FloatArray, ramp_s: tuple[float, float], rate_hz: float) -> FloatArray:
    """(n, c) values between rows of the table (k, c) at times knots (k,) [s], averaged over both ramps."""
    n = math.floor(knots[-1] * rate_hz + 1e-9) + 1
    if n > MAX_SAMPLES:
        raise RobotError(message("error.the_commands_take_s", knots=knots[-1], n=n, rate_hz=rate_hz, max_samples=MAX_SAMPLES))
    time_s = np.arange(n) / rate_hz
    return np.column_stack([_averaged(np.interp(time_s, knots, column), ramp_s, rate_hz) for column in table.T])


def _averaged(values: FloatArray, spans_s: Sequence[float], rate_hz: float) -> FloatArray:
    """Return the mean over the last span of each sample, span after span; before the first sample its value is repeated."""
    for span in spans_s:
        width = max(round(span * rate_hz), 1)
        padded = np.concatenate([np.full(width, values[0]), values]) - values[0]
        total = np.cumsum(padded)
        values = values[0] + (total[width:] - total[:-width]) / width
    return values


FOOT_MM = (1100.0, 0.0, -500.0)
"""Foot of the robot, at the side of the cell where no cable passes, below the work space; the arm looks along -X."""
TOOL_MM = 100.0
"""Distance from the flange down to the tool's origin."""
U_LENGTH_MM, U_ANGLE_RAD = 0.15, 2e-4
JOINT_NOISE_RAD = 1.5e-5
BACKLASH_RAD = 3e-5
RATED_SPEED_MM_S = 1000.0
RATED_LOAD_KG = 20.0
RAMP_S = (0.08, 0.03)
GROWTH = 1.5e-4
"""A steel arm that gets 13 K warmer."""
GROWTH_S = 1800.0
REST = (0.0, 0.0, 0.0, 0.0, 1.4, 0.0)
"""Joint angles near its pose before the start."""
# the flange looks down, the tool's axes are those of the base frame at rest
_FRAMES = (
    se3.pose(FOOT_MM, Rotation.from_rotvec([0.0, 0.0, math.pi])),
    se3.pose([0.0, 0.0, TOOL_MM], Rotation.from_matrix(np.diag([-1.0, 1.0, -1.0]))),
)
"""Base of the arm in the cell, and the tool on its flange."""


def nominal_robot() -> Robot:
    """Return the nominal arm of a robot.toml: its base in the cell, its tool, and the rated load at that."""
    place = [Place(position_mm=tuple(row[:3]), quaternion_xyzw=tuple(row[3:])) for row in _FRAMES]
    payload = Payload(mass_kg=RATED_LOAD_KG, centre_mm=place[1].position_mm)
    return shipped("generic6").model_copy(update={"name": "cell_robot", "base": place[0], "tool": place[1], "payload": payload})


def cell_robot(seed: int = 0) -> SimulatedRobot:
    """A robot of 20 kg with normal errors of its links: a few tenths of a millimetre at the tool, as no two are built."""
    rng = np.random.default_rng(seed)
    nominal = nominal_robot().arm
    axes = nominal.axes_count
    errors = rng.normal(size=nominal.links.shape) * [U_ANGLE_RAD, U_LENGTH_MM, U_LENGTH_MM, U_ANGLE_RAD, U_ANGLE_RAD]
    return SimulatedRobot(
        nominal,
        nominal.with_errors(errors),
        rest=np.array(REST),
        ramp_s=RAMP_S,
        natural_rad_s=rng.uniform(80.0, 110.0, axes),
        damping=rng.uniform(0.4, 0.55, axes),
        joint_noise_rad=JOINT_NOISE_RAD * rng.uniform(0.5, 1.5, axes),
        backlash_rad=BACKLASH_RAD * rng.uniform(0.5, 1.5, axes),
        stiffness_n_mm_rad=np.array([2e9, 2e9, 1.5e9, 4e8, 4e8, 3e8]),
        growth=GROWTH,
        growth_s=GROWTH_S,
    )
