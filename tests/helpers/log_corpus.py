"""Logs for the tests, written by python-can, and what python-can's own readers make of a log."""

import itertools
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import can
import numpy as np

FD_LENGTHS = (0, 1, 7, 8, 12, 16, 20, 24, 32, 48, 64)
START = 1_700_000_000.25

Row = tuple[float, int, bool, bool, bool, bool, bool, bool, bool, int, bytes, str]


def messages(count: int, seed: int, *, fd: bool = True, channels: tuple[int | str, ...] = (0, 1, 5)) -> list[can.Message]:
    """Random traffic of every kind: 11 and 29 bits, data, remote and error frames, FD, received and sent, several channels."""
    rng = np.random.default_rng(seed)
    time = START
    out = []
    for _ in range(count):
        time += float(rng.integers(0, 2_000_000)) * 1e-6
        extended = bool(rng.integers(2))
        kind = rng.choice(["data", "remote", "error", "fd"], p=[0.7, 0.1, 0.05, 0.15])
        common: dict[str, Any] = {
            "timestamp": round(time, 6), "channel": channels[int(rng.integers(len(channels)))],
            "arbitration_id": int(rng.integers(2**29 if extended else 2**11)), "is_extended_id": extended, "is_rx": bool(rng.integers(2)),
        }  # fmt: skip
        if kind == "remote":
            out.append(can.Message(**common, is_remote_frame=True, dlc=int(rng.integers(9))))
        elif kind == "error":
            out.append(can.Message(**{**common, "is_rx": True}, is_error_frame=True, dlc=0))
        elif kind == "fd" and fd:
            length = FD_LENGTHS[int(rng.integers(1, len(FD_LENGTHS)))]
            switches: dict[str, Any] = {"bitrate_switch": bool(rng.integers(2)), "error_state_indicator": bool(rng.integers(2))}
            out.append(can.Message(**common, **switches, is_fd=True, data=rng.bytes(length)))
        else:
            out.append(can.Message(**common, data=rng.bytes(int(rng.integers(9)))))
    return out


def write(path: Path, log: list[can.Message], **options: Any) -> Path:
    """The log as python-can's writer for the suffix writes it."""
    with can.Logger(str(path), **options) as writer:
        for message in log:
            writer(message)
    return path


def rows(log: Iterable[can.Message]) -> list[Row]:
    """Every field of the messages that carries a fact; the length is that of the data, of a remote frame the bytes asked for."""
    return [
        (
            m.timestamp, m.arbitration_id, m.is_extended_id, m.is_remote_frame, m.is_error_frame, m.is_fd, m.bitrate_switch,
            m.error_state_indicator, m.is_rx, m.dlc if m.is_remote_frame else len(m.data), bytes(m.data),
            "0" if m.channel is None else str(m.channel),
        )
        for m in log
    ]  # fmt: skip


def library_rows(path: Path, limit: int = 10**9) -> tuple[list[Row], bool]:
    """What python-can's reader yields, and whether it came to the end without an exception."""
    found: list[can.Message] = []
    try:
        reader = can.LogReader(path, relative_timestamp=False) if path.suffix == ".asc" else can.LogReader(path)
        with reader:
            for message in itertools.islice(reader, limit):
                found.append(message)
    except Exception:
        return rows(found), False
    return rows(found), True
