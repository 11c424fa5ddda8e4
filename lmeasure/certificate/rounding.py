"""Numbers as a person reads them: a value ends where its uncertainty does (JCGM 100, 7.2.6)."""

import math

from lmeasure.text import settled


def with_u95(value: float, u95: float) -> tuple[str, str]:
    """A value and its U95, which has two significant digits; the value ends at the same decimal."""
    if not u95 > 0:
        return f"{settled(value):.6g}", f"{u95:.2g}"
    decimals = 1 - math.floor(math.log10(u95))
    # 0.0996 rounds to 0.10, not to 0.100
    if round(u95, decimals) >= 10.0 ** (2 - decimals):
        decimals -= 1
    if decimals < 0:
        step = 10.0**-decimals
        return f"{round(value / step) * step:.0f}", f"{round(u95 / step) * step:.0f}"
    # + 0.0: what rounds to zero has no sign
    return f"{round(value, decimals) + 0.0:.{decimals}f}", f"{u95:.{decimals}f}"
