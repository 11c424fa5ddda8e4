"""Scan of ASC log lines into the columns of `lmeasure.kernels.frames`.

A line that is plainly a frame is read, a blank one, a comment and an event of a known name are counted; at anything else the scan stops
with ODD and leaves the line to the caller. It also stops where the columns are full. It reads bit for bit what python-can's reader does,
wherever that reads a line.
"""

import numpy as np
from numpy.typing import NDArray

from lmeasure.core import IntArray
from lmeasure.kernels.decorators import inline, kernel
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
    put,
)
from lmeasure.kernels.log_text import (
    POWERS,
    clear,
    decimal,
    integer,
    is_blank,
    is_digit,
    is_line_end,
    is_odd,
    is_parted,
    is_word,
    next_line,
    skip_blanks,
    skip_line,
)

LARGEST_CHANNEL = 65535
LARGEST_STANDARD = 0x7FF
TICKS = 10 ** np.arange(9, -1, -1)  # nanoseconds of the last digit
EVENTS = ("SV:", "TFS:", "J1939TP", "ETH", "Li", "L1", "L2", "Fr", "GPS-Event:", "GMMarker", "Comment:", "AL:")
"""Words behind the time of an event that is no frame; the scan counts them as known[2 + place]."""
LONGEST_EVENT = max(map(len, EVENTS))
EVENT_WORDS = np.array([list(word.encode().ljust(LONGEST_EVENT, b" ")) for word in EVENTS], np.uint8)
EVENT_LENGTHS = np.array([len(word) for word in EVENTS])


@inline
def _direction(b: Bytes, i: int) -> int:
    """0 for Rx, SENT for Tx, -1 for anything else, at a token."""
    if byte(b, i) == 82 and byte(b, i + 1) == 120 and is_blank(byte(b, i + 2)):
        return 0
    if byte(b, i) == 84 and byte(b, i + 1) == 120 and is_blank(byte(b, i + 2)):
        return SENT
    return -1


@inline
def _identifier(b: Bytes, i: int, base: int) -> tuple[int, int, int]:
    """(end, identifier, EXTENDED or 0); the identifier is -1 where the token is none."""
    i, value = integer(b, i, base)
    mark = 0
    if byte(b, i) == 120 or byte(b, i) == 88:
        mark = EXTENDED
        i += 1
    if not is_blank(byte(b, i)) or value > (0x1FFFFFFF if mark else LARGEST_STANDARD):
        value = i64(-1)
    return i, value, mark


@inline
def _stated(b: Bytes, i: int) -> tuple[int, int, int]:
    """Identifier that the rest of the line states as `ID = 385` or `ID = 419365136x`: (place behind it, identifier or -1, mark)."""
    while not is_line_end(byte(b, i)):
        if byte(b, i) == 73 and byte(b, i + 1) == 68 and is_blank(byte(b, i - 1)):
            k = skip_blanks(b, i + 2)
            if byte(b, k) == 61:
                k, value = integer(b, skip_blanks(b, k + 1), 10)
                mark = EXTENDED if byte(b, k) == 120 or byte(b, k) == 88 else 0
                k += 1 if mark else 0
                sound = is_parted(byte(b, k)) and value <= (0x1FFFFFFF if mark else LARGEST_STANDARD)
                return k, value if sound else i64(-1), mark
        i += 1
    return i, i64(-1), 0


@inline
def _data_bytes(b: Bytes, i: int, base: int, count: int, data: Bytes, row: int) -> int:
    """count data bytes, each after a blank: the place behind them, or -1."""
    clear(data, row)
    for k in range(count):
        if not is_blank(byte(b, i)):
            return -1
        i = skip_blanks(b, i)
        start = i
        i, value = integer(b, i, base)
        if value < 0 or value > 255 or i - start > 3 or not is_parted(byte(b, i)):
            return -1
        data[row, k] = value
    return i


ERROR_FRAME = np.frombuffer(b"ErrorFrame", np.uint8)
CAN_FD = np.frombuffer(b"CANFD", np.uint8)


@inline
def _classic(b: Bytes, i: int, base: int, data: Bytes, row: int) -> tuple[int, int, int, int]:
    """Identifier, direction and data from i on: (end or -1, identifier, flags, length)."""
    if is_word(b, i, ERROR_FRAME) and is_parted(byte(b, i + 10)):
        clear(data, row)
        return i, i64(0), ERROR | EXTENDED, 0
    # a message's name begins with a letter, and the line states its identifier behind the data
    named = not is_digit(byte(b, i))
    i, value, mark = _identifier(b, i, base)
    if value < 0:
        if not named:
            return -1, value, mark, 0
        while 32 < byte(b, i) < 127:
            i += 1
        if not is_blank(byte(b, i)):
            return -1, value, mark, 0
    i = skip_blanks(b, i)
    sent = _direction(b, i)
    if sent < 0:
        return -1, value, mark, 0
    i = skip_blanks(b, i + 2)
    kind = byte(b, i)
    if (kind != 100 and kind != 114) or not is_blank(byte(b, i + 1)):
        return -1, value, mark, 0
    i, length = integer(b, skip_blanks(b, i + 1), base if kind == 100 else 10)
    if length < 0 or length > 8 or not is_parted(byte(b, i)):
        return -1, value, mark, 0
    if kind == 100:
        i = _data_bytes(b, i, base, length, data, row)
        if i < 0:
            return -1, value, mark, 0
    else:
        clear(data, row)
        sent |= REMOTE
    i, stated, extended = _stated(b, i)
    if stated >= 0 and (named or value < 0):
        value, mark = stated, extended
    if value < 0 or (stated >= 0 and (stated != value or extended != mark)):
        return -1, value, mark, 0
    return i, value, mark | sent, length


@inline
def _fd(b: Bytes, i: int, base: int, data: Bytes, row: int) -> tuple[int, int, int, int]:
    """Direction, identifier and data of a CANFD line from i on: as `_classic`, the end -2 for a payload wider than data."""
    mark = FD
    sent = _direction(b, i)
    if sent < 0:
        return -1, i64(-1), mark, 0
    mark |= sent
    i = skip_blanks(b, i + 2)
    if is_word(b, i, ERROR_FRAME) and is_parted(byte(b, i + 10)):
        clear(data, row)
        return i, i64(0), mark | ERROR | EXTENDED, 0
    i, value, extended = _identifier(b, i, base)
    if value < 0:
        return -1, value, mark, 0
    mark |= extended
    i = skip_blanks(b, i)
    if not is_digit(byte(b, i)):  # the message's name
        while 32 < byte(b, i) < 127:
            i += 1
        if not is_blank(byte(b, i)):
            return -1, value, mark, 0
        i = skip_blanks(b, i)
    for bit in (BITRATE_SWITCH, ERROR_STATE):
        if not ((byte(b, i) == 48 or byte(b, i) == 49) and is_blank(byte(b, i + 1))):
            return -1, value, mark, 0
        mark |= bit if byte(b, i) == 49 else 0
        i = skip_blanks(b, i + 1)
    i, code = integer(b, i, base)
    if code < 0 or code > 15 or not is_blank(byte(b, i)):
        return -1, value, mark, 0
    i, length = integer(b, skip_blanks(b, i), 10)
    if length < 0 or length > 64 or not is_blank(byte(b, i)):
        return -1, value, mark, 0
    after = skip_blanks(b, i)
    if is_line_end(byte(b, after)) or is_odd(byte(b, after)):
        return -1, value, mark, 0
    if length == 0:
        clear(data, row)
        return i, value, mark | REMOTE, code
    if length > data.shape[1]:
        return -2, value, mark, length
    return _data_bytes(b, i, base, length, data, row), value, mark, length


@inline
def _event(b: Bytes, i: int) -> int:
    """Place in EVENTS of the word at i, -1 where it is none of them."""
    for k in range(len(EVENT_LENGTHS)):
        if is_word(b, i, EVENT_WORDS[k, : EVENT_LENGTHS[k]]) and is_blank(byte(b, i + EVENT_LENGTHS[k])):
            return k
    return -1


@kernel
def scan_asc(
    b: Bytes,
    start_s: float,
    base: int,
    relative: bool,
    since: int,
    out: Columns,
    places: NDArray[np.int32],
    places_used: int,
    known: IntArray,
) -> tuple[int, int, int, int, int]:
    """Frames of the ASC lines in b, which ends with a line end.

    b (k,) uint8; base 10 or 16; start_s is added to each time; relative: each time counts from the event before, and since is the
    nanoseconds reached; out, places and places_used as for `scan_blf`; known (2 + k,) counts blank lines, comments and events of EVENTS.
    Returns (frames, bytes used, status, places_used, since); where the columns are full it stops.
    """
    room, data = len(out[0]), out[4]
    end = len(b)
    n = 0
    pos = 0
    while pos < end and n < room:
        line = pos
        i = skip_blanks(b, pos)
        before = byte(b, i) == 45
        i += 1 if before else 0
        if not is_digit(byte(b, i)):
            if before:
                return n, line, ODD, places_used, since
            if is_line_end(byte(b, i)):
                known[0] += 1
            elif byte(b, i) == 47 and byte(b, i + 1) == 47:
                known[1] += 1
            else:
                return n, line, ODD, places_used, since
            pos = next_line(b, skip_line(b, i))
            continue
        i, ticks, digits = decimal(b, i)
        if ticks < 0 or digits == 0 or not is_blank(byte(b, i)):
            return n, line, ODD, places_used, since
        ticks = -ticks if before else ticks
        event = since
        seconds = float(ticks) / POWERS[digits]
        if relative:
            if digits > 9 or abs(ticks) > (1 << 61) // TICKS[digits] or abs(since) > 1 << 61:
                return n, line, ODD, places_used, since
            event = since + ticks * TICKS[digits]
            seconds = float(event) / 1e9
        if abs(seconds) > LATEST_S:
            return n, line, ODD, places_used, since
        i = skip_blanks(b, i)
        number = i64(-1)
        is_fd = False
        if is_digit(byte(b, i)):
            i, number = integer(b, i, 10)
        elif is_word(b, i, CAN_FD) and is_blank(byte(b, i + 5)):
            i, number = integer(b, skip_blanks(b, i + 5), 10)
            is_fd = True
        else:
            k = _event(b, i)
            if k < 0:
                return n, line, ODD, places_used, since
            known[2 + k] += 1
            since = event
            pos = next_line(b, skip_line(b, i))
            continue
        if number < 0 or number > LARGEST_CHANNEL or not is_blank(byte(b, i)):
            return n, line, ODD, places_used, since
        i = skip_blanks(b, i)
        if is_fd:
            i, value, mark, count = _fd(b, i, base, data, n)
        else:
            i, value, mark, count = _classic(b, i, base, data, n)
        if i == -2:
            return n, line, WIDE, places_used, since
        if i < 0:
            return n, line, ODD, places_used, since
        if places[number] < 0:
            places[number] = places_used
            places_used += 1
        put(out, n, seconds + start_s, value, mark, count, places[number])
        n += 1
        since = event
        pos = next_line(b, skip_line(b, i))
    return n, pos, DONE, places_used, since
