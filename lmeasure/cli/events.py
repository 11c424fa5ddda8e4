"""Events of a working command for another program: a line of JSON on standard error for everything that a user would see.

LMEASURE_EVENTS=1 in the environment switches them on, beside `--json`, whose document stays alone on standard output. Each line has
`event`: progress (fraction, text), said (text), state (text), asked (text, number, of), live (a recording, its pose), compiling (text).
Such a command reads its answers on standard input. At the end of standard input it ends as by Ctrl-C and keeps the recording
(docs/command-line.md). The document has `shown` beside `summary`: its lines in the user's language.
"""

import contextlib
import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from lmeasure.cli.text import rendered, word
from lmeasure.text import count_of, of_terminal, texts

if TYPE_CHECKING:
    from lmeasure.acquisition import LiveIdentifier, Moved, Progress as State
    from lmeasure.demo import PlayedCell
    from lmeasure.procedures import Session
    from lmeasure.trajectory import PoseWatch

VARIABLE = "LMEASURE_EVENTS"
REFRESH_S = 0.05
ANSWERED = ("check", "capture", "play")
"""Commands that read standard input themselves."""


def enabled() -> bool:
    """Return whether another program listens."""
    return os.environ.get(VARIABLE) == "1"


def tell(event: str, **values: Any) -> None:
    """Write one line; a reader that has gone is no fault of the work."""
    with contextlib.suppress(OSError, ValueError):
        print(json.dumps({"event": event, **values}, ensure_ascii=False, allow_nan=False), file=sys.stderr, flush=True)


class Paced:
    """Report one kind of event, twenty times a second at most, and never leaves out a new text."""

    def __init__(self, event: str) -> None:
        self._event, self._text, self._last = event, "", -math.inf

    def due(self) -> bool:
        return time.monotonic() - self._last >= REFRESH_S

    def __call__(self, text: str, **values: Any) -> None:
        now = time.monotonic()
        if (text != self._text and self._event != "state") or now - self._last >= REFRESH_S:
            self._text, self._last = text, now
            tell(self._event, text=rendered(text), **values)


def progress(label: str) -> Any:
    """Return a `Progress` that writes events."""
    paced = Paced("progress")
    return lambda fraction, text: paced(text or label, fraction=round(float(fraction), 4))


@contextmanager
def tied(command: str) -> Iterator[None]:
    """While the work is done: it ends as by Ctrl-C when standard input does."""
    if enabled() and command not in ANSWERED and sys.stdin is not None:
        threading.Thread(target=_end_with_input, daemon=True).start()
    yield


def _end_with_input() -> None:
    with contextlib.suppress(OSError, ValueError):
        for _ in sys.stdin:
            pass
    if os.name == "nt":
        signal.raise_signal(signal.SIGINT)
    else:
        os.kill(os.getpid(), signal.SIGINT)  # also wakes a thread that waits for a bus


def live(state: "State", pose: "PoseWatch | str") -> None:
    """The state of a recording: rates per channel, faults, and the pose of the last sample or why there is none."""
    global _shown
    if time.monotonic() - _shown < REFRESH_S:
        return
    _shown = time.monotonic()
    from lmeasure.cli.live import stale

    rows = zip(state.channels, state.counts, state.rates, state.speeds_mm_s, strict=True)
    tell(
        "live",
        seconds=state.seconds,
        samples=state.samples,
        frames=state.frames,
        faults=dict(state.faults),
        faults_shown=", ".join(rendered(count_of(kind, n)) for kind, n in sorted(state.faults.items())).replace("_", " "),
        latency_s=_number(state.latency_s),
        newest_s=_number(state.newest_s),
        lost=state.lost,
        disk_free=state.disk_free,
        channels=[{"name": n, "count": _number(c), "counts_s": _number(r), "mm_s": _number(v)} for n, c, r, v in rows],
        pose={"status": "", "shown": word("acquisition.no_counts"), "text": ""} if stale(state) else _pose(pose),
    )


_shown = -math.inf


def _pose(watch: "PoseWatch | str") -> dict[str, Any]:
    if isinstance(watch, str):
        return {"status": "", "shown": "", "text": rendered(watch)}
    from lmeasure.cli.live import curve_values, u95_mm

    latest = watch.latest
    if latest is None:
        return {"status": "", "shown": "", "text": ""}
    if latest.status != "ok":
        return {"status": latest.status, "shown": _status(latest.status), "text": rendered(watch.why)}
    return {
        "status": "ok",
        "shown": "",
        "u95_mm": u95_mm(watch),
        "position_mm": [float(v) for v in latest.pose[:3]],
        "angles": watch.angles(),
        "quaternion_xyzw": [float(v) for v in latest.pose[3:]],
        "worst_pressure_angle_deg": _number(latest.worst_pressure_angle_deg),
        "curve": curve_values(watch),
        "text": "",
    }


def _status(name: str) -> str:
    """Return the status of a sample without a pose, in the user's language."""
    return texts(of_terminal(), "trajectory").get(f"status.{name}", word("cli.start_unknown"))


def captured(session: "Session") -> None:
    """Report the state of a capture: the wanted pose, the readings, and their quality."""
    from lmeasure.procedures import state_of

    if _captured.due():
        state = state_of(session)
        _captured("", **state | {"doubted": rendered(state["doubted"])})


_captured = Paced("capture")


def spoken(seconds: float, lines: "tuple[LiveIdentifier, ...]") -> None:
    """Report the senders on a bus."""
    reported = [{"name": o.name, "frames": o.frames, "rate_hz": o.rate_hz, "data": o.data.hex(" "), "lit": o.lit} for o in lines]
    _spoken("", seconds=seconds, lines=reported)


_spoken = Paced("scan")


def moved(channels: "tuple[Moved, ...]") -> None:
    """Write how far each channel has moved since a step of the self-test began."""
    _moved("", channels=[asdict(one) for one in channels])


_moved = Paced("moved")


def played(cell: "PlayedCell") -> None:
    """Report a simulated cell: its robot's present or next pose, whether it still moves, and that pose as commanded."""
    _played("", at=cell.at, moves=cell.moves, pose=cell.stands_at(), cables=cell.cables, out=cell.out, poses=cell.poses)


_played = Paced("cell")


def _number(value: Any) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
