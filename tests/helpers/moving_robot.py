"""A robot that moves, and the counts that its cables and swivels show: nothing here imports lmeasure or shares its formulas.

Rigs are read from their files. A cable is a tangent to the circle of its pulley, a drum is solved by a fixed point, motions are moves with
limited jerk or sums of sines. Millimetres, seconds, radians; poses as places and rotations.
"""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly
from scipy.spatial.transform import Rotation

FloatArray = NDArray[np.float64]
TRUTH = Path(__file__).parents[1] / "authorities" / "truth"
Instants = tuple[FloatArray, Rotation, FloatArray, FloatArray]


class Motion(Protocol):
    """Places (n, 3), rotations, and velocities and accelerations (n, 6) of (rotation; place) in base axes, at times (n,)."""

    def at(self, time_s: FloatArray) -> Instants: ...


class Instrument:
    """Cables and swivels of a rig file."""

    def __init__(self, name: str, *, swivels: bool = True) -> None:
        data = tomllib.loads((TRUTH / name / "rig.toml").read_text())
        points, tool = {p["name"]: p for p in data["observation_point"]}, data["tool"]
        self.cables = [(points[c["from"]], np.array(tool[c["to"]])) for c in data["cable"]]
        arms = {c["from"]: np.array(tool[c["to"]]) for c in data["cable"]}
        table = data.get("swivel", []) if swivels else []
        self.swivels = [(points[s["point"]], arms[s["point"]], s) for s in table]
        self.channels = tuple(c["channel"] for c in data["cable"]) + tuple(s["channel"] for s in table)

    def lengths(self, j: int, place: FloatArray, turn: Rotation) -> FloatArray:
        """(n,) from the fixed point over the pulley to the gripper, along the circle's arc and its tangent."""
        point, arm = self.cables[j]
        radius, elevation = point["pulley_radius_mm"], np.radians(point["guide_alpha_deg"])
        heading = np.radians(point["guide_beta_deg"]) + np.pi
        u = np.array([np.cos(elevation) * np.sin(heading), np.cos(elevation) * np.cos(heading), np.sin(elevation)])
        d = place + turn.apply(arm) - np.array(point["position_mm"])
        along = d @ u
        across = np.linalg.norm(d - along[:, None] * u, axis=1)
        far = np.hypot(across - radius, along)
        tangent = np.arctan2(along, across - radius) + np.arccos(radius / far)
        return np.asarray(radius * ((np.pi - tangent) % (2.0 * np.pi)) + np.sqrt(far**2 - radius**2))

    def counts(self, j: int, place: FloatArray, turn: Rotation) -> FloatArray:
        """(n,) of a channel, not rounded, since the origin pose."""
        if j >= len(self.cables):
            point, arm, s = self.swivels[j - len(self.cables)]
            a, b = np.radians(point["guide_alpha_deg"]), np.radians(point["guide_beta_deg"])
            d = place + turn.apply(arm) - np.array(point["position_mm"])
            up = d @ np.array([np.sin(a) * np.sin(b), np.sin(a) * np.cos(b), np.cos(a)])
            side = d @ np.array([-np.cos(b), np.sin(b), 0.0])
            angle = np.unwrap(np.arctan2(side, up)) - np.radians(s["zero_deg"])
            return np.asarray(s["count_sign"] * angle / (2.0 * np.pi) * s["counts_per_revolution"])
        drum = self.cables[j][0]["drum"]
        change = self.lengths(j, place, turn) - self.lengths(j, np.zeros((1, 3)), Rotation.identity())
        pitch, away, begin = (drum["groove_pitch_mm"] / drum["counts_per_revolution"], drum["tangent_length_mm"], drum["axial_offset_mm"])
        k = np.zeros_like(change)
        for _ in range(60):
            k = (change + np.hypot(away, begin + pitch * k) - np.hypot(away, begin)) / drum["count_length_mm"]
        return np.asarray(drum["count_sign"] * k)

    def recorded(self, motion: Motion, time_s: FloatArray, phases: FloatArray | float = 0.0) -> FloatArray:
        """(n, m) whole counts of channels at their own times (n, m); phases: where within a count drums were zeroed."""
        out, shift = np.empty(time_s.shape), np.broadcast_to(phases, time_s.shape[1])
        for j in range(time_s.shape[1]):
            place, turn, *_ = motion.at(time_s[:, j])
            if j < len(self.cables):
                out[:, j] = np.rint(self.counts(j, place, turn) + shift[j])
            else:
                codes = self.swivels[j - len(self.cables)][2]["counts_per_revolution"]
                out[:, j] = np.rint(self.counts(j, place, turn)) % codes
        return out


class Moves:
    """Straight moves from the origin pose between random poses, each with limited speed, acceleration and jerk, with rests between."""

    def __init__(self, rng: np.random.Generator, lasts_s: float, speed: float = 1e3, acceleration: float = 1e4, jerk: float = 2e5) -> None:
        self.legs: list[tuple[float, PPoly, FloatArray, FloatArray, Rotation, FloatArray]] = []
        place, turn, now = np.zeros(3), Rotation.identity(), float(rng.uniform(0.1, 0.3))
        while now < lasts_s:
            to, turned = rng.uniform(-250.0, 250.0, 3), Rotation.from_rotvec(rng.uniform(-0.25, 0.25, 3))
            way = float(np.linalg.norm(to - place))
            profile = _profile(way, speed, acceleration, jerk)
            self.legs.append((now, profile, place, (to - place) / way, turn, (turned * turn.inv()).as_rotvec() / way))
            place, turn, now = to, turned, now + float(profile.x[-1]) + float(rng.uniform(0.1, 0.3))

    def at(self, time_s: FloatArray) -> Instants:
        """Return what `Motion.at` says."""
        n = len(time_s)
        place, quaternions, rates = np.zeros((n, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)), np.zeros((2, n, 6))
        for begin, profile, start, way, turn, axis in self.legs:
            after = time_s >= begin
            at = np.minimum(time_s[after] - begin, profile.x[-1])
            moving = at < profile.x[-1]
            place[after] = start + profile(at)[:, None] * way
            quaternions[after] = (Rotation.from_rotvec(profile(at)[:, None] * axis) * turn).as_quat()
            for d in (1, 2):
                rates[d - 1, after] = (profile(at, d) * moving)[:, None] * np.concatenate([axis, way])
        return place, Rotation.from_quat(quaternions), rates[0], rates[1]


def _profile(way: float, speed: float, acceleration: float, jerk: float) -> PPoly:
    """The way along a move over time, of seven pieces of constant jerk."""

    def ramp(v: float) -> tuple[float, float]:
        a = min(acceleration, np.sqrt(v * jerk))
        return a / jerk, v / a - a / jerk

    low, high = 0.0, speed
    for _ in range(80):
        middle = 0.5 * (low + high)
        jerks, holds = ramp(middle)
        low, high = (middle, high) if middle * (2.0 * jerks + holds) <= way else (low, middle)
    jerks, holds = ramp(low)
    cruise = (way - low * (2.0 * jerks + holds)) / low
    lasts, pieces, now = np.array([jerks, holds, jerks, cruise, jerks, holds, jerks]), [], np.zeros(3)
    for step, j in zip(lasts, jerk * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0]), strict=True):
        pieces.append([j / 6.0, now[2] / 2.0, now[1], now[0]])
        now = np.array([PPoly(np.array([pieces[-1]]).T, [0.0, 1.0])(step, d) for d in range(3)])
    used = lasts > 1e-9
    return PPoly(np.array(pieces)[used].T, np.concatenate([[0.0], np.cumsum(lasts[used])]))


class Waves:
    """Sums of five sines in each component from the origin pose, of at most 1 m/s, 10 m/s^2 and 300 mm."""

    def __init__(self, rng: np.random.Generator, lasts_s: float) -> None:
        self._pulse = 2.0 * np.pi * rng.uniform(0.2, 1.0, (6, 5)) * rng.uniform(1.0, 4.0)
        self._phase, self._size = rng.uniform(0.0, 2.0 * np.pi, (6, 5)), rng.standard_normal((6, 5)) / self._pulse**2
        x, v, a = self._raw(np.linspace(0.0, lasts_s, 4001))
        largest = [limit / np.linalg.norm(of[:, 3:], axis=1).max() for limit, of in ((300.0, x), (1e3, v), (1e4, a))]
        self._size[3:] *= min(largest)
        self._size[:3] *= 0.3 / np.abs(x[:, :3]).max()

    def _raw(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        p = self._pulse * time_s[:, None, None] + self._phase
        begin = (self._size * np.sin(self._phase)).sum(axis=1)
        by = self._size * self._pulse
        return (self._size * np.sin(p)).sum(axis=2) - begin, (by * np.cos(p)).sum(axis=2), (-by * self._pulse * np.sin(p)).sum(axis=2)

    def at(self, time_s: FloatArray) -> Instants:
        """Return what `Motion.at` says, turning rates by differences."""

        def turned(t: FloatArray) -> Rotation:
            return Rotation.from_rotvec(self._raw(t)[0][:, :3])

        def spin(t: FloatArray) -> FloatArray:
            return np.asarray((turned(t + 1e-5) * turned(t - 1e-5).inv()).as_rotvec() / 2e-5)

        x, v, a = self._raw(time_s)
        tilt = (spin(time_s + 1e-4) - spin(time_s - 1e-4)) / 2e-4
        return x[:, 3:], turned(time_s), np.hstack([spin(time_s), v[:, 3:]]), np.hstack([tilt, a[:, 3:]])


class FreeRunning:
    """Frames of m channels that each send by their own timer and clock, about samples time_s (n,) in between.

    Clocks are off by up to late_s and slow by up to slow, uniformly.
    """

    def __init__(self, rng: np.random.Generator, m: int, lasts_s: float, rate_hz: float, late_s: float = 0.0, slow: float = 0.0) -> None:
        n = int(lasts_s * rate_hz)
        self.middle_s = 0.5 * lasts_s
        self.time_s = np.asarray((np.arange(n) + 0.5) / rate_hz, dtype=np.float64)
        self.true_s = np.arange(n)[:, None] / rate_hz + rng.uniform(0.0, 1.0 / rate_hz, m)
        self.late_s, self.slow = rng.uniform(-late_s, late_s, m), rng.uniform(-slow, slow, m)
        self.stamp_s = self.true_s - self.late_s - self.slow * (self.true_s - self.middle_s)

    def common(self, time_s: FloatArray) -> FloatArray:
        """(n,) true times at which the mean of all clocks shows times (n,)."""
        return np.asarray(time_s + self.late_s.mean() + self.slow.mean() * (time_s - self.middle_s))


def logged(motion: Motion, lasts_s: float, late_s: float, noise_mm: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Times (n,) of a late clock, and poses (n, 7) of a flange at 250 Hz, with a base and a tool that nobody states."""
    base, mount, tool = Rotation.from_rotvec([0.3, -0.2, 2.0]), Rotation.from_rotvec([0.1, 0.5, -0.3]), np.array([30.0, -20.0, 150.0])
    time_s = np.arange(0.0, lasts_s, 0.004)
    place, turn, *_ = motion.at(time_s)
    flange = turn * mount.inv()
    places = base.apply(place - flange.apply(tool)) + [800.0, 10.0, 400.0]
    places += noise_mm * np.random.default_rng(1).standard_normal(places.shape)
    return time_s + late_s, np.hstack([places, (base * flange).as_quat()])


def errors(motion: Motion, time_s: FloatArray, found: Any) -> list[FloatArray]:
    """Errors (n, 6) of (rotation; place) of poses, velocities and accelerations that a curve found for times (n,)."""
    place, turn, velocity, acceleration = motion.at(time_s)
    turned = (turn * Rotation.from_quat(found.poses[:, 3:]).inv()).as_rotvec()
    out = [np.hstack([turned, place - found.poses[:, :3]])]
    return [*out, *(rate - found.rates[:, d] for d, rate in enumerate((velocity, acceleration)[: found.rates.shape[1] - 1], 1))]


class Cornering:
    """Cycles along x, round a corner that the tool passes at a distance, along y and back: at constant speed between, from rest to rest.

    At its end the tool swings along x by up to swing_mm, and rests.
    """

    LEG_MM, RUN_UP_MM = 120.0, 40.0

    def __init__(self, cycles: int, speed: float = 240.0, distance: float = 2.0, begin_s: float = 0.3, swing_mm: float = 0.0) -> None:
        rest_s = 0.6
        self.speed, self.cycles, self.begin_s, self.swing_mm = speed, cycles, begin_s, swing_mm
        self.radius = distance / (np.sqrt(2.0) - 1.0)
        self.straight, self.arc = self.LEG_MM - self.radius, 0.5 * np.pi * self.radius
        self.way = 2.0 * self.straight + self.arc
        self.ramp_s = 2.0 * self.RUN_UP_MM / speed
        self.run_s = 2.0 * self.ramp_s + (self.way - 2.0 * self.RUN_UP_MM) / speed
        self.back_s = 1.2
        self.period_s = self.run_s + self.back_s + 2.0 * rest_s
        self.rest_s, self.lasts_s = rest_s, begin_s + cycles * self.period_s

    @property
    def corner(self) -> FloatArray:
        """(3,) the commanded corner [mm]."""
        return np.array([self.LEG_MM, 0.0, 0.0])

    def windows(self) -> list[tuple[float, float]]:
        """Times in which the cycles run from start to end."""
        starts = self.begin_s + np.arange(self.cycles) * self.period_s
        return [(float(t), float(t + self.run_s)) for t in starts]

    def _along(self, s: FloatArray) -> FloatArray:
        """Places (n, 3) at ways (n,)."""
        turn = np.clip((s - self.straight) / self.radius, 0.0, 0.5 * np.pi)
        x = np.minimum(s, self.straight) + self.radius * np.sin(turn)
        y = self.radius * (1.0 - np.cos(turn)) + np.maximum(s - self.straight - self.arc, 0.0)
        return np.stack([x, y, np.zeros_like(s)], axis=1)

    def at(self, time_s: FloatArray) -> Instants:
        """Return places and turns as `Motion.at` does; velocities and accelerations by differences."""
        here, step = self.places(time_s), 1e-4
        before, behind = self.places(time_s - step), self.places(time_s + step)
        rates = np.zeros((2, len(time_s), 6))
        rates[0, :, 3:], rates[1, :, 3:] = (behind - before) / (2.0 * step), (behind - 2.0 * here + before) / step**2
        return here, Rotation.identity(len(time_s)), rates[0], rates[1]

    def places(self, time_s: FloatArray) -> FloatArray:
        """Return (n, 3) places [mm] at times (n,)."""
        t = np.clip(time_s - self.begin_s, 0.0, self.lasts_s - self.begin_s - 1e-9) % self.period_s
        t = np.where(time_s < self.begin_s, 0.0, t)
        # speeds rise and fall as cosines
        up, down = np.minimum(t, self.ramp_s), np.clip(t - self.run_s + self.ramp_s, 0.0, self.ramp_s)

        def risen(u: FloatArray) -> FloatArray:
            return np.asarray(0.5 * self.speed * (u - self.ramp_s / np.pi * np.sin(np.pi * u / self.ramp_s)))

        s = risen(up) + self.speed * np.clip(t - self.ramp_s, 0.0, self.run_s - 2.0 * self.ramp_s) + self.speed * down - risen(down)
        back = np.clip((t - self.run_s - self.rest_s) / self.back_s, 0.0, 1.0)
        part = back**4 * (35.0 - 84.0 * back + 70.0 * back**2 - 20.0 * back**3)
        since = t - self.run_s - 0.12
        swing = self.swing_mm * np.exp(-((since / 0.05) ** 2)) * np.cos(2.0 * np.pi * 8.0 * since)
        return np.asarray((1.0 - part)[:, None] * self._along(s) + swing[:, None] * np.array([1.0, 0.0, 0.0]))


class Shaken:
    """A motion with a displacement (n,) [mm] of the tool along x added, a function of times (n,)."""

    def __init__(self, motion: Motion, by: Callable[[FloatArray], FloatArray]) -> None:
        self.motion, self.by = motion, by

    def at(self, time_s: FloatArray) -> Instants:
        """Return what `Motion.at` does; rates of the displacement by differences."""
        place, turn, velocity, acceleration = self.motion.at(time_s)
        before, here, behind = (self.by(time_s + step) for step in (-1e-5, 0.0, 1e-5))
        along = np.eye(6)[3]
        velocity = velocity + (behind - before)[:, None] / 2e-5 * along
        return place + here[:, None] * along[3:], turn, velocity, acceleration + (behind - 2.0 * here + before)[:, None] / 1e-10 * along
