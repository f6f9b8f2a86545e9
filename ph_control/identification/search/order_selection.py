"""The choice of the order: what each number of modes achieves, and which frequencies stay as it grows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

from ... import _checks
from ..._display import Report
from ..._frozen import Frozen
from ..._units import common_unit, unit_for
from ...exceptions import StructureError
from ...plotting.validation_plot import stabilisation_plot
from ..regression.variable_projection import Problem
from .criteria import criteria
from .formulation import Callback, Formulation, reporter
from .holdout import held_out_losses

Array = NDArray[np.float64]

CRITERIA = ("aic", "aicc", "bic", "holdout")

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

    orders: NDArray[np.intp]
    loss: Array
    aic: Array
    aicc: Array
    bic: Array
    holdout: Array | None
    frequencies: tuple[Array, ...]
    stable: tuple[NDArray[np.bool_], ...]
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
        return stabilisation_plot(
            self.orders, self.frequencies, self.stable, above,
            chosen=self.chosen(criterion), criterion=_WRITTEN[criterion], **kwargs,
        )  # fmt: skip


_WRITTEN = {"aic": "AIC", "aicc": "AICc", "bic": "BIC", "holdout": "hold-out"}


def order_selection(
    data: Any,
    orders: int | Sequence[int] | None = None,
    *,
    dt: Any = None,
    holdout: float = 0.0,
    initial_guess: Any = None,
    weights: Any = None,
    callback: Callback | None = None,
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
        Time between samples; needed with arrays.
    holdout : float
        Part of the data to be foretold by models fitted to the rest: 0 for none, at most 0.9.  Of each record it is
        the end, of a frequency response points all over it.
    initial_guess, weights, callback : optional
        As for `pem`.
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
    posed = Formulation.of(data, dt, weights, **options)
    problem, guess = posed.problem, posed.guess(initial_guess)
    posed.check_signals()
    wanted = _wanted(orders, problem)
    largest = posed.largest_order(wanted[-1], wanted[-1], guess)
    found = posed.path(guess, largest, report=reporter(problem, largest, callback))
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
    ahead, losses = held_out_losses(posed, guess, [len(step.d) for step in steps], part) if part else (0, None)
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
    several = isinstance(orders, Sequence | np.ndarray) and np.iterable(orders) and not isinstance(orders, str)
    wanted = list(orders) if several else [orders]
    if not wanted or not all(
        isinstance(n, int | np.integer) and not isinstance(n, bool) and n >= (0 if several else 1) for n in wanted
    ):
        raise StructureError(
            f"orders is {_checks.shown(orders)}; it must be a whole number >= 1, or a sequence of numbers of modes"
        )
    if max(wanted) == 0:
        raise StructureError("orders asks for no mode only; the largest must be at least 1")
    return sorted({int(n) for n in wanted}) if several else list(range(int(orders) + 1))


def _part(holdout: Any) -> float:
    try:
        part = float(holdout)
    except (TypeError, ValueError):
        part = np.nan
    if isinstance(holdout, bool) or not 0 <= part <= 0.9:
        raise StructureError(f"holdout is {holdout!r}; it must be the part of the data to hold out, from 0 to 0.9")
    return part


def _stable(path: Sequence[Any], bin_width: float) -> list[NDArray[np.bool_]]:
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
