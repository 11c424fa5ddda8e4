"""CAN frames as arrays: output of every source, input of every decoder."""

import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, Self

import numpy as np
from numpy.typing import NDArray

from lmeasure.core import AcquisitionError, BoolArray, FloatArray
from lmeasure.text import message

if TYPE_CHECKING:
    import can

EXTENDED = 1 << 0
"""29-bit identifier."""
REMOTE = 1 << 1
"""Remote request: a length without data."""
ERROR = 1 << 2
"""Error frame: its identifier and data describe the error and carry no count."""
FD = 1 << 3
"""CAN FD frame, up to 64 bytes."""
BITRATE_SWITCH = 1 << 4
"""FD: the data was sent at the faster rate."""
ERROR_STATE = 1 << 5
"""FD: the sender was error passive."""
SENT = 1 << 6
"""Sent by the recording side, not received."""
CLASSED = 1 << 7
"""Mark of an error frame whose identifier and data are a class of SocketCAN with its data (linux/can/error.h)."""

BUS_OFF, CONTROLLER, COUNTERS = 0x40, 0x04, 0x200
"""Classes of SocketCAN: bus-off; state of the controller in byte 1; error counters (sent, received) in bytes 6 and 7."""
LARGEST_CLASS = 0x3FF
PASSIVE, WARNING = (128, 0x20, 0x10), (96, 0x08, 0x04)
"""States of a controller by ISO 11898-1: error counter from which on, and the bits of byte 1 of its counters (sent, received)."""

CLASSIC_BYTES = 8
FD_BYTES = 64
PIECE_FRAMES = 1 << 16

TimestampSource = Literal["hardware", "kernel", "host", "log"]


@dataclass(frozen=True)
class Frames:
    """Frames in the order in which they were received.

    time_s (n,) float64 [s] as the source gives it; identifier (n,) uint32, 11 or 29 bits, no flags; flags (n,) uint8 of the bits above;
    length (n,) uint8 bytes of data (of a remote frame: bytes requested); data (n, 8) or (n, 64) uint8, zero beyond the length; channel (n,)
    int16, index into buses, the names of the buses as the source writes them. timestamp_source names the clock: the interface's, the
    kernel's, this program's, or that of the log's writer.
    """

    time_s: FloatArray
    identifier: NDArray[np.uint32]
    flags: NDArray[np.uint8]
    length: NDArray[np.uint8]
    data: NDArray[np.uint8]
    channel: NDArray[np.int16]
    buses: tuple[str, ...] = ("0",)
    timestamp_source: TimestampSource = "host"
    source: str = "frames"

    def __post_init__(self) -> None:
        n = len(self.time_s)
        for name in ("identifier", "flags", "length", "channel"):
            if getattr(self, name).shape != (n,):
                raise AcquisitionError(
                    message("error.has_shape_for_frames", where=self.source, name=name, shape=str(getattr(self, name).shape), n=n)
                )
        if self.data.shape not in {(n, CLASSIC_BYTES), (n, FD_BYTES)}:
            raise AcquisitionError(message("error.data_has_shape_for", where=self.source, shape=str(self.data.shape), n=n))

    def __len__(self) -> int:
        return len(self.time_s)

    def take(self, index: BoolArray | NDArray[np.intp] | slice) -> Self:
        """The chosen frames: a mask, positions or a slice."""
        arrays = ("time_s", "identifier", "flags", "length", "data", "channel")
        return dataclasses.replace(self, **{name: getattr(self, name)[index] for name in arrays})


def no_frames(source: str = "frames", timestamp_source: TimestampSource = "host") -> Frames:
    """An empty batch."""
    return Frames(
        np.empty(0),
        np.empty(0, np.uint32),
        np.empty(0, np.uint8),
        np.empty(0, np.uint8),
        np.empty((0, CLASSIC_BYTES), np.uint8),
        np.empty(0, np.int16),
        timestamp_source=timestamp_source,
        source=source,
    )


def join(parts: Sequence[Frames]) -> Frames:
    """Batches of one source, one after the other; bus names are united, data widened where a batch holds FD frames."""
    if not parts:
        return no_frames()
    buses = tuple(dict.fromkeys(name for part in parts for name in part.buses))
    width = max(part.data.shape[1] for part in parts)
    data = [np.pad(part.data, ((0, 0), (0, width - part.data.shape[1]))) for part in parts]
    channel = [np.array([buses.index(b) for b in part.buses], np.int16)[part.channel] for part in parts]
    return Frames(
        np.concatenate([part.time_s for part in parts]),
        np.concatenate([part.identifier for part in parts]),
        np.concatenate([part.flags for part in parts]),
        np.concatenate([part.length for part in parts]),
        np.concatenate(data),
        np.concatenate(channel),
        buses,
        parts[0].timestamp_source,
        parts[0].source,
    )


def pieces(batches: Iterable[Frames]) -> Iterator[Frames]:
    """Yield the frames of all batches in pieces of PIECE_FRAMES: where a batch ends does not matter then."""
    held: list[Frames] = []
    for batch in batches:
        held.append(batch)
        if sum(map(len, held)) >= PIECE_FRAMES:
            whole = join(held)
            ends = range(PIECE_FRAMES, len(whole) + 1, PIECE_FRAMES)
            yield from (whole.take(slice(end - PIECE_FRAMES, end)) for end in ends)
            held = [whole.take(slice(ends[-1], None))]
    if held:
        yield join(held)


def controller_state(state: tuple[int, int, int], counters: tuple[int, int] = (0, 0)) -> tuple[int, bytes]:
    """Return the class and the data of SocketCAN for a controller that is PASSIVE or at its WARNING limit; counters (0, 0): not stated."""
    limit, *bits = state
    which = sum(bit for bit, count in zip(bits, counters, strict=True) if count >= limit) or sum(bits)
    return CONTROLLER | (COUNTERS if any(counters) else 0), bytes([0, which, 0, 0, 0, 0, *counters])


def frames_from_messages(
    messages: Iterable["can.Message"], timestamp_source: TimestampSource = "host", source: str = "frames", *, classes: bool = True
) -> Frames:
    """Return the frames of python-can messages, in their order; classes: identifiers of error frames are classes of SocketCAN."""
    kept = list(messages)
    n = len(kept)
    if n == 0:
        return no_frames(source, timestamp_source)
    width = FD_BYTES if any(len(m.data) > CLASSIC_BYTES for m in kept) else CLASSIC_BYTES
    data = np.zeros((n, width), np.uint8)
    for row, m in zip(data, kept, strict=True):
        if m.data:
            row[: len(m.data)] = m.data
    names = ["0" if m.channel is None else str(m.channel) for m in kept]
    buses = tuple(dict.fromkeys(names))
    place = {name: i for i, name in enumerate(buses)}
    return Frames(
        np.array([m.timestamp for m in kept], np.float64),
        np.array([m.arbitration_id for m in kept], np.uint32),
        np.array([flags_of(m) | (CLASSED if classes and is_classed(m) else 0) for m in kept], np.uint8),
        np.array([m.dlc for m in kept], np.uint8),
        data,
        np.array([place[name] for name in names], np.int16),
        buses,
        timestamp_source,
        source,
    )


def flags_of(message: "can.Message") -> int:
    """The flag bits of a python-can message."""
    return (
        (EXTENDED if message.is_extended_id else 0)
        | (REMOTE if message.is_remote_frame else 0)
        | (ERROR if message.is_error_frame else 0)
        | (FD if message.is_fd else 0)
        | (BITRATE_SWITCH if message.bitrate_switch else 0)
        | (ERROR_STATE if message.error_state_indicator else 0)
        | (0 if message.is_rx else SENT)
    )


def is_classed(message: "can.Message") -> bool:
    """Return whether the identifier of an error frame may be a class of SocketCAN."""
    return message.is_error_frame and message.arbitration_id <= LARGEST_CLASS


def each(frames: Frames) -> Iterator[tuple[float, int, int, int, NDArray[np.uint8], int]]:
    """Time [s], identifier, flags, length, data bytes and channel of each frame."""
    return zip(
        frames.time_s.tolist(),
        frames.identifier.tolist(),
        frames.flags.tolist(),
        frames.length.tolist(),
        frames.data,
        frames.channel.tolist(),
        strict=True,
    )


def messages_from_frames(frames: Frames) -> Iterator["can.Message"]:
    """Frames as python-can messages, in their order; the channel is the bus name."""
    from lmeasure.acquisition.bus.python_can import can

    for t, identifier, flags, length, data, channel in each(frames):
        yield can.Message(
            timestamp=t,
            arbitration_id=identifier,
            is_extended_id=bool(flags & EXTENDED),
            is_remote_frame=bool(flags & REMOTE),
            is_error_frame=bool(flags & ERROR),
            is_fd=bool(flags & FD),
            bitrate_switch=bool(flags & BITRATE_SWITCH),
            error_state_indicator=bool(flags & ERROR_STATE),
            is_rx=not flags & SENT,
            channel=frames.buses[channel],
            dlc=length,
            data=None if flags & REMOTE else data[:length].tobytes(),
        )
