"""Result of a sample: a number in arrays and kernels, a word in files and on pages."""

from enum import IntEnum

import numpy as np

from lmeasure.core.arrays import IntArray, TextArray


class Status(IntEnum):
    """Whether a sample has a pose, and if not, why; the contract's words are the names in small letters.

    Numbers are never given to another meaning: arrays in memory, kept compiled code and scripts hold them.
    """

    OK = 0
    SINGULAR = 1
    """The cables do not determine the pose."""
    NOT_CONVERGED = 2
    """No pose has these lengths."""
    GAP = 3
    """A channel has no count, or may have wrapped unseen."""
    JUMP = 4
    """A count moved faster than its drum allows."""
    SLACK = 5
    """A cable does not follow the tool."""
    OTHER_ASSEMBLY = 6
    """The lengths fit two assemblies."""
    INCONSISTENT = 7
    """Redundant channels contradict each other, and which is wrong cannot be determined."""
    ORIGIN_LOST = 8
    """A counter went on after a discontinuity that nothing has bridged."""

    @property
    def word(self) -> str:
        """How files and pages call it."""
        return self.name.lower()


WORDS = tuple(status.word for status in Status)
"""The word of each number."""


def words(status: IntArray) -> TextArray:
    """(n,) words of (n,) numbers."""
    return np.array(WORDS, dtype=np.object_)[status]
