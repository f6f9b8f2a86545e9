"""The choice of the order: what each number of modes achieves, and which frequencies stay as it grows."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

from .. import _checks
from ..exceptions import IdentifiabilityWarning, IdentificationError, StructureError
from ..validation_plots import order_plot
from .data import Record, as_record
from .pem import pem
from .result import OrderRow

Array = NDArray[np.float64]

CRITERIA = ("aic", "aicc", "bic", "holdout")

_LARGEST = 10  # by default
_UNKNOWNS = 4  # of a mode, its initial state included
_STABLE, _STABLE_BINS = 0.01, 2.0


@dataclass(frozen=True, eq=False)
class OrderSelection:
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
        Mean squared error over the last part of the record, of models fitted to what comes before it.
    frequencies : tuple of ndarray
        Natural frequencies of each order, ascending, rad per unit time.
    stable : tuple of ndarray of bool
        Which of them were there one order before already.
    samples : int
        Observed output samples.
    held_out : int
        How many of them are in the last part.
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

    def __post_init__(self) -> None:
        for value in (*vars(self).values(), *self.frequencies, *self.stable):
            if isinstance(value, np.ndarray):
                _checks.readonly(value)

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
            If there is no such criterion, or no part of the record was held out.

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

    def plot(self, criterion: str = "bic", **kwargs: Any) -> ct.ControlPlot:
        """Stabilisation diagram, and the criteria beside it.

        Parameters
        ----------
        criterion : {'aic', 'aicc', 'bic', 'holdout'}
            Whose choice is marked.
        **kwargs
            `time_unit`, `title`, and `ax`: an array of two axes.

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
        return order_plot(
            self.orders, self.frequencies, self.stable, above,
            chosen=self.chosen(criterion), criterion=_WRITTEN[criterion], **kwargs,
        )  # fmt: skip


_WRITTEN = {"aic": "AIC", "aicc": "AICc", "bic": "BIC", "holdout": "hold-out"}


def order_selection(
    data: Any,
    orders: int | Sequence[int] | None = None,
    *,
    dt: float | None = None,
    holdout: float = 0.0,
    **options: Any,
) -> OrderSelection:
    """Fit models of several orders, and show what speaks for each.

    Parameters
    ----------
    data : control.TimeResponseData, or pair (u, y) of array_like, shape (T,) each
        As for `pem`.  Not modified.
    orders : int or sequence of int, optional
        Largest number of modes, or those to choose from; by default 10, or what the record can carry if that is less.
        The path begins with no mode at all, order 0.
    dt : float, optional
        Time between samples; needed with arrays.
    holdout : float
        Part of the record, at its end, to be foretold by models fitted to the rest: 0 for none, at most 0.9.
    **options
        As for `pem`, except `order` and `max_order`.

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
        If a keyword is not one of `pem`, or `order` or `max_order` is given.

    See Also
    --------
    pem : with `order='auto'` takes the order of the least BIC.

    Notes
    -----
    A mode counts as stable if the path had one within 1 % or 2 bins of the Fourier transform of the record, `4 pi / T`,
    one order before; modes are paired one to one.  The path keeps what it has found, so that a mode of noise may
    stay as well: stability speaks against a mode that moves, and the criteria tell the rest apart.

    `AICc = AIC + 2 p (p + 1)/(N - p - 1)` for p parameters and N observed samples.  Criteria penalise by the number of
    parameters and need white residuals; the hold-out loss needs neither, but part of the record.

    One fit of the largest order; with `holdout` one of each order more.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u).outputs + 0.01 * rng.standard_normal(400)
    >>> selection = phc.order_selection((u, y), 4, dt=0.1, holdout=0.25)
    >>> selection.chosen(), selection.chosen("holdout")
    (2, 2)
    >>> selection.frequencies[2].round(3), selection.stable[3]
    (array([0.5, 2. ]), array([ True,  True, False]))
    >>> picture = selection.plot()
    """
    for name in ("order", "max_order"):
        if name in options:
            raise TypeError(f"unexpected keyword argument {name!r}: the orders to try are the argument orders")
    record = as_record(data, dt)
    wanted = _wanted(orders, record)
    part = _part(holdout)
    path = _path(record, wanted[-1], options)
    # a path that ends in rounding has no higher orders
    kept = [k for k, row in enumerate(path) if row.order in wanted]
    if not kept:
        raise StructureError(
            f"the smallest order asked for is {wanted[0]}, and {path[-1].order} modes already reproduce the record to "
            "rounding; ask for lower orders"
        )
    stable = _stable(path, 2 * np.pi / (record.samples * record.dt))
    rows = [path[k] for k in kept]
    aic, bic = np.array([row.aic for row in rows]), np.array([row.bic for row in rows])
    samples = int(record.observed.sum())
    held_out, losses = _holdout(record, rows, part, options) if part else (0, None)
    return OrderSelection(
        orders=np.array([row.order for row in rows]),
        loss=np.array([row.loss for row in rows]),
        aic=aic,
        aicc=_corrected(aic, bic, samples),
        bic=bic,
        holdout=losses,
        frequencies=tuple(np.sort(row.d) for row in rows),
        stable=tuple(stable[k] for k in kept),
        samples=samples,
        held_out=held_out,
    )


def _wanted(orders: Any, record: Record) -> list[int]:
    if orders is None:
        carried = (int(record.observed.sum()) - 1) // _UNKNOWNS
        orders = max(1, min(_LARGEST, carried))
    several = isinstance(orders, Sequence | np.ndarray) and not isinstance(orders, str)
    wanted = list(orders) if several else [orders]
    if not wanted or not all(
        isinstance(n, int | np.integer) and not isinstance(n, bool) and n >= (0 if several else 1) for n in wanted
    ):
        raise StructureError(f"orders is {orders!r}; it must be a whole number >= 1, or a sequence of numbers of modes")
    if max(wanted) == 0:
        raise StructureError("orders asks for no mode only; the largest must be at least 1")
    return sorted({int(n) for n in wanted}) if several else list(range(int(orders) + 1))


def _part(holdout: Any) -> float:
    try:
        part = float(holdout)
    except (TypeError, ValueError):
        part = np.nan
    if isinstance(holdout, bool) or not 0 <= part <= 0.9:
        raise StructureError(f"holdout is {holdout!r}; it must be the part of the record to hold out, from 0 to 0.9")
    return part


def _path(data: Any, order: int, options: dict[str, Any]) -> list[OrderRow]:
    with warnings.catch_warnings():
        # of the largest order, which nobody has chosen yet
        warnings.simplefilter("ignore", IdentifiabilityWarning)
        return list(pem(data, order, **options).order_table)


def _stable(path: list[OrderRow], bin_width: float) -> list[NDArray[np.bool_]]:
    """Which frequencies of each row are those of the row before: nearest to one another, and near."""
    marks = [np.zeros(path[0].order, bool)]
    for before, row in pairwise(path):
        old, new = np.sort(before.d), np.sort(row.d)
        distance = np.abs(new[:, None] - old)
        mark = np.zeros(len(new), bool)
        if distance.size:
            nearest = distance.argmin(axis=1)
            mutual = distance.argmin(axis=0)[nearest] == np.arange(len(new))
            mark = mutual & (distance.min(axis=1) <= np.maximum(_STABLE * new, _STABLE_BINS * bin_width))
        marks.append(mark)
    return marks


def _corrected(aic: Array, bic: Array, samples: int) -> Array:
    """AICc; the number of parameters is what AIC and BIC differ by, infinite where the record cannot carry it."""
    parameters = np.rint((bic - aic) / (np.log(samples) - 2))
    spare = samples - parameters - 1
    penalty = 2 * parameters * (parameters + 1) / np.where(spare > 0, spare, 1)
    return np.where(spare > 0, aic + penalty, np.inf)


def _holdout(record: Record, rows: list[OrderRow], part: float, options: dict[str, Any]) -> tuple[int, Array]:
    """Number of samples held out, and the mean squared error of each order there."""
    split = record.samples - max(1, round(part * record.samples))
    ahead = record.observed[split:]
    if split < 2 or not ahead.any() or not record.observed[:split].any():
        raise IdentificationError(
            f"with holdout={part:g} the record has {int(record.observed[:split].sum())} observed outputs to fit and "
            f"{int(ahead.sum())} to foretell; hold out another part"
        )
    first = (record.u[:split], record.y[:split])
    target = record.y[split:][ahead]
    losses = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", IdentifiabilityWarning)
        for row in rows:
            foretold = 0.0 * target
            if row.order:
                result = pem(first, row.order, dt=record.dt, **options)
                foretold = np.reshape(result.predict(record.u[split:], initial_state="final").y, -1)[ahead]
            losses.append(float(np.mean((target - foretold) ** 2)))
    return len(target), np.array(losses)
