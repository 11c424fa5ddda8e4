"""Scan of a BLF log's objects into arrays of frames, and extraction of integers from payloads.

The layout of the objects is that of python-can's reader (`can.io.blf`), which follows Vector's binlog.h; the scan yields
the same frames as that reader, bit for bit. It also reads CAN_ERROR, CAN_FD_ERROR_64, CAN_DRIVER_ERROR,
and objects with headers of version 3 (layout: Wireshark's blf.h, Vector BLF of
Tobias Lorenz). An object that contradicts itself stops the scan: nothing behind it can be trusted.

Every scan fills the same columns: time [s], identifier, flags (bits of `lmeasure.acquisition.bus.frames`), length in bytes, data (n, 8) or
(n, 64), channel as an index into the names found so far.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmeasure.core import FloatArray, IntArray
from lmeasure.kernels.decorators import inline, kernel

Bytes = NDArray[np.uint8]
Columns = tuple[FloatArray, NDArray[np.uint32], NDArray[np.uint8], NDArray[np.uint8], Bytes, NDArray[np.int16]]

i64: Any = np.int64  # a byte shifted or added to as it is would stay a byte's kind of number
u64: Any = np.uint64

EXTENDED, REMOTE, ERROR, FD, BITRATE_SWITCH, ERROR_STATE, SENT, CLASSED = 1, 2, 4, 8, 16, 32, 64, 128
LARGEST_CLASS = 0x3FF

DONE = 0
"""All whole objects or lines were read."""
BROKEN = 1
"""What stands at the position returned contradicts itself."""
WIDE = 2
"""A payload longer than the data columns: scan again with 64."""
ODD = 3
"""A line or an object that the scan does not know."""

CAN_MESSAGE, CAN_ERROR, CAN_ERROR_EXT, CAN_MESSAGE2, CAN_FD_MESSAGE, CAN_FD_MESSAGE_64, CAN_FD_ERROR_64 = 1, 2, 73, 86, 100, 101, 104
DRIVER_ERRORS = (31, 74)
"""CAN_DRIVER_ERROR and CAN_DRIVER_ERROR_EXT."""
OTHER_OBJECTS = 132
"""Kinds of objects below are those that binlog.h names; 10 is the container, which no container holds."""
SMALLEST_FRAME_OBJECT = 36
LARGEST_OBJECT = 1 << 24
SIGNATURE = int.from_bytes(b"LOBJ", "little")
NAMED_CHANNELS = 1 << 16
LATEST_S = 1e11
"""Times beyond are no times: a double could not tell samples apart."""

FD_LENGTH = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64], np.uint8)


@inline
def byte(b: Bytes, i: int) -> int:
    """Byte i. By an unsigned place: a signed one is tested each time for counting from the end, which costs a scan a third of its speed."""
    return b[u64(i)]  # type: ignore[no-any-return]


@inline
def _u16(b: Bytes, i: int) -> int:
    return i64(byte(b, i)) | i64(byte(b, i + 1)) << 8


@inline
def _u32(b: Bytes, i: int) -> int:
    return i64(byte(b, i)) | i64(byte(b, i + 1)) << 8 | i64(byte(b, i + 2)) << 16 | i64(byte(b, i + 3)) << 24


@inline
def _u64(b: Bytes, i: int) -> Any:
    return u64(_u32(b, i)) | u64(_u32(b, i + 4)) << u64(32)


@inline
def _seconds(ticks: Any, per_second: Any) -> float:
    """ticks / per_second as the nearest double, ties to even, for every 64-bit count (beyond 2^53 a plain division rounds twice)."""
    if ticks < u64(1 << 53):
        return float(ticks) / float(per_second)
    whole = ticks // per_second
    rest = ticks % per_second
    shift = u64(53)  # bits of the significand behind the point
    top = whole
    while top != u64(0):
        top >>= u64(1)
        shift -= u64(1)
    rest <<= shift  # whole has at least 30 bits here, so this stays under 2^53
    significand = (whole << shift) + rest // per_second
    twice = u64(2) * (rest % per_second)
    if twice > per_second or (twice == per_second and significand & u64(1)):
        significand += u64(1)
    return float(significand) / float(u64(1) << shift)


@inline
def _copy(b: Bytes, start: int, count: int, data: Bytes, row: int) -> None:
    for k in range(data.shape[1]):
        data[row, k] = 0
    for k in range(count):
        data[row, k] = byte(b, start + k)


@inline
def _driver_error(data: Bytes, row: int) -> None:
    """Data of SocketCAN from channel (2 bytes), counters (sent, received) and code (4 bytes); the code comes into bytes 2 to 5."""
    sent, received = data[row, 2], data[row, 3]
    data[row, 0] = 0
    data[row, 1] = (0x20 if sent >= 128 else 0x08 if sent >= 96 else 0) | (0x10 if received >= 128 else 0x04 if received >= 96 else 0)
    for k in range(2, 6):
        data[row, k] = data[row, k + 2]
    data[row, 6], data[row, 7] = sent, received


@inline
def put(out: Columns, row: int, time_s: float, identifier: int, flags: int, length: int, channel: int) -> None:
    """Write all of a frame but its data into a row of the columns."""
    out[0][row] = time_s
    out[1][row] = identifier
    out[2][row] = flags
    out[3][row] = length
    out[5][row] = channel


@kernel
def scan_blf(
    b: Bytes, start_s: float, out: Columns, places: NDArray[np.int32], places_used: int, known: IntArray
) -> tuple[int, int, int, int]:
    """Frames of the objects in b, the unpacked content of log containers.

    b (k,) uint8; start_s is added to each time; out the columns; places (65536,) int32, index of each channel number or -1, and
    places_used how many it holds, both carried on; known (132,) counts objects of other kinds by their number. Returns (frames, bytes used,
    status, places_used); ODD at the start of an object of an unknown kind or header.
    """
    data = out[4]
    width = data.shape[1]
    end = len(b)
    n = 0
    pos = 0
    while True:
        # the next object starts within the padding of the last: at most four bytes on
        at = pos
        while at <= pos + 4 and at + 4 <= end and _u32(b, at) != SIGNATURE:
            at += 1
        if at > pos + 4 or at + 4 > end:
            return n, pos, BROKEN if pos + 8 <= end else DONE, places_used
        if at + 16 > end:
            return n, pos, DONE, places_used
        header_size, version, size, kind = _u16(b, at + 4), _u16(b, at + 6), _u32(b, at + 8), _u32(b, at + 12)
        if size < 16 or size > LARGEST_OBJECT:
            return n, pos, BROKEN, places_used
        following = at + size
        if following > end:
            return n, pos, DONE, places_used
        is_frame = kind in (CAN_MESSAGE, CAN_MESSAGE2, CAN_FD_MESSAGE, CAN_FD_MESSAGE_64, CAN_ERROR_EXT, CAN_ERROR, CAN_FD_ERROR_64)
        if kind in DRIVER_ERRORS and 0 < version < 4:
            i = at + (40 if version == 2 else 32)
            # counters (sent, received) and the code of the driver; all zero: the controller is well
            is_frame = i + 8 <= following and (byte(b, i + 2) | byte(b, i + 3) | _u32(b, i + 4)) != 0
        if not is_frame and 0 < kind < OTHER_OBJECTS and kind != 10:
            known[kind] += 1
            pos = following
            continue
        if not is_frame or version < 1 or version > 3:
            return n, at, ODD, places_used
        i = at + (40 if version == 2 else 32)
        if kind == CAN_FD_MESSAGE:
            needed = 84
        elif kind == CAN_FD_ERROR_64:
            needed = 44
        elif kind == CAN_ERROR:
            needed = 4
        elif kind == CAN_FD_MESSAGE_64:
            needed = 40
        elif kind == CAN_ERROR_EXT:
            needed = 32
        elif kind in DRIVER_ERRORS:
            needed = 8
        else:
            needed = 16
        if i + needed > following:
            return n, pos, BROKEN, places_used
        per_second = u64(100_000) if _u32(b, at + 16) == 1 else u64(1_000_000_000)
        mark = 0
        if kind == CAN_FD_MESSAGE_64:
            number = i64(byte(b, i))
            wanted, valid = i64(byte(b, i + 1)), i64(byte(b, i + 2))
            raw = _u32(b, i + 4)
            fd_flags = _u32(b, i + 12)
            mark |= REMOTE if fd_flags & 0x0010 else 0
            mark |= FD if fd_flags & 0x1000 else 0
            mark |= BITRATE_SWITCH if fd_flags & 0x2000 else 0
            mark |= ERROR_STATE if fd_flags & 0x4000 else 0
            mark |= SENT if byte(b, i + 34) else 0
            wanted = i64(FD_LENGTH[wanted]) if wanted < 16 else 64
            beyond = i64(byte(b, i + 35))
            start = i + 40
            # the object may contain fewer bytes than it states; the rest is zero, as Vector's library reads it
            count = max(0, min(valid, (beyond if beyond else size) - header_size - 40))
            if valid > 64 or start + count > following:
                return n, pos, BROKEN, places_used
        elif kind == CAN_FD_MESSAGE:
            number = _u16(b, i)
            wanted = i64(byte(b, i + 3))
            raw = _u32(b, i + 4)
            mark |= REMOTE if byte(b, i + 2) & 0x80 else 0
            mark |= SENT if byte(b, i + 2) & 1 else 0
            mark |= FD if byte(b, i + 13) & 1 else 0
            mark |= BITRATE_SWITCH if byte(b, i + 13) & 2 else 0
            mark |= ERROR_STATE if byte(b, i + 13) & 4 else 0
            wanted = i64(FD_LENGTH[wanted]) if wanted < 16 else 64
            valid = min(i64(byte(b, i + 14)), 64)
            start, count = i + 20, valid
        elif kind == CAN_FD_ERROR_64:
            number = i64(byte(b, i))
            raw = _u32(b, i + 16)
            mark |= ERROR
            valid = min(i64(byte(b, i + 2)), 64)
            start = i + 44
            count = max(0, min(valid, following - start))
            wanted = valid
        elif kind == CAN_ERROR:
            number = _u16(b, i)
            raw = i64(0)
            mark |= ERROR
            valid = wanted = count = i64(0)
            start = i
        elif kind == CAN_ERROR_EXT:
            number = _u16(b, i)
            wanted = i64(byte(b, i + 10))
            raw = _u32(b, i + 16)
            mark |= ERROR
            valid = min(wanted, 8)
            start, count = i + 24, valid
            # no flag: nothing of Vector's is valid, and the identifier of SocketCAN's error frames (of 8 bytes) is their class
            if _u32(b, i + 4) == 0 and wanted == 8 and 0 < raw & 0x1FFFFFFF <= LARGEST_CLASS:
                mark |= CLASSED
        elif kind in DRIVER_ERRORS:
            number = _u16(b, i)
            raw = i64(0x204)  # state of the controller, counters
            mark |= ERROR | CLASSED
            valid = wanted = count = i64(8)
            start = i
        else:
            number = _u16(b, i)
            wanted = i64(byte(b, i + 3))
            raw = _u32(b, i + 4)
            mark |= REMOTE if byte(b, i + 2) & 0x80 else 0
            mark |= SENT if byte(b, i + 2) & 1 else 0
            valid = min(wanted, 8)
            start, count = i + 8, valid
        mark |= EXTENDED if raw & 0x80000000 else 0
        if mark & REMOTE:
            valid, count = wanted, 0
        if count > width or (valid > width and not mark & REMOTE):
            return n, pos, WIDE, places_used
        seconds = _seconds(_u64(b, at + 24), per_second)
        if seconds > LATEST_S:
            return n, pos, BROKEN, places_used
        if places[number] < 0:
            places[number] = places_used
            places_used += 1
        put(out, n, seconds + start_s, raw & 0x1FFFFFFF, mark, valid, places[number])
        _copy(b, start, count, data, n)
        if kind in DRIVER_ERRORS:
            _driver_error(data, n)
        n += 1
        pos = following


KEY, MASK, FIRST_BIT, BITS, BIG_ENDIAN, SIGNED, BEHIND = range(7)
FIELD_COLUMNS = 7
"""Columns of a field: see `extract`."""


@inline
def _little(data: Bytes, row: int, first: int, bits: int) -> Any:
    """The bits from bit `first` on, counted from the lowest bit of byte 0 upwards; the first is the lowest."""
    at, shift = first >> 3, first & 7
    value = u64(data[u64(row), u64(at)]) >> u64(shift)
    got = 8 - shift
    while got < bits:
        at += 1
        value |= u64(data[u64(row), u64(at)]) << u64(got)
        got += 8
    return value


@inline
def _big(data: Bytes, row: int, first: int, bits: int) -> Any:
    """The bits from bit `first` on, counted from the highest bit of byte 0 downwards; the first is the highest."""
    at, shift = first >> 3, first & 7
    value = u64(data[u64(row), u64(at)]) & u64(0xFF >> shift)
    got = 8 - shift
    while got + 8 <= bits:
        at += 1
        value = value << u64(8) | u64(data[u64(row), u64(at)])
        got += 8
    if got < bits:
        left = bits - got
        return value << u64(left) | u64(data[u64(row), u64(at + 1)]) >> u64(8 - left)
    return value >> u64(got - bits)


@inline
def _carried(before: int, after: int, bits: int, upper_before: int, upper_after: int) -> bool:
    """Whether a field of `bits` passes its end between two readings and the byte behind it counts on by one the same way."""
    half = i64(1) << bits - 1
    step = (after & 2 * half - 1) - (before & 2 * half - 1)
    if abs(step) <= half:
        return False
    return (upper_after - upper_before) & 0xFF == (1 if step < 0 else 0xFF)


@kernel
def extract(frames: Columns, fields: IntArray, sync_key: int) -> Any:
    """Integers at given places of given frames, in the order of the frames, and the positions of the SYNCs among them.

    frames: columns of n frames. fields (m, 7): key and mask, a frame being meant where (identifier + 2^29 if extended) & mask = key; first
    bit, bits (1 to 64), 1 for big-endian, 1 for signed; the byte in which the counter would go on if it were wider, or -1. The first bit
    counts from the lowest bit of byte 0 upwards, or where big-endian from the highest bit of byte 0 downwards. sync_key: key of SYNC
    frames, -1 for none. Remote and error frames carry no values.

    Returns (k,) each: positions of the frames, indices of the fields, values (an unsigned value of 64 bits as the same bits), how many
    SYNCs come before; (m,) each: how many frames were too short to hold the field, how often the byte behind carried on; (s,) positions
    of the SYNCs.
    """
    _, identifier, flags, length, data, _ = frames
    n, m = len(identifier), len(fields)
    short, wider = np.zeros(m, np.int64), np.zeros(m, np.int64)
    last = np.full(m, -1)
    key, mask = fields[:, KEY].copy(), fields[:, MASK].copy()
    together = 0  # fields that one frame can carry at most
    for j in range(m):
        count = 0
        for k in range(m):
            count += (key[j] ^ key[k]) & mask[j] & mask[k] == 0
        together = max(together, count)
    room = n * together
    row, index, values, window = np.empty(room, np.int64), np.empty(room, np.int16), np.empty(room, np.int64), np.empty(room, np.int64)
    syncs = np.empty(n, np.int64)
    at = seen = 0
    for i in range(n):
        if flags[i] & (REMOTE | ERROR):
            continue
        name = i64(identifier[i]) | (i64(1) << 29 if flags[i] & EXTENDED else i64(0))
        if name == sync_key:
            syncs[seen] = i
            seen += 1
        for j in range(m):
            if name & mask[j] != key[j]:
                continue
            first, bits = fields[j, FIRST_BIT], fields[j, BITS]
            if first + bits > i64(length[i]) * 8 or first + bits > 8 * data.shape[1]:
                short[j] += 1
                continue
            value = _big(data, i, first, bits) if fields[j, BIG_ENDIAN] else _little(data, i, first, bits)
            lift = u64(64 - bits)  # the field's highest bit to the word's, and back: clears what is above, or repeats the sign
            values[at] = i64(value << lift) >> i64(lift) if fields[j, SIGNED] else i64(value << lift >> lift)
            row[at] = i
            index[at] = j
            window[at] = seen
            behind = fields[j, BEHIND]
            if 0 <= behind < min(i64(length[i]), data.shape[1]):
                before = last[j]
                if before >= 0 and _carried(values[before], values[at], bits, i64(data[row[before], behind]), i64(data[i, behind])):
                    wider[j] += 1
                last[j] = at
            else:
                last[j] = -1
            at += 1
    return row[:at], index[:at], values[:at], window[:at], short, wider, syncs[:seen]


@kernel
def tabulate(window: IntArray, field: NDArray[np.int16], value: IntArray, m: int, total: int) -> Any:
    """Readings as a table: (m, total) the first value of each field and window, 0 where there is none, and (m, total) how many there are.

    window, field and value (k,): the column and the row of each reading, and its value.
    """
    first, many = np.zeros((m, total), np.int64), np.zeros((m, total), np.int64)
    for k in range(len(window)):
        c, w = field[k], window[k]
        if many[c, w] == 0:
            first[c, w] = value[k]
        many[c, w] += 1
    return first, many
