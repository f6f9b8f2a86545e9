"""Modes of models of ascending order: which of them stay in frequency, damping and shape."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np

from ..._display import Report, aligned
from ..._frozen import Frozen
from ..._types import Array, ComplexArray, Indices, Mask, NDArray, RealOrComplex
from ..._units import hertz_size
from ...numerics.modal_assurance import stable_poles
from ...plotting.validation_plot import stabilisation_plot

Orders = Sequence[tuple[ComplexArray, ComplexArray]]  # poles (n,) and shapes (n, p) of each

_LEVELS = ("new", "frequency", "damping", "shape")


@dataclass(frozen=True, eq=False, repr=False)
class Stabilisation(Report, Frozen):
    """Poles of ascending orders, compared with those of the order before; made by `PEMResult.stabilisation`.

    Its text is a table of the orders, and of how many poles are new, stable in frequency only, in damping as well, and
    in shape as well; iterated, it gives the pairs (poles, shapes).

    Attributes
    ----------
    orders : ndarray, shape (K,)
        Numbers of modes, ascending.
    poles : tuple of ndarray of complex, shapes (n,)
        Of each order, those of positive imaginary part, by their natural frequencies.
    shapes : tuple of ndarray of complex, shapes (n, p)
        Mode shapes, in units of velocity, the largest entry 1.
    stability : tuple of ndarray of int, shapes (n,)
        0 of a pole that is new, 1 if its frequency is that of a pole of the order before, 2 if its damping is as well,
        3 if its shape is as well.  Of a pole that grows it is 1 at most.
    mac : tuple of ndarray, shapes (n,)
        Modal assurance criterion with that pole; NaN where there is none, and of a single output.
    order : int
        That of the result.
    frequency_tolerance, damping_tolerance, least_mac : float
        What counts as the same.
    experiments : tuple
        What the fit says of each experiment, for the picture.
    time_unit : str or None
        Unit of time of the data.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> rng, plant = np.random.default_rng(0), phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> u = rng.standard_normal(400)
    >>> y = phc.forced_response(plant, 0.1 * np.arange(400), u, intersample="zoh").outputs
    >>> y = y + 0.01 * rng.standard_normal(400)
    >>> diagram = phc.pem((u, y), dt=0.1).stabilisation(beyond=1)
    >>> diagram.orders, diagram.order, [len(poles) for poles in diagram.poles]
    (array([1, 2, 3]), 2, [1, 2, 3])
    """

    orders: Indices
    poles: tuple[ComplexArray, ...]
    shapes: tuple[ComplexArray, ...]
    stability: tuple[NDArray[np.int8], ...]
    mac: tuple[Array, ...]
    order: int
    frequency_tolerance: float
    damping_tolerance: float
    least_mac: float
    experiments: tuple[Any, ...]
    time_unit: str | None

    def __iter__(self) -> Iterator[tuple[ComplexArray, ComplexArray]]:
        return iter(zip(self.poles, self.shapes, strict=True))

    @property
    def hertz(self) -> tuple[Array, ...]:
        """Natural frequencies of each order in Hz; where `time_unit` is not known, as if it were the second."""
        return tuple(np.abs(poles) / hertz_size(self.time_unit) for poles in self.poles)

    @property
    def damping_ratios(self) -> tuple[Array, ...]:
        """Damping ratios of each order."""
        return tuple(0.0 - poles.real / np.abs(poles) for poles in self.poles)

    @property
    def stable(self) -> tuple[Mask, ...]:
        """Which poles of each order are stable in frequency, damping and, of several outputs, in shape."""
        most = 3 if self.shapes and self.shapes[0].shape[1] > 1 else 2
        return tuple(stability == most for stability in self.stability)

    @property
    def table(self) -> RealOrComplex:
        """All poles one after the other, as a structured array: order, hertz, damping_ratio, mac, stability, stable."""
        of_orders: list[Any] = [self.hertz, self.damping_ratios, self.mac, self.stability, self.stable]
        columns = [np.repeat(self.orders, self.orders), *(np.concatenate(parts) for parts in of_orders)]
        kinds = zip(("order", "hertz", "damping_ratio", "mac", "stability", "stable"), columns, strict=True)
        return np.array(list(zip(*columns, strict=True)), [(name, column.dtype) for name, column in kinds]).view(
            np.recarray
        )

    def __str__(self) -> str:
        """Table of the orders."""
        levels = _LEVELS if self.shapes and self.shapes[0].shape[1] > 1 else _LEVELS[:3]
        rows = [["order", *levels, ""]]
        for order, stability in zip(self.orders, self.stability, strict=True):
            counts = np.bincount(stability, minlength=len(levels))
            rows.append([str(order), *map(str, counts), "the result" if order == self.order else ""])
        return "\n".join(aligned(rows))

    def _headline(self) -> str:
        place = np.flatnonzero(self.orders == self.order)
        stable = int(self.stable[place[0]].sum()) if len(place) else 0
        return f"orders {self.orders[0]} to {self.orders[-1]}, {stable} of {self.order} modes stable"

    def plot(self, data: object = None, **kwargs: Any) -> ct.ControlPlot:
        """Stabilisation diagram, over the measured responses or the spectra of the outputs.

        Parameters
        ----------
        data : control.FrequencyResponseData, control.TimeResponseData, or list of them, optional
            What to draw behind the poles; by default what was fitted.
        **kwargs
            As in `stabilisation_plot`.

        Returns
        -------
        control.ControlPlot

        Examples
        --------
        See `stabilisation_plot`.
        """
        limits = {name: getattr(self, name) for name in ("frequency_tolerance", "damping_tolerance", "least_mac")}
        return stabilisation_plot(self, data, **{**limits, **kwargs})


def compared(rows: Orders, result: Any, **limits: float) -> Stabilisation:
    """Poles and shapes of ascending orders about that of a result, compared with those before."""
    ranks = [np.argsort(np.abs(poles), kind="stable") for poles, _ in rows]
    poles, shapes = (tuple(np.asarray(row[k])[rank] for row, rank in zip(rows, ranks, strict=True)) for k in (0, 1))
    stability, assurance = stable_poles(poles, shapes, **limits)
    return Stabilisation(
        np.array([len(order_poles) for order_poles in poles]), poles, shapes, tuple(stability), tuple(assurance),
        result.order, experiments=result.experiments, time_unit=result.time_unit, **limits,
    )  # fmt: skip
