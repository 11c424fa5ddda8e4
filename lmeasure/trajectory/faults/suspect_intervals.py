"""From when and until when cables are in doubt that contradict the others at some epochs.

An alarm comes late where an error grows, and an error that stays hides wherever the geometry does not show it. So a doubt reaches back to
the last epoch, and on to the first of some, at which every cable in question is seen to agree, by a standard uncertainty that would show
the error it has at the alarms.
"""

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray

AGREES = 2.0
"""Standard uncertainties within which a cable agrees."""
SHOWS = (3.0, 30.0)
"""Times its standard uncertainty a cable's error must be, half of what it is at the alarms within these bounds, for an agreement to speak
against it."""
AGAIN_S = 0.1
AGAIN = 5
"""Samples, and for so long, a cable must agree again."""
MOSTLY = 0.8
"""Of those samples: one of twenty lies beyond two standard uncertainties."""


def spans(time_s: FloatArray, alarms: IntArray, error: FloatArray, u: FloatArray) -> list[tuple[int, int]]:
    """First and last epochs of the doubts, from the alarms on (k,), about cables with errors and uncertainties (n, q) at times (n,)."""
    n = len(error)
    told = np.where(np.isfinite(u[alarms]), np.abs(error[alarms]), 0.0)
    size = np.quantile(told, 0.9, axis=0)
    shows = np.clip(0.5 * (told / u[alarms]).max(axis=0), *SHOWS)
    agrees: BoolArray = np.all((np.abs(error) <= AGREES * u) & (shows * u <= size), axis=1)
    out: list[tuple[int, int]] = []
    for alarm in alarms.tolist():
        if out and alarm <= out[-1][1]:
            continue
        # several channels may err so that for a while no single one seems to
        before = np.flatnonzero(agrees[:alarm])
        first = int(before[-1]) + 1 if len(before) else 0
        again = (int(begin) for begin in np.flatnonzero(agrees[alarm:]) + alarm if _agrees_from(int(begin), time_s, agrees))
        out.append((first, max(next(again, n) - 1, alarm)))
    return out


def _agrees_from(begin: int, time_s: FloatArray, agrees: BoolArray) -> bool:
    """Whether most epochs agree from there on for as long and as many as it takes, or up to the end."""
    end = max(int(np.searchsorted(time_s, time_s[begin] + AGAIN_S)), begin + AGAIN - 1)
    return bool(agrees[begin : end + 1].mean() >= MOSTLY)
