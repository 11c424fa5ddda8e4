"""Scan of ASC and candump log lines into the columns of `lmeasure.kernels.frames`.

A line that is plainly a frame is read, one that is plainly none is passed over; at anything else the scan stops with ODD and leaves the
line to the caller. It also stops where the columns are full. What it reads is bit for bit what python-can's readers make of the same line.
The text must end with a line end, which no token contains: that is what keeps every loop inside the text.
"""

import numpy as np
from numpy.typing import NDArray

from lmeasure.kernels import inline, kernel
from lmeasure.kernels.frames import (
    BITRATE_SWITCH,
    DONE,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    LATEST_S,
    ODD,
    REMOTE,
    SENT,
    WIDE,
    Bytes,
    Columns,
    byte,
    i64,
)

LARGEST_EXACT = 1 << 53
LARGEST_CHANNEL = 65535
NAME_BYTES = 32
NAMES = 64

POWERS = 10.0 ** np.arange(23)  # every one exact, so that significand / power is the nearest double
POWERS_OF_TEN = 10 ** np.arange(19)
TICKS = 10 ** np.arange(9, -1, -1)  # nanoseconds of the last digit

NIBBLE = np.array([int(chr(c), 16) if chr(c) in "0123456789abcdefABCDEF" else -1 for c in range(256)], np.int8)


@inline
def _digit(c: int) -> bool:
    return 48 <= c <= 57


@inline
def _blank(c: int) -> bool:
    return c == 32 or c == 9


@inline
def _line_end(c: int) -> bool:
    return c == 10 or c == 13


@inline
def _parted(c: int) -> bool:
    return c == 32 or c == 9 or c == 10 or c == 13


@inline
def _odd(c: int) -> bool:
    """Not printable ASCII and no blank: Python may take it for a blank, or may not be able to read it."""
    return c > 126 or (c < 32 and c != 9 and c != 10 and c != 13)


@inline
def _skip_blanks(b: Bytes, i: int) -> int:
    while _blank(byte(b, i)):
        i += 1
    return i


@inline
def _skip_line(b: Bytes, i: int) -> int:
    while not _line_end(byte(b, i)):
        i += 1
    return i


@inline
def _digits(b: Bytes, i: int) -> tuple[int, int]:
    """Decimal digits from i on: (end, value); the value means nothing where there are more than 18."""
    value = i64(0)
    while _digit(byte(b, i)):
        value = value * 10 + (i64(byte(b, i)) - 48)
        i += 1
    return i, value


@inline
def _decimal(b: Bytes, i: int) -> tuple[int, int, int]:
    """Digits, a point and digits from i on: (end, significand, digits behind the point); the significand is -1 where it is not exact or
    not such a number. A point without digits behind it gives 0 of them."""
    point, whole = _digits(b, i)
    if point == i or byte(b, point) != 46:
        return point, i64(-1), 0
    end, part = _digits(b, point + 1)
    behind = end - point - 1
    if behind > 18 or point - i + behind > 18:
        return end, i64(-1), behind
    significand = whole * POWERS_OF_TEN[behind] + part
    return end, significand if significand < LARGEST_EXACT else i64(-1), behind


@inline
def _integer(b: Bytes, i: int, base: int) -> tuple[int, int]:
    """Digits in the base from i on: (end, value); the value is -1 without a digit, or where it passes 2^32."""
    value = i64(0)
    start = i
    while True:
        digit = i64(NIBBLE[byte(b, i)])
        if digit < 0 or digit >= base:
            break
        if value < 1 << 32:
            value = value * base + digit
        i += 1
    if i == start or value >= 1 << 32:
        return i, i64(-1)
    return i, value


@kernel
def line_stop(b: Bytes, i: int) -> int:
    """Where the line in which place i stands ends."""
    return _skip_line(b, i)


@inline
def _is(b: Bytes, i: int, word: Bytes) -> bool:
    """Whether the word stands at i; it compares no further than the first difference, so never past a line end."""
    k = 0
    while k < len(word) and byte(b, i + k) == word[k]:
        k += 1
    return k == len(word)


@inline
def _direction(b: Bytes, i: int) -> int:
    """0 for Rx, SENT for Tx, -1 for anything else, at a token."""
    if byte(b, i) == 82 and byte(b, i + 1) == 120 and _blank(byte(b, i + 2)):
        return 0
    if byte(b, i) == 84 and byte(b, i + 1) == 120 and _blank(byte(b, i + 2)):
        return SENT
    return -1


@inline
def _asc_identifier(b: Bytes, i: int, base: int) -> tuple[int, int, int]:
    """(end, identifier, EXTENDED or 0); the identifier is -1 where the token is none."""
    i, value = _integer(b, i, base)
    mark = 0
    if byte(b, i) == 120 or byte(b, i) == 88:
        mark = EXTENDED
        i += 1
    if not _blank(byte(b, i)) or value > 0x1FFFFFFF:
        value = i64(-1)
    return i, value, mark


@inline
def _clear(data: Bytes, row: int) -> None:
    for k in range(data.shape[1]):
        data[row, k] = 0


@inline
def _asc_bytes(b: Bytes, i: int, base: int, count: int, data: Bytes, row: int) -> int:
    """count data bytes, each after a blank: the place behind them, or -1."""
    _clear(data, row)
    for k in range(count):
        if not _blank(byte(b, i)):
            return -1
        i = _skip_blanks(b, i)
        start = i
        i, value = _integer(b, i, base)
        if value < 0 or value > 255 or i - start > 3 or not _parted(byte(b, i)):
            return -1
        data[row, k] = value
    return i


ERROR_FRAME = np.frombuffer(b"ErrorFrame", np.uint8)
CAN_FD = np.frombuffer(b"CANFD", np.uint8)


@inline
def _asc_classic(b: Bytes, i: int, base: int, data: Bytes, row: int) -> tuple[int, int, int, int]:
    """Identifier, direction and data from i on: (end or -1, identifier, flags, length)."""
    if _is(b, i, ERROR_FRAME) and _parted(byte(b, i + 10)):
        _clear(data, row)
        return i, i64(0), ERROR | EXTENDED, 0
    i, value, mark = _asc_identifier(b, i, base)
    if value < 0:
        return -1, value, mark, 0
    i = _skip_blanks(b, i)
    sent = _direction(b, i)
    if sent < 0:
        return -1, value, mark, 0
    mark |= sent
    i = _skip_blanks(b, i + 2)
    if byte(b, i) == 100 and _blank(byte(b, i + 1)):
        i, length = _integer(b, _skip_blanks(b, i + 1), base)
        if length < 0 or length > 8 or not _parted(byte(b, i)):
            return -1, value, mark, 0
        return _asc_bytes(b, i, base, length, data, row), value, mark, length
    if byte(b, i) == 114 and _blank(byte(b, i + 1)):
        i, length = _integer(b, _skip_blanks(b, i + 1), 10)
        if length < 0 or length > 8 or not _parted(byte(b, i)):
            return -1, value, mark, 0
        _clear(data, row)
        return i, value, mark | REMOTE, length
    return -1, value, mark, 0


@inline
def _asc_fd(b: Bytes, i: int, base: int, data: Bytes, row: int) -> tuple[int, int, int, int]:
    """Direction, identifier and data of a CANFD line from i on: as `_asc_classic`, the end -2 for a payload wider than data."""
    mark = FD
    sent = _direction(b, i)
    if sent < 0:
        return -1, i64(-1), mark, 0
    mark |= sent
    i = _skip_blanks(b, i + 2)
    if _is(b, i, ERROR_FRAME) and _parted(byte(b, i + 10)):
        _clear(data, row)
        return i, i64(0), mark | ERROR | EXTENDED, 0
    i, value, extended = _asc_identifier(b, i, base)
    if value < 0:
        return -1, value, mark, 0
    mark |= extended
    i = _skip_blanks(b, i)
    if not _digit(byte(b, i)):  # the message's name
        while 32 < byte(b, i) < 127:
            i += 1
        if not _blank(byte(b, i)):
            return -1, value, mark, 0
        i = _skip_blanks(b, i)
    for bit in (BITRATE_SWITCH, ERROR_STATE):
        if not ((byte(b, i) == 48 or byte(b, i) == 49) and _blank(byte(b, i + 1))):
            return -1, value, mark, 0
        mark |= bit if byte(b, i) == 49 else 0
        i = _skip_blanks(b, i + 1)
    i, code = _integer(b, i, base)
    if code < 0 or code > 15 or not _blank(byte(b, i)):
        return -1, value, mark, 0
    i, length = _integer(b, _skip_blanks(b, i), 10)
    if length < 0 or length > 64 or not _blank(byte(b, i)):
        return -1, value, mark, 0
    after = _skip_blanks(b, i)
    if _line_end(byte(b, after)) or _odd(byte(b, after)):
        return -1, value, mark, 0
    if length == 0:
        _clear(data, row)
        return i, value, mark | REMOTE, code
    if length > data.shape[1]:
        return -2, value, mark, length
    return _asc_bytes(b, i, base, length, data, row), value, mark, length


@kernel
def scan_asc(
    b: Bytes, start_s: float, base: int, since: int, out: Columns, places: NDArray[np.int32], places_used: int
) -> tuple[int, int, int, int, int]:
    """Frames of the ASC lines in b, which ends with a line end.

    b (k,) uint8; base 10 or 16; start_s is added to each time; since is -1 for times from the start of the measurement, or the
    nanoseconds reached where each time counts from the event before; out, places and places_used as for `scan_blf`. Returns (frames,
    bytes used, status, places_used, since); where the columns are full it stops.
    """
    time, identifier, flags, length, data, channel = out
    end = len(b)
    n = 0
    pos = 0
    while pos < end and n < len(time):
        line = pos
        i = _skip_blanks(b, pos)
        c = byte(b, i)
        if not _digit(c):
            # Begin and End TriggerBlock are the caller's
            if _odd(c) or c == 66 or c == 98 or c == 69 or c == 101:
                return n, line, ODD, places_used, since
            pos = _skip_line(b, i) + 1
            continue
        i, ticks, digits = _decimal(b, i)
        if ticks < 0 or digits == 0 or not _blank(byte(b, i)):
            if _odd(byte(b, i)) or digits > 0:
                return n, line, ODD, places_used, since
            pos = _skip_line(b, i) + 1
            continue
        event = since
        seconds = float(ticks) / POWERS[digits]
        if since >= 0:
            if digits > 9 or ticks > (1 << 61) // TICKS[digits] or since > 1 << 61:
                return n, line, ODD, places_used, since
            event = since + ticks * TICKS[digits]
            seconds = float(event) / 1e9
        if seconds > LATEST_S:
            return n, line, ODD, places_used, since
        i = _skip_blanks(b, i)
        c = byte(b, i)
        number = i64(-1)
        is_fd = False
        if _digit(c):
            i, number = _integer(b, i, 10)
            if number < 0 or number > LARGEST_CHANNEL or not _blank(byte(b, i)):
                return n, line, ODD, places_used, since
        elif _is(b, i, CAN_FD) and _blank(byte(b, i + 5)):
            i, number = _integer(b, _skip_blanks(b, i + 5), 10)
            if number < 0 or number > LARGEST_CHANNEL or not _blank(byte(b, i)):
                return n, line, ODD, places_used, since
            is_fd = True
        else:
            while 32 < byte(b, i) < 127:
                i += 1
            if _odd(byte(b, i)):
                return n, line, ODD, places_used, since
            since = event
            pos = _skip_line(b, i) + 1
            continue
        i = _skip_blanks(b, i)
        if is_fd:
            i, value, mark, count = _asc_fd(b, i, base, data, n)
        else:
            i, value, mark, count = _asc_classic(b, i, base, data, n)
        if i == -2:
            return n, line, WIDE, places_used, since
        if i < 0:
            return n, line, ODD, places_used, since
        if places[number] < 0:
            places[number] = places_used
            places_used += 1
        time[n] = seconds + start_s
        identifier[n] = value
        flags[n] = mark
        length[n] = count
        channel[n] = places[number]
        n += 1
        since = event
        pos = _skip_line(b, i) + 1
    return n, pos, DONE, places_used, since


ERROR_FLAG, BUS_ERROR = 0x20000000, 0x80


@inline
def _name(b: Bytes, i: int, names: Bytes, lengths: NDArray[np.int64], used: int) -> tuple[int, int, int]:
    """Place of the channel name that stands at i, entering a new one: (end, place or -1 where it is not plain or too long, used)."""
    start = i
    while 32 < byte(b, i) < 127:
        i += 1
    size = i - start
    # python-can takes digits for a number, in which leading zeros say nothing
    if size == 0 or size > names.shape[1] or not _blank(byte(b, i)) or (byte(b, start) == 48 and size > 1):
        return i, -1, used
    for place in range(used):
        if lengths[place] == size:
            k = 0
            while k < size and names[place, k] == byte(b, start + k):
                k += 1
            if k == size:
                return i, place, used
    if used == len(names):
        return i, -1, used
    for k in range(size):
        names[used, k] = byte(b, start + k)
    lengths[used] = size
    return i, used, used + 1


@inline
def _candump_data(b: Bytes, i: int, data: Bytes, row: int) -> tuple[int, int]:
    """Pairs of hexadecimal digits: (end, or -1 where a digit stands alone, or -2 for more than the columns hold; bytes)."""
    width = data.shape[1]
    _clear(data, row)
    count = i64(0)
    while True:
        high = NIBBLE[byte(b, i)]
        if high < 0:
            return i, count
        low = NIBBLE[byte(b, i + 1)]
        if low < 0:
            return -1, count
        if count == width:
            return -2 if width < 64 else -1, count
        data[row, count] = high * 16 + low
        count += 1
        i += 2


@kernel
def scan_candump(b: Bytes, out: Columns, names: Bytes, lengths: NDArray[np.int64], used: int) -> tuple[int, int, int, int]:
    """Frames of the `candump -L` lines in b, which ends with a line end: `(1234.567890) can0 181#0102030405060708`, and R or T behind it.

    b (k,) uint8; out as for `scan_blf`; names (64, 32) uint8 and lengths (64,) int64 hold the channel names found, used how many, all
    carried on. Returns (frames, bytes used, status, used).
    """
    time, identifier, flags, length, data, channel = out
    end = len(b)
    n = 0
    pos = 0
    while pos < end and n < len(time):
        line = pos
        i = _skip_blanks(b, pos)
        if _line_end(byte(b, i)):
            pos = i + 1
            continue
        if byte(b, i) != 40:
            return n, line, ODD, used
        i, ticks, digits = _decimal(b, i + 1)
        if ticks < 0 or byte(b, i) != 41 or not _blank(byte(b, i + 1)):
            return n, line, ODD, used
        seconds = float(ticks) / POWERS[digits]
        if seconds > LATEST_S:
            return n, line, ODD, used
        i, place, used = _name(b, _skip_blanks(b, i + 1), names, lengths, used)
        if place < 0:
            return n, line, ODD, used
        i = _skip_blanks(b, i)
        start = i
        i, raw = _integer(b, i, 16)
        if raw < 0 or byte(b, i) != 35 or i - start > 8:
            return n, line, ODD, used
        mark = EXTENDED if i - start > 3 else 0
        i += 1
        if byte(b, i) == 35:
            if not _digit(byte(b, i + 1)):
                return n, line, ODD, used
            switches = byte(b, i + 1) - 48
            mark |= FD | (BITRATE_SWITCH if switches & 1 else 0) | (ERROR_STATE if switches & 2 else 0)
            i += 2
        if (byte(b, i) == 82 or byte(b, i) == 114) and not mark & FD:
            mark |= REMOTE
            count = i64(0)
            if _digit(byte(b, i + 1)):
                i, count = _integer(b, i + 1, 10)
                if count < 0 or count > 8:
                    return n, line, ODD, used
            else:
                i += 1
            _clear(data, n)
        else:
            i, count = _candump_data(b, i, data, n)
            if i == -2:
                return n, line, WIDE, used
            if i < 0 or (count > 8 and not mark & FD):
                return n, line, ODD, used
        if not _parted(byte(b, i)):
            return n, line, ODD, used
        i = _skip_blanks(b, i)
        if not _line_end(byte(b, i)):
            c = byte(b, i)
            if c == 84 or c == 116:
                mark |= SENT
            elif c != 82 and c != 114:
                return n, line, ODD, used
            if byte(b, i - 1) != 32:  # python-can takes a direction behind a tab for a fourth word
                return n, line, ODD, used
            i = _skip_blanks(b, i + 1)
            if not _line_end(byte(b, i)):
                return n, line, ODD, used
        if raw & ERROR_FLAG:
            mark |= ERROR
            if raw & BUS_ERROR:
                raw, mark, count = i64(0), ERROR | EXTENDED, i64(0)
                _clear(data, n)
        time[n] = seconds
        identifier[n] = raw & 0x1FFFFFFF
        flags[n] = mark
        length[n] = count
        channel[n] = place
        n += 1
        pos = i + 1
    return n, pos, DONE, used
