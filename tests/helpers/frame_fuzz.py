"""Mutated frames into the whole way from a bus to counts: whatever comes, it is counted or refused, and nothing grows without bound."""

import dataclasses

import numpy as np
from rigged_feed import cell, frames_of, motion

from lmeasure.acquisition import Frames, counter_fields
from lmeasure.acquisition.bus.frames import TimestampSource, messages_from_frames
from lmeasure.acquisition.counters.assembly import new_assembler
from lmeasure.acquisition.counters.events import EVENTS_KEPT
from lmeasure.acquisition.recorder import candump_lines, count_lines
from lmeasure.rig import rig_from_dict

RIGS = {
    "sync": cell(),
    "free": rig_from_dict(
        cell().to_dict()
        | {
            "can": {
                "decoder": "raw",
                "timing": "free",
                "channel": [{"channel": f"ch{i}", "id": 0x180 + i, "bits": 16} for i in range(1, 7)],
            }
        }
    ),
    "start input": rig_from_dict(
        cell().to_dict()
        | {
            "can": {
                "decoder": "raw",
                "start_input": {"id": 0x181, "byte_offset": 7},
                "channel": [{"channel": f"ch{i}", "id": 0x180 + i, "range": 40000} for i in range(1, 7)],
            }
        }
    ),
}


def mutated(frames: Frames, rng: np.random.Generator) -> Frames:
    """A tenth of the frames changed: identifier, flags, length, data, time, order; some dropped and doubled."""
    n = len(frames)

    def some(share: float) -> np.ndarray:
        return rng.random(n) < share

    identifier, flags, length, data, time_s = (
        frames.identifier.copy(), frames.flags.copy(), frames.length.copy(), frames.data.copy(), frames.time_s.copy(),
    )  # fmt: skip
    hit = some(0.02)
    identifier[hit] = rng.integers(0, 2**11, hit.sum())
    hit = some(0.02)
    identifier[hit] ^= (1 << rng.integers(0, 11, hit.sum())).astype(np.uint32)
    hit = some(0.02)
    flags[hit] = rng.integers(0, 128, hit.sum())
    hit = some(0.02)
    length[hit] = rng.integers(0, 9, hit.sum())
    hit = some(0.03)
    data[hit] = rng.integers(0, 256, (hit.sum(), data.shape[1]))
    hit = some(0.01)
    time_s[hit] += rng.choice([-1e3, -1.0, -1e-3, 1e-3, 1.0, 1e3], hit.sum())
    out = dataclasses.replace(frames, identifier=identifier, flags=flags, length=length, data=data, time_s=time_s)
    order = np.repeat(np.arange(n), rng.choice([0, 1, 2], n, p=[0.02, 0.96, 0.02]))
    swap = np.flatnonzero(rng.random(len(order) - 1) < 0.02)
    order[swap], order[swap + 1] = order[swap + 1].copy(), order[swap].copy()
    sources: tuple[TimestampSource, ...] = ("host", "kernel", "log")
    return dataclasses.replace(out.take(order), timestamp_source=sources[rng.integers(3)])


def fuzz(frames_wanted: int, seed: int) -> dict[str, int]:
    """Push that many mutated frames through every rig's assembler and the recorder's lines; how many frames, samples and faults."""
    rng = np.random.default_rng(seed)
    sent, samples, faults = 0, 0, 0
    while sent < frames_wanted:
        for rig in RIGS.values():
            assembler = new_assembler(rig, counter_fields(rig))
            good = frames_of(RIGS["sync"], motion(RIGS["sync"]))
            frames = mutated(good, rng)
            last = -np.inf
            for a in range(0, len(frames), 500):
                piece = frames.take(slice(a, a + 500))
                candump_lines(piece)
                given = assembler.feed(piece, last=a + 500 >= len(frames))
                count_lines(given, 0.0)
                assert given.recorded.shape == (len(given.time_s), 6)
                if len(given.time_s):
                    assert (np.diff(given.time_s, prepend=last) > 0).all()
                    last = float(given.time_s[-1])
                samples += len(given.time_s)
            for message in messages_from_frames(frames.take(slice(0, 20))):
                assert message.dlc <= 64
            assert all(n <= EVENTS_KEPT or n for n in assembler.events.tally.values())
            assert len(assembler.events.kept) <= EVENTS_KEPT * len(assembler.events.tally)
            faults += sum(assembler.events.tally.values())
            sent += len(frames)
    return {"frames": sent, "samples": samples, "faults": faults}
