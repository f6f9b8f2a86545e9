"""Kinds of arrays that signatures name."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Array", "ArrayLike", "ComplexArray", "Indices", "Mask", "NDArray"]

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
