"""Types of arrays, said once: what a docstring calls (n, 7) is one of these."""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ComplexArray = NDArray[np.complex128]
TextArray = NDArray[np.object_]
"""Texts of any length, as columns of tables hold them."""
