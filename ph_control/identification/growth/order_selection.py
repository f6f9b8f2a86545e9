"""The choice of the order: what each number of modes achieves, and which frequencies stay as it grows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import control as ct
import numpy as np

from ... import _checks
from ..._display import Report
from ..._frozen import Frozen
from ..._heartbeat import Callback, reporter
from ..._options import CRITERIA, DISCRETISATIONS, INITIAL_STATES, INTERPOLATIONS_OR_AUTO, Criterion
from ..._threads import on_one_thread
from ..._types import Array, Indices, Mask, OneOrEach
from ..._units import common_unit, unit_for
from ..._workers import check_workers
from ...exceptions import IdentificationError, StructureError
from ...plotting.validation_plot import order_selection_plot
from ..data.channels import refuse_still
from ..data.experiments import as_channels
from ..data.quantities import checked_quantities, quantity_of
from ..search.channel_rows import Experiments, RowOptions
from ..search.path import FreePath, SearchOptions
from ..search.starting_poles import poles_of
from .growing import through_orders
from .held_out import errors_ahead

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
    frequencies : tuple of ndarray, shapes (n,) for n in `orders`
        Natural frequencies of each order, ascending, rad per unit time.
    stable : tuple of ndarray of bool, shapes (n,) for n in `orders`
        Which of them were there one order before already.
    samples : int
        Observed output samples; of responses real and imaginary parts.
    held_out : int
        How many of them were held out.
    time_unit : str or None
        Unit of time of the data; None where it is not known.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> rng, plant = np.random.default_rng(0), phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    >>> y = y + 0.01 * rng.standard_normal(400)
    >>> selection = phc.order_selection((u, y), 3, dt=0.1)
    >>> selection.orders, selection.chosen()
    (array([0, 1, 2, 3]), 2)
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

    def chosen(self, criterion: Criterion = "bic") -> int:
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

    def plot(self, criterion: Criterion = "bic", **kwargs: Any) -> ct.ControlPlot:
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
    data: object,
    orders: int | Sequence[int] | None = None,
    *,
    dt: OneOrEach = None,
    holdout: float = 0.0,
    initial_guess: object = None,
    weights: OneOrEach = None,
    callback: Callback | None = None,
    workers: object = 1,
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
        `method`, `intersample`, `initial_state`, `offset` and `quantity`, as for `pem`.

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
    unknown = sorted(set(options) - {"method", "intersample", "initial_state", "offset", "quantity"})
    if unknown:
        what = ": the orders to try are the argument orders" * (unknown[0] in ("order", "max_order", "criterion"))
        raise TypeError(f"unexpected keyword argument {unknown[0]!r}{what}")
    part = _part(holdout)
    check_workers(workers)
    quantity = options.get("quantity") or quantity_of(data)
    channels = as_channels(data, dt, weights=weights)
    quantities = checked_quantities(quantity, channels[0].output_labels)
    moving = _checks.choice("initial_state", options.get("initial_state", "estimate"), INITIAL_STATES) == "estimate"
    hold = _checks.choice("intersample", options.get("intersample", "auto"), INTERPOLATIONS_OR_AUTO)
    method = _checks.choice("method", options.get("method", "exact"), DISCRETISATIONS)
    offset = options.get("offset", "auto")
    _checks.flag_or_auto("offset", offset)
    refuse_still(channels, moving)

    form = RowOptions(quantities, hold, int(bool(offset)), moving, method)

    def path_for(channels: Experiments) -> FreePath:
        return FreePath.of(channels, form)

    path = path_for(channels)
    wanted = _wanted(orders, path)
    path.check(wanted[-1])
    path.options = SearchOptions(reports=reporter(wanted[-1], callback))
    start = np.zeros(0, complex) if initial_guess is None else poles_of(initial_guess)
    try:
        through_orders(path, start, wanted[-1])
    except KeyboardInterrupt:
        if not path.table:
            raise
    rows = [path.table[n] for n in sorted(path.table)]
    # a path that ends in rounding has no higher orders
    kept = [k for k, row in enumerate(rows) if row.order in wanted]
    if not kept:
        raise StructureError(
            f"the smallest order asked for is {wanted[0]}, and {rows[-1].order} modes already reproduce the record to "
            "rounding; ask for lower orders"
        )
    samples = int(path.counts.sum())
    stable = _stable([np.abs(row.poles) for row in rows], path.search.region.bin)
    chosen = [rows[k] for k in kept]

    def searched(path: FreePath) -> None:
        path.check(wanted[-1])
        through_orders(path, start, wanted[-1])

    reached = [row.order for row in chosen]
    losses, held_out = None, 0
    if part:
        losses, held_out = _losses_ahead(errors_ahead(channels, path_for, part, searched, reached), reached)
    return OrderSelection(
        orders=np.array(reached),
        loss=np.array([float(np.exp(-2 * row.loglik / samples - 1) / (2 * np.pi)) for row in chosen]),
        aic=np.array([row.aic for row in chosen]),
        aicc=np.array([row.aicc for row in chosen]),
        bic=np.array([row.bic for row in chosen]),
        holdout=losses,
        frequencies=tuple(np.abs(row.poles) for row in chosen),
        stable=tuple(stable[k] for k in kept),
        samples=samples,
        held_out=held_out,
        time_unit=common_unit(list(channels)),
    )


def _losses_ahead(errors: dict[int, tuple[Array, Array]], orders: Sequence[int]) -> tuple[Array, int]:
    """Mean squared error of each order over what was held out, infinite where it has none, and the samples of this."""
    samples = int(max(counts.sum() for _, counts in errors.values()))
    if not samples:
        raise IdentificationError("there are no observed outputs in what is held out; hold out more")
    losses = [float(errors[order][0].sum()) / samples if order in errors else np.inf for order in orders]
    return np.array(losses), samples


def _wanted(orders: object, path: FreePath) -> list[int]:
    if orders is None:
        orders = max(1, min(_LARGEST, path.carried))
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


def _stable(path: Sequence[Array], bin_width: float) -> list[Mask]:
    """Which frequencies of each order are those of the order before: nearest to one another, and near."""
    marks = [np.zeros(len(path[0]), bool)]
    for old, new in pairwise(path):
        distance = np.abs(new[:, None] - old)
        mark = np.zeros(len(new), bool)
        if distance.size:
            nearest = distance.argmin(axis=1)
            mutual = distance.argmin(axis=0)[nearest] == np.arange(len(new))
            mark = mutual & (distance.min(axis=1) <= np.maximum(_STABLE * new, _STABLE_BINS * bin_width))
        marks.append(mark)
    return marks
