"""Scan of candump log lines into the columns of `lmeasure.kernels.frames`.

A line that is plainly a frame is read, a blank one is counted; at anything else the scan stops with ODD and leaves the line to the caller.
It also stops where the columns are full. It reads bit for bit what python-can's reader does, apart from error frames, whose class
and data it keeps.
"""

from lmeasure.core import IntArray
from lmeasure.kernels.decorators import inline, kernel
from lmeasure.kernels.frames import (
    BITRATE_SWITCH,
    CLASSED,
    DONE,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    LARGEST_CLASS,
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
    NIBBLE,
    POWERS,
    clear,
    decimal,
    integer,
    is_blank,
    is_digit,
    is_line_end,
    is_parted,
    next_line,
    skip_blanks,
)

ERROR_FLAG = 0x20000000
NAME_BYTES = 32
NAMES = 64


@inline
def _name(b: Bytes, i: int, names: Bytes, lengths: IntArray, used: int) -> tuple[int, int, int]:
    """Place of the channel name at i, entering a new one: (end, place or -1 where it is not plain or too long, used)."""
    start = i
    while 32 < byte(b, i) < 127:
        i += 1
    size = i - start
    # python-can takes digits for a number, in which leading zeros mean nothing
    if size == 0 or size > names.shape[1] or not is_blank(byte(b, i)) or (byte(b, start) == 48 and size > 1):
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
def _data_bytes(b: Bytes, i: int, data: Bytes, row: int) -> tuple[int, int]:
    """Pairs of hexadecimal digits: (end, or -1 where a digit is alone, or -2 for more than the columns hold; bytes)."""
    width = data.shape[1]
    clear(data, row)
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
def scan_candump(b: Bytes, out: Columns, names: Bytes, lengths: IntArray, used: int, known: IntArray) -> tuple[int, int, int, int]:
    """Frames of the `candump -L` lines in b, which ends with a line end: `(1234.567890) can0 181#0102030405060708`, and R or T behind it.

    b (k,) uint8; out as for `scan_blf`; names (64, 32) uint8 and lengths (64,) int64 hold the channel names found, used how many, all
    carried on; known (1,) counts blank lines. Returns (frames, bytes used, status, used).
    """
    room, data = len(out[0]), out[4]
    end = len(b)
    n = 0
    pos = 0
    while pos < end and n < room:
        line = pos
        i = skip_blanks(b, pos)
        if is_line_end(byte(b, i)):
            known[0] += 1
            pos = next_line(b, i)
            continue
        if byte(b, i) != 40:
            return n, line, ODD, used
        i += 1
        before = byte(b, i) == 45
        if before:
            i += 1
        i, ticks, digits = decimal(b, i)
        if ticks < 0 or byte(b, i) != 41 or not is_blank(byte(b, i + 1)):
            return n, line, ODD, used
        seconds = float(ticks) / POWERS[digits]
        if seconds > LATEST_S:
            return n, line, ODD, used
        if before:
            seconds = -seconds
        i, place, used = _name(b, skip_blanks(b, i + 1), names, lengths, used)
        if place < 0:
            return n, line, ODD, used
        i = skip_blanks(b, i)
        start = i
        i, raw = integer(b, i, 16)
        if raw < 0 or byte(b, i) != 35 or i - start > 8:
            return n, line, ODD, used
        mark = EXTENDED if i - start > 3 else 0
        i += 1
        if byte(b, i) == 35:
            if not is_digit(byte(b, i + 1)):
                return n, line, ODD, used
            switches = byte(b, i + 1) - 48
            mark |= FD | (BITRATE_SWITCH if switches & 1 else 0) | (ERROR_STATE if switches & 2 else 0)
            i += 2
        if (byte(b, i) == 82 or byte(b, i) == 114) and not mark & FD:
            mark |= REMOTE
            count = i64(0)
            if is_digit(byte(b, i + 1)):
                i, count = integer(b, i + 1, 10)
                if count < 0 or count > 8:
                    return n, line, ODD, used
            else:
                i += 1
            clear(data, n)
        else:
            i, count = _data_bytes(b, i, data, n)
            if i == -2:
                return n, line, WIDE, used
            if i < 0 or (count > 8 and not mark & FD):
                return n, line, ODD, used
        if not is_parted(byte(b, i)):
            return n, line, ODD, used
        i = skip_blanks(b, i)
        if not is_line_end(byte(b, i)):
            c = byte(b, i)
            if c == 84 or c == 116:
                mark |= SENT
            elif c != 82 and c != 114:
                return n, line, ODD, used
            if byte(b, i - 1) != 32:  # python-can takes a direction behind a tab for a fourth word
                return n, line, ODD, used
            i = skip_blanks(b, i + 1)
            if not is_line_end(byte(b, i)):
                return n, line, ODD, used
        if raw & ERROR_FLAG:
            mark |= ERROR | (CLASSED if raw & 0x1FFFFFFF <= LARGEST_CLASS else 0)
        put(out, n, seconds, raw & 0x1FFFFFFF, mark, count, place)
        n += 1
        pos = next_line(b, i)
    return n, pos, DONE, used
