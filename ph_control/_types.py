"""Kinds of arrays that signatures name, and what random numbers come from."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Array", "ArrayLike", "ComplexArray", "Indices", "Mask", "NDArray", "Numbers", "OneOrEach", "RandomSource",
    "RealOrComplex",
]  # fmt: skip

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
RealOrComplex = NDArray[np.inexact]
Numbers = TypeVar("Numbers", Array, ComplexArray)  # real, or complex, as what comes with them
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
OneOrEach = ArrayLike | Sequence[ArrayLike | None] | None  # for all experiments, or a list for each
RandomSource = (
    np.random.Generator
    | np.random.BitGenerator
    | np.random.SeedSequence
    | np.random.RandomState
    | Sequence[int]
    | int
    | None
)
