"""What every result is: frozen, with locked arrays, and the same after a copy or a pickle."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from ._types import Array


class Frozen:
    """A result whose arrays are locked; numpy forgets that in copies and pickles, this class does not."""

    def __post_init__(self) -> None:
        _lock(vars(self).values())

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        _lock(state.values())


def _lock(values: Iterable[object]) -> None:
    for value in values:
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        elif isinstance(value, tuple):
            _lock(value)


class ReadOnlyMapping(Frozen, Mapping[str, Array]):
    """Locked arrays by name; unlike a `MappingProxyType` it can be copied and pickled."""

    def __init__(self, arrays: Mapping[str, Array]) -> None:
        self._names, self._arrays = tuple(arrays), tuple(arrays.values())
        self.__post_init__()

    def __getitem__(self, name: str) -> Array:
        try:
            return self._arrays[self._names.index(name)]
        except ValueError:
            raise KeyError(name) from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        return repr(dict(self))
