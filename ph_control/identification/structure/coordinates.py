"""Coordinates of the models that have a structure: poles, shapes or matrices, what is fed through; and derivatives.

    rho[l, o, i] = g[l, o] x[l, a] x[l, b]   or   g[l, o] K[l, c],        g[l, o] = p_l**k_o / (p_l - q_l)

with `k_o` times that the displacement is differentiated by output o, and `q_l` the other pole of the section.  Of a
plant with damping that decouples in its real modes `x` is real, and the same for both poles: a response of unit modal
mass is `x_a x_b / (s - p) (s - q)`, and its part at `p` that product over `p - q`.  A real pole without another is that
of a mass on a damper, `x_a x_b / (s - p)` in units of velocity.  At a port, output and input have the same number `x`.
A layout says which input and output each residue belongs to, in which units, and which of these are ports.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse.csgraph import connected_components

from ..._types import Array, ComplexArray, Indices, Mask, RealOrComplex
from ..._units import DERIVATIVES
from ..regression.sections import Sections

_NOTHING = 1e-3  # of the largest of a mode: what a shape begins with where its residue has the wrong sign


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


@dataclass(frozen=True)
class StructureCoordinates:
    """Real numbers: coordinates of sections, without their decays if there are no losses, residues, and feedthrough.

    `sections` are those of the model that the structure starts from; `shown_entries` (p, m) are those of which any
    experiment shows residues, `fed_entries` (p, m) those that may be fed through.  Residues have their values for each
    section if these are `real`, else for each pole.
    """

    layout: ChannelLayout
    sections: Sections
    shown_entries: Mask
    fed_entries: Mask
    damped: bool = True
    real: bool = False

    @cached_property
    def pole_coordinates(self) -> Indices:
        """Which coordinates of the sections may move."""
        k, s = len(self.sections.decay), len(self.sections.rates)
        return np.arange(2 * k + s) if self.damped else np.arange(k, 2 * k)

    @property
    def _pole_count(self) -> int:
        return len(self.pole_coordinates)

    @property
    def _unit_count(self) -> int:
        """Sections, or poles, that have values of their own."""
        return len(self.sections.decay) + len(self.sections.rates) if self.real else len(self.sections.p)

    @property
    def _reals_per_value(self) -> int:
        """Real numbers of one value in all units: of a complex pole two."""
        return self._unit_count + (0 if self.real else int(np.sum(self.sections.p.imag != 0)))

    @cached_property
    def size(self) -> int:
        """Number of coordinates."""
        return self._pole_count + self._unit_count * self.values * (1 + (not self.real)) + int(self.fed_entries.sum())

    @cached_property
    def values(self) -> int:
        """Number of values of residues in each section or pole."""
        raise NotImplementedError

    @property
    def dof(self) -> int:
        """Unknowns that the data show."""
        raise NotImplementedError

    def sections_at(self, x: Array) -> Sections:
        """Sections of a model."""
        coordinates = self.sections.x * (self.damped or np.repeat([0.0, 1.0, 0.0], self._section_counts))
        coordinates[self.pole_coordinates] = x[: self._pole_count]
        return self.sections.moved(coordinates)

    @property
    def _section_counts(self) -> tuple[int, int, int]:
        return len(self.sections.decay), len(self.sections.decay), len(self.sections.rates)

    def start(self, residues: ComplexArray, feedthrough: Array) -> Array:
        """Coordinates near those of a free model with residues (n, p, m) at the poles of the `sections`."""
        x = self.sections.x if self.damped else np.abs(self.sections.x)
        sections = self.sections_at(x[self.pole_coordinates])
        factor, unit = self._factor(self.sections), self._unit_of_pole(self.sections)
        products, weights = factor.conj() * residues, np.abs(factor) ** 2
        scaled = np.zeros((self._unit_count, *residues.shape[1:]), complex)
        sums = np.zeros((self._unit_count, *factor.shape[1:]))
        np.add.at(scaled, unit, products)
        np.add.at(sums, unit, weights)
        values = self.nearest_values(np.asarray(scaled / sums, complex))
        parts = [sections.x[self.pole_coordinates], values.real.ravel()]
        parts += [] if self.real else [values.imag.ravel()]
        return np.concatenate([*parts, feedthrough[self.fed_entries]])

    def nearest_values(self, scaled: ComplexArray) -> RealOrComplex:
        """Values (units, number) for matrices (units, p, m) near to these."""
        raise NotImplementedError

    def residue_values(self, x: Array) -> RealOrComplex:
        """Values of the residues, shape (units, number): real if the structure says so."""
        count = self._unit_count * self.values
        real = x[self._pole_count : self._pole_count + count]
        values = real if self.real else real + 1j * x[self._pole_count + count : self._pole_count + 2 * count]
        return values.reshape(self._unit_count, self.values)

    def model(self, x: Array) -> tuple[Sections, ComplexArray, Array]:
        """Sections, residues (n, p, m) of their poles, and feedthrough (p, m)."""
        sections, through = self.sections_at(x), np.zeros(self.fed_entries.shape)
        through[self.fed_entries] = x[self.size - int(self.fed_entries.sum()) :]
        matrices = self.matrices(self.residue_values(x))[self._unit_of_pole(sections)]
        return sections, self._factor(sections) * matrices, through

    def sizes(self, x: Array, bin: float) -> Array:
        """Sizes of the coordinates, in which steps are compared: of a value of residues its largest in any mode."""
        sizes, largest = np.abs(x), np.abs(self.residue_values(x)).max(axis=0, initial=0.0)
        sizes[: self._pole_count] = self.sections_at(x).sizes(bin)[self.pole_coordinates]
        value_sizes = np.tile(largest, self._unit_count * (2 - self.real))
        sizes[self._pole_count : self._pole_count + len(value_sizes)] = value_sizes
        return sizes

    def matrices(self, values: RealOrComplex) -> RealOrComplex:
        """Residues over their factor, shape (units, p, m)."""
        raise NotImplementedError

    def _unit_of_pole(self, sections: Sections) -> Indices:
        """Which unit each pole belongs to."""
        if not self.real:
            return np.arange(len(sections.p))
        units = np.empty(len(sections.p), int)
        for k, places in enumerate(sections.places):
            units[places] = k
        units[sections.single] = len(sections.places) + np.arange(len(sections.single))
        return units

    def _factor(self, sections: Sections) -> ComplexArray:
        """`g`, shape (n, p, 1); of real poles half, as they are their own conjugates."""
        differences = np.full(len(sections.p), 2.0 + 0j)
        slow, fast = sections.places.T
        differences[fast] = np.where(sections.square > 0, 2j, -4.0) * sections.root
        real = sections.square <= 0
        differences[slow[real]] = 4.0 * sections.root[real]
        return (_nonzero(sections.p)[:, None] ** self._powers(sections) / differences[:, None])[:, :, None]

    def _powers(self, sections: Sections) -> Indices:
        """Powers (n, p) of the poles in `g`: that of a section of first order is by one less."""
        powers = np.tile(self.layout.powers, (len(sections.p), 1))
        powers[sections.single] -= 1
        return powers

    def _factor_slopes(self, sections: Sections) -> ComplexArray:
        """Derivatives of the logarithm of `g` by the coordinates of the poles, shape (n, p, coordinates)."""
        p, k, n = sections.p, len(sections.decay), len(sections.p)
        pole_slopes = sections.pole_slopes[n:] + 1j * sections.pole_slopes[:n]
        slopes = self._powers(sections)[:, :, None] * (pole_slopes / _nonzero(p)[:, None])[:, None]
        by_square = (0.5 / sections.square / np.where(sections.square > 0, 2.0, 1.0))[:, None]
        for column in (0, 1):  # a complex pole stands at both places
            slopes[sections.places[:, column], :, k + np.arange(k)] -= by_square
            slopes[sections.places[:, column], :, np.arange(k)] += 2 * sections.decay[:, None] * by_square
        return slopes[:, :, self.pole_coordinates]

    def derivatives(self, x: Array, output: int, has_feedthrough: bool) -> Array:
        """Derivatives of the `shared` unknowns of an output, in the units of the data, shape (numbers, size)."""
        sections, values = self.sections_at(x), self.residue_values(x)
        unit, n = self._unit_of_pole(sections), len(sections.p)
        factor, slopes = self._factor(sections)[:, :, 0], self._factor_slopes(sections)
        matrices, poles, pole_count = self.matrices(values)[unit], np.arange(n), int(self._pole_count)
        blocks = []
        for o, i in self.layout.entries(output):
            residue = np.zeros((n, self.size), complex)
            residue[:, :pole_count] = (factor[:, o] * matrices[:, o, i])[:, None] * slopes[:, o]
            for place, slope in self.slopes(values, o, i):
                columns = pole_count + unit * self.values + place
                residue[poles, columns] += factor[:, o] * slope[unit]
                if not self.real:
                    residue[poles, columns + self._unit_count * self.values] += 1j * factor[:, o] * slope[unit]
            feedthrough = np.zeros((int(has_feedthrough), self.size))
            if self.fed_entries[o, i]:
                feedthrough[:, self._feedthrough_places[o, i]] = 1.0
            blocks += [residue.real, residue.imag, feedthrough]
        return np.concatenate(blocks) if blocks else np.zeros((0, self.size))

    @cached_property
    def _feedthrough_places(self) -> Indices:
        """Places of the feedthrough of each entry among the coordinates."""
        return self.size - 1 - int(self.fed_entries.sum()) + np.cumsum(self.fed_entries).reshape(self.fed_entries.shape)

    def slopes(self, values: RealOrComplex, output: int, input: int) -> Sequence[tuple[int, RealOrComplex]]:
        """Places of the values that an entry depends on, and its derivative by each."""
        raise NotImplementedError

    def pole_derivatives(self, x: Array) -> Array:
        """Derivatives of imaginary and real parts of the poles, shape (2n, size)."""
        slopes = self.sections_at(x).pole_slopes
        derivatives = np.zeros((len(slopes), self.size))
        derivatives[:, : self._pole_count] = slopes[:, self.pole_coordinates]
        return derivatives

    def free_coordinates(self, x: Array) -> Mask:
        """Coordinates that may move: of several that make the same model all but one are held."""
        movable = np.ones(self.size, bool)
        if not self.real:
            # residues of real poles are real
            count = self._unit_count * self.values
            real = np.repeat(self.sections.p.imag == 0, self.values)
            movable[self._pole_count + count : self._pole_count + 2 * count] = ~real
        return movable


def _nonzero(p: ComplexArray) -> ComplexArray:
    return np.where(p == 0, np.finfo(float).tiny ** 0.25, p)


@dataclass(frozen=True)
class MatrixCoordinates(StructureCoordinates):
    """Residues with any values, or with the same for the pairs of ports that reciprocity makes equal."""

    reciprocal: bool = False

    @cached_property
    def _classes(self) -> Indices:
        """Which value each entry has, shape (p, m)."""
        classes = np.arange(self.layout.outputs * self.layout.inputs).reshape(self.layout.outputs, -1)
        for o, i in self.layout.ports if self.reciprocal else ():
            for other_o, other_i in self.layout.ports:
                classes[o, other_i] = classes[other_o, i] = min(classes[o, other_i], classes[other_o, i])
        return np.unique(classes, return_inverse=True)[1].reshape(classes.shape)

    @cached_property
    def values(self) -> int:
        """Number of values of residues in each mode."""
        return int(self._classes.max(initial=-1)) + 1

    @property
    def dof(self) -> int:
        """Unknowns that the data show."""
        return (
            self._pole_count
            + self._reals_per_value * len(np.unique(self._classes[self.shown_entries]))
            + int(self.fed_entries.sum())
        )

    def _powers(self, sections: Sections) -> Indices:
        """Powers without those that all residues have: values of any phase are any, and so finite at a pole of 0."""
        return np.asarray(self.layout.powers - self.layout.powers.min() + np.zeros((len(sections.p), 1), int))

    def nearest_values(self, scaled: ComplexArray) -> RealOrComplex:
        """Means over the entries of each value."""
        membership = np.eye(self.values)[self._classes[self.shown_entries]]
        return scaled[:, self.shown_entries] @ (membership / np.maximum(membership.sum(axis=0), 1))

    def matrices(self, values: RealOrComplex) -> RealOrComplex:
        """Residues over their factor, shape (n, p, m)."""
        return values[:, self._classes]

    def slopes(self, values: RealOrComplex, output: int, input: int) -> Sequence[tuple[int, RealOrComplex]]:
        """One value for each entry."""
        return [(int(self._classes[output, input]), np.ones(self._unit_count))]


@dataclass(frozen=True)
class ShapeCoordinates(StructureCoordinates):
    """Residues of rank one: products of a number of each output and one of each input, the same at ports if `tied`."""

    tied: bool = False

    @cached_property
    def _places(self) -> tuple[Indices, Indices]:
        """Which number each output and each input has."""
        p, m = self.layout.outputs, self.layout.inputs
        numbers = np.arange(p + m)
        for output, input in self.layout.ports if self.tied else ():
            first, second = numbers[output], numbers[p + input]
            numbers[numbers == max(first, second)] = min(first, second)
        numbers = np.unique(numbers, return_inverse=True)[1]
        return numbers[:p], numbers[p:]

    @cached_property
    def values(self) -> int:
        """Number of values of residues in each mode."""
        return int(max(places.max(initial=-1) for places in self._places)) + 1

    @property
    def is_port_alone(self) -> bool:
        """Whether each mode has a single number, the root of its weight."""
        return self.real and self.values == 1

    @cached_property
    def _gauges(self) -> list[Indices]:
        """Numbers that may be scaled against one another without any effect: one set for each such scale.

        Numbers that are multiplied with one another are linked; where the links part a set in two halves, one may grow
        as the other shrinks.
        """
        outputs, inputs = self._places
        count = self.values
        first, second = outputs[np.nonzero(self.shown_entries)[0]], inputs[np.nonzero(self.shown_entries)[1]]
        # each number on either side of the products: they are one half and the other unless some set meets itself
        links = np.zeros((2 * count, 2 * count), bool)
        links[first, count + second] = links[second, count + first] = True
        labels = connected_components(links, directed=False)[1]
        free_nodes = np.flatnonzero(labels[:count] != labels[count:])
        sets = {tuple(np.unique(np.flatnonzero(labels == labels[node]) % count).tolist()) for node in free_nodes}
        return [np.array(gauge) for gauge in sorted(sets)]

    @property
    def dof(self) -> int:
        """Unknowns that the data show."""
        return (
            self._pole_count + self._reals_per_value * (self.values - len(self._gauges)) + int(self.fed_entries.sum())
        )

    def free_coordinates(self, x: Array) -> Mask:
        """All but the largest of the numbers that share a scale."""
        sizes, fixed = np.abs(self.residue_values(x)), np.zeros((self._unit_count, self.values), bool)
        for gauge in self._gauges:
            fixed[np.arange(self._unit_count), gauge[np.argmax(sizes[:, gauge], axis=1)]] = True
        movable = super().free_coordinates(x)
        movable[self._pole_count :][: fixed.size] &= ~fixed.ravel()
        if not self.real:
            movable[self._pole_count + fixed.size :][: fixed.size] &= ~fixed.ravel()
        return movable

    def turned_to_positive(self, residues: ComplexArray) -> ComplexArray:
        """Residues of the same sizes with the phase of a port."""
        factor = self._factor(self.sections)
        return np.asarray(np.abs(residues / factor) * factor)

    def nearest_values(self, scaled: ComplexArray) -> RealOrComplex:
        """From the first singular vectors, scaled so that output and input agree at ports as far as they can."""
        outputs, inputs = self._places
        matrices = np.where(self.shown_entries, scaled.real if self.real else scaled, 0.0)
        U, sizes, Vh = np.linalg.svd(matrices, full_matrices=False)
        root = np.sqrt(sizes[:, :1])
        c, b = U[:, :, 0] * root, Vh[:, 0] * root
        values = np.zeros((self._unit_count, self.values), matrices.dtype)
        if self.tied and self.layout.ports:
            port_outputs, port_inputs = (np.array(channels) for channels in zip(*self.layout.ports, strict=True))
            # of c t and b / t, which agree where t**2 = b / c
            square_scale = np.sum(c[:, port_outputs].conj() * b[:, port_inputs], axis=1) / np.maximum(
                np.sum(np.abs(c[:, port_outputs]) ** 2, axis=1), np.finfo(float).tiny
            )
            wrong_sign = square_scale.real <= 0 if self.real else square_scale == 0
            scale = np.where(wrong_sign, 1.0, np.sqrt(np.where(wrong_sign, 1.0, square_scale)))[:, None]
            c, b = c * scale, b / scale
            b[:, port_inputs] = np.where(
                wrong_sign[:, None],
                _NOTHING * np.abs(b[:, port_inputs]),
                0.5 * (b[:, port_inputs] + c[:, port_outputs]),
            )
            c[:, port_outputs] = b[:, port_inputs]
        values[:, inputs] = b
        values[:, outputs] = c
        return values

    def shapes(self, x: Array) -> tuple[RealOrComplex, RealOrComplex]:
        """Numbers of the outputs (n, p), and of the inputs (n, m)."""
        values = self.residue_values(x)
        return values[:, self._places[0]], values[:, self._places[1]]

    def matrices(self, values: RealOrComplex) -> RealOrComplex:
        """Residues over their factor, shape (n, p, m)."""
        outputs, inputs = self._places
        return values[:, outputs, None] * values[:, None, inputs]

    def slopes(self, values: RealOrComplex, output: int, input: int) -> Sequence[tuple[int, RealOrComplex]]:
        """Each factor by the other."""
        first, second = int(self._places[0][output]), int(self._places[1][input])
        return [(first, values[:, second]), (second, values[:, first])]
