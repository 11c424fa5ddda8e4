"""Decoders: place and value of counters in frames.

Every description of a counter (a place in a frame, a signal of a DBC file, a J1939 parameter group, the mapping read from a CiA 406
encoder) becomes one `CounterField`; decoding and encoding know nothing else.
"""

import logging
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lmeasure.acquisition.bus.frames import ERROR, EXTENDED, REMOTE, Frames
from lmeasure.core import AcquisitionError, BoolArray, FileFormatError, IntArray
from lmeasure.io import read_regular
from lmeasure.kernels import FIELD_COLUMNS, extract
from lmeasure.rig import CounterChannel, DbcCan, DbcChannel, Drum, J1939Can, J1939Channel, RawCan, Rig, SensorTable
from lmeasure.text import composed, message

ALL_BITS = 0x1FFFFFFF
STANDARD_IDENTIFIERS = 0x800
NO_RANGE = 2**62
"""Units of a counter that never starts again; integers stay within 64 bits."""
LARGEST_DBC = 1 << 26
SHOWN_NAMES = 20
PDU1_LIMIT = 240
"""J1939: below this PDU format the lower byte of the group's number is the receiver's address (SAE J1939-21)."""
RESERVED = 0xFB
"""J1939: raw values whose highest byte is this or more are reserved, an error, or not available (SAE J1939-71)."""
FIRST_PDO_ID, LAST_PDO_ID = 0x181, 0x57F
NO_VALUE = re.compile(
    r"\b(in ?valid|(?<!no )(?<!non )(error|err|fault|failure)(?! free)|faulty|defect|sna|na|n a|un ?available|undefined|reserved"
    r"|not? (available|avail|valid|defined|value|data))\b"
)
"""Names of values in a DBC file that carry no count, in lower case, the words parted by blanks."""


@dataclass(frozen=True)
class CounterField:
    """Place of a counter in frames and law of its device.

    A frame carries it if identifier & mask agrees. first_bit is the field's least significant bit in little-endian order (bit i of byte j
    is 8 j + i), its most significant one in big-endian order (8 j + 7 - i). modulus: units after which the device starts again; start: its
    value at the start pose; recorded count = scale * (unwrapped value - start).
    """

    channel: str
    identifier: int
    mask: int
    extended: bool
    first_bit: int
    bits: int
    byte_order: Literal["little", "big"]
    signed: bool
    modulus: int
    start: int = 0
    scale: float = 1.0
    reader: Callable[[bytes], int | None] | None = None
    """Reads the value out of a frame's data where it is no plain integer; None where the frame holds none."""
    limits: tuple[int, int] | None = None
    """Least and largest value that is a count, where a DBC file states them."""
    reserved: int | None = None
    """Raw values, without a sign, from here on are no counts."""
    names: Mapping[int, str] = field(default_factory=dict)
    """Values that are no counts, and their names."""
    range_text: str = ""
    """Source of the limits, for messages."""
    node: int | None = None
    """Number of the CANopen node that sends it."""
    absolute: bool = False
    """Whether the device still knows its count after it was switched off."""

    @property
    def bytes_needed(self) -> int:
        """Bytes a frame must have to hold the field."""
        return (self.first_bit + self.bits + 7) // 8

    def no_counts(self, values: IntArray) -> BoolArray:
        """Return which of (n,) values carry no count."""
        out = np.isin(values, list(self.names)) if self.names else np.zeros(len(values), np.bool_)
        if self.reserved is not None:
            out |= values.view(np.uint64) & np.uint64(2**self.bits - 1) >= np.uint64(self.reserved)
        if self.limits is not None:
            # an unsigned value of 64 bits comes as its two's complement
            seen = values if self.signed or self.bits < 64 else values.view(np.uint64)
            out |= (seen < self.limits[0]) | (seen > self.limits[1])
        return out

    def why_no_count(self, value: int) -> str:
        """Return why a value carries no count."""
        unsigned = value % 2**self.bits if self.reader is None else value
        shown = f"{unsigned:0{(self.bits + 3) // 4}X}h" if self.reader is None else str(value)
        return composed("{shown}: {why}", shown=shown, why=self.names.get(value) or self.range_text)

    def row(self) -> tuple[int, ...]:
        """Return the row of `kernels.frames.extract`; the extended flag is above the identifier's bits."""
        above = ALL_BITS + 1
        key = self.identifier | (above if self.extended else 0)
        return key, self.mask | above, self.first_bit, self.bits, int(self.byte_order == "big"), int(self.signed)

    def shifts(self) -> list[tuple[int, int]]:
        """(byte of the frame, left shift of its value in the field; right shift where negative)."""
        first, last = self.first_bit // 8, self.bytes_needed - 1
        if self.byte_order == "little":
            return [(b, 8 * b - self.first_bit) for b in range(first, last + 1)]
        end = 8 * (last + 1) - self.first_bit - self.bits
        return [(b, 8 * (last - b) - end) for b in range(first, last + 1)]


@dataclass(frozen=True)
class Readings:
    """Decoded values in the order of their frames: frame (n,) position of the frame in its batch, field (n,) index of the field, value (n,)
    int64 in device units (of an unsigned 64-bit field its two's complement), window (n,) number of SYNCs of the batch before it. sync (k,):
    positions of the SYNCs. Per field positions of frames: short, those too short for it; wider, where the byte behind it counted on when it
    passed its end: then the byte belongs to the counter, which has more bits than stated in the rig. void (k, 3): frame, field and value
    whose value means that there is no count."""

    frame: IntArray
    field: NDArray[np.int16]
    value: IntArray
    short: tuple[IntArray, ...]
    wider: tuple[IntArray, ...]
    window: IntArray
    sync: IntArray
    void: IntArray


def counter_fields(rig: Rig, passage: int = 1, folder: Path = Path()) -> tuple[CounterField, ...]:
    """Return the fields of the rig's `[can]` table for the cables of one pass, in the cables' order.

    folder: start of a DBC file's path, the rig file's folder. A CiA 406 table needs the devices: see `canopen_nodes`. FileFormatError if
    the DBC file lacks a signal of the table.
    """
    table = rig.can_table
    drums = rig.counters_of(passage)
    known = {c.channel: c for c in table.channel}
    places: dict[str, Place]
    if isinstance(table, RawCan):
        places = {c.channel: (c.id, ALL_BITS, c.extended, _first_bit(c.byte_offset), c.bits, c.byte_order, c.signed) for c in table.channel}
    elif isinstance(table, J1939Can):
        places = {
            c.channel: (*_parameter_group(c.pgn, c.source_address), True, _first_bit(c.byte_offset), c.bits, c.byte_order, c.signed)
            for c in table.channel
        }
    elif isinstance(table, DbcCan):
        return _dbc_fields(table, folder, drums)
    else:
        raise AcquisitionError(message("error.can_decoder_cia406_asks"))
    return tuple(field_at(known[channel], places[channel], drum) for channel, drum in drums.items())


Place = tuple[int, int, bool, int, int, Literal["little", "big"], bool]
"""identifier, mask, extended, first bit, bits, byte order, signed."""


def field_at(channel: CounterChannel, place: Place, counter: Drum | SensorTable) -> CounterField:
    """The field of a channel at a place; its device counts the stated range, else the codes of an absolute encoder, else the counter's
    bits, else all values of the field."""
    identifier, mask, extended, first_bit, bits, byte_order, signed = place
    values = counter.codes if counter.counter_bits is None else 2**counter.counter_bits
    modulus = channel.range or 2 ** (counter.counter_bits or bits)
    if counter.codes is not None and channel.range is None:
        modulus = round(counter.codes / channel.scale)
    if modulus > 2**bits:
        raise AcquisitionError(message("error.can_channel_its_device", channel=channel.channel, modulus=modulus, bits=bits))
    if values is not None and channel.scale * modulus != values:
        said = message("bus.encoder_codes", codes=values)
        if counter.codes is None:
            said = message("bus.counter_bits", bits=counter.counter_bits)
        raise AcquisitionError(
            message("error.can_channel_its_device_counts", channel=channel.channel, scale=channel.scale * modulus, said=said)
        )
    j1939 = isinstance(channel, J1939Channel) and not channel.whole_range
    return CounterField(
        channel.channel,
        identifier,
        mask,
        extended,
        first_bit,
        bits,
        byte_order,
        signed,
        modulus,
        channel.start,
        channel.scale,
        reserved=RESERVED << bits - 8 if j1939 else None,
        range_text=message("event.reserved") if j1939 else "",
        node=_node(channel, identifier, extended),
        absolute=channel.absolute,
    )


def _node(channel: CounterChannel, identifier: int, extended: bool) -> int | None:
    """The node of a channel: as the rig states it, else that of the identifier where CiA 301 has one in it."""
    stated: int | None = getattr(channel, "node", None)
    return stated or (identifier & 0x7F or None if not extended and FIRST_PDO_ID <= identifier <= LAST_PDO_ID else None)


def _first_bit(byte_offset: int) -> int:
    return 8 * byte_offset


def _parameter_group(pgn: int, source_address: int | None) -> tuple[int, int]:
    """(identifier, mask) of a J1939 group: priority never counts, the receiver's address not below PDU format 240."""
    mask = 0x03FFFF00 if (pgn >> 8) & 0xFF >= PDU1_LIMIT else 0x03FF0000
    if source_address is not None:
        mask |= 0xFF
    return ((pgn << 8) | (source_address or 0)) & mask, mask


def _dbc_fields(table: DbcCan, folder: Path, drums: Mapping[str, Drum | SensorTable]) -> tuple[CounterField, ...]:
    path = folder / table.dbc
    database = dbc_file(path)
    known = {c.channel: c for c in table.channel}
    chosen = [known[channel] for channel in drums]
    return tuple(_dbc_field(known[channel], chosen, database, path, drum) for channel, drum in drums.items())


def dbc_file(path: Path) -> Any:
    """Return cantools' database of a DBC file without its checks: many real files contradict themselves in unused signals.

    FileFormatError when it cannot be read.
    """
    from lmeasure.acquisition.bus.python_can import user

    cantools, text = user("cantools"), read_regular(path, LARGEST_DBC)
    logging.getLogger("cantools").setLevel(logging.ERROR)  # its warnings are not for the terminal
    try:
        return cantools.database.load_string(text.decode("cp1252", "replace").replace("\r\n", "\n"), database_format="dbc", strict=False)
    except Exception as error:  # its parser raises whatever a broken file leads it into
        raise FileFormatError(message("error.cannot_be_read_as", where=path, error=" ".join(str(error).split())[:200])) from error


def _of_signals(message: Any, wanted: list[str]) -> Any:
    """Return the message with the wanted signals and their multiplexers alone. cantools' Error if they do not fit into it or overlap."""
    from cantools.database import Message

    known = {s.name: s for s in message.signals}
    names: list[str] = []
    for each in wanted:
        name: str | None = each
        while name is not None and name not in names:
            names.append(name)
            name = known[name].multiplexer_signal if name in known else None
    chosen = [known[name] for name in names if name in known]
    return Message(message.frame_id, message.name, message.length, chosen, is_extended_frame=message.is_extended_frame, strict=True)


def _dbc_field(c: DbcChannel, chosen: list[DbcChannel], database: Any, path: Path, drum: Drum | SensorTable) -> CounterField:
    """The field of a signal: compiled where it is a plain integer, by cantools where it is multiplexed or a floating-point number."""
    from cantools.database.errors import Error

    where = f"{path}: channel {c.channel}: message {c.message!r}"
    whole = next((m for m in database.messages if m.name == c.message), None)
    if whole is None:
        raise FileFormatError(message("error.is_not_in_it", where=where))
    try:
        own = _of_signals(whole, list(dict.fromkeys([c.signal, *(other.signal for other in chosen if other.message == c.message)])))
    except Error as error:
        raise FileFormatError(composed("{where}: {error}", where=where, error=" ".join(str(error).split())[:200])) from error
    signal = next((s for s in own.signals if s.name == c.signal), None)
    if signal is None:
        names = ", ".join(s.name for s in whole.signals[:SHOWN_NAMES]) + ", ..." * (len(whole.signals) > SHOWN_NAMES)
        raise FileFormatError(message("error.has_no_signal_it", where=where, signal=c.signal, names=names))
    if not 8 <= signal.length <= 64:
        raise FileFormatError(message("error.signal_has_bits_a", where=where, signal=c.signal, length=signal.length))
    first = signal.start if signal.byte_order == "little_endian" else 8 * (signal.start // 8) + 7 - signal.start % 8
    order: Literal["little", "big"] = "little" if signal.byte_order == "little_endian" else "big"
    place: Place = (own.frame_id, ALL_BITS, own.is_extended_frame, first, signal.length, order, signal.is_signed)
    if not signal.conversion.is_float:
        one = replace(field_at(c, place, drum), **_stated_values(c, signal, 1.0))
        return replace(one, reader=_reader(own, signal.name, 1.0)) if signal.multiplexer_ids else one
    if drum.counter_bits is not None:
        raise AcquisitionError(message("error.signal_is_a_floating", where=where, signal=c.signal))
    # as whole counts, so that everything behind the decoder is as for any counter
    start = round(c.scale * c.start)
    one = CounterField(c.channel, *place, c.range or NO_RANGE, start, 1.0, _reader(own, signal.name, c.scale), absolute=c.absolute)
    return replace(one, node=_node(c, own.frame_id, own.is_extended_frame), **_stated_values(c, signal, c.scale))


def _stated_values(c: DbcChannel, signal: Any, scale: float) -> dict[str, Any]:
    """Return a DBC file's limits and names of a signal's values, in counts of `scale` a raw unit. Limits [min|max] are physical values and
    mean nothing if both are 0. Named values (VAL_) are no counts."""
    if c.whole_range:
        return {}
    out: dict[str, Any] = {"names": {round(scale * v): str(name) for v, name in (signal.choices or {}).items() if is_no_value(str(name))}}
    if signal.minimum is None and signal.maximum is None:
        return out
    factor, offset = float(signal.scale), float(signal.offset)
    ends = [None if end is None else scale * (float(end) - offset) / factor for end in (signal.minimum, signal.maximum)]
    low, high = ends if factor > 0 else ends[::-1]
    # decimal figures of the file do not meet whole units exactly
    least = -(2**63) if low is None else max(math.ceil(low - max(1e-6, 1e-12 * abs(low))), -(2**63))
    most = 2**64 - 1 if high is None else min(math.floor(high + max(1e-6, 1e-12 * abs(high))), 2**64 - 1)
    said = message("event.outside_range")
    if None not in ends:
        unit = f" {signal.unit}" if signal.unit else ""
        said = message("event.outside_limits", low=float(signal.minimum), high=float(signal.maximum), unit=unit)
    return out | {"limits": (least, most), "range_text": said}


def is_no_value(name: str) -> bool:
    """Return whether a DBC file's name of a value means no value: invalid, error, not available, SNA and the like."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])|[\W_]+", " ", name)
    return NO_VALUE.search(" ".join(parted.lower().split())) is not None


def _reader(message: Any, signal: str, scale: float) -> Callable[[bytes], int | None]:
    from cantools.database.errors import Error

    def read(data: bytes) -> int | None:
        try:
            value = message.decode(data, decode_choices=False, scaling=False).get(signal)
        except (Error, ValueError):  # a multiplexer value that the file does not know
            return None
        if value is None or not math.isfinite(value) or abs(scale * value) >= NO_RANGE:
            return None
        return round(scale * value)

    return read


def decode(frames: Frames, fields: tuple[CounterField, ...], sync_id: int | None = None) -> Readings:
    """All values of the fields in the frames, and the SYNCs among them. Error and remote frames carry none; a frame too short for its field
    is counted, not read."""
    columns = (frames.time_s, frames.identifier, frames.flags, frames.length, frames.data, frames.channel)
    compiled = [j for j, f in enumerate(fields) if f.reader is None]
    rows = [(*fields[j].row(), _byte_behind(fields[j], fields)) for j in compiled]
    sync_key = -1 if sync_id is None else sync_id if sync_id < STANDARD_IDENTIFIERS else sync_id | ALL_BITS + 1
    frame, field, value, window, short, wider, syncs = extract(columns, np.array(rows, np.int64).reshape(-1, FIELD_COLUMNS), sync_key)
    shorts, widers = [NO_ROWS] * len(fields), [NO_ROWS] * len(fields)
    for k, j in enumerate(compiled):
        shorts[j] = _too_short(frames, fields[j]) if short[k] else NO_ROWS
        widers[j] = _carries(frames, fields[j], frame[field == k], value[field == k], int(rows[k][-1])) if wider[k] else NO_ROWS
    if len(compiled) == len(fields):
        return _with_counts(Readings(frame, field, value, tuple(shorts), tuple(widers), window, syncs, NO_VOID), fields)
    read = _by_readers(frames, fields, shorts)
    frame = np.concatenate([frame, read[0]])
    field = np.concatenate([np.array(compiled, np.int16)[field], read[1].astype(np.int16)])
    value = np.concatenate([value, read[2]])
    order = np.argsort(frame, kind="stable")
    window = np.searchsorted(syncs, frame[order])
    return _with_counts(Readings(frame[order], field[order], value[order], tuple(shorts), tuple(widers), window, syncs, NO_VOID), fields)


NO_ROWS = np.empty(0, np.int64)
NO_VOID = np.empty((0, 3), np.int64)


def _with_counts(readings: Readings, fields: tuple[CounterField, ...]) -> Readings:
    """The readings without those that carry no count, which go to `void`."""
    void = np.zeros(len(readings.value), np.bool_)
    for j, one in enumerate(fields):
        if one.limits is not None or one.reserved is not None or one.names:
            mine = np.flatnonzero(readings.field == j)
            void[mine] = one.no_counts(readings.value[mine])
    if not void.any():
        return readings
    rows = np.column_stack([readings.frame[void], readings.field[void].astype(np.int64), readings.value[void]])
    kept = ~void
    return replace(
        readings,
        frame=readings.frame[kept],
        field=readings.field[kept],
        value=readings.value[kept],
        window=readings.window[kept],
        void=rows,
    )


def _carriers(frames: Frames, field: CounterField) -> IntArray:
    """Positions of the frames that carry a field."""
    plain, extended = (frames.flags & (ERROR | REMOTE)) == 0, (frames.flags & EXTENDED) != 0
    return np.flatnonzero(plain & (frames.identifier & field.mask == field.identifier) & (extended == field.extended))


def _too_short(frames: Frames, field: CounterField) -> IntArray:
    mine = _carriers(frames, field)
    return mine[frames.length[mine] < field.bytes_needed]


def _carries(frames: Frames, field: CounterField, frame: IntArray, value: IntArray, behind: int) -> IntArray:
    """Positions of the frames in which the byte behind a field counts on by one as the field passes its end."""
    steps, upper = np.diff(value % 2**field.bits), np.diff(frames.data[frame, behind].astype(np.int64)) & 0xFF
    passed = (np.abs(steps) > 2 ** (field.bits - 1)) & (upper == np.where(steps < 0, 1, 0xFF))
    return np.asarray(frame[1:][passed & (frames.length[frame[1:]] > behind) & (frames.length[frame[:-1]] > behind)])


def _by_readers(frames: Frames, fields: tuple[CounterField, ...], short: list[IntArray]) -> IntArray:
    """Return (3, k) frame, field and value of the readers, in the order of the frames; short gets the frames that are too short."""
    found: list[tuple[int, int, int]] = []
    for j, f in enumerate(fields):
        if f.reader is None:
            continue
        short[j] = _too_short(frames, f)
        for i in np.setdiff1d(_carriers(frames, f), short[j]).tolist():
            if (value := f.reader(frames.data[i, : int(frames.length[i])].tobytes())) is not None:
                found.append((i, j, value))
    return np.array(sorted(found), np.int64).reshape(-1, 3).T


def _byte_behind(field: CounterField, fields: tuple[CounterField, ...]) -> int:
    """Return the byte in which a counter wider than stated would continue; -1 if it is another counter's, or no carry would reach it."""
    behind = field.bytes_needed if field.byte_order == "little" else field.first_bit // 8 - 1
    taken = {b for f in fields if (f.identifier, f.extended) == (field.identifier, field.extended) for b, _ in f.shifts()}
    return -1 if field.bits >= 63 or field.modulus != 2**field.bits or behind in taken else behind


def encode(values: IntArray, field: CounterField, data: NDArray[np.uint8]) -> None:
    """Write (n,) values in device units into (n, w) data bytes, the inverse of `decode`."""
    bits = np.uint64(2**field.bits - 1)
    value = values.view(np.uint64) & bits
    for byte, shift in field.shifts():
        data[:, byte] |= ((value >> np.uint64(shift) if shift >= 0 else value << np.uint64(-shift)) & np.uint64(0xFF)).astype(np.uint8)
