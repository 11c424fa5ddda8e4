"""Types of arrays by their shape: (n, 7) in a docstring is one of these."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]
TextArray = NDArray[np.object_]
"""Texts of any length, as columns of tables hold them."""


def words_of(value: str | Iterable[str]) -> tuple[str, ...]:
    """Return the words of a text with commas, or words as they are; blanks around them, and empty ones, are dropped."""
    words = value.split(",") if isinstance(value, str) else value
    return tuple(word.strip() for word in words if word.strip())
