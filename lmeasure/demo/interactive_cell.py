"""A simulated cell to play with: a robot in the cables of a rig, and a hand that pulls them.

It differs from the nominal rig as a built one does. Its counts are read row by row, for a bus.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmeasure.core import FloatArray, LMeasureError, angles_from_rotation, se3
from lmeasure.iso9283 import read_commands
from lmeasure.recording import Poses
from lmeasure.rig import Observed, Rig
from lmeasure.robots import cell_robot
from lmeasure.sensors import counts_from_poses, drawn_phases, recorded_from_counts
from lmeasure.simulation import Leg, scattered_poses, smooth_path
from lmeasure.text import message

PULL_MM = 100.0
HAND_S = 0.5
"""Time that a hand takes for a request."""
SPEED_MM_S, TURN_RAD_S = 400.0, 1.0
REST_S = 0.5
"""Before and behind a motion."""
STOPS, STOPS_MM, STOPS_RAD = 6, 150.0, 0.1
"""Stops of the default motion."""
HOME = "home"


@dataclass(frozen=True)
class Built:
    """Construction of the cell: points within off_mm of the rig's, along each axis, guides within off_deg; the robot takes its poses with
    standard deviations u_mm and u_deg of each coordinate and about each axis, the same at each return; exchanged: channels with swapped
    encoders."""

    off_mm: float = 0.0
    off_deg: float = 0.0
    u_mm: float = 0.0
    u_deg: float = 0.0
    exchanged: tuple[str, ...] = ()


def built_rig(rig: Rig, how: Built, rng: np.random.Generator) -> Rig:
    """The rig as it was built, no calibration linked."""
    points = []
    for p in rig.observation_point:
        x, y, z = np.asarray(p.position_mm) + rng.uniform(-how.off_mm, how.off_mm, 3)
        alpha, beta = rng.uniform(-how.off_deg, how.off_deg, 2)
        guide = {"guide_alpha_deg": p.guide_alpha_deg + alpha, "guide_beta_deg": p.guide_beta_deg + beta}
        points.append(p.model_copy(update=guide | {"position_mm": (float(x), float(y), float(z))}))
    return rig.model_copy(update={"observation_point": tuple(points), "calibration": None})


class PlayedCell:
    """Counts of one pass of a cell, row by row, while it is played with.

    home (7,): the robot's first pose, at which counters are zeroed. poses: targets for it; commands: a list of commands in the form of
    `program`, which is the motion then. GeometryError if a cable cannot run at home, LMeasureError for an impossible motion.
    """

    def __init__(
        self,
        rig: Rig,
        home: FloatArray,
        rate_hz: float,
        *,
        how: Built = Built(),
        passage: int = 1,
        poses: Poses | None = None,
        commands: Path | None = None,
        seed: int = 0,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        rng = np.random.default_rng(seed)
        self.rig, self._rate_hz, self._poses = built_rig(rig, how, rng), rate_hz, poses
        self._observed = tuple(o for o in rig.observed if o.passage == passage)
        self._order = _order(self._observed, how.exchanged)
        self._phase = drawn_phases(self.rig, rng.spawn(1)[0], self._observed)
        count = 0 if poses is None else len(poses)
        self._errors = rng.normal(size=(count, 6)) * np.repeat([math.radians(how.u_deg), how.u_mm], 3)
        self.home = self._here = np.asarray(home, np.float64)
        self.at = HOME
        self._hand, self._pulled, self._turned = np.zeros((3, len(self._observed)))
        self._rows: deque[FloatArray] = deque()
        self._last = self._recorded(self._here[None], self._hand[None])[0]
        self._motion = _motion(self.home, rate_hz, commands, seed, progress=progress)

    @property
    def moves(self) -> bool:
        """Return whether anything still moves."""
        return bool(self._rows)

    @property
    def cables(self) -> list[str]:
        """Return names that a hand can pull or turn."""
        return [o.name for o in self._observed]

    @property
    def out(self) -> list[str]:
        """Names of those that a hand holds away from where they were."""
        return [o.name for o, away in zip(self._observed, self._pulled + self._turned, strict=True) if away]

    @property
    def poses(self) -> list[str]:
        """Names of where the robot can be sent."""
        return [] if self._poses is None else list(self._poses.names)

    def stands_at(self) -> list[float]:
        """Return the robot's present or next pose as commanded: x, y, z [mm] and the angles of the rig's convention."""
        turn = angles_from_rotation(self.rig.angles, se3.rotation(self._here[None]))[0]
        return [round(float(v), 6) + 0.0 for v in (*self._here[:3], *turn)]

    def take(self, count: int) -> FloatArray:
        """(count, m) the next recorded counts, in the order of the rig's channels."""
        out = np.empty((count, len(self._observed)))
        for row in out:
            if self._rows:
                self._last = self._rows.popleft()
            row[:] = self._last
        return out

    def do(self, text: str) -> str:
        """Do the action of a line, after those still going on, and return the answer. LMeasureError for an impossible one."""
        word, _, rest = text.strip().partition(" ")
        name, _, much = rest.strip().rpartition(" ") if word in ("pull", "swing") and " " in rest.strip() else (rest.strip(), "", "")
        if word == "pull":
            return self._pull(name, _number(much, PULL_MM), "mm")
        if word == "swing":
            return self._pull(name, _number(much, 45.0), "degrees")
        if word == "let":
            return self._let(name)
        if word == "turn":
            return self._turn(name)
        if word == HOME and not name:
            self._go(self.home)
            self.at = HOME
            return message("demo.robot_goes_home")
        if word == "go":
            return self._go_to(name)
        if word == "run" and not name:
            return self._run()
        raise LMeasureError(message("error.the_simulated_cell_knows", strip=text.strip()))

    # --- the hand ---

    def _pull(self, name: str, much: float, unit: str) -> str:
        j = self._channel(name)
        of = self.rig.counter(self._observed[j])
        k = (much if of.is_length else math.radians(much)) / of.per_count
        self._pulled[j] += k
        self._move_hand(j, k)
        return message("demo.pulled_out_mm", name=name, much=much) if unit == "mm" else message("demo.turned_degrees", name=name, much=much)

    def _let(self, name: str) -> str:
        j = self._channel(name)
        held = self._pulled if self._pulled[j] else self._turned  # an earlier turn stays: only the pull returns
        self._move_hand(j, -float(held[j]))
        held[j] = 0.0
        return message("demo.let_back", name=name)

    def _turn(self, name: str) -> str:
        j = self._channel(name)
        k = float(self.rig.counter(self._observed[j]).counts_per_revolution)
        self._turned[j] += k
        self._move_hand(j, k)
        return message("demo.drum_turned_once", name=name)

    def _channel(self, name: str) -> int:
        """Return the channel of a cable's or an encoder's name."""
        for j, o in enumerate(self._observed):
            names = {o.name, o.channel, *([o.from_point] if o.is_cable else [])}
            if name in names:
                return j
        raise LMeasureError(message("error.there_is_no_such", name=name, observed=", ".join(o.name for o in self._observed)))

    def _move_hand(self, j: int, k: float) -> None:
        s = np.linspace(0.0, 1.0, max(2, round(HAND_S * self._rate_hz)))
        hand = np.tile(self._hand, (len(s), 1))
        hand[:, j] += k * s**3 * (10.0 + s * (6.0 * s - 15.0))
        self._hand = hand[-1]
        self._rows.extend(self._recorded(np.broadcast_to(self._here, (len(s), 7)), hand))

    # --- the robot ---

    def _go_to(self, name: str) -> str:
        if self._poses is None or name not in self._poses.names:
            known = message("demo.no_poses") if self._poses is None else message("demo.known_poses", names=", ".join(self._poses.names))
            raise LMeasureError(message("error.there_is_no_pose", name=name, known=known))
        i = self._poses.names.index(name)
        self._go(se3.displaced(self._poses.rows[i], self._errors[i]))
        self.at = name
        return message("demo.robot_goes_pose", name=name)

    def _go(self, pose: FloatArray) -> None:
        for j in np.flatnonzero(self._turned):  # no hand holds a drum any more: its spring winds up the loose cable
            self._move_hand(int(j), -float(self._turned[j]))
        self._turned[:] = 0.0
        self._follow(smooth_path(self._here, [Leg(pose, SPEED_MM_S, TURN_RAD_S, REST_S)], self._rate_hz)[1])

    def _run(self) -> str:
        self._go(self.home)
        self._follow(self._motion)
        self.at = HOME
        return message("demo.robot_runs_motion_s", seconds=len(self._motion) / self._rate_hz)

    def _follow(self, poses: FloatArray) -> None:
        self._rows.extend(self._recorded(poses, np.broadcast_to(self._hand, (len(poses), len(self._hand)))))
        self._here = poses[-1]

    def _recorded(self, poses: FloatArray, hand: FloatArray) -> FloatArray:
        counts = counts_from_poses(self.rig, poses, self.home, self._observed)
        return recorded_from_counts(self.rig, counts + hand, self._observed, self._phase)[:, self._order]


def _number(text: str, usual: float) -> float:
    try:
        return float(text) if text else usual
    except ValueError:
        raise LMeasureError(message("error.is_no_number_2", text=text)) from None


def _order(observed: tuple[Observed, ...], exchanged: tuple[str, ...]) -> list[int]:
    """Return the counter of each channel."""
    channels = [o.channel for o in observed]
    order = list(range(len(channels)))
    unknown = next((c for c in exchanged if c not in channels), None)
    if unknown is not None or len(exchanged) not in (0, 2):
        raise LMeasureError(message("error.two_of_the_channels", channels=", ".join(channels), exchanged=", ".join(exchanged)))
    if exchanged:
        i, j = map(channels.index, exchanged)
        order[i], order[j] = j, i
    return order


def _motion(
    home: FloatArray, rate_hz: float, commands: Path | None, seed: int, *, progress: Callable[[int, int], None] | None
) -> FloatArray:
    """(n, 7) poses of the motion, at rest at home at its beginning and its end."""
    if commands is None:
        stops = scattered_poses(STOPS, (STOPS_MM,) * 3, STOPS_RAD, home, rng=np.random.default_rng(seed))
        legs = [Leg(home, dwell_s=REST_S), *(Leg(p, SPEED_MM_S, TURN_RAD_S) for p in stops), Leg(home, SPEED_MM_S, TURN_RAD_S, REST_S)]
        return smooth_path(home, legs, rate_hz)[1]
    listed = read_commands(commands)
    done = cell_robot(seed).perform(listed, home, rate_hz, np.random.default_rng(seed), progress=progress).poses
    return np.vstack([_way(home, done[0], rate_hz), done, _way(done[-1], home, rate_hz)])


def _way(here: FloatArray, there: FloatArray, rate_hz: float) -> FloatArray:
    """Return the way from rest to rest."""
    return smooth_path(here, [Leg(here, dwell_s=REST_S), Leg(there, SPEED_MM_S, TURN_RAD_S, REST_S)], rate_hz)[1]
