"""Sources of frames, all alike: open, receive for a while, close.

`open_source` takes the text after `--bus`: INTERFACE:CHANNEL for any interface of python-can, `replay:FILE` for a log, in its own time, and
`simulated:SCENARIO` for the simulated cell.

python-can's udp_multicast is kept to its own group: python-can 4.6 binds its sockets to every address: a socket then gets the traffic of
every group that any socket of this machine has joined on that port. Two recordings on two groups would hear each other.
"""

import contextlib
import logging
import os
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from lmeasure.acquisition.bus.feed import frames_from_counts, send, virtual_place
from lmeasure.acquisition.bus.frames import Frames, TimestampSource, frames_from_messages, no_frames
from lmeasure.acquisition.counters.clock import MODULI_S
from lmeasure.acquisition.logs.read import log_batches
from lmeasure.acquisition.logs.report import LogReport
from lmeasure.core import AcquisitionError, LMeasureError
from lmeasure.text import message

if TYPE_CHECKING:
    import can

import struct
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import can


def bind_to_group(bus: "can.BusABC") -> None:
    """Exchange the bus's socket for one that is bound to its group; where the system cannot (Windows), it stays as it is."""
    link: Any = getattr(bus, "_multicast", None)
    old = getattr(link, "_socket", None)
    if not isinstance(old, socket.socket):
        return
    own = socket.socket(old.family, socket.SOCK_DGRAM)
    try:
        own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if hasattr(socket, "SO_REUSEPORT"):
            own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        if link.timestamp_nanosecond:
            from can.interfaces.udp_multicast.bus import SO_TIMESTAMPNS

            own.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        own.bind((link.group, link.port))
        group = socket.inet_pton(old.family, link.group)
        if old.family == socket.AF_INET:
            own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, struct.pack("@I", link.hop_limit))
            own.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group + struct.pack("@I", socket.INADDR_ANY))
        else:
            own.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, struct.pack("@I", link.hop_limit))
            own.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, group + struct.pack("@I", 0))
    except OSError:
        own.close()
        return
    link._socket = own
    with contextlib.suppress(OSError):
        old.close()


def is_garbled(error: Exception) -> bool:
    """Return whether the bus is whole and only the datagram was no frame: anyone may send anything to a group."""
    return "could not unpack received message" in str(error)


MOST_AT_ONCE = 4096
MOST_WAITING = 200_000
"""Frames that wait to be taken: half a minute of six encoders at 1 kHz, a hundred megabytes."""
RECEIVE_BUFFER = 1 << 23
HARDWARE_CLOCKS = ("vector", "pcan", "kvaser", "ixxat", "canalystii", "systec", "etas", "nican", "nixnet", "neovi")
"""Interfaces of python-can whose devices stamp frames by their own clock."""
SOCKETCAN_ERRORS = ("socketcan", "socketcand", "gs_usb", "virtual", "udp_multicast", "simulated")
"""Interfaces of python-can whose error frames have the classes and data of SocketCAN; others have codes of their own, or none."""
KERNEL_CLOCKS = ("socketcan", "socketcand", "udp_multicast")
SMALLEST_STEP_S = 0.05
"""Smallest step [s] of a clock that was set; the latency of a busy host is shorter."""
REOPEN_EVERY_S = 0.2


@dataclass(frozen=True)
class Notice:
    """Event of a source: its kind, its text, when by the frames' clock [s] (this moment if None), frames lost."""

    kind: str
    text: str
    time_s: float | None = None
    lost: int = 0


class Source(Protocol):
    """Source of frames."""

    name: str
    timestamp_source: TimestampSource
    bit_rate: int | None

    @property
    def behind_s(self) -> float:
        """Return how long the oldest frame that was not taken yet has waited [s]."""

    def receive(self, timeout_s: float) -> Frames | None:
        """Frames that came within the time, perhaps none; None when there will be no more. AcquisitionError when the source is lost."""

    def notices(self) -> list[Notice]:
        """Return the events of the source since the last question."""

    def close(self) -> None:
        """Let go of it; a second time does nothing."""


class BusSource:
    """A bus of python-can, emptied by a thread of its own, so that a busy disk or screen costs no frame.

    Where frames are not taken for so long that MOST_WAITING wait, those that come are dropped until there is room, and counted.
    A bus that fails is opened again for up to patience_s. Where the clock that stamps the frames is set while frames come, their times are
    brought back to this program's steady clock: a stamp is never later than the arrival, so the step is how far the best stamps moved.
    """

    def __init__(self, open_bus: Callable[[], "can.BusABC"], name: str, bit_rate: int | None = None, patience_s: float = 30.0) -> None:
        interface = name.split(":", 1)[0]
        self.name, self.bit_rate = name, bit_rate
        self.timestamp_source: TimestampSource = (
            "hardware" if interface in HARDWARE_CLOCKS else "kernel" if interface in KERNEL_CLOCKS else "host"
        )
        self._classes = interface in SOCKETCAN_ERRORS
        self._open, self._patience_s = open_bus, patience_s
        self.bus = self._opened()
        self._arrived: deque[_Arrival] = deque()
        self._notices: deque[Notice] = deque()
        self._lost: AcquisitionError | None = None
        self._garbled = 0
        self._clock = SteadyClock()
        self._done = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _opened(self) -> "can.BusABC":
        try:
            bus = self._open()
        except LMeasureError:
            raise
        except Exception as error:  # each driver reports a missing device by another exception
            # python-can calls functions of a driver's library that it has not found: Kvaser's
            reported = " ".join(str(error).split()) or type(error).__name__
            if isinstance(error, NameError):
                reported = message("bus.no_driver")
            raise AcquisitionError(message("error.cannot_be_opened_lmeasure", where=self.name, reported=reported)) from error
        _enlarge_buffer(bus)
        return bus

    def _read(self) -> None:
        from lmeasure.acquisition.bus.python_can import can

        lost = 0
        while not self._done.is_set():
            try:
                message = self.bus.recv(0.1)
                if len(self._arrived) >= MOST_WAITING:
                    lost += message is not None
                elif message is not None or lost:
                    self._arrived.append((message, time.monotonic(), lost))
                    lost = 0
            except (can.CanError, OSError, ValueError, TypeError) as error:
                if is_garbled(error):
                    self._garbled += 1
                    continue
                try:
                    self._reopen(error)
                except AcquisitionError as gone:
                    self._lost = gone
                    return

    def receive(self, timeout_s: float) -> Frames | None:
        end = time.monotonic() + timeout_s
        while len(self._arrived) < MOST_AT_ONCE and time.monotonic() < end and not self._done.is_set():
            time.sleep(min(max(end - time.monotonic(), 0.0), 0.02))
        count = len(self._arrived)
        if self._garbled:
            garbled, self._garbled = self._garbled, 0
            self._notices.append(Notice("unread", message("bus.garbled", count=garbled, bus=self.name)))
        if count == 0:
            if self._lost is not None:
                raise self._lost
            return None if self._done.is_set() else no_frames(self.name, self.timestamp_source)
        arrived = [self._arrived.popleft() for _ in range(count)]
        taken = [(one, at) for one, at, _ in arrived if one is not None]
        frames = frames_from_messages((one for one, _ in taken), self.timestamp_source, self.name, classes=self._classes)
        step = self._clock.correct(frames.time_s, np.array([at for _, at in taken]))
        if step:
            self._notices.append(Notice("clock_step", message("acquisition.clock_moved", bus=self.name, step=step)))
        row = 0
        for one, _, lost in arrived:
            if lost:
                behind = float(frames.time_s[row]) if row < len(frames) else None
                text = message("acquisition.frames_lost", lost=lost, waiting=MOST_WAITING)
                self._notices.append(Notice("overflow", text, behind, lost))
            row += one is not None
        return frames

    def _reopen(self, error: Exception) -> None:
        """Wait for the bus to come back; AcquisitionError when it does not."""
        why = " ".join(str(error).split()) or type(error).__name__
        lost = time.monotonic()
        self._shut()
        while not self._done.is_set():
            try:
                self.bus = self._opened()
            except AcquisitionError as again:
                if time.monotonic() - lost > self._patience_s:
                    raise AcquisitionError(
                        message("error.lost_and_not_back", where=self.name, why=why, patience_s=self._patience_s, again=again)
                    ) from again
                self._done.wait(REOPEN_EVERY_S)
            else:
                text = message("acquisition.open_again", bus=self.name, why=why, seconds=time.monotonic() - lost)
                self._notices.append(Notice("bus_off", text))
                return

    @property
    def behind_s(self) -> float:
        with contextlib.suppress(IndexError):  # the thread that reads only adds
            return time.monotonic() - self._arrived[0][1]
        return 0.0

    def notices(self) -> list[Notice]:
        return [self._notices.popleft() for _ in range(len(self._notices))]

    def _shut(self) -> None:
        with contextlib.suppress(Exception):  # a bus that is already gone
            self.bus.shutdown()

    def close(self) -> None:
        self._done.set()
        self._reader.join()
        self._shut()


_Arrival = tuple["can.Message | None", float, int]
"""A message, when it was taken from the bus, and how many were dropped before it; no message where none came after those."""


def _enlarge_buffer(bus: "can.BusABC") -> None:
    """Let the kernel hold a second of frames for us where the bus is a socket, as far as it lets us."""
    try:
        number = os.dup(bus.fileno())
    except Exception:  # no descriptor behind this interface
        return
    try:
        with socket.socket(fileno=number) as end:
            for option in (getattr(socket, "SO_RCVBUFFORCE", 33), socket.SO_RCVBUF):
                with contextlib.suppress(OSError):
                    end.setsockopt(socket.SOL_SOCKET, option, RECEIVE_BUFFER)
                    return
    except OSError:  # a descriptor, but no socket
        os.close(number)


class SteadyClock:
    """Frame times compared with the host's monotonic clock."""

    MEMORY_S = 10.0

    def __init__(self) -> None:
        self._best: deque[tuple[float, float]] = deque()
        self._shift = 0.0
        self._last: float | None = None

    def correct(self, time_s: "np.ndarray[Any, np.dtype[np.float64]]", arrival_s: "np.ndarray[Any, np.dtype[np.float64]]") -> float:
        """Take steps of the frames' clock out of time_s (n,), in place; the sum of the steps found [s].

        arrival_s (n,) is when each frame was taken from the bus. The stamps lag the arrivals by an unknown constant and by a latency that
        is never negative: a leap to a lead above the best so far, or stamps that run backwards, mean that the clock was set.
        """
        time_s += self._shift
        total = 0.0
        while True:
            lead = time_s - arrival_s
            best = max((b for _, b in self._best), default=None)
            if best is None:
                break
            before = np.concatenate([[time_s[0] if self._last is None else self._last], time_s[:-1]])
            ahead = (lead > best + SMALLEST_STEP_S) & (time_s > before + SMALLEST_STEP_S)
            stepped = np.flatnonzero(ahead | (time_s < before - SMALLEST_STEP_S))
            if len(stepped) == 0:
                break
            i = int(stepped[0])
            step = float(lead[i:].max()) - best
            if abs(step) < SMALLEST_STEP_S:
                break
            # of a clock that started again the step is known exactly
            step = next((-modulus for modulus in MODULI_S if abs(step + modulus) < SMALLEST_STEP_S), step)
            time_s[i:] -= step
            self._shift -= step
            total += step
        if len(time_s):
            self._last = float(time_s[-1])
            self._best.append((float(arrival_s[-1]), float((time_s - arrival_s).max())))
            while arrival_s[-1] - self._best[0][0] > self.MEMORY_S:
                self._best.popleft()
        return total


class ReplaySource:
    """Log file as a source, in its own time or at the requested speed."""

    bit_rate: int | None = None
    behind_s: float = 0.0
    timestamp_source: TimestampSource = "log"

    def __init__(self, path: Path, *, paced: bool) -> None:
        self.name = f"replay:{path}"
        self._report = LogReport()
        self._batches: Iterator[Frames] | None = log_batches(path, self._report)
        self._paced = paced
        self._held = next(self._batches, no_frames())  # a log that cannot be read is refused here, before anything is written
        self._begin: float | None = None

    def receive(self, timeout_s: float) -> Frames | None:
        if len(self._held) == 0 and self._batches is not None:
            self._held = next(self._batches, no_frames())
        if len(self._held) == 0:
            self.close()
            return None
        if not self._paced:
            out, self._held = self._held, no_frames()
            return out
        if self._begin is None:
            self._begin = time.monotonic() - float(self._held.time_s[0])
        # sleep until the last available frame is due, but no longer than requested
        time.sleep(min(max(self._begin + float(self._held.time_s[-1]) - time.monotonic(), 0.0), timeout_s))
        due = self._held.time_s <= time.monotonic() - self._begin
        count = len(due) if due.all() else int(np.argmin(due))
        out, self._held = self._held.take(slice(count)), self._held.take(slice(count, None))
        return out

    def notices(self) -> list[Notice]:
        if self._batches is not None:
            return []
        notes, self._report = self._report.notes(), LogReport()
        return [Notice("unread", note) for note in notes]

    def close(self) -> None:
        if self._batches is not None:
            self._batches.close()  # type: ignore[attr-defined]
        self._batches, self._held = None, no_frames()


class SimulatedSource(BusSource):
    """The simulated cell: a scenario's frames, sent in real time from a thread over python-can's virtual bus."""

    def __init__(self, scenario: Path) -> None:
        from lmeasure.acquisition.bus.python_can import can
        from lmeasure.acquisition.counters.decoders import counter_fields
        from lmeasure.simulation import read_scenario, simulate

        requested, rig = read_scenario(scenario)
        run = simulate(requested, rig).run
        if run is None:
            raise AcquisitionError(message("error.has_no_waypoint_to", where=scenario))
        counts = run.run.passes[0]
        fields = counter_fields(rig)
        recorded = np.column_stack([counts.of(f.channel) for f in fields])
        frames = frames_from_counts(counts.time_s, recorded, fields, rig.can_table.sync_id)
        place = virtual_place()
        super().__init__(lambda: can.Bus(interface="virtual", channel=place), f"simulated:{scenario}")
        self._stop = threading.Event()
        self._sender = can.Bus(interface="virtual", channel=place)
        self._thread = threading.Thread(target=send, args=(frames, self._sender), kwargs={"paced": True, "stop": self._stop}, daemon=True)
        self._thread.start()

    def receive(self, timeout_s: float) -> Frames | None:
        running = self._thread.is_alive()
        frames = super().receive(timeout_s)
        return frames if frames is None or len(frames) or running else None

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._sender.shutdown()
        super().close()


def bus_opener(bus: str, bit_rate: int | None = None, options: Mapping[str, str | int] | None = None) -> Callable[[], "can.BusABC"]:
    """Return a function that opens the bus INTERFACE:CHANNEL of python-can; see `open_source`. AcquisitionError for an unknown
    interface."""
    interface, _, channel = bus.partition(":")
    from lmeasure.acquisition.bus.python_can import can

    # errors come as exceptions and are reported in one line; messages of drivers are not for the terminal
    logging.getLogger("can").setLevel(logging.ERROR)
    if interface not in can.interfaces.BACKENDS:
        raise AcquisitionError(
            message("error.bus_is_no_interface", bus=bus, interface=interface, backends=", ".join(sorted(can.interfaces.BACKENDS)))
        )
    given: dict[str, Any] = {k: int(v) if isinstance(v, str) and v.lstrip("-").isdigit() else v for k, v in (options or {}).items()}
    if bit_rate is not None:
        given["bitrate"] = bit_rate
    if interface == "udp_multicast":
        given.setdefault("hop_limit", 0)

    def opened() -> "can.BusABC":
        made = can.Bus(interface=interface, channel=channel, **given)
        if interface == "udp_multicast":
            bind_to_group(made)
        return made

    return opened


def open_source(
    bus: str,
    bit_rate: int | None = None,
    options: Mapping[str, str | int] | None = None,
    *,
    paced: bool = True,
    prepare: "Callable[[can.BusABC], object] | None" = None,
) -> Source:
    """Open the source that `--bus` names. options go to python-can's interface unchanged (whole numbers as such); AcquisitionError in one
    line.

    udp_multicast stays on this machine unless `hop_limit` is set. prepare is called with the bus each time it has been opened.
    """
    interface, _, channel = bus.partition(":")
    if not interface or not channel:
        raise AcquisitionError(message("error.bus_give_interface_channel", bus=bus))
    if interface == "replay":
        return ReplaySource(Path(channel), paced=paced)
    if interface == "simulated":
        return SimulatedSource(Path(channel))
    open_it = bus_opener(bus, bit_rate, options)

    def open_bus() -> "can.BusABC":
        opened = open_it()
        if prepare is not None:
            try:
                prepare(opened)
            except BaseException:
                opened.shutdown()
                raise
        return opened

    return BusSource(open_bus, f"{interface}:{channel}", bit_rate)
