"""Decoders: which bits of which frames are counters, and their values.

Whatever names a counter (a place in a frame, a signal of a DBC file, a J1939 parameter group, the mapping read from a CiA 406 encoder),
it comes down to one `CounterField`; decoding and encoding know nothing else.
"""

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from lmeasure.acquisition.frames import ERROR, EXTENDED, REMOTE, Frames
from lmeasure.arrays import IntArray
from lmeasure.can_table import CounterChannel, DbcCan, DbcChannel, J1939Can, RawCan
from lmeasure.errors import AcquisitionError, FileFormatError
from lmeasure.kernels.frames import FIELD_COLUMNS, extract
from lmeasure.opened import read_regular
from lmeasure.rig import AngleEncoder, Drum, Rig

ALL_BITS = 0x1FFFFFFF
STANDARD_IDENTIFIERS = 0x800
NO_RANGE = 2**62
"""Units of a counter that never starts again; integers stay within 64 bits."""
LARGEST_DBC = 1 << 26
SHOWN_NAMES = 20
PDU1_LIMIT = 240
"""J1939: below this PDU format the lower byte of the group's number is the receiver's address (SAE J1939-21)."""


@dataclass(frozen=True)
class CounterField:
    """Where a counter stands and how its device counts.

    A frame carries it when identifier & mask agrees. first_bit is the field's least significant bit in little-endian order (bit i of byte j
    is 8 j + i), its most significant one in big-endian order (8 j + 7 - i). modulus: units after which the device starts again; start:
    what it shows at the start pose; recorded count = scale * (unwrapped value - start).
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

    @property
    def bytes_needed(self) -> int:
        """Bytes a frame must have to hold the field."""
        return (self.first_bit + self.bits + 7) // 8

    def row(self) -> tuple[int, ...]:
        """The field as `kernels.frames.extract` takes it: the extended flag stands above the identifier's bits."""
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
    int64 in device units (of an unsigned 64-bit field its two's complement), window (n,) how many SYNCs of the batch stand before
    it. sync (k,): positions of the SYNCs. Per field: short, frames too short for it; wider, how often the byte behind it counted on when it
    passed its end: then the byte belongs to the counter, which has more bits than the rig says."""

    frame: IntArray
    field: NDArray[np.int16]
    value: IntArray
    short: tuple[int, ...]
    wider: tuple[int, ...]
    window: IntArray
    sync: IntArray


def counter_fields(rig: Rig, passage: int = 1, folder: Path = Path()) -> tuple[CounterField, ...]:
    """The fields of the channels that the cables of one pass need, in the cables' order, as the rig's `[can]` table names them.

    folder: where a DBC file's path starts, the rig file's folder. A CiA 406 table needs the devices: see `canopen_nodes`.
    FileFormatError when the DBC file does not say what the table expects of it.
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
        raise AcquisitionError("can: decoder 'cia406' asks the encoders where they put their counts")
    return tuple(field_at(known[channel], places[channel], drum) for channel, drum in drums.items())


Place = tuple[int, int, bool, int, int, Literal["little", "big"], bool]
"""identifier, mask, extended, first bit, bits, byte order, signed."""


def field_at(channel: CounterChannel, place: Place, counter: Drum | AngleEncoder) -> CounterField:
    """The field of a channel at a place; its device counts the stated range, else the codes of an absolute encoder, else the counter's
    bits, else all values of the field."""
    identifier, mask, extended, first_bit, bits, byte_order, signed = place
    values = counter.codes if counter.counter_bits is None else 2**counter.counter_bits
    modulus = channel.range or 2 ** (counter.counter_bits or bits)
    if counter.codes is not None and channel.range is None:
        modulus = round(counter.codes / channel.scale)
    if modulus > 2**bits:
        raise AcquisitionError(f"can: channel {channel.channel}: its device counts {modulus} units, more than {bits} bits can carry")
    if values is not None and channel.scale * modulus != values:
        said = f"its drum says counter_bits = {counter.counter_bits}" if counter.codes is None else f"its encoder has {values} codes"
        raise AcquisitionError(f"can: channel {channel.channel}: its device counts {channel.scale * modulus:g} counts, but {said}")
    return CounterField(
        channel.channel, identifier, mask, extended, first_bit, bits, byte_order, signed, modulus, channel.start, channel.scale
    )


def _first_bit(byte_offset: int) -> int:
    return 8 * byte_offset


def _parameter_group(pgn: int, source_address: int | None) -> tuple[int, int]:
    """(identifier, mask) of a J1939 group: priority never counts, the receiver's address not below PDU format 240."""
    mask = 0x03FFFF00 if (pgn >> 8) & 0xFF >= PDU1_LIMIT else 0x03FF0000
    if source_address is not None:
        mask |= 0xFF
    return ((pgn << 8) | (source_address or 0)) & mask, mask


def _dbc_fields(table: DbcCan, folder: Path, drums: Mapping[str, Drum | AngleEncoder]) -> tuple[CounterField, ...]:
    path = folder / table.dbc
    database = dbc_file(path)
    known = {c.channel: c for c in table.channel}
    chosen = [known[channel] for channel in drums]
    return tuple(_dbc_field(known[channel], chosen, database, path, drum) for channel, drum in drums.items())


def dbc_file(path: Path) -> Any:
    """cantools' database of a DBC file, its signals as they stand: many real files contradict themselves where nobody reads them.

    FileFormatError when it cannot be read.
    """
    import cantools

    text = read_regular(path, LARGEST_DBC)
    logging.getLogger("cantools").setLevel(logging.ERROR)  # its warnings are not for the terminal
    try:
        return cantools.database.load_string(text.decode("cp1252", "replace").replace("\r\n", "\n"), database_format="dbc", strict=False)
    except Exception as error:  # its parser raises whatever a broken file leads it into
        raise FileFormatError(f"{path}: cannot be read as DBC: {' '.join(str(error).split())[:200]}") from error


def _of_signals(message: Any, wanted: list[str]) -> Any:
    """The message with the wanted signals alone, and those that say which of them a frame carries; cantools' Error where they do not fit
    into it or lie upon each other."""
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


def _dbc_field(c: DbcChannel, chosen: list[DbcChannel], database: Any, path: Path, drum: Drum | AngleEncoder) -> CounterField:
    """The field of a signal: compiled where it is a plain integer, by cantools where it is multiplexed or a floating-point number."""
    from cantools.database.errors import Error

    where = f"{path}: channel {c.channel}: message {c.message!r}"
    whole = next((m for m in database.messages if m.name == c.message), None)
    if whole is None:
        raise FileFormatError(f"{where} is not in it")
    try:
        message = _of_signals(whole, list(dict.fromkeys([c.signal, *(other.signal for other in chosen if other.message == c.message)])))
    except Error as error:
        raise FileFormatError(f"{where}: {' '.join(str(error).split())[:200]}") from error
    signal = next((s for s in message.signals if s.name == c.signal), None)
    if signal is None:
        names = ", ".join(s.name for s in whole.signals[:SHOWN_NAMES]) + ", ..." * (len(whole.signals) > SHOWN_NAMES)
        raise FileFormatError(f"{where} has no signal {c.signal!r}; it has {names}")
    if not 8 <= signal.length <= 64:
        raise FileFormatError(f"{where}: signal {c.signal!r} has {signal.length} bits, a counter has 8 to 64")
    first = signal.start if signal.byte_order == "little_endian" else 8 * (signal.start // 8) + 7 - signal.start % 8
    order: Literal["little", "big"] = "little" if signal.byte_order == "little_endian" else "big"
    place: Place = (message.frame_id, ALL_BITS, message.is_extended_frame, first, signal.length, order, signal.is_signed)
    if not signal.conversion.is_float:
        field = field_at(c, place, drum)
        return replace(field, reader=_reader(message, signal.name, 1.0)) if signal.multiplexer_ids else field
    if drum.counter_bits is not None:
        raise AcquisitionError(
            f"{where}: signal {c.signal!r} is a floating-point number, which never wraps: its drum needs no counter_bits"
        )
    # as whole counts, so that everything behind the decoder is as for any counter
    start = round(c.scale * c.start)
    return CounterField(c.channel, *place, c.range or NO_RANGE, start, 1.0, _reader(message, signal.name, c.scale))


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
    if len(compiled) == len(fields):
        return Readings(frame, field, value, tuple(short.tolist()), tuple(wider.tolist()), window, syncs)
    all_short, all_wider = np.zeros(len(fields), np.int64), np.zeros(len(fields), np.int64)
    all_short[compiled], all_wider[compiled] = short, wider
    read = _by_readers(frames, fields, all_short)
    frame = np.concatenate([frame, read[0]])
    field = np.concatenate([np.array(compiled, np.int16)[field], read[1].astype(np.int16)])
    value = np.concatenate([value, read[2]])
    order = np.argsort(frame, kind="stable")
    window = np.searchsorted(syncs, frame[order])
    return Readings(frame[order], field[order], value[order], tuple(all_short.tolist()), tuple(all_wider.tolist()), window, syncs)


def _by_readers(frames: Frames, fields: tuple[CounterField, ...], short: IntArray) -> IntArray:
    """(3, k) frame, field and value of what the readers read, in the order of the frames; short gets the frames too short."""
    found: list[tuple[int, int, int]] = []
    plain = (frames.flags & (ERROR | REMOTE)) == 0
    extended = (frames.flags & EXTENDED) != 0
    for j, f in enumerate(fields):
        if f.reader is None:
            continue
        for i in np.flatnonzero(plain & (frames.identifier & f.mask == f.identifier) & (extended == f.extended)).tolist():
            length = int(frames.length[i])
            if length < f.bytes_needed:
                short[j] += 1
            elif (value := f.reader(frames.data[i, :length].tobytes())) is not None:
                found.append((i, j, value))
    return np.array(sorted(found), np.int64).reshape(-1, 3).T


def _byte_behind(field: CounterField, fields: tuple[CounterField, ...]) -> int:
    """The byte in which the counter would go on if it were wider than the rig says; -1 where that cannot be: it would be another counter's,
    or no carry would reach it."""
    behind = field.bytes_needed if field.byte_order == "little" else field.first_bit // 8 - 1
    taken = {b for f in fields if (f.identifier, f.extended) == (field.identifier, field.extended) for b, _ in f.shifts()}
    return -1 if field.bits >= 63 or field.modulus != 2**field.bits or behind in taken else behind


def encode(values: IntArray, field: CounterField, data: NDArray[np.uint8]) -> None:
    """Write (n,) values in device units into (n, w) data bytes: what `decode` reads back."""
    bits = np.uint64(2**field.bits - 1)
    value = values.view(np.uint64) & bits
    for byte, shift in field.shifts():
        data[:, byte] |= ((value >> np.uint64(shift) if shift >= 0 else value << np.uint64(-shift)) & np.uint64(0xFF)).astype(np.uint8)
