"""A session of a capture: samples and commands in, readings and words out. It knows no bus, no terminal and no clock but the samples'.

After a fault, or in a new session, a pose that was read before shows whether the counters still count from the same origin. `Trust` knows
them. Functions named `line` or `lines` write for the terminal.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from lmeasure.acquisition import Event, Samples, folded, moduli
from lmeasure.core import BoolArray, FloatArray, conventions
from lmeasure.procedures.capture.folder import CaptureFolder, Reading, mean_variances, thinned
from lmeasure.procedures.capture.progress import Expected, Progress, Worth
from lmeasure.procedures.capture.rest import Rest, Return, judged_return, lengths_of_counts, still_counts
from lmeasure.recording import Poses
from lmeasure.rig import Rig
from lmeasure.text import composed, joined, message

SURPRISED = 5.0
SURPRISED_MM = 2.0
"""Standard uncertainties, and least mm, of a deviation from the expected counts before a pose is doubted."""
IN_A_LINE = 3


def pose_line(poses: Poses, name: str, angles: str) -> str:
    """A pose as it is typed into a controller."""
    i = poses.names.index(name)
    values = [f"{c[0]} {v:.1f}" for c, v in zip(("x", "y", "z"), poses.rows[i, :3] + 0.0, strict=True)]
    if poses.oriented:
        typed = conventions.rounded_angles(angles, conventions.angles_from_rotation(angles, poses.rotation[i]))
        columns = conventions.convention(angles).columns
        values += [f"{c.rsplit('_', 1)[0]} {v:g}" for c, v in zip(columns, typed, strict=True)]
    return message("capture.pose", name=name, v1=i + 1, count=len(poses), v4="  ".join(values))


def reading_lines(reading: Reading, channels: tuple[str, ...], u: FloatArray) -> list[str]:
    """Return the counts: means with their standard uncertainties u (m,) [counts]."""
    lasts = reading.time_s[-1] - reading.time_s[0]
    lines = [message("capture.read_counts_each_channel", count=len(reading.counts), lasts=lasts, v3=reading.spread.max())]
    reported = [f"{c} {mean:.2f} (u {err:.2f})" for c, mean, err in zip(channels, reading.mean, u, strict=True)]
    return lines + [f"    {'  '.join(reported[i : i + IN_A_LINE])}" for i in range(0, len(reported), IN_A_LINE)]


def worth_line(worth: Worth, readings: int, code: str = "capture.u95_now_lengths_mm") -> str:
    """Return how well lengths and positions would be known if nothing more were read; code is that of the text."""
    if not worth.enough(readings):
        return message("capture.least_poses_too_few", readings=readings, least=worth.least)
    left = worth.unknowns - worth.rank
    held = message("capture.held", left=left, of=worth.unknowns) if left else ""
    position = "" if worth.position_mm is None else message("capture.position", mm=worth.position_mm)
    return message(code, rms_mm=worth.rms_mm, worst_mm=worth.worst_mm, worst_cable=worth.worst_cable, position=position, held=held)


def _missing(recorded: FloatArray, channels: tuple[str, ...]) -> str:
    """Return why a dwell's counts (n, m) are too few for a reading; empty where they are enough."""
    if np.isfinite(recorded).all(axis=1).mean() >= WHOLE_PART:
        return ""
    gaps = np.isnan(recorded).mean(axis=0)
    return message(
        "procedures.counts_missing_dwell", which=tuple(f"{channels[j]} ({gaps[j]:.0%})" for j in np.argsort(-gaps) if gaps[j] > 0)
    )


def surprising(expected: Expected) -> BoolArray:
    """Return (m,) whether lengths differ from the expected ones."""
    return np.abs(expected.off_mm) > np.maximum(SURPRISED * expected.u_mm, SURPRISED_MM)


def surprise(expected: Expected) -> str:
    """The lengths that are farthest off."""
    order = [j for j in np.argsort(-np.abs(expected.off_mm) / expected.u_mm) if surprising(expected)[j]][:IN_A_LINE]
    reported = tuple(message("capture.off_by", cable=expected.cables[j].name, off=expected.off_mm[j], u=expected.u_mm[j]) for j in order)
    return message("procedures.off_expected", cables=reported)


def expected_line(expected: Expected) -> str:
    """Return the agreement of the counts with the expected ones."""
    if surprising(expected).any():
        return message("capture.unexpected", what=surprise(expected))
    j = int(np.argmax(np.abs(expected.off_mm)))
    return message("capture.expected_within_mm_u", abs=abs(expected.off_mm[j]), u_mm=expected.u_mm[j], name=expected.cables[j].name)


KEPT_COUNTS = 3.0
KEPT_MM = 0.1
"""Largest differences of counters at an earlier pose without lost counts; the second is the usual drift of robots."""
REPORTED = 0.5
"""Part of the channels that may differ at a pose while the others still identify it."""


@dataclass
class Trust:
    """Trust in the counters of a session. resumed: whether earlier readings have not been confirmed yet; doubts: channels with a doubtful
    count, and the reason."""

    rig: Rig
    channels: tuple[str, ...]
    passage: int
    resumed: bool
    doubts: dict[str, str] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        """Return whether the counters are trusted."""
        return not self.resumed and not self.doubts

    @property
    def why(self) -> str:
        """Return the objections to them."""
        return joined(composed("{channel} {what}", channel=channel, what=what) for channel, what in self.doubts.items()) or (
            message("capture.this_new_session") if self.resumed else ""
        )

    def restore(self) -> None:
        """Trust the counters from here on."""
        self.resumed, self.doubts = False, {}

    def compare(self, mean: FloatArray, readings: list[Reading]) -> tuple[str, str]:
        """Compare mean counts (m,) of a rest with the readings: return the pose with the same counts, or the reason why there is none."""
        mm = lengths_of_counts(self.rig, self.channels, self.passage)
        limit = np.where(mm > 0.0, np.maximum(KEPT_COUNTS, KEPT_MM / np.where(mm > 0.0, mm, 1.0)), KEPT_COUNTS)
        off = folded(np.array([mean - r.mean for r in readings]), moduli(self.rig, self.channels, self.passage))
        # the best half of the channels of each reading gives its distance
        agree = np.sort(np.abs(off) / limit, axis=1)[:, : max(len(mm) // 2, 1)].max(axis=1)
        nearest = int(np.argmin(agree))
        wrong, pose = ~(np.abs(off[nearest]) <= limit), readings[nearest].pose
        if not wrong.any():
            return pose, ""
        if wrong.mean() < REPORTED:
            reported = tuple(message("capture.counts", channels=self.channels[j], off=off[nearest, j]) for j in np.flatnonzero(wrong))
            return "", message("procedures.others_stand_pose_but", pose=pose, channels=reported)
        return "", message("capture.none_of_them", why=self.why, back=message("capture.back"))


By = Literal["key", "rest", "both"]

AWAY = 4.0
"""Bands of a rest that the robot moves at least between two readings taken by themselves."""
WHOLE_PART = 0.5
"""Part of a dwell's samples that must have all channels."""
MOVES_S = 0.1
"""A rest is no rest before that."""
IDLE_S = 1.0
LATE_S = 2.0
"""Longest delay between typed keys and the counts."""
PIECE_S = 0.05
LOSSES = {"jump": "capture.loss.jump", "reset": "capture.loss.reset", "lost_wrap": "capture.loss.silent", "stall": "capture.loss.stall"}
"""Faults of a recording after which a channel's count is not believed."""
ORIGIN_LOST = ("reset", "lost_wrap")
"""Those after which it has none any more in the same recording."""


@dataclass(frozen=True)
class Settings:
    """How to take readings: by a key, by a rest or by both; seconds of a dwell, and of the rest before it; whether the first pose is read
    again at the end."""

    by: By = "both"
    dwell_s: float = 1.0
    settle_s: float = 0.3
    closure: bool = True


class Session:
    """Session through the poses of a folder. say prints lines."""

    def __init__(self, folder: CaptureFolder, settings: Settings, say: Callable[[str], None]) -> None:
        self.folder, self.settings, self._say = folder, settings, say
        self.recording = folder.next_recording
        self._band = still_counts(folder.rig, folder.channels, folder.passage)
        self.rest = Rest(folder.channels, self._band, folder.modulus)
        self.poses = folder.poses
        self.skipped: set[str] = set()
        self._wanted, self._idle = False, False
        self.behind_s = 0.0
        """Age of the newest sample where more wait [s]."""
        self._asked_s = self._held_s = self._lacking_s = -np.inf
        self.trust = Trust(folder.rig, folder.channels, folder.passage, bool(folder.of_pass))
        self._seen_events = 0
        self._originless: set[str] = set()
        self._pending: list[Samples] = []
        self.progress = Progress(folder, say)
        self.keys = settings.by != "rest"
        self.closure: Return | None = None
        self.finished = self.stopped = False
        self.goal: str | None = self._next()
        self._begin()

    @property
    def idle(self) -> bool:
        """Return whether no counts have come for so long that the user must look."""
        return self._idle

    @property
    def lost(self) -> tuple[str, ...]:
        """Channels whose frames may come, and whose counts are none any more: where they count from is not known."""
        return tuple(c for c in self.rest.silent if c in self._originless)

    @property
    def to_read(self) -> int:
        """Return how many readings there will be, the return among them."""
        return len(self.poses) - len(self.skipped) + self.settings.closure

    @property
    def worth(self) -> Worth | None:
        """Return the value of the readings so far; None if it is unknown."""
        return self.progress.worth

    # --- input ---

    def feed(self, samples: Samples) -> None:
        """Take the samples of the recording, in their order; they are used after `look` has checked them."""
        self._pending.append(samples)

    def command(self, line: str, waited_s: float = 0.0) -> None:
        """A line that a person, or a script, has typed; waited_s is how long ago [s]."""
        word, _, rest = line.strip().partition(" ")
        apart = max(self.behind_s, waited_s)
        if word in ("", "take") and apart > LATE_S:  # the counts are from another moment than the key
            self._refuse(message("capture.late", seconds=apart))
            return
        actions: dict[str, Callable[[], None]] = {
            "": self._take,
            "take": self._take,
            "undo": self._undo,
            "skip": self._skip,
            "return": self._return,
            "status": self._status,
            "trust": self._believe,
            "quit": self._quit,
            "help": lambda: self._say(message("capture.help")),
        }
        if word == "go":
            self._go(rest.strip())
        elif word in actions and not rest:
            actions[word]()
        else:
            self._say(message("capture.no_command", strip=line.strip(), help=message("capture.help")))

    def look(self, events: Sequence[Event], idle_s: float = 0.0, behind_s: float = 0.0) -> None:
        """Decide on the new samples; events are all faults of the recording so far, idle_s the time since the last sample [s], behind_s the
        age of the newest sample if more wait [s]."""
        self._note_faults(events)
        if behind_s > LATE_S >= self.behind_s:
            self._say(message("capture.behind", seconds=behind_s))
        self.behind_s = behind_s
        if idle_s > IDLE_S and not self._idle:  # once, even without a requested reading
            self._say(message("capture.no_counts_come_from"))
        self._idle = idle_s > IDLE_S
        pending, self._pending = self._pending, []
        # as they would have come had nothing else kept this program busy: no rest is overlooked
        for samples in pending:
            count = len(samples.time_s)
            begun = np.arange(samples.time_s[0], samples.time_s[-1], PIECE_S) if count else np.empty(0)
            for first, end in pairwise(sorted({0, count, *np.searchsorted(samples.time_s, begun).tolist()})):
                self.rest.add(Samples(samples.time_s[first:end], samples.recorded[first:end]))
                self._note_leaps()
                self._decide()
        self._decide()

    def _decide(self) -> None:
        """Decide at the newest checked sample."""
        if self.finished or self.goal is None:
            return
        still = self.rest.lasts_s >= self.settings.settle_s + self.settings.dwell_s and not self._idle
        if self._wanted and self.rest.since_s > self._asked_s:
            self._refuse(message("capture.robot_moved_during_dwell"))
        elif still and not self.trust.whole and self.folder.of_pass:
            if self.rest.seen_throughout(self.settings.dwell_s):
                self._hold_against_readings()
        elif still and (self._wanted or self._away_from_last()) and self._is_due():
            self._read()

    def keys_are_gone(self) -> None:
        """Note that no more input can come."""
        if self.settings.by == "key":
            self._quit()
        self.keys = False

    # --- commands ---

    def _take(self) -> None:
        if self.goal is None:
            return
        why = self._unfit()
        if why:
            self._refuse(why)
        elif self.rest.lasts_s < MOVES_S:
            channel, speed = self.rest.fastest
            self._refuse(message("procedures.robot_moves_counts_s", channel=channel, speed=speed))
        else:
            self._wanted, self._asked_s = True, self.rest.since_s

    def _undo(self) -> None:
        if not self.folder.of_pass:
            self._say(message("capture.nothing_take_back"))
            return
        reading = self.folder.take_back()
        if self.keys:  # a deleted reading is not read again at once: wait for `Enter` or another rest
            self._held_s = self.rest.now_s
        self.progress.renew()
        if not self.folder.of_pass:
            self.trust.restore()
        self.closure, self.finished = None, False
        self._say(message("procedures.taken_back_reading_pose", pose=reading.pose, left=len(self.folder.of_pass)))
        self._head_for(reading.pose)

    def _skip(self) -> None:
        if self.goal is None:
            return
        if self.returns:
            self.settings = replace(self.settings, closure=False)
        self.skipped.add(self.goal)
        self._say(message("procedures.pose_left_out", pose=self.goal))
        self._head_for(self._next())

    def _go(self, name: str) -> None:
        if name not in self.poses.names:
            self._say(message("procedures.there_no_pose_they", pose=name, poses=tuple(self.poses.names)))
            return
        self.skipped.discard(name)
        self._head_for(name)

    def _return(self) -> None:
        if not self.folder.of_pass:
            self._say(message("capture.no_pose_has_been"))
            return
        self._head_for(self.folder.of_pass[0].pose)

    def _believe(self) -> None:
        if not self.trust.whole:
            self.folder.note(message("procedures.trusted_before_reading", number=len(self.folder.of_pass) + 1, why=self.trust.why))
            self.trust.restore()
            self._say(message("capture.counters_trusted_they_stand"))

    def _quit(self) -> None:
        self.finished = self.stopped = True

    def _status(self) -> None:
        for reading in self.folder.of_pass:
            means = "  ".join(f"{c} {v:.1f}" for c, v in zip(self.folder.channels, reading.mean, strict=True))
            self._say(message("capture.counts_each", pose=reading.pose, count=len(reading.counts), means=means))
        self._say_worth()
        self._say(self.line())

    # --- readings ---

    @property
    def doubt(self) -> str:
        """Return the reason why counts are not trusted, or do not come; empty without one."""
        if self._idle:
            return message("capture.no_counts_come_from_bus")
        if self.lost:
            return message("capture.lost_folder" if self.folder.of_pass else "capture.lost_again", channels=tuple(self.lost))
        if self.rest.silent:
            return message("procedures.no_counts_come_look", channels=tuple(self.rest.silent))
        return (
            message("capture.why_back", why=self.trust.why, back=message("capture.back"))
            if self.folder.of_pass and not self.trust.whole
            else ""
        )

    def _unfit(self) -> str:
        """Return why no reading can be taken whatever the robot does; empty if it can."""
        if self.doubt or not self.folder.of_pass:
            return self.doubt
        if self.goal == self.folder.of_pass[-1].pose:
            return message("procedures.pose_was_read_last", pose=self.goal)
        return ""

    def _is_due(self) -> bool:
        """Return whether the rest is complete, and the user or the rest itself wants the reading."""
        return self.rest.seen_throughout(self.settings.dwell_s) and (self._wanted or (self._may_read_by_itself() and not self._lacking()))

    def _lacking(self) -> str:
        """Return why too many counts are missing in the dwell, reported once per rest, which is read as soon as its last seconds are
        complete."""
        why = "" if self._unfit() else _missing(self.rest.last(self.settings.dwell_s).recorded, self.folder.channels)
        if why and not self._lacking_s >= self.rest.since_s:
            self._lacking_s = self.rest.now_s
            self._refuse(why)
        return why

    def _away_from_last(self) -> bool:
        """Return whether this rest is elsewhere than the last reading, and not yet reported."""
        if not self.folder.of_pass or self.rest.silent:
            return True
        off = np.abs(folded(self.rest.middle - self.folder.of_pass[-1].mean, self.folder.modulus))
        return self._held_s < self.rest.since_s and not bool((off <= AWAY * self._band).all())

    def _may_read_by_itself(self) -> bool:
        """Return whether a rest alone is enough for a reading: a new one, at the expected pose."""
        if self.settings.by == "key":
            return False
        why = self._unfit()
        if why:
            if self.rest.silent and self._held_s < self.rest.since_s:
                self._held_s = self.rest.now_s
                self._refuse(why)
            return False
        if not self.folder.of_pass:
            # the robot's pose is not known yet
            return self.settings.by == "rest" or not self.keys
        mean = self.rest.middle
        assert self.goal is not None
        expected = self.progress.expected(self.goal, mean)
        if expected is None or not surprising(expected).any():
            return True
        self._held_s = self.rest.now_s
        code = "procedures.rest_but_not_pose_enter" if self.keys else "procedures.rest_but_not_pose"
        self._say(message(code, pose=self.goal, why=surprise(expected)))
        return False

    def _read(self) -> None:
        """Take the reading of the rest, or report why not."""
        assert self.goal is not None
        self._wanted = False
        dwell = self.rest.last(self.settings.dwell_s)
        whole = np.isfinite(dwell.recorded).all(axis=1)
        why = self._unfit() or _missing(dwell.recorded, self.folder.channels)
        if why:
            self._held_s = self.rest.now_s  # reported once per rest
            self._refuse(why)
            return
        was_return, first = self.returns, not self.folder.of_pass
        expected = None if first else self.progress.expected(self.goal, dwell.recorded[whole].mean(axis=0))
        reading = thinned(self.goal, self.folder.passage, self.recording, dwell.time_s[whole], counts=dwell.recorded[whole])
        self.folder.add(reading)
        self.progress.renew()
        u = np.sqrt(mean_variances(self.folder.of_pass)[-1])
        for line in reading_lines(reading, self.folder.channels, u):
            self._say(line)
        if expected is not None and len(expected.off_mm):
            self._say(expected_line(expected))
        self._say_worth()
        if was_return:
            self._close()
        self._head_for(self._next())

    def _close(self) -> None:
        readings = self.folder.of_pass
        variance = mean_variances(readings)[[0, -1]].sum(axis=0)
        difference = folded(readings[-1].mean - readings[0].mean, self.folder.modulus)
        of = self.folder.rig, self.folder.channels, self.folder.passage
        self.closure = judged_return(*of, difference, variance=variance, u_repeatability_mm=self.folder.u_repeatability_mm)
        for line in self.closure.lines():
            self._say(line)

    def _hold_against_readings(self) -> None:
        """Compare the counters at this rest with those of an earlier pose."""
        dwell = self.rest.last(self.settings.dwell_s).recorded
        if self._held_s >= self.rest.since_s or not (self.rest.silent or np.isfinite(dwell).any(axis=0).all()):
            return
        self._held_s = self.rest.now_s
        if self.rest.silent:
            self._refuse(self._unfit())
            return
        mean = np.nanmean(dwell, axis=0)
        pose, why = self.trust.compare(mean, self.folder.of_pass)
        if not pose:
            self._refuse(why)
            return
        self.trust.restore()
        self._say(message("procedures.counters_stand_they_did", pose=pose))
        self._head_for(self.goal)

    # --- faults ---

    def _note_faults(self, events: Sequence[Event]) -> None:
        for event in events[self._seen_events :]:
            if event.kind in ORIGIN_LOST:
                self._originless.add(event.channel)
            if event.kind in LOSSES and self.folder.of_pass:
                self._doubt(event.channel, message(LOSSES[event.kind]), composed(" ({text})", text=event.text) if event.text else "")
        self._seen_events = len(events)

    def _note_leaps(self) -> None:
        for leap in self.rest.leaps():
            if self.folder.of_pass:
                self._doubt(leap.channel, message("capture.leapt", counts=leap.counts), "")

    def _doubt(self, channel: str, why: str, more: str) -> None:
        if channel not in self.trust.doubts:
            self._say(message("capture.doubt", channel=channel, why=why, more=more))
            self.trust.doubts[channel] = why
            self._wanted = False

    def _refuse(self, why: str) -> None:
        self._wanted = False
        self._say(message("procedures.not_read", why=why))

    # --- output ---

    def _begin(self) -> None:
        done = len(self.folder.of_pass)
        if done:
            self._say(
                message(
                    "procedures.going_readings_there_poses", count=done, poses=tuple(dict.fromkeys(r.pose for r in self.folder.of_pass))
                )
            )
        self.progress.renew()
        if self.progress.of_all is not None:
            self._say(message("procedures.all_poses_promise", count=len(self.poses)))
            self._say(worth_line(self.progress.of_all, len(self.poses), "capture.u95_lengths_mm"))
        if self.settings.by != "rest":
            self._say(message("capture.help"))
        if self.goal is None:
            self.finished = True
            self._say(message("capture.all_poses_have_been"))
        else:
            self._head_for(self.goal)

    def _head_for(self, name: str | None) -> None:
        self.goal, self._wanted = name, False
        if name is None:
            self.finished = True
            return
        pose = pose_line(self.poses, name, self.folder.rig.angles)
        self._say(message("capture.back_to_first", pose=pose) if self.returns else pose)

    def line(self) -> str:
        """Return the state in one line."""
        if self._idle:
            state = message("acquisition.no_counts")
        elif self.behind_s > LATE_S:
            state = message("capture.state.behind", seconds=self.behind_s)
        elif self.lost:
            state = message("capture.state.no_origin", channels=tuple(self.lost))
        elif self.rest.silent:
            state = message("capture.state.silent", channels=tuple(self.rest.silent))
        elif self.rest.lasts_s > 0.1:
            state = message("capture.state.still", seconds=self.rest.lasts_s)
        else:
            state = message("capture.state.moving")
        newest = self.rest.counts[-1] if len(self.rest.counts) else np.full(len(self.folder.channels), np.nan)
        counts = " ".join("-" if np.isnan(v) else f"{v:+.0f}" for v in newest)
        return message("capture.pose_2", goal=self.goal, state=state, counts=counts)

    def _say_worth(self) -> None:
        if self.worth is not None:
            self._say(worth_line(self.worth, len({r.pose for r in self.folder.of_pass})))

    # --- state ---

    @property
    def returns(self) -> bool:
        """Return whether the wanted pose is the first one again."""
        readings = self.folder.of_pass
        return len(readings) > 1 and self.goal == readings[0].pose

    def _next(self) -> str | None:
        """The next pose to be read: those not read yet, then the first once more."""
        readings = self.folder.of_pass
        read = {r.pose for r in readings}
        left = [name for name in self.poses.names if name not in read and name not in self.skipped]
        if left:
            return left[0]
        if self.settings.closure and len(read) > 1 and readings[-1].pose != readings[0].pose:
            return readings[0].pose
        return None
