"""Poles anywhere and residues of any phase, fitted to data: the linear problem, and its minimum over the poles.

    G(s) = D + sum_l rho_l / (s - p_l) + conj(rho_l) / (s - conj(p_l)),       residues rho_l (outputs, inputs)

Poles may lie on either side of the axis, and residues are of any phase and sign, so that every lossless model is among
these.  A real pole is its own conjugate: half of its residue is `rho`, and the column of the imaginary part is 0.  The
coordinates of the minimisation are those of `sections`, which pass smoothly through critical damping.  All outputs of
a record share its columns, and so one factorisation; as columns depend on each pole analytically, the same factor gives
the derivatives for every output.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from ..._checks import EPS
from ..._types import Array, ComplexArray, Indices, Mask, NDArray
from ..data.time_record import LONG
from ..data.windowed import have_shared_errors, shared_score_covariance
from .elimination import LinearProjection, eliminate, inverse_gram, null_space, orthogonal, reduced, without
from .frequency_rows import FreeResponse
from .sections import PoleRegion, Sections
from .spectral_rows import FreeWindow
from .time_rows import FreeRecord
from .tuning import TUNING
from .variable_projection import Progress, refine

_STEPS = 40
_TRACE = 1e-6  # part of a unit vector without a trace, from which on a number belongs to it

# A complex coefficient has two columns, for its real and its imaginary part: those of the free motion, if modes may be
# `moving` at the start, then of each input those of the residues (2n), and what is fed `through` if that may be.
# Derivatives are those of these columns by the pole.
FreeRows = FreeRecord | FreeResponse | FreeWindow

Rows = TypeVar("Rows", FreeRecord, FreeResponse)  # what may have a delay

# outputs, residual, Jacobians by poles and by the shared unknowns of these outputs
Sensitivity = tuple[list[int], Array, Array, Array]

ROUNDED = 1.5  # times what rounding leaves: less of an output is no evidence of anything
_SHOWN = 3.0  # times that: with as much noise before it, errors of samples are not the same

# --- delays -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Lateness:
    """Times by which `outputs` (p,) come later than the response to the inputs, and `inputs` (m,) act later."""

    outputs: Array
    inputs: Array


@dataclass(frozen=True)
class Delays:
    """Delays that outputs of a projection share, in units of time.

    Attributes
    ----------
    groups : ndarray of int, shape (outputs of the projection,)
        Which delay each output has.
    values : ndarray, shape (k,)
        The delays.
    step : float
        Time within which an answer hardly turns: no step of a search is longer.
    least, most : float or None
        Bounds of a search; the samples of records that any delay between them leaves out are left out for all.
    """

    groups: Indices
    values: Array
    step: float = np.inf
    least: float | None = None
    most: float | None = None

    @classmethod
    def of_outputs(cls, delay: Array) -> Delays:
        """The delays of all outputs."""
        values, groups = np.unique(delay, return_inverse=True)
        return cls(groups, values)

    @property
    def count(self) -> int:
        """Number of delays."""
        return len(self.values)

    @property
    def by_output(self) -> Array:
        """Delay of each output."""
        return self.values[self.groups]

    def rows(self, experiments: Sequence[Rows]) -> list[Rows]:
        """Rows with these delays, of outputs that share one."""
        delayed = list[Rows]()
        for rows in experiments:
            groups = self.groups[rows.outputs]
            for group in np.unique(groups).tolist():
                selection = rows if np.all(groups == group) else rows.among_outputs(groups == group)
                delayed.append(selection.delayed(float(self.values[group]), self.least, self.most))
        return delayed

    def inside(self, values: Array) -> Array:
        """Delays brought to where they are allowed."""
        return np.clip(values, self.least, self.most)


# --- the linear problem ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _ExperimentColumns:
    """Rows of the triangular factor of an experiment: those of its own unknowns, or those that remain without them.

    Columns of the shared unknowns, their derivatives by the poles, and the outputs.
    """

    shared: Array
    derivatives: Array
    outputs: Array

    @classmethod
    def of(cls, rows: FreeRows, columns: Array, n: int, shared: int) -> _ExperimentColumns:
        """Columns in the order of `FreeRows`; `shared` are those that any experiment has."""
        places, last = input_places(rows, n), columns.shape[1] - len(rows.outputs)
        own = len(places)
        padded = np.zeros((len(columns), shared))
        padded[:, places] = columns[:, :own]
        return cls(padded, columns[:, own:last], columns[:, last:])


@dataclass(frozen=True)
class _OutputGroup:
    """Outputs that are shown by the same experiments, and their columns with what solves for the shared unknowns.

    Of these the places in `absent` are 0; `rows` is the number of samples of which rounding is left out.
    """

    outputs: list[int]
    experiments: tuple[int, ...]
    columns: Array
    targets: Array
    absent: tuple[int, ...]
    rows: int

    @cached_property
    def _solved(self) -> tuple[Array, Array]:
        basis, solve = orthogonal(self.columns, self.rows)
        solve[list(self.absent)] = 0.0
        return basis, solve

    @property
    def basis(self) -> Array:
        """Orthonormal basis of the columns."""
        return self._solved[0]

    @property
    def solve(self) -> Array:
        """What turns coordinates in the basis into the shared unknowns."""
        return self._solved[1]

    def slopes(self, by_poles: Array) -> tuple[Array, Array]:
        """Derivatives by the poles without what the shared unknowns absorb, and how these then change."""
        coefficients = self.basis.T @ by_poles
        return by_poles - self.basis @ coefficients, -self.solve @ coefficients


class FreeProjection(LinearProjection):
    """Best residues, and what belongs to each experiment, for poles `p` (n,): of pairs the upper ones, and real ones.

    Natural frequencies are `d`, decay rates `sigma`; `rows` is the number of real equations, `inputs` that of inputs, 0
    for a free motion.  Of what rows may feed through, only that of entries `fed` (outputs, inputs) is.  Derivatives are
    by the coordinates `x` of the `sections`, those of these poles by default.
    """

    def __init__(
        self, experiments: Sequence[FreeRows], p: ComplexArray, fed: Mask | None = None,
        sections: Sections | None = None,
    ) -> None:  # fmt: skip
        self.sections = Sections.of(p) if sections is None else sections
        self.p, self.x, self.d, self.sigma = p, self.sections.x, np.abs(p), -p.real
        self.sizes = self.sections.sizes()
        self.experiments = experiments
        self.rows = sum(rows.samples * len(rows.outputs) for rows in experiments)
        self.inputs = max(int(rows.acting.max(initial=-1)) + 1 for rows in experiments)
        self.fed = fed
        self.region: PoleRegion | None = None  # at whose border poles may be
        self._predictions: list[NDArray[Any]] | None = None

    @property
    def pole_parts(self) -> Array:
        """Imaginary, then real parts of the poles."""
        return np.concatenate([self.p.imag, self.p.real])

    @property
    def has_feedthrough(self) -> bool:
        """Whether something may be fed through."""
        return any(rows.through and rows.inputs > 0 for rows in self.experiments)

    @property
    def excited_unknowns(self) -> Mask:
        """Which numbers of `shared` leave a trace in any experiment."""
        excited = np.zeros(self.shared.shape, bool)
        for group in self._groups:
            excited[:, group.outputs] = np.any(group.columns, axis=0, keepdims=True).T
        return excited

    @cached_property
    def unidentifiable_unknowns(self) -> Mask:
        """Numbers of `shared` in a combination that leaves no trace, as residues under an input of one sine."""
        unidentifiable = np.zeros(self.shared.shape, bool)
        for group in self._groups:
            present = np.flatnonzero(np.any(group.columns, axis=0))
            null = null_space(group.columns[:, present], self.rows)
            unidentifiable[np.ix_(present, np.asarray(group.outputs))] = np.any(np.abs(null) > _TRACE, axis=0)[:, None]
        return unidentifiable

    @property
    def deficiency(self) -> int:
        """Number of combinations of `shared` that leave no trace."""
        return sum((np.count_nonzero(np.any(group.columns, axis=0)) - group.basis.shape[1]) * len(group.outputs)
                   for group in self._groups)  # fmt: skip

    @property
    def rounding(self) -> Array:
        """Losses of outputs below which residuals are rounding: of recursions in doubles it grows with the samples."""
        return np.asarray((EPS * self.rows) ** 2 * GivenResidues(self, np.zeros_like(self.shared)).losses)

    def variance_of(self, loss: float) -> float:
        """Return the variance of the rows where a model leaves a loss, no smaller than that of rounded outputs."""
        return max(loss, float(self.rounded.sum())) / max(1, self.rows - self.unknowns)

    @property
    def within_rounding(self) -> Mask:
        """Which outputs were rounded, and leave no more than that and a little noise."""
        return np.asarray((self.losses <= _SHOWN * self.rounded) & (self.rounded > 0))

    @cached_property
    def rounded(self) -> Array:
        """Losses of outputs that are rounding of what was recorded."""
        losses = np.zeros(self.shared.shape[1])
        for rows in self.experiments:
            if isinstance(rows, FreeRecord):
                losses[rows.outputs] += rows.rounded
        return losses

    @property
    def unknowns(self) -> int:
        """Number of real unknowns: poles, the shared ones that are shown, and those of each experiment and output."""
        real = int(np.sum(self.p.imag == 0))
        own = sum(
            (rows.own_unknowns(len(self.p)) - real * rows.moving) * len(rows.outputs) for rows in self.experiments
        )  # fmt: skip
        return len(self.x) + int(self.excited_unknowns.sum()) + own

    @property
    def _shared_unknowns(self) -> int:
        return self.inputs * (2 * len(self.p) + self.has_feedthrough)

    @cached_property
    def factors(self) -> list[Array]:
        """Triangular factor of all columns of each experiment."""
        return [rows.evaluated(self.p).factor(rows.samples) for rows in self.experiments]

    def with_unknowns(
        self, p: ComplexArray, shared: Array, sections: Sections | None = None,
        experiments: Sequence[FreeRows] | None = None,
    ) -> GivenResidues:  # fmt: skip
        """The same data at other poles and shared unknowns, which may be those of `experiments` with delays."""
        experiments = self.experiments if experiments is None else experiments
        projection = FreeProjection(experiments, p, self.fed, sections)
        if experiments is self.experiments and np.array_equal(p, self.p):
            projection.factors = self.factors
        return GivenResidues(projection, shared)

    def rescaled(self, experiments: Sequence[FreeRows], ratio: Array, fed: Mask | None) -> FreeProjection:
        """The same poles in rows whose outputs are as large as these, times the `ratio` (outputs,)."""
        projection = FreeProjection(experiments, self.p, fed, self.sections)
        projection.region = self.region
        projection.factors = [factor.copy() for factor in self.factors]
        for rows, factor in zip(experiments, projection.factors, strict=True):
            factor[:, -len(rows.outputs) :] *= ratio[rows.outputs]
        return projection

    def ascending(self) -> FreeProjection:
        """The same with the poles by natural frequency, and the coordinates of these."""
        rank = np.argsort(self.d)
        projection, modes = FreeProjection(self.experiments, self.p[rank], self.fed), np.arange(len(rank))
        if np.array_equal(rank, modes):
            projection.factors = self.factors
            return projection
        projection.factors = []
        for rows, factor in zip(self.experiments, self.factors, strict=True):
            columns = np.arange(factor.shape[1])
            for first in self._mode_columns(rows):
                columns[first + modes] = first + rank
            projection.factors.append(reduced(np.asfortranarray(factor[:, columns])))
        return projection

    def without_mode(self, k: int) -> FreeProjection:
        """The same without a mode, from the factors that are known."""
        n = len(self.p)
        projection = FreeProjection(self.experiments, np.delete(self.p, k), self.fed)
        if any(rows.own_unknowns(n) - rows.own_unknowns(n - 1) != 2 * rows.moving for rows in self.experiments):
            return projection  # fewer modes leave unknowns to others
        projection.factors = []
        for rows, factor in zip(self.experiments, self.factors, strict=True):
            dropped = [first + k for first in self._mode_columns(rows)]
            projection.factors.append(reduced(np.asfortranarray(np.delete(factor, dropped, axis=1))))
        return projection

    def _mode_columns(self, rows: FreeRows) -> list[int]:
        """First columns of all that factors have of each mode, in the order of the modes."""
        n = len(self.p)
        width, own = 2 * n + rows.through, rows.own_unknowns(n)
        slopes = own + width * rows.inputs
        firsts = [0] * rows.moving + [own + width * i for i in range(rows.inputs)]
        firsts += list(range(slopes, slopes + 2 * n * (rows.moving + rows.inputs), 2 * n))
        return [first + part for first in firsts for part in (0, n)]

    @cached_property
    def evidence(self) -> Array:
        """How much the loss would grow without each mode."""
        return np.array([self.without_mode(k).loss - self.loss for k in range(len(self.p))])

    @cached_property
    def _parts(self) -> list[tuple[Array, _ExperimentColumns, _ExperimentColumns]]:
        """Of each experiment the inverse that solves for own unknowns, their rows, and the remaining rows."""
        n, parts = len(self.p), []
        for rows, factor in zip(self.experiments, self.factors, strict=True):
            part = eliminate(factor, rows.own_unknowns(n), rows.samples)
            above, below = (
                _ExperimentColumns.of(rows, columns, n, self._shared_unknowns) for columns in (part.above, part.below)
            )
            parts.append((part.inverse, above, below))
        return parts

    @cached_property
    def _groups(self) -> list[_OutputGroup]:
        outputs_by_members: dict[tuple[tuple[int, ...], tuple[int, ...]], list[int]] = {}
        for output in range(1 + max(int(rows.outputs.max()) for rows in self.experiments)):
            members = tuple(k for k, rows in enumerate(self.experiments) if output in rows.outputs)
            outputs_by_members.setdefault((members, self._absent_feedthrough(output)), []).append(output)
        groups = []
        for (members, absent), outputs in outputs_by_members.items():
            columns = np.concatenate([self._parts[k][2].shared for k in members])
            columns[:, list(absent)] = 0.0
            targets = np.concatenate([self._parts[k][2].outputs[:, self._output_places(k, outputs)] for k in members])
            groups.append(_OutputGroup(outputs, members, columns, targets, absent, self.rows))
        return groups

    def _absent_feedthrough(self, output: int) -> tuple[int, ...]:
        """Places of what is not fed through to an output among the shared unknowns."""
        if self.fed is None or not self.has_feedthrough:
            return ()
        width = 2 * len(self.p) + 1
        return tuple(width * k + width - 1 for k in range(self.inputs) if not self.fed[output, k])

    def _output_places(self, experiment: int, outputs: list[int]) -> Indices:
        """Places of outputs among those of an experiment."""
        return np.array([np.flatnonzero(self.experiments[experiment].outputs == output)[0] for output in outputs])

    @cached_property
    def shared(self) -> Array:
        """Real and imaginary parts of the residues and what is fed through of each input, shape (.., outputs)."""
        shared = np.zeros((self._shared_unknowns, sum(len(group.outputs) for group in self._groups)))
        for group in self._groups:
            shared[:, group.outputs] = group.solve @ (group.basis.T @ group.targets)
        return shared

    @property
    def shared_errors(self) -> Array:
        """Standard errors of `shared` for known poles and rows of variance 1."""
        errors = np.zeros(self.shared.shape)
        for group in self._groups:
            errors[:, group.outputs] = np.linalg.norm(group.solve, axis=1)[:, None]
        return errors

    @property
    def fed_through(self) -> Mask:
        """Which entries (outputs, inputs) are fed through."""
        entries = np.ones((self.shared.shape[1], self.inputs), bool)
        return entries & self.has_feedthrough if self.fed is None else self.fed

    @property
    def residues(self) -> ComplexArray:
        """Residues `rho`, shape (n, outputs, inputs)."""
        n = len(self.p)
        unknowns = self.shared.reshape(self.inputs, -1 if self.inputs else 2 * n, self.shared.shape[1])
        return np.transpose(unknowns[:, :n] + 1j * unknowns[:, n : 2 * n], (1, 2, 0))

    @property
    def feedthrough(self) -> Array:
        """What is fed through, shape (outputs, inputs)."""
        unknowns = self.shared.reshape(self.inputs, -1 if self.inputs else 1, self.shared.shape[1])
        return unknowns[:, -1].T if self.has_feedthrough else np.zeros((self.shared.shape[1], self.inputs))

    def held_outputs(self, rows: FreeRecord) -> Array:
        """Outputs (q,) of a record that the inputs hold which were subtracted from it; nothing of poles at 0."""
        if rows.steady is None:
            return np.zeros(len(rows.outputs))
        stays = self.p != 0
        gains = self.feedthrough - 2 * np.einsum("lqi,l->qi", self.residues[stays], 1 / self.p[stays]).real
        return np.asarray(gains[np.ix_(rows.outputs, rows.acting)] @ rows.steady)

    def integrated_outputs(self, rows: FreeRecord) -> Array:
        """Change per unit time of outputs (q,) by inputs that were subtracted from a record, through poles at 0."""
        if rows.steady is None:
            return np.zeros(len(rows.outputs))
        rates = 2 * self.residues[self.p == 0].real.sum(axis=0)
        return np.asarray(rates[np.ix_(rows.outputs, rows.acting)] @ rows.steady)

    @cached_property
    def own(self) -> list[Array]:
        """What belongs to each experiment, shape (unknowns, its outputs)."""
        return [
            inverse @ (above.outputs - above.shared @ self.shared[:, rows.outputs])
            for (inverse, above, _), rows in zip(self._parts, self.experiments, strict=True)
        ]

    @cached_property
    def losses(self) -> Array:
        """Sum of squared residuals of each output."""
        losses = np.zeros(sum(len(group.outputs) for group in self._groups))
        for group in self._groups:
            losses[group.outputs] = np.sum(self._residual(group) ** 2, axis=0)
        return losses

    def _residual(self, group: _OutputGroup) -> Array:
        """What is left of the outputs of a group."""
        return without(group.targets, group.basis)

    @cached_property
    def loss(self) -> float:
        """Sum of squared residuals of all outputs."""
        return float(self.losses.sum())

    def predictions(self) -> list[NDArray[Any]]:
        """Outputs (q, T) at all instants or frequencies of each experiment; kept unless many, not to be changed."""
        if self._predictions is not None:
            return self._predictions
        n, predictions = len(self.p), list[NDArray[Any]]()
        for rows, own in zip(self.experiments, self.own, strict=True):
            shared = self.shared[np.ix_(input_places(rows, n), rows.outputs)]
            predictions.append(rows.evaluated(self.p).predict(shared, own))
            predictions[-1].flags.writeable = self.rows > LONG
        self._predictions = predictions if self.rows <= LONG else None
        return predictions

    def own_covariances(self, experiment: int, covariance: Array, variance: float) -> list[tuple[Array, Array]]:
        """Covariances of what belongs to an experiment, for each output, from that of poles and `shared`.

        Then those with the poles, by imaginary and real parts, and with what `shared` has of the output.
        """
        rows, (inverse, above, _) = self.experiments[experiment], self._parts[experiment]
        n, width, pairs = len(self.p), len(self.shared), []
        for own, output in zip(self.own[experiment].T, rows.outputs.tolist(), strict=True):
            slopes = pole_derivatives(above.derivatives, rows, own, self.residues[:, output])
            jacobian = -inverse @ np.concatenate([slopes, above.shared], axis=1)
            places = np.append(np.arange(2 * n), 2 * n + output * width + np.arange(width)).astype(int)
            cross = jacobian @ covariance[np.ix_(places, places)]
            pairs.append((variance * inverse @ inverse.T + cross @ jacobian.T, cross))
        return pairs

    def _pole_slopes(self, group: _OutputGroup, output: int) -> Array:
        """Derivatives of an output by imaginary and real parts of the poles, in the rows of its group."""
        slopes = []
        for k in group.experiments:
            rows, own = self.experiments[k], self.own[k][:, self._output_places(k, [output])[0]]
            slopes.append(pole_derivatives(self._parts[k][2].derivatives, rows, own, self.residues[:, output]))
        return np.concatenate(slopes)

    def delay_slopes(self, output: int) -> Array:
        """Derivative of an output by its delay, per unit time, in the rows of its group."""
        (group,) = (group for group in self._groups if output in group.outputs)
        slopes = []
        for k in group.experiments:
            own = self.own[k][:, self._output_places(k, [output])[0]]
            parts = self._parts[k][2], self.experiments[k], self.p
            slopes.append(delay_derivative(*parts, own, self.residues[:, output], self.feedthrough[output]))
        return np.concatenate(slopes)

    @cached_property
    def condensed(self) -> tuple[Array, Array]:
        """Residual and its Jacobian by the coordinates, all else moving along."""
        parts, pole_slopes = [], self.sections.pole_slopes
        for group in self._groups:
            for output, target in zip(group.outputs, group.targets.T, strict=True):
                rows = np.column_stack([-self._pole_slopes(group, output) @ pole_slopes, target])
                parts.append(without(rows, group.basis))
        R = reduced(np.asfortranarray(np.concatenate(parts)))
        return R[:, -1], R[:, :-1]

    @cached_property
    def held_coordinates(self) -> Mask:
        """Which coordinates are at a border that a descent would push them across."""
        residual, jacobian = self.condensed
        nothing = np.zeros(len(self.x), bool)
        return nothing if self.region is None else self.region.held(self.x, jacobian.T @ residual)

    @cached_property
    def gradient(self) -> Array:
        """Half the gradient of the loss, 0 for what is held."""
        residual, jacobian = self.condensed
        return np.where(self.held_coordinates, 0.0, jacobian.T @ residual)

    @cached_property
    def gram(self) -> Array:
        """`J^T J` of the residuals, 0 for what is held."""
        jacobian = np.where(self.held_coordinates, 0.0, self.condensed[1])
        return np.asarray(jacobian.T @ jacobian)

    def covariance(self, variance: float) -> Array:
        """Covariance of imaginary and real parts of the poles, then `shared` by outputs, for a variance of the rows."""
        n, width, pole_slopes = len(self.p), self._shared_unknowns, self.sections.pole_slopes
        jacobian = np.zeros((2 * n + self.shared.size, len(self.x)))
        jacobian[: 2 * n] = pole_slopes
        remainders, places = [np.zeros((0, len(self.x)))], {}
        for group in self._groups:
            for output in group.outputs:
                remainder, unknown_slopes = group.slopes(self._pole_slopes(group, output) @ pole_slopes)
                places[output] = slice(2 * n + output * width, 2 * n + (output + 1) * width)
                jacobian[places[output]] = unknown_slopes
                remainders.append(remainder)
        covariance = (
            jacobian @ inverse_gram(np.concatenate(remainders)) @ jacobian.T if n else np.zeros((self.shared.size,) * 2)
        )
        for group in self._groups:
            for output in group.outputs:
                covariance[places[output], places[output]] += group.solve @ group.solve.T
        if have_shared_errors(self.experiments):
            covariance = covariance + self._shared_error_covariance()
        return variance * covariance

    @property
    def excess(self) -> float:
        """How many more squares than it has unknowns the model takes of errors that entries have in common."""
        _, inverse, scores = self._score_moments
        return float(np.sum(inverse * scores))

    def _shared_error_covariance(self) -> Array:
        """What errors that entries have in common add to the covariance."""
        derivatives, inverse, scores = self._score_moments
        return np.asarray(derivatives @ inverse @ scores @ inverse @ derivatives.T)

    @cached_property
    def _score_moments(self) -> tuple[Array, Array, Array]:
        """Derivatives of what a covariance is of by all coordinates, the inverse Gram matrix and scores of these."""
        k, n = len(self.x), len(self.p)
        jacobians = {}
        for place, rows in enumerate(self.experiments):
            by_poles, by_shared = self.row_jacobians(place)
            columns = np.zeros((len(by_poles), k + self.shared.size))
            start = k + int(rows.outputs[0]) * len(self.shared)
            columns[:, :k] = by_poles @ self.sections.pole_slopes
            columns[:, start : start + len(self.shared)] = by_shared
            jacobians[place] = columns
        inverse = inverse_gram(np.concatenate([reduced(np.asfortranarray(J)) for J in jacobians.values()]))
        derivatives = np.zeros((2 * n + self.shared.size, k + self.shared.size))
        derivatives[: 2 * n, :k], derivatives[2 * n :, k:] = self.sections.pole_slopes, np.eye(self.shared.size)
        return derivatives, inverse, shared_score_covariance(self.experiments, jacobians)

    def row_jacobians(self, place: int) -> tuple[Array, Array]:
        """Derivatives of the one output of an experiment by poles and by what is shared, in all its rows.

        By imaginary and real parts of the poles; what belongs to the experiment is eliminated.
        """
        rows, n = self.experiments[place], len(self.p)
        columns = np.concatenate(list(rows.evaluated(self.p).blocks()), axis=1).T
        own, output = rows.own_unknowns(n), int(rows.outputs[0])
        parts = _ExperimentColumns.of(rows, columns[:, own:], n, self._shared_unknowns)
        slopes = pole_derivatives(parts.derivatives, rows, self.own[place][:, 0], self.residues[:, output])
        absent = list(self._absent_feedthrough(output))
        parts.shared[:, absent] = 0.0
        basis, _ = orthogonal(columns[:, :own], len(columns))
        return without(slopes, basis), without(parts.shared, basis)


class GivenResidues(FreeProjection):
    """The same poles with `shared` unknowns that are given: only what belongs to each experiment is at its best."""

    def __init__(self, projection: FreeProjection, shared: Array) -> None:
        super().__init__(projection.experiments, projection.p, projection.fed, projection.sections)
        self._parts, self._groups, self.shared = projection._parts, projection._groups, shared

    @cached_property
    def condensed(self) -> tuple[Array, Array]:
        """Residual and its Jacobian by the coordinates, the shared unknowns at rest."""
        pole_slopes = self.sections.pole_slopes
        rows = [np.column_stack([slopes @ pole_slopes, residual]) for _, residual, slopes, _ in self.sensitivities()]
        R = reduced(np.asfortranarray(np.concatenate(rows)))
        return R[:, -1], R[:, :-1]

    def sensitivities(self) -> Iterator[Sensitivity]:
        """Residuals of outputs and their Jacobians by imaginary and real parts of poles, and by `shared`, by output.

        What belongs to each experiment moves along; the gradient and the information are those of all unknowns.
        """
        for group in self._groups:
            residual = self._residual(group)
            for place, output in enumerate(group.outputs):
                yield [output], residual[:, place], -self._pole_slopes(group, output), -group.columns

    def _residual(self, group: _OutputGroup) -> Array:
        return np.asarray(group.targets - group.columns @ self.shared[:, group.outputs])


def input_places(rows: FreeRows, n: int) -> Indices:
    """Places of the unknowns of the inputs of an experiment among those of all inputs."""
    width = 2 * n + rows.through
    return np.asarray((width * rows.acting[:, None] + np.arange(width)).ravel())


def pole_derivatives(derivatives: Array, rows: FreeRows, own: Array, residues: ComplexArray) -> Array:
    """Derivatives of an output by imaginary and real parts of the poles, from those of its columns.

    `own` unknowns are those of the output, as are its `residues` (n, inputs).
    """
    n = len(residues)
    slopes = np.zeros((len(derivatives), n), complex)
    amplitudes = [own[:n] + 1j * own[n : 2 * n]] if rows.moving else []
    amplitudes += list(residues.T[rows.acting])
    for k, amplitude in enumerate(amplitudes):
        first, second = derivatives[:, 2 * k * n : (2 * k + 1) * n], derivatives[:, (2 * k + 1) * n : (2 * k + 2) * n]
        # derivative along the real axis; along the imaginary one the coefficient turns by a quarter
        slopes += (
            first * amplitude.real + second * amplitude.imag + 1j * (second * amplitude.real - first * amplitude.imag)
        )
    return np.concatenate([slopes.imag, slopes.real], axis=1)


def delay_derivative(
    columns: _ExperimentColumns, rows: FreeRows, p: ComplexArray, own: Array, residues: ComplexArray, through: Array
) -> Array:
    """Derivative of an output by its delay: what it changes by per unit time, with the other sign.

    A mode `x' = p x + u` changes by itself, and by the input.  `residues` are (n, inputs), what is fed `through`
    (inputs,); the free motion is that of the output with its delay.
    """
    n = len(p)
    residues, through = residues[:, rows.acting], through[rows.acting]
    rotated, direct = -p[:, None] * residues, -2.0 * residues.real.sum(axis=0)[None]
    weights = np.concatenate([rotated.real, rotated.imag, *[direct] * rows.through]).T.ravel()
    slope = columns.shared[:, input_places(rows, n)] @ weights
    derivatives = columns.derivatives[:, 2 * n * (rows.moving + rows.inputs) :]
    if isinstance(rows, FreeResponse):
        first = -through if rows.through else direct[0]
        return np.asarray(slope + derivatives @ np.concatenate([first, -own]))
    if isinstance(rows, FreeRecord) and derivatives.shape[1]:
        slope = slope - derivatives @ through / rows.hold.h
    return np.asarray(slope)


# --- the non-linear one ----------------------------------------------------------------------------------------------

RowMaker = Callable[[ComplexArray], Sequence[FreeRows]]  # rows for modes about which they reach


@dataclass(frozen=True)
class FreeProblem:
    """Experiments whose loss is minimised over the coordinates of the sections."""

    experiments: Sequence[FreeRows]
    region: PoleRegion
    fed: Mask | None = None
    known: FreeProjection | None = None  # of the same rows

    @property
    def samples(self) -> int:
        """Number of real equations."""
        return sum(rows.samples * len(rows.outputs) for rows in self.experiments)

    def project(self, x: Array) -> FreeProjection:
        """Best residues for these poles."""
        sections = Sections.from_coordinates(x)
        projection = FreeProjection(self.experiments, sections.p, self.fed, sections)
        projection.region = self.region
        if self.known is not None and np.array_equal(sections.p, self.known.p):
            projection.factors = self.known.factors
        return projection

    def inside(self, x: Array) -> Array:
        """Poles brought to where they are allowed."""
        return self.region.inside(x)

    def reach(self, projection: FreeProjection) -> Array:
        """Widths of the basins."""
        return self.region.reach(projection.sections)


def refine_free(
    make_rows: RowMaker, p: ComplexArray, region: PoleRegion, rtol: float = 1e-8, fed: Mask | None = None,
    last: bool = True, steps: int = _STEPS, progress: Progress | None = None, known: FreeProjection | None = None,
) -> FreeProjection:  # fmt: skip
    """Poles refined from a start; of those without a decay rate (NaN) it is looked for first.

    What is not the `last` refinement ends where steps get small.  `progress` is told the mean of the squared rows.
    What is `known` of rows that are the same for all poles is not worked out again.
    """
    p = p.copy()
    for k in np.flatnonzero(np.isnan(p.real)):
        p[k] = _first_decay(make_rows, p, int(k), region)
    for _ in range(3):  # peaks turn out wider than their window
        sections = Sections.of(p)
        problem = FreeProblem(make_rows(p), region.about(sections), fed, known)
        start = problem.inside(sections.x)
        report = progress and _mean_progress(progress, problem.samples)
        end = refine(problem, start, rtol=rtol, max_iterations=steps, last=last, progress=report)
        before, p = p, end.projection.p
        if len(p) == len(before) and np.all(np.abs(p.real) <= 2 * np.abs(before.real) + region.bin):
            break
    return end.projection


def _mean_progress(progress: Progress, samples: int) -> Progress:
    return lambda iteration, loss: progress(iteration, loss / samples)


def _first_decay(make_rows: RowMaker, p: ComplexArray, k: int, region: PoleRegion) -> complex:
    """Pole k with the one of some decay rates that gives the smallest loss beside the other poles."""
    start = np.where(np.isnan(p.real), -region.bin, p.real) + 1j * p.imag
    widest = 0.3 * max(p[k].imag, 4 * region.bin)
    rates = [width * region.bin for width in TUNING.decay_rates if width * region.bin <= widest]

    def with_decay_rate(rate: float) -> ComplexArray:
        return np.where(np.arange(len(p)) == k, -rate + 1j * p.imag, start)

    rows = make_rows(with_decay_rate(max(rates)))
    return complex(-min(rates, key=lambda rate: FreeProjection(rows, with_decay_rate(rate)).loss), p[k].imag)
