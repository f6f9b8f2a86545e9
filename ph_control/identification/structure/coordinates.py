"""Coordinates of the models that have a structure: poles, shapes or matrices, what is fed through; and derivatives.

    rho[l, o, i] = g[l, o] x[l, a] x[l, b]   or   g[l, o] K[l, c],        g[l, o] = p_l**k_o / (2j Im p_l)

with `k_o` times that the displacement is differentiated by output o.  Of a plant with damping that decouples in its
real modes `x` is real: a response of unit modal mass is `x_a x_b / (s - p) (s - conj p)`, and its part at `p` that
product over `2j Im p`.  At a port, output and input have the same number `x`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components

from ..._types import Array, ComplexArray, Indices, Mask, NDArray
from .layout import ChannelLayout

_NOTHING = 1e-3  # of the largest of a mode: what a shape begins with where its residue has the wrong sign


@dataclass(frozen=True)
class StructureCoordinates:
    """Real numbers: frequencies Im p, growth Re p if it is free, residues by some numbers, and the feedthrough.

    `shown` (p, m) are the entries of which any experiment shows residues, `through` (p, m) those that may be fed
    through.
    """

    layout: ChannelLayout
    n: int
    shown: Mask
    through: Mask
    damped: bool = True
    real: bool = False

    @property
    def _poles(self) -> int:
        return self.n * (1 + self.damped)

    @cached_property
    def size(self) -> int:
        """Number of coordinates."""
        return self._poles + self.n * self.values * (1 + (not self.real)) + int(self.through.sum())

    @cached_property
    def values(self) -> int:
        """Number of values of residues in each mode."""
        raise NotImplementedError

    @property
    def dof(self) -> int:
        """Unknowns that the data show."""
        raise NotImplementedError

    def start(self, p: ComplexArray, residues: ComplexArray, feedthrough: Array) -> Array:
        """Coordinates near those of a free model."""
        values = self.nearest(residues / self._factor(p))
        parts = [p.imag, *([p.real] if self.damped else []), values.real.ravel()]
        parts += [] if self.real else [values.imag.ravel()]
        return np.concatenate([*parts, feedthrough[self.through]])

    def nearest(self, scaled: ComplexArray) -> NDArray[Any]:
        """Values (n, number) for matrices (n, p, m) near to these."""
        raise NotImplementedError

    def poles(self, x: Array) -> ComplexArray:
        """Poles of a model."""
        n = self.n
        return np.asarray((x[n : 2 * n] if self.damped else 0.0) + 1j * x[:n])

    def residue_values(self, x: Array) -> NDArray[Any]:
        """Values of the residues, shape (n, number): real if the structure says so."""
        count = self.n * self.values
        real = x[self._poles : self._poles + count]
        both = real if self.real else real + 1j * x[self._poles + count : self._poles + 2 * count]
        return both.reshape(self.n, self.values)

    def model(self, x: Array) -> tuple[ComplexArray, ComplexArray, Array]:
        """Poles, residues (n, p, m) and feedthrough (p, m)."""
        p, through = self.poles(x), np.zeros(self.through.shape)
        through[self.through] = x[self.size - int(self.through.sum()) :]
        return p, self._factor(p) * self.matrices(self.residue_values(x)), through

    def matrices(self, values: NDArray[Any]) -> NDArray[Any]:
        """Residues over their factor, shape (n, p, m)."""
        raise NotImplementedError

    def _factor(self, p: ComplexArray) -> ComplexArray:
        """`g`, shape (n, p, 1)."""
        return (p[:, None] ** self.layout.powers / (2j * p.imag[:, None]))[:, :, None]

    def derivatives(self, x: Array, output: int, has_feedthrough: bool) -> Array:
        """Of what `shared` has of an output of the projection, in the units of the data, shape (numbers, size)."""
        n, p, values = self.n, self.poles(x), self.residue_values(x)
        factor, matrices = self._factor(p)[:, :, 0], self.matrices(values)
        modes, first = np.arange(n), int(self._poles)
        found = []
        for o, i in self.layout.entries(output):
            rho, k = factor[:, o] * matrices[:, o, i], self.layout.powers[o]
            by = np.zeros((n, self.size), complex)
            by[modes, modes] = rho * (1j * k / p - 1 / p.imag)
            if self.damped:
                by[modes, n + modes] = rho * k / p
            for place, slope in self.slopes(values, o, i):
                at = first + modes * self.values + place
                by[modes, at] += factor[:, o] * slope
                if not self.real:
                    by[modes, at + n * self.values] += 1j * factor[:, o] * slope
            fed = np.zeros((int(has_feedthrough), self.size))
            fed[:, self._through_at[o, i]] = self.through[o, i]
            found += [by.real, by.imag, fed]
        return np.concatenate(found) if found else np.zeros((0, self.size))

    @cached_property
    def _through_at(self) -> Indices:
        """Places of the feedthrough of each entry among the coordinates."""
        return self.size - 1 - int(self.through.sum()) + np.cumsum(self.through).reshape(self.through.shape)

    def slopes(self, values: NDArray[Any], output: int, input: int) -> Sequence[tuple[int, NDArray[Any]]]:
        """Places of the values that an entry depends on, and its derivative by each."""
        raise NotImplementedError

    def pole_derivatives(self) -> Array:
        """Of imaginary and real parts of the poles, shape (2n, size)."""
        return np.eye(2 * self.n, self.size) * (np.arange(2 * self.n) < self._poles)[:, None]

    def free(self, x: Array) -> Mask:
        """Coordinates that may move: of several that make the same model all but one are held."""
        return np.ones(self.size, bool)


@dataclass(frozen=True)
class MatrixCoordinates(StructureCoordinates):
    """Residues with any values, or with the same for the pairs of ports that reciprocity makes equal."""

    reciprocal: bool = False

    @cached_property
    def _classes(self) -> Indices:
        """Which value each entry has, shape (p, m)."""
        found = np.arange(self.layout.outputs * self.layout.inputs).reshape(self.layout.outputs, -1)
        for first, here in self.layout.ports if self.reciprocal else ():
            for second, there in self.layout.ports:
                found[first, there] = found[second, here] = min(found[first, there], found[second, here])
        return np.unique(found, return_inverse=True)[1].reshape(found.shape)

    @cached_property
    def values(self) -> int:
        """Number of values of residues in each mode."""
        return int(self._classes.max(initial=-1)) + 1

    @property
    def dof(self) -> int:
        """Unknowns that the data show."""
        shapes = len(np.unique(self._classes[self.shown])) * (1 + (not self.real))
        return self._poles + self.n * shapes + int(self.through.sum())

    def nearest(self, scaled: ComplexArray) -> NDArray[Any]:
        """Means over the entries of each value."""
        belongs = np.eye(self.values)[self._classes[self.shown]]
        return scaled[:, self.shown] @ (belongs / np.maximum(belongs.sum(axis=0), 1))

    def matrices(self, values: NDArray[Any]) -> NDArray[Any]:
        """Residues over their factor, shape (n, p, m)."""
        return values[:, self._classes]

    def slopes(self, values: NDArray[Any], output: int, input: int) -> Sequence[tuple[int, NDArray[Any]]]:
        """One value for each entry."""
        return [(int(self._classes[output, input]), np.ones(self.n))]


@dataclass(frozen=True)
class ShapeCoordinates(StructureCoordinates):
    """Residues of rank one: products of a number of each output and one of each input, the same at ports if `tied`."""

    tied: bool = False

    @cached_property
    def _places(self) -> tuple[Indices, Indices]:
        """Which number each output and each input has."""
        p, m = self.layout.outputs, self.layout.inputs
        place = np.arange(p + m)
        for output, input in self.layout.ports if self.tied else ():
            first, second = place[output], place[p + input]
            place[place == max(first, second)] = min(first, second)
        place = np.unique(place, return_inverse=True)[1]
        return place[:p], place[p:]

    @cached_property
    def values(self) -> int:
        """Number of values of residues in each mode."""
        return int(max(one.max(initial=-1) for one in self._places)) + 1

    @cached_property
    def _gauges(self) -> list[Indices]:
        """Numbers that may be scaled against one another without any effect: one set for each such scale.

        Numbers that are multiplied with one another are linked; where the links part a set in two halves, one may grow
        as the other shrinks.
        """
        outputs, inputs = self._places
        count = self.values
        first, second = outputs[np.nonzero(self.shown)[0]], inputs[np.nonzero(self.shown)[1]]
        # each number on either side of the products: they are one half and the other unless some set meets itself
        links = np.zeros((2 * count, 2 * count), bool)
        links[first, count + second] = links[second, count + first] = True
        labels = connected_components(links, directed=False)[1]
        parted = np.flatnonzero(labels[:count] != labels[count:])
        sets = {tuple(np.unique(np.flatnonzero(labels == labels[one]) % count).tolist()) for one in parted}
        return [np.array(one) for one in sorted(sets)]

    @property
    def dof(self) -> int:
        """Unknowns that the data show."""
        shapes = (self.values - len(self._gauges)) * (1 + (not self.real))
        return self._poles + self.n * shapes + int(self.through.sum())

    def free(self, x: Array) -> Mask:
        """All but the largest of the numbers that share a scale."""
        sizes, held = np.abs(self.residue_values(x)), np.zeros((self.n, self.values), bool)
        for one in self._gauges:
            held[np.arange(self.n), one[np.argmax(sizes[:, one], axis=1)]] = True
        found = np.ones(self.size, bool)
        found[self._poles :][: held.size] = ~held.ravel()
        if not self.real:
            found[self._poles + held.size :][: held.size] = ~held.ravel()
        return found

    def nearest(self, scaled: ComplexArray) -> NDArray[Any]:
        """From the first singular vectors, scaled so that output and input agree at ports as far as they can."""
        outputs, inputs = self._places
        kept = np.where(self.shown, scaled.real if self.real else scaled, 0.0)
        U, sizes, Vh = np.linalg.svd(kept, full_matrices=False)
        root = np.sqrt(sizes[:, :1])
        c, b = U[:, :, 0] * root, Vh[:, 0] * root
        values = np.zeros((self.n, self.values), kept.dtype)
        if self.tied and self.layout.ports:
            at_outputs, at_inputs = (np.array(one) for one in zip(*self.layout.ports, strict=True))
            # of c t and b / t, which agree where t**2 = b / c
            square = np.sum(c[:, at_outputs].conj() * b[:, at_inputs], axis=1) / np.maximum(
                np.sum(np.abs(c[:, at_outputs]) ** 2, axis=1), np.finfo(float).tiny
            )
            wrong = square.real <= 0 if self.real else square == 0
            turn = np.where(wrong, 1.0, np.sqrt(np.where(wrong, 1.0, square)))[:, None]
            c, b = c * turn, b / turn
            b[:, at_inputs] = np.where(
                wrong[:, None], _NOTHING * np.abs(b[:, at_inputs]), 0.5 * (b[:, at_inputs] + c[:, at_outputs])
            )
            c[:, at_outputs] = b[:, at_inputs]
        values[:, inputs] = b
        values[:, outputs] = c
        return values

    def shapes(self, x: Array) -> tuple[NDArray[Any], NDArray[Any]]:
        """Numbers of the outputs (n, p), and of the inputs (n, m)."""
        values = self.residue_values(x)
        return values[:, self._places[0]], values[:, self._places[1]]

    def matrices(self, values: NDArray[Any]) -> NDArray[Any]:
        """Residues over their factor, shape (n, p, m)."""
        outputs, inputs = self._places
        return values[:, outputs, None] * values[:, None, inputs]

    def slopes(self, values: NDArray[Any], output: int, input: int) -> Sequence[tuple[int, NDArray[Any]]]:
        """Each factor by the other."""
        first, second = int(self._places[0][output]), int(self._places[1][input])
        return [(first, values[:, second]), (second, values[:, first])]
