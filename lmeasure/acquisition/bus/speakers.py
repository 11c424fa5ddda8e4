"""Who speaks on a bus, as it comes: identifiers, rates, and which of their bytes move."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from lmeasure.acquisition.bus.frames import ERROR
from lmeasure.acquisition.bus.sources import Source
from lmeasure.acquisition.logs.scan_log import Heard, Scan, Seen
from lmeasure.core import AcquisitionError
from lmeasure.text import message

LOOK_S = 0.1
LIT_S = 0.6
"""How long a byte that has moved is shown as moving."""
Key = tuple[str, int, bool]


@dataclass(frozen=True)
class Spoken:
    """An identifier by now: how often it came, frames a second, its last bytes, and which of them have moved just now."""

    name: str
    frames: int
    rate_hz: float
    data: bytes
    lit: tuple[bool, ...]


class _Lights:
    """Of each byte of each identifier, when it moved last."""

    def __init__(self) -> None:
        self._before: dict[Key, bytes] = {}
        self._moved_at: dict[Key, list[float]] = {}

    def of(self, key: Key, seen: Seen, now: float) -> Spoken:
        """The identifier by now."""
        data, before = seen.newest, self._before.get(key, seen.newest)
        at = self._moved_at.setdefault(key, [])
        at += [-LIT_S] * (len(data) - len(at))
        for i, (a, b) in enumerate(zip(data, before, strict=False)):
            if a != b:
                at[i] = now
        self._before[key] = data
        name = f"{key[1]:08X}x" if key[2] else f"{key[1]:03X}"
        return Spoken(name, seen.count, seen.rate_hz, data, tuple(now - at[i] < LIT_S for i in range(len(data))))


def listen(
    source: Source,
    seconds: float,
    *,
    show: Callable[[float, tuple[Spoken, ...]], None] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Scan:
    """Listen for so long, or until `stop` says so; nothing is sent. show gets it all the while: seconds, and who has spoken.

    AcquisitionError where nothing comes, and where what comes cannot be read.
    """
    heard, lights, errors = Heard(), _Lights(), 0
    begin = time.monotonic()
    while (now := time.monotonic() - begin) < seconds and not stop():
        frames = source.receive(LOOK_S)
        if frames is None:
            break
        errors += int(((frames.flags & ERROR) != 0).sum())
        heard.add(frames)
        if show is not None:
            show(now, tuple(lights.of(key, heard.found[key], now) for key in sorted(heard.found)))
    if not heard.found:
        why = f"{errors} error frames and none that can be read: another bit rate, or a line without its terminating resistors"
        silent = "no frame at all: nothing is connected or switched on, nobody sends the SYNC, or another bit rate is set"
        raise AcquisitionError(f"{source.name}: {why if errors else silent}")
    notes = (message("acquisition.error_frames", count=errors),) if errors else ()
    return heard.scan(Path(source.name), message("acquisition.bus"), notes)
