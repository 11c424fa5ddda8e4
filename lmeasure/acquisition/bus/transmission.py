"""Which SYNCs a channel answers: CiA 301 lets a device answer every n-th one (transmission types 1 to 240)."""

import math
from collections.abc import Sequence

import numpy as np

from lmeasure.core import BoolArray, IntArray

MOST = 240
ANSWERS = 5
"""Answers that show an n above 1; three show that every SYNC is answered."""
RECENT = 16
"""Answers by which n is judged again."""
REGULAR = 0.9
"""Part of the distances between answers that are multiples of n at least."""


def every(answered: IntArray) -> int | None:
    """Return n of a channel that answered the SYNCs of these numbers (k,): the median of their distances; None where they are too few.

    1 where the distances are no multiples of the median: then answers are lost.
    """
    distances = np.diff(answered)
    distances = distances[distances > 0]
    if len(distances) >= 2 and (distances[:2] == 1).all() and len(distances) < ANSWERS - 1:
        return 1
    if len(distances) < ANSWERS - 1:
        return None
    n = int(np.median(distances))
    return n if 1 < n <= MOST and np.mean(distances % n == 0) >= REGULAR else 1


def ordinal(n: int) -> str:
    """2nd, 3rd, 11th, ..."""
    return f"{n}{'th' if n % 100 // 10 == 1 else {1: 'st', 2: 'nd', 3: 'rd'}.get(n % 10, 'th')}"


class Transmission:
    """Which SYNCs each of m channels is due to answer, from those that it has answered. SYNCs are numbered from the first one on."""

    def __init__(self, channels: int) -> None:
        self.n = np.ones(channels, np.int64)
        """Each channel answers every n-th SYNC."""
        self._recent: list[IntArray] = [np.empty(0, np.int64)] * channels
        self._latest: list[IntArray] = [np.empty(0, np.int64)] * channels

    def known(self, answers: Sequence[IntArray]) -> BoolArray:
        """(m,) whether n of each channel is known, by the numbers of the SYNCs that it answered so far."""
        return np.array([every(one) is not None for one in answers])

    def learn(self, answers: Sequence[IntArray]) -> list[int]:
        """Take the numbers of the SYNCs that each channel answered since the last time; the channels whose n is another now."""
        other = []
        for c, new in enumerate(answers):
            self._recent[c] = np.concatenate([self._recent[c], new])[-RECENT:]
            self._latest[c] = np.concatenate([self._latest[c][-1:], new])
            n = every(self._recent[c])
            if n is not None and n != self.n[c]:
                self.n[c] = n
                other.append(c)
        return other

    def moved(self, channel: int, number: int) -> None:
        """The answer to the SYNC behind this one was late, and belongs to this one."""
        for kept in (self._recent, self._latest):
            kept[channel] = np.where(kept[channel] == number + 1, number, kept[channel])

    def due(self, first: int, end: int) -> BoolArray:
        """(m, end - first) which of the SYNCs from first to end each channel is due to answer, by its last answer before."""
        number = np.arange(first, end)
        out = np.ones((len(self.n), end - first), np.bool_)
        for c in np.flatnonzero(self.n > 1):
            if len(latest := self._latest[c]):
                before = latest[np.maximum(np.searchsorted(latest, number) - 1, 0)]
                out[c] = (number - before) % self.n[c] == 0
        return out

    @property
    def meets(self) -> bool:
        """Whether there are SYNCs that all channels answer."""
        slow = [(int(self.n[c]), int(self._recent[c][-1])) for c in np.flatnonzero(self.n > 1) if len(self._recent[c])]
        return all((a - b) % math.gcd(n, k) == 0 for n, a in slow for k, b in slow)
