"""Words of log lines, for ASC and candump.

The text must end with a line end, which no token contains: that is what keeps every loop inside the text.
"""

import numpy as np

from lmeasure.kernels.decorators import inline, kernel
from lmeasure.kernels.frames import Bytes, byte, i64

LARGEST_EXACT = 1 << 53

POWERS = 10.0 ** np.arange(23)  # every one exact, so that significand / power is the nearest double
POWERS_OF_TEN = 10 ** np.arange(19)

NIBBLE = np.array([int(chr(c), 16) if chr(c) in "0123456789abcdefABCDEF" else -1 for c in range(256)], np.int8)


@inline
def is_digit(c: int) -> bool:
    return 48 <= c <= 57


@inline
def is_blank(c: int) -> bool:
    return c == 32 or c == 9


@inline
def is_line_end(c: int) -> bool:
    return c == 10 or c == 13


@inline
def is_parted(c: int) -> bool:
    return c == 32 or c == 9 or c == 10 or c == 13


@inline
def is_odd(c: int) -> bool:
    """Not printable ASCII and no blank: Python may take it for a blank, or may not be able to read it."""
    return c > 126 or (c < 32 and c != 9 and c != 10 and c != 13)


@inline
def skip_blanks(b: Bytes, i: int) -> int:
    while is_blank(byte(b, i)):
        i += 1
    return i


@inline
def skip_line(b: Bytes, i: int) -> int:
    while not is_line_end(byte(b, i)):
        i += 1
    return i


@inline
def next_line(b: Bytes, i: int) -> int:
    """Return the start of the line behind the line end at i; a carriage return and its line feed are one end."""
    return i + 2 if byte(b, i) == 13 and i + 1 < len(b) and byte(b, i + 1) == 10 else i + 1


@inline
def read_digits(b: Bytes, i: int) -> tuple[int, int]:
    """Decimal digits from i on: (end, value); the value means nothing where there are more than 18."""
    value = i64(0)
    while is_digit(byte(b, i)):
        value = value * 10 + (i64(byte(b, i)) - 48)
        i += 1
    return i, value


@inline
def decimal(b: Bytes, i: int) -> tuple[int, int, int]:
    """Digits, a point or a decimal comma, and digits from i on: (end, significand, digits behind the point); the significand is -1 where it
    is not exact or not such a number. A point without digits behind it gives 0 of them."""
    point, whole = read_digits(b, i)
    if point == i or (byte(b, point) != 46 and byte(b, point) != 44):
        return point, i64(-1), 0
    end, part = read_digits(b, point + 1)
    behind = end - point - 1
    if behind > 18 or point - i + behind > 18:
        return end, i64(-1), behind
    significand = whole * POWERS_OF_TEN[behind] + part
    return end, significand if significand < LARGEST_EXACT else i64(-1), behind


@inline
def integer(b: Bytes, i: int, base: int) -> tuple[int, int]:
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
def line_ends(b: Bytes) -> int:
    """Return the number of line ends: line feed, carriage return, or both together."""
    feeds = returns = together = i64(0)
    for i in range(len(b)):
        feeds += b[i] == 10
        returns += b[i] == 13
    if returns:
        for i in range(1, len(b)):
            together += (b[i - 1] == 13) & (b[i] == 10)
    return feeds + returns - together


@kernel
def line_stop(b: Bytes, i: int) -> tuple[int, int]:
    """Return where the line of place i ends, and where the next begins."""
    end = skip_line(b, i)
    return end, next_line(b, end)


@inline
def is_word(b: Bytes, i: int, word: Bytes) -> bool:
    """Return whether the word is at i; it compares no further than the first difference, so never past a line end."""
    k = 0
    while k < len(word) and byte(b, i + k) == word[k]:
        k += 1
    return k == len(word)


@inline
def clear(data: Bytes, row: int) -> None:
    for k in range(data.shape[1]):
        data[row, k] = 0
