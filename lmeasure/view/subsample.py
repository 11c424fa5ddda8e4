"""Rows for pictures, out of more than can be drawn, that come a piece at a time."""

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray


class Thinned:
    """The first row of all and others at equal steps, about `limit` of them, the last, and every row that must be kept.

    Rows that come in one piece give at most the limit, in pieces up to twice as many: the step doubles as they become more. Only those
    rows are held.
    """

    def __init__(self, limit: int, width: int) -> None:
        self._limit, self._step = limit, 1
        self.seen = 0
        """Rows that were given."""
        self.numbers: IntArray = np.empty(0, np.int64)
        """(k,) numbers of the rows that are held, from 0."""
        self.rows: FloatArray = np.empty((0, width))
        """(k, width) those rows."""
        self._keep = np.empty(0, np.bool_)

    def __len__(self) -> int:
        return len(self.numbers)

    def add(self, rows: FloatArray, keep: IntArray) -> None:
        """Take the next rows (n, width), of which those at the indices `keep` must stay."""
        n = len(rows)
        if self.seen == 0:
            self._step = -(-n // self._limit)
        while self.seen + n > 2 * self._limit * self._step:
            self._step *= 2
        chosen = np.union1d(np.arange(-self.seen % self._step, n, self._step), np.append(keep, n - 1)).astype(np.int64)
        numbers = np.concatenate([self.numbers, self.seen + chosen])
        must: BoolArray = np.concatenate([self._keep, np.isin(chosen, keep)])
        self.seen += n
        stay = must | (numbers % self._step == 0) | (numbers == self.seen - 1)
        self.numbers, self._keep = numbers[stay], must[stay]
        self.rows = np.concatenate([self.rows, rows[chosen]])[stay]
