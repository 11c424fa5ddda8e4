"""Some samples of a run, evenly spread over it, whatever they say."""

from dataclasses import replace

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.trajectory.faults.redundancy import Epochs

MOST = 2048


class Thinned:
    """Keeps every k-th sample of a run that is given in pieces, k doubling where they become more than twice `MOST`."""

    def __init__(self) -> None:
        self._kept: list[Epochs] = []
        self._every, self._seen = 1, 0

    def add(self, epochs: Epochs, travel: FloatArray) -> None:
        """The next samples, and which way their channels travelled last (n, m)."""
        rows = np.arange(-self._seen % self._every, len(epochs), self._every)
        self._seen += len(epochs)
        self._kept.append(replace(epochs.at(rows), travel=travel[rows]))
        while sum(map(len, self._kept)) > 2 * MOST:
            self._every *= 2
            whole = joined(self._kept)
            self._kept = [whole.at(np.arange(0, len(whole), 2))]

    def epochs(self) -> Epochs:
        """All that were kept."""
        return joined(self._kept)


def joined(pieces: list[Epochs]) -> Epochs:
    """One behind the other."""

    def of(name: str) -> FloatArray | None:
        values = [getattr(piece, name) for piece in pieces]
        return None if values[0] is None else np.concatenate(values)

    return Epochs(**{name: of(name) for name in Epochs.__dataclass_fields__})  # type: ignore[arg-type]
