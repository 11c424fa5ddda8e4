"""Logs that are longer than memory: counts in a file of their own, and stalls that are found piece by piece."""

import errno
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from log_corpus import write
from log_fuzz import START_POSE, counter_log, six_cables

from lmeasure.acquisition import import_logs, write_import
from lmeasure.acquisition.bus import frames
from lmeasure.acquisition.counters.events import EventLog
from lmeasure.acquisition.counters.stalls import STALL_OTHERS_MM, STALL_S, Stalls, mark_stalls
from lmeasure.acquisition.logs import kept_counts
from lmeasure.core import LMeasureError
from lmeasure.recording import Counts


def faulty_log(path: Path) -> Path:
    """A log with a stuck counter, a gap and an interruption."""
    log = counter_log(2200, 14)
    stuck = [m for m in log[800:] if m.arbitration_id == 0x183 and len(m.data) == 4 and not m.is_extended_id]
    for m in stuck:
        m.data = stuck[0].data
    for m in log[16000:]:
        m.timestamp += 700.0
    return write(path, [m for i, m in enumerate(log) if i != 5000])


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_counts_in_a_file_are_those_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str) -> None:
    path, found = faulty_log(tmp_path / "drive.blf"), []
    monkeypatch.setattr(frames, "PIECE_FRAMES", 500)
    for most in (1 << 20, 100):
        monkeypatch.setattr(kept_counts, "KEPT_SAMPLES", most)
        imported = import_logs([path], six_cables(), START_POSE)
        write_import(tmp_path / str(most), imported, suffix)
        found.append(imported)
    memory, filed = found
    assert filed.summary() == memory.summary()
    assert "two recordings" in filed.summary()
    assert memory.logs[0].events.tally["stall"] >= 1
    for one, other in zip(memory.run.passes, filed.run.passes, strict=True):
        assert np.array_equal(one.time_s, other.time_s)
        assert np.array_equal(one.recorded, other.recorded, equal_nan=True)
    assert len(list(filed.logs[0].pieces())) > 10
    names = ["rig.toml", "run.toml", "pass1.events.csv", *(["pass1.csv"] if suffix == ".csv" else [])]
    assert [(tmp_path / "100" / name).read_bytes() for name in names] == [(tmp_path / f"{1 << 20}" / name).read_bytes() for name in names]


def test_a_full_temporary_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(kept_counts, "KEPT_SAMPLES", 100)
    monkeypatch.setattr("pickle.dump", full)
    with pytest.raises(LMeasureError, match="cannot be written"):
        import_logs([write(tmp_path / "drive.blf", counter_log(300, 1))], six_cables(), None)


def expected_stalls(counts: Counts, mm: float) -> list[tuple[int, int, int]]:
    """Channel, first sample without a good count, and last, by the whole run at once."""
    way = np.cumsum(np.nan_to_num(np.abs(np.diff(counts.recorded, axis=0, prepend=counts.recorded[:1]))) * mm, axis=0)
    out = []
    for j, column in enumerate(counts.recorded.T):
        there = np.flatnonzero(~np.isnan(column))
        for rows in np.split(there, np.flatnonzero(np.diff(column[there]) != 0) + 1):
            others = np.median(np.delete(way - way[rows[0]], j, axis=1), axis=1)
            if counts.time_s[rows[-1]] - counts.time_s[rows[0]] >= STALL_S and others[rows[-1]] >= STALL_OTHERS_MM:
                out.append((j, int(rows[0] + np.argmax(others[rows[0] :] > 0)), int(rows[-1])))
    return out


@pytest.mark.parametrize("seed", range(8))
def test_stalls_are_found_wherever_pieces_end(seed: int) -> None:
    rng, n = np.random.default_rng(seed), 4000
    moves = rng.integers(-30, 31, (n, 6))
    for _ in range(6):  # all stand, and one is stuck
        standing, stuck = (int(rng.integers(0, n - most)) for most in (300, 900))
        moves[standing : standing + rng.integers(50, 300)] = 0
        moves[stuck : stuck + rng.integers(60, 900), rng.integers(6)] = 0
    recorded = np.cumsum(moves, axis=0).astype(np.float64)
    recorded[rng.random(recorded.shape) < 0.02] = np.nan
    recorded[rng.integers(0, n - 200) :][:150] = np.nan
    rig = six_cables()
    counts = Counts(np.arange(n) / 100.0, tuple(c.channel for c in rig.cable), recorded)
    expected = expected_stalls(counts, rig.drums_of(1)["ch1"].count_length_mm)
    assert expected
    for cuts in ([], sorted(rng.choice(np.arange(1, n), 7, replace=False).tolist()), list(range(1, n, 37))):
        search = Stalls(rig, counts.channels)
        for first, last in zip([0, *cuts], [*cuts, n], strict=True):
            search.add(replace(counts, time_s=counts.time_s[first:last], recorded=recorded[first:last], first=first))
        assert [(one.channel, one.begin, one.last) for one in search.found()] == expected
    events = EventLog()
    marked = mark_stalls(rig, counts, events)
    assert marked is not None
    assert events.tally["stall"] == len(expected)
    wanted = recorded.copy()
    for j, begin, last in expected:
        wanted[begin : last + 1, j] = np.nan
    assert np.array_equal(marked.recorded, wanted, equal_nan=True)
