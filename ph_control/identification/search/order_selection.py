"""The choice of the order: what each number of modes achieves, and which frequencies stay as it grows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import control as ct
import numpy as np

from ... import _checks
from ..._display import Report
from ..._frozen import Frozen
from ..._threads import on_one_thread
from ..._types import Array, Indices, Mask
from ..._units import common_unit, unit_for
from ..._workers import check_workers, mapped
from ...exceptions import IdentificationError, StructureError
from ...plotting.validation_plot import order_selection_plot
from ..regression.frequency_rows import FrequencyRows
from ..regression.time_rows import RecordRows
from ..regression.variable_projection import Problem, Rows, refine
from .criteria import CRITERIA, criteria
from .formulation import Callback, Formulation, reporter
from .held_out import held_out
from .steps import Step

_LARGEST = 10  # by default
_STABLE, _STABLE_BINS = 0.01, 2.0


@dataclass(frozen=True, eq=False, repr=False)
class OrderSelection(Report, Frozen):
    """What each number of modes achieves; made by `order_selection`.

    Attributes
    ----------
    orders : ndarray, shape (k,)
        Numbers of modes, ascending.
    loss : ndarray, shape (k,)
        Mean squared residual.
    aic, aicc, bic : ndarray, shape (k,)
        Criteria of Akaike, the same corrected for short records, and of Schwarz; the smallest is best.
    holdout : ndarray, shape (k,), or None
        Mean squared error over what was held out, of models fitted to the rest.
    frequencies : tuple of ndarray
        Natural frequencies of each order, ascending, rad per unit time.
    stable : tuple of ndarray of bool
        Which of them were there one order before already.
    samples : int
        Observed output samples; of responses real and imaginary parts.
    held_out : int
        How many of them were held out.
    time_unit : str or None
        Unit of time of the data; None where it is not known.
    """

    orders: Indices
    loss: Array
    aic: Array
    aicc: Array
    bic: Array
    holdout: Array | None
    frequencies: tuple[Array, ...]
    stable: tuple[Mask, ...]
    samples: int
    held_out: int
    time_unit: str | None = None

    def chosen(self, criterion: str = "bic") -> int:
        """Order that a criterion chooses.

        Parameters
        ----------
        criterion : {'aic', 'aicc', 'bic', 'holdout'}
            Which to minimise.

        Returns
        -------
        int

        Raises
        ------
        StructureError
            If there is no such criterion, or no part of the data was held out.

        Examples
        --------
        See `order_selection`.
        """
        _checks.choice("criterion", criterion, CRITERIA)
        values = getattr(self, criterion)
        if values is None:
            raise StructureError("no part of the record was held out; pass holdout=0.3 to order_selection")
        return int(self.orders[np.argmin(values)])

    def __str__(self) -> str:
        """Table of the orders; the best of each criterion is marked."""
        columns = {"loss": self.loss, "AIC": self.aic, "AICc": self.aicc, "BIC": self.bic}
        if self.holdout is not None:
            columns["hold-out"] = self.holdout
        head = "order" + "".join(f"{name:>13} " for name in columns)
        lines = [head.rstrip() + "  stable"]
        for row, order in enumerate(self.orders):
            text = f"{order:5d}"
            for name, values in columns.items():
                mark = "*" if name != "loss" and row == np.argmin(values) else " "
                text += f"{values[row]:13.6g}{mark}"
            lines.append(f"{text} {int(self.stable[row].sum()):3d} of {order}")
        return "\n".join(lines)

    def _headline(self) -> str:
        return f"orders {self.orders[0]} to {self.orders[-1]}, BIC chooses {self.chosen('bic')}"

    def plot(self, criterion: str = "bic", **kwargs: Any) -> ct.ControlPlot:
        """Stabilisation diagram, and the criteria beside it.

        Parameters
        ----------
        criterion : {'aic', 'aicc', 'bic', 'holdout'}
            Whose choice is marked.
        **kwargs
            `time_unit`, `Hz` as in `bode_plot`, style as in `fit_plot`, and `ax`: an array of two axes.

        Returns
        -------
        control.ControlPlot
            `axes` of shape (1, 2): frequencies of each order, and criteria, over a common axis of orders.

        Examples
        --------
        See `order_selection`.
        """
        above = {
            name: values - values.min() for name, values in (("AIC", self.aic), ("AICc", self.aicc), ("BIC", self.bic))
        }
        if self.holdout is not None:
            # on the scale of the others: twice the difference of Gaussian log-likelihoods
            least = max(float(self.holdout.min()), np.finfo(float).tiny)
            above["hold-out"] = self.held_out * np.log(np.maximum(self.holdout, least) / least)
        kwargs["time_unit"] = unit_for(kwargs.get("time_unit"), self)
        return order_selection_plot(
            self.orders, self.frequencies, self.stable, above,
            chosen=self.chosen(criterion), criterion=_WRITTEN[criterion], **kwargs,
        )  # fmt: skip


_WRITTEN = {"aic": "AIC", "aicc": "AICc", "bic": "BIC", "holdout": "hold-out"}


@on_one_thread
def order_selection(
    data: Any,
    orders: int | Sequence[int] | None = None,
    *,
    dt: Any = None,
    holdout: float = 0.0,
    initial_guess: Any = None,
    weights: Any = None,
    callback: Callback | None = None,
    workers: Any = 1,
    **options: Any,
) -> OrderSelection:
    """Look for one mode after the other, and show what speaks for each number of them.

    Parameters
    ----------
    data : control.TimeResponseData, control.FrequencyResponseData, data frame, pair (u, y), or list of these
        As for `pem`.  Not modified.
    orders : int or sequence of int, optional
        Largest number of modes, or those to choose from; by default 10, or what the data can carry if that is less.
        The path begins with no mode at all, order 0.
    dt : float, or sequence of float, one for each experiment, optional
        Time between samples; required with arrays.
    holdout : float
        Part of the data to be foretold by models fitted to the rest: 0 for none, at most 0.9.  Of each record it is
        the end, of a frequency response points all over it.
    initial_guess, weights, callback : optional
        As for `pem`.
    workers : int, executor, Dask client or map-like callable
        Number of processes for the models of `holdout`, -1 for all, or what runs them; the result is the same.
    **options
        `method`, `intersample`, `initial_state`, `offset`, `quantity` and `representation`, as for `pem`.

    Returns
    -------
    OrderSelection
        A table with a choice and a picture.

    Raises
    ------
    StructureError
        If the data or options are not of this form.
    IdentificationError
        As `pem`, or if the part that is not held out is too short.
    TypeError
        If a keyword is not one of these.

    See Also
    --------
    pem : with `order='auto'` takes the order of the least BIC.

    Notes
    -----
    A mode counts as stable if the path had one within 1 % or 2 bins of the Fourier transform of the longest record,
    `4 pi / T`, one order before (of a response, 2 distances of its points); modes are paired one to one.  The path
    keeps what it has found, so that a mode of noise may stay as well: stability speaks against a mode that moves, and
    the criteria tell the rest apart.

    `AICc = AIC + 2 p (p + 1)/(N - p - 1)` for p parameters and N observed samples.  Criteria penalise by the number of
    parameters and need white residuals; the hold-out loss needs neither, but part of the data.  Its models know
    nothing of what is held out: they are those of a path of their own through the rest.

    One path, each order from the one before, O(T n^2) an order; with `holdout` as much once more.  The fits of `pem`
    may be better yet where modes of the path have to be seated anew.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    >>> y = y + 0.01 * rng.standard_normal(400)
    >>> selection = phc.order_selection((u, y), 4, dt=0.1, holdout=0.25)
    >>> selection.chosen(), selection.chosen("holdout")
    (2, 2)
    >>> selection.frequencies[2].round(3), selection.stable[3]
    (array([0.5, 2. ]), array([ True,  True, False]))
    >>> picture = selection.plot()
    """
    for name in ("order", "max_order", "criterion"):
        if name in options:
            raise TypeError(f"unexpected keyword argument {name!r}: the orders to try are the argument orders")
    part = _part(holdout)
    check_workers(workers)
    posed = Formulation.of(data, dt, weights, **options)
    problem, guess = posed.problem, posed.guess(initial_guess)
    posed.check_signals()
    wanted = _wanted(orders, problem)
    largest = posed.largest_order(wanted[-1], wanted[-1], guess)
    try:
        found = posed.path(guess, largest, report=reporter(largest, callback, problem.samples))
    except KeyboardInterrupt:
        found = posed.so_far(largest)
    posed, path = found.posed, found.steps
    problem = posed.problem
    # a path that ends in rounding has no higher orders
    kept = [k for k, step in enumerate(path) if len(step.d) in wanted]
    if not kept:
        raise StructureError(
            f"the smallest order asked for is {wanted[0]}, and {len(path[-1].d)} modes already reproduce the record to "
            "rounding; ask for lower orders"
        )
    stable = _stable(path, problem.bin)
    steps = [path[k] for k in kept]
    rows = [criteria(problem, step.loss, len(step.d)) for step in steps]
    ahead, losses = held_out_losses(posed, guess, [len(step.d) for step in steps], part, workers) if part else (0, None)
    return OrderSelection(
        orders=np.array([len(step.d) for step in steps]),
        loss=np.array([step.loss / problem.samples for step in steps]),
        aic=np.array([row.aic for row in rows]),
        aicc=np.array([row.aicc for row in rows]),
        bic=np.array([row.bic for row in rows]),
        holdout=losses,
        frequencies=tuple(np.sort(step.d) for step in steps),
        stable=tuple(stable[k] for k in kept),
        samples=problem.samples,
        held_out=ahead,
        time_unit=common_unit(posed.records),
    )


def _wanted(orders: Any, problem: Problem) -> list[int]:
    if orders is None:
        orders = max(1, min(_LARGEST, problem.carried))
    if isinstance(orders, str) or not np.iterable(orders):
        return list(range(_checks.whole_number("orders", orders, 1) + 1))
    wanted = sorted({_checks.whole_number("one of the orders", n, 0) for n in orders})
    if not wanted or wanted[-1] == 0:
        raise StructureError("orders has no order above 0; the largest must be at least 1")
    return wanted


def _part(holdout: Any) -> float:
    try:
        part = float(holdout)
    except (TypeError, ValueError):
        part = np.nan
    if isinstance(holdout, bool) or not 0 <= part <= 0.9:
        raise StructureError(f"holdout is {holdout!r}; it must be the part of the data to hold out, from 0 to 0.9")
    return part


def _stable(path: Sequence[Any], bin_width: float) -> list[Mask]:
    """Which frequencies of each step are those of the step before: nearest to one another, and near."""
    marks = [np.zeros(len(path[0].d), bool)]
    for before, step in pairwise(path):
        old, new = np.sort(before.d), np.sort(step.d)
        distance = np.abs(new[:, None] - old)
        mark = np.zeros(len(new), bool)
        if distance.size:
            nearest = distance.argmin(axis=1)
            mutual = distance.argmin(axis=0)[nearest] == np.arange(len(new))
            mark = mutual & (distance.min(axis=1) <= np.maximum(_STABLE * new, _STABLE_BINS * bin_width))
        marks.append(mark)
    return marks


# --- hold-out prediction error ---------------------------------------------------------------------------------


_POLISH = 1e-15  # relative decrease of the loss at which a refinement ends: what is foretold feels the frequencies


@dataclass(frozen=True)
class HeldOut:
    """A problem, and the samples of each experiment that are held out of it; of a response none that are missing."""

    problem: Problem
    hidden: tuple[Mask, ...]

    @classmethod
    def of(cls, problem: Problem, part: float) -> HeldOut:
        """Hold out a part of each experiment."""
        hidden = []
        for one in problem.experiments:
            observed = _record(one).observed
            if isinstance(one, RecordRows):
                hidden.append(held_out(len(observed), part, True))
            else:
                hidden.append(np.zeros(len(observed), bool))
                hidden[-1][observed] = held_out(int(observed.sum()), part, False)
        return cls(problem, tuple(hidden))

    @cached_property
    def training(self) -> Problem:
        """The problem of what is not held out."""
        rows: list[Any] = []
        for one, hidden in zip(self.problem.experiments, self.hidden, strict=True):
            if isinstance(one, RecordRows):
                rows.append(replace(one, u=one.u[~hidden], y=one.y[~hidden], observed=one.observed[~hidden]))
            else:
                record = _record(one)
                rows.append(replace(one, record=replace(record, response=np.where(hidden, np.nan, record.response))))
        return replace(self.problem, experiments=tuple(rows))

    @property
    def ahead(self) -> int:
        """Number of equations that are held out."""
        return self.problem.samples - self.training.samples

    def loss(self, d: Array) -> float:
        """Mean squared error over what is held out, of the model that fits the rest best about these frequencies."""
        at = refine(self.training, d, rtol=_POLISH).projection
        found = []
        for one, own, hidden in zip(self.problem.experiments, at.own, self.hidden, strict=True):
            record, predicted = _record(one), one.at(at.d).predict(at.kappa, own)
            if isinstance(one, RecordRows):
                found.append((one.y - predicted)[hidden & one.observed])
            else:
                left = ((record.response - predicted) * np.sqrt(record.weights))[hidden]
                found += [left.real, left.imag]
        return float(np.mean(np.concatenate(found) ** 2))


def _record(one: Rows) -> Any:
    return one.record if isinstance(one, FrequencyRows) else one


def held_out_losses(
    posed: Formulation, guess: Array, orders: Sequence[int], part: float, workers: Any
) -> tuple[int, Array]:
    """Number of equations held out, and the mean squared error of each order there; infinite if too few are left.

    The models are those of a path of their own: frequencies found in all of the data would know what is to be foretold.
    """
    rest = HeldOut.of(posed.problem, part)
    if not rest.ahead or not rest.training.samples:
        raise IdentificationError(
            f"with {part:.3g} of the data held out there are {rest.training.samples} observed outputs to fit and "
            f"{rest.ahead} to predict; hold out another part, or choose by 'bic'"
        )
    largest = min(max(orders), rest.training.carried)
    path: list[Step] = []
    if largest:
        # under the circumstances that all of the data have decided
        posed = replace(posed, problem=rest.training, open=frozenset(), searched=None, trail=[])
        path = posed.path(guess, posed.largest_order(largest, largest, guess)).steps
    judged = {0: np.zeros(0)} | {len(step.d): step.d for step in path if len(step.d) in orders or step is path[-1]}
    losses = dict(zip(judged, mapped(rest.loss, list(judged.values()), workers, float), strict=True))
    # a path that ended in rounding has no better model of higher order
    last = losses[len(path[-1].d)] if path and len(path[-1].d) < largest else np.inf
    return rest.ahead, np.array([losses.get(n, last if n <= largest else np.inf) for n in orders])
