"""A recording in a simulated world: bus, clocks and disk, with faults, all from one seed; and what must be true of the files it leaves.

The code of the recorder and of its source runs as it is, on a simulated machine. The truth is in the counts: channel 1 counts 3 per
sample and channel 2 counts 5, so that each row says which sample it is.
"""

import hashlib
import shutil
import signal
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import can
import numpy as np
import rigged_feed
from numpy.typing import NDArray
from simulated_machine import BEGIN_S, Frame, Killed, Machine, content, simulated

from lmeasure.acquisition import counter_fields, import_logs, record
from lmeasure.acquisition.bus.sources import BusSource
from lmeasure.core import LMeasureError
from lmeasure.io import files
from lmeasure.recording import Run, read_counts, read_run
from lmeasure.rig import Rig

FloatArray = NDArray[np.float64]
CHANNELS = 6
MOST_PER_S = 200.0
"""Counts per second of the fastest channel; the rig's limit is ten times as much."""
LIMIT_MM_S = 10.0 * MOST_PER_S * 0.012
FAR = 50_000
"""Counts from zero at which an encoder starts again."""
SURE_S = 0.06
"""What the smallest step of a clock that is noticed may leave."""


@dataclass(kw_only=True)
class World(Machine):
    """What one seed draws: the truth, what happens to the frames, the clocks and the disk, and how it went."""

    period_s: float
    bits: int
    truth: NDArray[np.int64]
    faults: list[str]
    good: NDArray[np.bool_]
    """Samples and channels (n, 6) of which each frame came, and the frames before and behind it."""
    first_lost: NDArray[np.int64]
    """The sample from which a channel has another origin."""
    steps: int
    """How often the clock of the wall is set."""
    stop_at_s: float
    sent_s: FloatArray
    """When each sample was taken."""
    exact: bool
    """Whether the rig states an exact zero."""
    hopeless: bool
    """Whether the bus is gone for longer than the recorder waits."""
    kept: list[FloatArray] = field(default_factory=list)

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(self.truth)


def rig_of(bits: int, exact: bool = True) -> Rig:
    """Return the rig of the six counters."""
    return rigged_feed.cell(max_cable_speed_mm_s=LIMIT_MM_S, counter_bits=bits, zero_exact=exact)


def drawn(seed: int, samples: int = 400) -> World:
    """Return the world of a seed."""
    rng = np.random.default_rng(seed)
    period, bits = float(rng.choice([0.05, 0.2, 1.0])), int(rng.choice([16, 24, 32]))
    n, row, exact = int(rng.integers(samples // 4, samples)), np.arange(samples), bool(rng.integers(2))
    waves = MOST_PER_S * 20.0 * np.sin(2.0 * np.pi * row[:, None] * period / rng.uniform(200.0, 900.0, 4) + rng.uniform(0, 6, 4))
    truth = np.column_stack(
        [3 * row, 5 * row + 7, np.rint(waves + rng.integers(-FAR, FAR, 4) * (2.0**15 / 2.0**17 if bits == 16 else 1.0))]
    ).astype(np.int64)[:n]
    fields = counter_fields(rig_of(bits))
    came = np.ones((n, 1 + CHANNELS), bool)
    twice = np.zeros((n, 1 + CHANNELS), bool)
    late = np.zeros((n, 1 + CHANNELS))
    sent_truth, words, first_lost = truth.copy(), [], np.full(CHANNELS, n)
    faults: list[str] = []

    def happens(name: str, chance: float) -> bool:
        if rng.random() >= chance:
            return False
        faults.append(name)
        return True

    sent_s: FloatArray = np.arange(n, dtype=np.float64) * period
    if happens("pause", 0.25):
        sent_s[int(rng.integers(1, n)) :] += float(10.0 ** rng.uniform(1.0, 4.0))
    if happens("lost", 0.35):
        came[rng.random(came.shape) < rng.choice([0.002, 0.02])] = False
    if happens("silent channel", 0.15):
        at, long = int(rng.integers(n)), int(rng.integers(2, 40))
        came[at : at + long, int(rng.integers(1, 1 + CHANNELS))] = False
    if happens("doubled", 0.25):
        twice[rng.random(twice.shape) < 0.02] = True
    if happens("late", 0.25):
        late[rng.random(late.shape) < 0.01] = period * rng.uniform(0.3, 0.9)
        if not {"lost", "silent channel"} & set(faults):  # behind the next SYNC, before the frame that answers it
            behind = (late > 0.0) & (rng.random(late.shape) < 0.5)
            behind[1:] |= behind[:-1] & (rng.random(n - 1) < 0.3)[:, None]
            behind[2:] &= ~(behind[1:-1] & behind[:-2])
            late = np.where(behind, period - 0.5e-4 * np.arange(1.0 + CHANNELS), late)
        late[:, 0] = 0.0
    if happens("no frames", 0.06):
        came[:] = False
    others = np.zeros((n, 1 + CHANNELS), np.int64)
    if not faults and happens("another sender", 0.5):
        others = np.where(rng.random(others.shape) < 0.01, rng.integers(1, 4, others.shape), 0)
        others[:, 0], others[:10] = 0, 0  # the motion is known
    if happens("encoder starts again", 0.25):
        channel, at = int(rng.integers(2, CHANNELS)), int(rng.integers(5, n - 5))
        reported = bool(rng.random() < 0.6)
        if reported and not exact and rng.random() < 0.5:  # so near zero that only its word tells
            truth[:, channel] -= truth[at, channel] - int(rng.integers(25, 300))
            sent_truth[:, channel] = truth[:, channel]
        if abs(truth[at, channel]) > (MOST_PER_S // 10 if reported and not exact else FAR // 10):
            sent_truth[at:, channel] -= truth[at, channel]
            first_lost[channel] = at
            if reported:
                words.append(
                    (float(sent_s[at]) - 0.3 * period, can.Message(arbitration_id=0x701 + channel, data=b"\0", is_extended_id=False))
                )
                came[at - 1, 1 + channel] = False
    steps: list[tuple[float, float]] = []
    if happens("clock set", 0.25):
        steps = [(float(sent_s[int(rng.integers(1, n))]) - 0.5 * period, float(rng.choice([-1, 1]) * 10.0 ** rng.uniform(0.0, 3.5)))]
    due: list[tuple[float, Frame]] = []
    for k in range(n):
        for j in range(1 + CHANNELS):
            if not came[k, j]:
                continue
            at = float(sent_s[k]) + j * 1e-4 + late[k, j]
            for more in [0] * (1 + int(twice[k, j])) + [int(others[k, j])] * bool(others[k, j]):
                data, identifier = b"", 0x80
                if j:
                    value = (int(sent_truth[k, j - 1]) + more) % 2**bits
                    identifier, data = fields[j - 1].identifier, value.to_bytes(fields[j - 1].bytes_needed, "little", signed=False)
                moment = at - (-1) ** k * 3e-5 * bool(more)
                due.append((moment, can.Message(arbitration_id=identifier, data=data, is_extended_id=False)))
    if happens("junk", 0.2):
        for _ in range(int(rng.integers(1, 200))):
            junk = can.Message(arbitration_id=int(rng.integers(0x400, 0x580)), data=rng.bytes(int(rng.integers(9))), is_extended_id=False)
            due.append((float(rng.uniform(0, n * period)), junk))
    due += words
    due.sort(key=lambda one: one[0])
    for i, (moment, message) in enumerate(due):
        assert isinstance(message, can.Message)
        own = can.Message(
            timestamp=BEGIN_S + moment + sum(size for when, size in steps if moment >= when),
            arbitration_id=message.arbitration_id, data=message.data, is_extended_id=False, is_rx=True,
        )  # fmt: skip
        due[i] = moment, own
    back_s, hopeless, stop_at_s = 0.0, False, float(sent_s[-1]) + period + 3.0
    if happens("bus off", 0.15):
        begin = float(sent_s[int(rng.uniform(0.2, 0.8) * n)]) + 0.3 * period
        end = begin + float(rng.uniform(0.1, 8.0) if rng.random() < 0.7 else rng.uniform(31.0, 90.0))
        inside = np.array([begin <= at < end for at, _ in due])
        came &= ~((sent_s >= begin - period) & (sent_s < end + period))[:, None]
        due = [one for one, out in zip(due, inside, strict=True) if not out]
        place = sum(at < begin for at, _ in due)
        due[place:place] = [(begin, can.CanOperationError("bus off"))]
        back_s, hopeless = end, min(end, stop_at_s) - begin > 32.0
    intact = came.all(axis=1) & (late == 0.0).all(axis=1) & (others == 0).all(axis=1)
    around = intact & np.roll(intact, 1) & np.roll(intact, -1)
    around[[0, -1]] = intact[[0, -1]]
    disk: dict[int, str] = {}
    if happens("disk", 0.4):
        answer = str(rng.choice(["full", "part", "error", "interrupted", "killed", "killed"]))
        number = int(rng.integers(1, 60 + 4 * n if rng.random() < 0.6 else 40))
        disk = {number: answer} if answer != "full" else {-number: "", 0: "full"}
        faults[-1] = f"disk: {answer}"
    return World(
        seed=seed, period_s=period, bits=bits, truth=truth, due=due, faults=faults, good=np.repeat(around[:, None], CHANNELS, axis=1),
        first_lost=first_lost, steps=len(steps), disk=disk, stop_at_s=stop_at_s, end_s=stop_at_s + 1.0, sent_s=sent_s, back_s=back_s,
        short=int(rng.choice([10**9, 10**9, 10**9, 100])), slow=int(rng.integers(5, 60)) if happens("slow disk", 0.25) else 0,
        exact=exact, hopeless=hopeless,
    )  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """How a world went: how the recording ended, its simulated seconds, a digest of its files, the faults drawn, and what was wrong."""

    seed: int
    ended: str
    seconds: float
    digest: str
    faults: list[str]
    samples: int
    wrong: list[str]


def lived(world: World, folder: Path) -> Outcome:
    """Record the world into a folder, and judge the files."""
    shutil.rmtree(folder, ignore_errors=True)
    rig = rig_of(world.bits, world.exact)
    wrong: list[str] = []
    ended, reported = "complete", None
    handlers = signal.getsignal(signal.SIGINT)
    with simulated(world, folder):
        source = BusSource(world.bus, "socketcan:can0", patience_s=30.0)
        try:
            reported = record(
                rig, source, counter_fields(rig), folder, start=rigged_feed.HOME, each=lambda s: world.kept.append(s.recorded.copy()),
                stop=lambda: world.now > world.stop_at_s,
            )  # fmt: skip
            ended = reported.ended
        except Killed:
            ended = "killed"
        except LMeasureError as error:
            ended = f"refused: {error}"
    for one in world.opened:
        one.close()
    if signal.getsignal(signal.SIGINT) is not handlers:
        wrong.append("a signal's handler is left")
    if world.left is not None:
        shutil.rmtree(folder, ignore_errors=True)
        for name, data in world.left.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)
    after = content(folder) if folder.exists() else {}
    wrong += _judged(world, rig, folder, after, ended, reported is not None)
    if world.hopeless and ended == "complete":
        wrong.append("complete, though the bus did not come back")
    if reported is not None:
        if reported.faults.get("clock_step", 0) > world.steps:
            wrong.append(f"{reported.faults['clock_step']} steps of a clock that was set {world.steps} times")
        if reported.samples != (rows := max(after["pass1.csv"].count(b"\n") - 1, 0)):
            wrong.append(f"reports {reported.samples} samples, {rows} are in the file")
        lines, came = after["pass1.log"].count(b"\n"), sum(isinstance(what, can.Message) for _, what in world.due[: world.position])
        if ended == "complete" and not world.disk and lines != came:
            wrong.append(f"{came} frames came, the log has {lines}")
    digest = hashlib.sha256(b"".join(name.encode() + data for name, data in sorted(after.items()) if ".part" not in name)).hexdigest()[:16]
    return Outcome(world.seed, ended, world.now, digest, world.faults, sum(map(len, world.kept)), wrong)


def _judged(world: World, rig: Rig, folder: Path, after: dict[str, bytes], ended: str, done: bool) -> Iterator[str]:
    whole = {name: data for name, data in after.items() if ".part" not in name}
    if ended != "killed" and len(whole) != len(after):
        yield f"left: {sorted(set(after) - set(whole))}"
    if ended.startswith("refused"):
        if whole:
            yield f"refused, and left {sorted(whole)}"
        if not world.disk and not {"bus off", "no frames"} & set(world.faults):
            yield ended
        return
    if "run.toml" not in whole:
        if ended != "killed" or world.kept:
            yield "no run.toml"
        return
    for name in ("run.toml", "rig.toml"):
        files.read_toml(folder / name)
    entry = files.read_toml(folder / "run.toml")["recording"][0]
    if entry["ended"] not in (("complete",) if ended == "complete" and not world.disk else ("complete", "early")):
        yield f"run.toml says {entry['ended']}, it ended {ended}"
    if ended != "complete" and entry["ended"] == "complete":
        yield "run.toml says complete"
    for name in ("pass1.csv", "pass1.log"):
        if done and not whole[name].endswith(b"\n"):
            yield f"{name} ends within a line"
    if done and "sha256" in entry:
        for name, stated in entry["sha256"].items():
            if files.sha256(folder / name) != stated:
                yield f"{name} is not what run.toml says"
    kept = np.concatenate(world.kept) if world.kept else np.empty((0, CHANNELS))
    try:
        counts = read_counts(folder / "pass1.csv", torn=True)
    except LMeasureError as error:
        if len(kept):
            yield f"unreadable: {error}"
        return
    if len(counts.time_s) < len(kept):
        yield f"{len(kept) - len(counts.time_s)} samples were shown and are not in the file"
    same = (counts.recorded[: len(kept)] == kept[: len(counts.time_s)]) | np.isnan(counts.recorded[: len(kept)])
    if not same.all():
        yield "samples are not as they were shown"
    yield from _true(world, counts.time_s, counts.recorded, ended == "complete" and not world.disk)
    yield from _again(world, rig, folder, counts.time_s, counts.recorded, done)


def _true(world: World, time_s: FloatArray, recorded: FloatArray, complete: bool) -> Iterator[str]:
    """Compare each count with the truth by the number of the sample that channels 1 and 2 count."""
    rows = np.where(np.isnan(recorded[:, 0]), (recorded[:, 1] - 7) / 5, recorded[:, 0] / 3)
    known = np.isfinite(rows)
    if not np.array_equal(rows[known], np.rint(rows[known])) or (known.any() and not 0 <= rows[known].min() <= rows[known].max() < world.n):
        yield "counts that nobody sent"
        return
    if (np.diff(rows[known]) <= 0).any():
        yield "samples twice, or in another order"
    row = rows[known].astype(int)
    off = recorded[known] - world.truth[row]
    if "late" in world.faults and not complete:
        off[-1] = np.nan  # its frame may be that of the sample before
    off[row[:, None] >= world.first_lost] = np.where(np.isnan(off), np.nan, np.inf)[row[:, None] >= world.first_lost]
    if (np.abs(off) > 0).any():
        at = np.argwhere(np.abs(off) > 0)[0]
        yield f"channel {at[1] + 1}, sample {row[at[0]]}: a count off by {off[tuple(at)]}"
    if len(row):
        moved = (time_s[known] - time_s[known][0]) - (world.sent_s[row] - world.sent_s[row[0]])
        allowed = SURE_S if world.steps else 1e-3
        if np.abs(moved).max() > allowed:
            yield f"a time is off by {np.abs(moved).max():.3g} s"
    if complete and len(row):
        expected = np.flatnonzero(world.good[:, 0])
        doubtful = np.abs(world.sent_s[:, None] - (time_s[~known] - time_s[0] + world.sent_s[row[0]])[None, :]) < 0.5 * world.period_s
        if missing := np.setdiff1d(expected, [*row, *np.flatnonzero(doubtful.any(axis=1))]).tolist():
            yield f"{len(missing)} whole samples are not there, the first {missing[0]}"
        if not world.faults and np.isnan(recorded).any():
            yield "empty cells without a fault"
        lost = {"encoder starts again", "lost", "silent channel", "bus off", "late", "pause", "another sender"}
        if not lost & set(world.faults) and np.isnan(recorded).any():
            yield f"empty cells with {world.faults}"
        empty = int((np.isnan(recorded[known]) & world.good[row]).sum())
        if set(world.faults) <= {"lost", "late", "doubled", "junk", "slow disk", "another sender"} and empty:
            yield f"{empty} empty cells though their frames came"


def _again(world: World, rig: Rig, folder: Path, time_s: FloatArray, recorded: FloatArray, done: bool) -> Iterator[str]:
    """Import the frames that were kept: they give the same counts."""
    try:
        imported = import_logs([folder / "pass1.log"], rig, None).run.passes[0]
    except LMeasureError as error:
        if not np.isnan(recorded).all(axis=0).any():  # an import refuses a channel without a count
            yield f"the log cannot be imported: {error}"
        return
    again = imported.recorded
    if len(again) < len(recorded) or (done and not world.disk and len(again) != len(recorded)):
        yield f"the log gives {len(again)} samples, the recording {len(recorded)}"
    n = min(len(again), len(recorded))
    if not world.disk and not world.faults and n and np.abs(imported.time_s[:n] - time_s[:n]).max() > 2e-6:
        yield "the log gives other times"
    differ = ~((again[:n] == recorded[:n]) | (np.isnan(again[:n]) & np.isnan(recorded[:n])))
    if world.disk or world.faults:  # the end is another, and so is what it shows of earlier samples
        differ &= ~np.isnan(again[:n]) & ~np.isnan(recorded[:n])
    if differ.any():
        yield f"the log gives other counts at {np.argwhere(differ)[0].tolist()}"
    if done:
        run: Run = read_run(folder)
        if len(run.passes[0].time_s) != len(recorded):
            yield "the run cannot be read as it was written"
