"""A simulated robot that goes through poses while six drums count, on a real bus or sample by sample, and whatever may happen to them."""

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can
import numpy as np

from lmeasure.acquisition import Event, Samples, counter_fields
from lmeasure.acquisition.bus.feed import frames_from_counts, send
from lmeasure.core import FloatArray
from lmeasure.io import write_table
from lmeasure.procedures import Session, Settings, open_folder
from lmeasure.recording import pose_columns, poses_from_rows
from lmeasure.rig import Rig, read_rig, rig_from_dict, write_rig
from lmeasure.simulation import Leg, campaign_at, cell_rig, scattered_poses, simulate_run, smooth_path

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
RATE_HZ = 200.0


def true_rig(cables: int = 6) -> Rig:
    """The simulated cell with some of its cables, which no hurry of this robot is too fast for."""
    data = cell_rig(3).to_dict()
    for point in data["observation_point"]:
        point["drum"]["max_cable_speed_mm_s"] = 1e6
    data["observation_point"], data["cable"] = data["observation_point"][:cables], data["cable"][:cables]
    return rig_from_dict(data)


def nominal_of(rig: Rig, seed: int = 0) -> Rig:
    """As a tape measures it: points up to 20 mm off, guides up to 3 degrees."""
    return campaign_at(rig, HOME[None], np.random.default_rng(seed), nominal_shift_mm=20.0, nominal_shift_deg=3.0).nominal


def some_poses(count: int, seed: int = 1) -> FloatArray:
    """(count, 7) poses well apart."""
    return scattered_poses(count, (250.0, 250.0, 250.0), 0.3, HOME, rng=np.random.default_rng(seed))


def write_inputs(folder: Path, rig: Rig, poses: FloatArray, **columns: Any) -> tuple[Path, Path]:
    """rig.toml and planned.csv of a person who begins."""
    write_rig(folder / "rig.toml", rig)
    planned = pose_columns(poses_from_rows(poses))
    for name in ("u_position_mm", "u_rotation_deg"):
        planned.pop(name)
    write_table(folder / "planned.csv", planned | columns)
    return folder / "rig.toml", folder / "planned.csv"


def motion(rig: Rig, poses: FloatArray, dwell_s: float, zero: FloatArray | None = None, speed_mm_s: float = 4000.0) -> Samples:
    """Recorded counts along a motion that rests at each of the poses, counted from a zero pose (7,), else from the first of them."""
    legs = [Leg(pose, speed_mm_s, 10.0, dwell_s) for pose in poses]
    time_s, rows = smooth_path(poses[0], legs, RATE_HZ)
    every = np.vstack([rows[0] if zero is None else zero, rows])
    run = simulate_run(rig, np.arange(len(every)) / RATE_HZ, every, noise_mm=0.0, rng=np.random.default_rng(2)).run
    return Samples(time_s, run.passes[0].recorded[1:])


def joined(parts: Sequence[Samples]) -> Samples:
    """One after the other in time."""
    times, begin = [], 0.0
    for part in parts:
        times.append(part.time_s - part.time_s[0] + begin)
        begin = float(times[-1][-1]) + 1.0 / RATE_HZ
    return Samples(np.concatenate(times), np.vstack([part.recorded for part in parts]))


@contextmanager
def on_bus(rig: Rig, counts: FloatArray, bus: dict[str, Any], begin: threading.Event | None = None) -> Iterator[None]:
    """Encoders that send the counts at `RATE_HZ`, once `begin` is set, the first before and the last ever after."""
    fields, done = counter_fields(rig), threading.Event()

    def run() -> None:
        with can.Bus(**bus) as sender:
            k, start = 0, time.perf_counter()
            while not done.is_set():
                if begin is None or begin.is_set():
                    k += 1
                row = counts[min(k, len(counts) - 1)][None]
                send(frames_from_counts(np.zeros(1), row, fields, rig.can_table.sync_id), sender, paced=False)
                start += 1.0 / RATE_HZ
                time.sleep(max(start - time.perf_counter(), 0.0))

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


RIG = true_rig(2)
POSES = some_poses(8)
QUICK = Settings("rest", dwell_s=0.1, settle_s=0.05)


def going(poses: FloatArray, dwell_s: float) -> Samples:
    """The robot on its way through poses, counted from the first of `POSES`."""
    return motion(RIG, poses, dwell_s, zero=POSES[0])


class Bench:
    """A session in a folder, what it said, and the robot before it."""

    def __init__(self, folder: Path, settings: Settings = QUICK, **columns: Any) -> None:
        self.folder, self.said, self._clock = folder, list[str](), 0.0
        if not (folder / "rig.toml").exists():
            write_inputs(folder, nominal_of(RIG), POSES, **columns)
        self.begin(settings)

    def begin(self, settings: Settings = QUICK) -> None:
        rig = read_rig(self.folder / "rig.toml")
        self.out = open_folder(self.folder / "cal", rig, rig.channels, 1, planned=self.folder / "planned.csv", beside={})
        self.events: list[Event] = []
        self.session = Session(self.out, settings, self.said.append)

    def show(self, samples: Samples, piece: int = 7) -> None:
        """The samples, some at a time as a bus gives them, on one clock."""
        time_s = samples.time_s - samples.time_s[0] + self._clock
        self._clock = float(time_s[-1]) + 1.0 / RATE_HZ
        for i in range(0, len(time_s), piece):
            self.session.feed(Samples(time_s[i : i + piece], samples.recorded[i : i + piece]))
            self.session.look(self.events)

    def at(self, pose: int, seconds: float = 0.3, off: FloatArray | float = 0.0) -> Samples:
        """The robot at rest at one of the poses."""
        recorded = going(POSES[[0, pose]], 0.0).recorded[-1]
        n = int(seconds * RATE_HZ)
        return Samples(np.arange(n) / RATE_HZ, np.tile(recorded + off, (n, 1)))

    def heard(self, text: str) -> bool:
        return any(text in line for line in self.said)

    @property
    def read(self) -> list[str]:
        return [r.pose for r in self.out.readings]
