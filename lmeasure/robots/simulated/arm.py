"""A simulated arm at work: what a controller commands, and where an arm with errors, servos and heat really goes."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.signal import cont2discrete, lfilter
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, RobotError, se3
from lmeasure.robots.simulated.commands import Command

GRAVITY_M_S2 = 9.80665
MAX_SAMPLES = 50_000_000
APPROACH_S = 0.05
"""Before its arrival, the time over which a joint's direction decides on which side its backlash lies."""
BETWEEN = 101
"""Joint values of a way that are looked at before it is gone."""


class Mechanics(Protocol):
    """What a simulation needs of a robot of n joints: a `SerialArm`, or any other `mounted.Mounted`."""

    @property
    def axes_count(self) -> int:
        """Of joints."""
        ...

    def follow(self, poses: FloatArray, start: FloatArray) -> FloatArray:
        """(N, n) joint values along tool poses (N, 7), beginning near start (n,)."""
        ...

    def forward(self, joints: FloatArray, growth: FloatArray | float = 0.0) -> FloatArray:
        """(N, 7) tool poses, lengths grown by growth (N,) of themselves."""
        ...

    def deflection(self, joints: FloatArray, stiffness: FloatArray, force: FloatArray, points: FloatArray) -> FloatArray:
        """(N, n) by which forces (N, 3) at points (N, 3) move joints."""
        ...


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
        asked = self._joints(commands, setpoints, spans, rate_hz)
        return self._gone(commands, setpoints, spans, asked, rate_hz, rng, since_s=since_s, progress=progress)

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
        asked = _sampled(knots, np.array(rows), self.ramp_s, rate_hz)
        setpoints = self.nominal.forward(asked)
        ends = np.searchsorted(np.arange(len(asked)) / rate_hz, [s.end_s + 1e-9 for s in spans], side="right") - 1
        commands = [Command(setpoints[end][None], np.inf, dwell_s, name) for name, end in zip(names, ends, strict=True)]
        return self._gone(commands, setpoints, spans, asked, rate_hz, rng)

    def _there(self, begin: FloatArray, end: FloatArray) -> bool:
        """Whether all joint values (n,) between two have a pose, as drawn and as built."""
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
        asked: FloatArray,
        rate_hz: float,
        rng: np.random.Generator,
        *,
        since_s: float = 0.0,
        progress: Callable[[int, int], None] | None = None,
    ) -> "Performance":
        """Where it goes with joint values (n, axes) asked of it."""
        n = len(asked)
        time_s = np.arange(n) / rate_hz
        out = np.empty((n, 7))
        joints = self._servo(asked, rate_hz)
        errors = self._errors(asked, spans, rate_hz, rng)
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
        return Performance(time_s, setpoints, out, tuple(commands), tuple(spans), asked)

    def _joints(self, commands: Sequence[Command], setpoints: FloatArray, spans: Sequence["Span"], rate_hz: float) -> FloatArray:
        try:
            return self.nominal.follow(setpoints, self.rest)
        except RobotError as error:
            if error.sample is None:
                raise
            number = int(np.searchsorted([math.ceil(s.begin_s * rate_hz) for s in spans], error.sample, side="right")) - 1
            command = commands[max(number, 0)]
            raise RobotError(f"command {max(number, 0) + 1} ({command.target or 'on the way'}, cycle {command.cycle}): {error}") from None

    def _servo(self, asked: FloatArray, rate_hz: float) -> FloatArray:
        """(n, 6) joint angles that follow the setpoints, at rest before the first sample; setpoints run straight between samples."""
        out = np.empty_like(asked)
        for i, (w, z) in enumerate(zip(self.natural_rad_s, self.damping, strict=True)):
            numerator, denominator, _ = cont2discrete(([w * w], [1.0, 2.0 * z * w, w * w]), 1.0 / rate_hz, method="foh")
            out[:, i] = asked[0, i] + lfilter(numerator[0], denominator, asked[:, i] - asked[0, i])
        return out

    def _errors(self, asked: FloatArray, spans: Sequence["Span"], rate_hz: float, rng: np.random.Generator) -> FloatArray:
        """(n, 6) errors of the joints: drawn once for each command, taken up while it moves, kept while it rests."""
        axes = self.nominal.axes_count
        noise = rng.normal(size=(len(spans), axes)) * self.joint_noise_rad
        knots, values = [0.0], [np.zeros(axes)]
        for span, drawn in zip(spans, noise, strict=True):
            end = min(round(span.arrival_s * rate_hz), len(asked) - 1)
            before = max(round((span.arrival_s - sum(self.ramp_s) - APPROACH_S) * rate_hz), 0)
            way = asked[end] - asked[before]
            side = np.where(np.abs(way) > 1e-9, np.sign(way), 0.0)
            knots += [span.begin_s, span.arrival_s]
            values += [values[-1], drawn - 0.5 * self.backlash_rad * side]
        time_s, table = np.arange(len(asked)) / rate_hz, np.array(values)
        return np.column_stack([np.interp(time_s, knots, table[:, i]) for i in range(axes)])


@dataclass(frozen=True)
class Span:
    """Times [s] of a command: it begins to move, its setpoint arrives, its rest ends."""

    begin_s: float
    arrival_s: float
    end_s: float


@dataclass(frozen=True)
class Performance:
    """Commands carried out: (n,) times [s], (n, 7) commanded and true poses, when each command was carried out, and the joint values
    (n, joints) that the controller asked for."""

    time_s: FloatArray
    commanded: FloatArray
    poses: FloatArray
    commands: tuple[Command, ...]
    spans: tuple[Span, ...]
    asked: FloatArray


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
        raise RobotError(f"the commands take {knots[-1]:.6g} s, {n} samples at {rate_hz:g} Hz; at most {MAX_SAMPLES} are simulated")
    time_s = np.arange(n) / rate_hz
    return np.column_stack([_averaged(np.interp(time_s, knots, column), ramp_s, rate_hz) for column in table.T])


def _averaged(values: FloatArray, spans_s: Sequence[float], rate_hz: float) -> FloatArray:
    """The mean over the last span of each sample, span after span; before the first sample stands its value."""
    for span in spans_s:
        width = max(round(span * rate_hz), 1)
        padded = np.concatenate([np.full(width, values[0]), values]) - values[0]
        total = np.cumsum(padded)
        values = values[0] + (total[width:] - total[:-width]) / width
    return values
