"""Which input and output each residue of a projection belongs to, in which units, and which of these are ports."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..._types import Array, ComplexArray, Indices
from ..._units import DERIVATIVES


@dataclass(frozen=True)
class ChannelLayout:
    """Channels of a fit: how its `shared` unknowns are residues of outputs by inputs.

    Attributes
    ----------
    outputs, inputs : int
        Number of them, p and m.
    scales : ndarray
        What was measured is `scales` times the rows of the projection: one number for each of its outputs.
    quantities : tuple of str
        'displacement', 'velocity', 'acceleration' or 'free', of each output.
    ports : tuple of (int, int)
        Pairs of an output and an input at the same place.
    per_entry : bool
        Whether outputs of the projection are entries (output, input) of a response matrix, row by row.
    """

    outputs: int
    inputs: int
    scales: Array
    quantities: tuple[str, ...]
    ports: tuple[tuple[int, int], ...] = ()
    per_entry: bool = field(default=False)

    @property
    def powers(self) -> Indices:
        """How often the displacement of each output was differentiated."""
        return np.array([DERIVATIVES[quantity] for quantity in self.quantities])

    def entries(self, output: int) -> list[tuple[int, int]]:
        """Outputs and inputs of the residues that an output of the projection has."""
        if self.per_entry:
            return [divmod(output, self.inputs)]
        return [(output, i) for i in range(self.inputs)]

    def split(self, shared: Array, n: int) -> tuple[ComplexArray, Array]:
        """Residues (n, p, m) and feedthrough (p, m) in the units of the data."""
        q = self.inputs if not self.per_entry else 1
        each = (shared * self.scales).reshape(q, -1 if q else 2 * n, len(self.scales))
        residues = each[:, :n] + 1j * each[:, n : 2 * n]
        through = each[:, 2 * n] if each.shape[1] > 2 * n else np.zeros((q, len(self.scales)))
        shape = self.outputs, self.inputs
        return np.moveaxis(residues, 0, 2).reshape(n, *shape), through.T.reshape(shape).copy()

    def joined(self, residues: ComplexArray, feedthrough: Array, has_feedthrough: bool) -> Array:
        """`shared` of residues (n, p, m) and feedthrough (p, m): the way back."""
        n, k = len(residues), len(self.scales)
        each = np.moveaxis(residues.reshape(n, k, feedthrough.size // k), 2, 0)
        through = feedthrough.reshape(k, -1).T[:, None][:, : int(has_feedthrough)]
        joined = np.concatenate([each.real, each.imag, through], axis=1)
        return np.asarray(joined.reshape(-1, k) / self.scales)


def residue_of_unit_weight(d: Array, power: int, zeta: Any = 0.0) -> ComplexArray:
    """Residues at the upper poles of modes with weight `r = 1`, differentiated `power` times from the displacement."""
    turn = np.sqrt(1 - np.square(zeta))
    if power == 1 and not np.any(zeta):
        return np.asarray(0.5 * d, complex)
    return np.asarray(d**power * (-zeta + 1j * turn) ** power / (2j * turn))


def weights_of(poles: ComplexArray, residues: ComplexArray, quantity: str) -> Array:
    """Weights `r` of lossless or classical modes with these residues of one input and one output, at least 0."""
    d = np.abs(poles)
    per_weight = residue_of_unit_weight(d, DERIVATIVES[quantity], -poles.real / d)
    return np.maximum((residues / per_weight).real, 0.0)
