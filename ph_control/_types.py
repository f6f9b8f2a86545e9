"""Kinds of arrays that signatures name, and what random numbers come from."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, TypedDict, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "Array", "ArrayLike", "ComplexArray", "Indices", "Mask", "NDArray", "Numbers", "OneOrEach", "PortPairs",
    "RandomSource", "RealOrComplex", "SystemNames", "Unpack",
]  # fmt: skip

if TYPE_CHECKING:
    from typing_extensions import Unpack
else:
    Unpack = dict  # annotations stay texts

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
RealOrComplex = NDArray[np.inexact]
Numbers = TypeVar("Numbers", Array, ComplexArray)  # real, or complex, as what comes with them
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
OneOrEach = ArrayLike | Sequence[ArrayLike | None] | None  # for all experiments, or a list for each
# output and input of each port, by number or name
PortPairs = Sequence[tuple[int | str, int | str]] | Mapping[str, int | str] | Mapping[int, int | str]
RandomSource = (
    np.random.Generator
    | np.random.BitGenerator
    | np.random.SeedSequence
    | np.random.RandomState
    | Sequence[int]
    | int
    | None
)


class SystemNames(TypedDict, total=False):
    """Names of a system and of its signals, as python-control takes them."""

    name: str | None
    inputs: int | str | Sequence[str] | None
    outputs: int | str | Sequence[str] | None
    states: int | str | Sequence[str] | None
    input: str | None
    output: str | None
    state: str | None
    input_prefix: str
    output_prefix: str
    state_prefix: str
    repr_format: str | None
