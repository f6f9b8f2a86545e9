"""What pictures of modes, poles and zeros show, as numbers: weights with their errors, and how poles and zeros lie."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _checks
from ..exceptions import StructureError
from ..systems.base import LosslessSystem
from ..systems.port_hamiltonian import ph
from .inputs import as_systems, labels_of, title_of

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

QUANTITIES = ("kappa", "r")
_ON_AXIS = 1e-7  # relative real part of a pole or zero that is on the axis but for the rounding of an eigenvalue
_POLES_IN_STRIP = 24  # that are told apart
_STRIPS = 12  # that fit on a page; of more than 288 poles the marks overlap


@dataclass(frozen=True)
class ModeTable:
    """Modes of one system: weights `size`, shape (n, m), at `d`, shape (n,), and that of a pole at 0, shape (m,).

    `d_range`, shape (n, 2), and `size_range`, shape (n, 2), are confidence intervals: NaN where there is none, and
    infinite for what the data do not show.
    """

    label: str
    d: Array
    size: Array
    at_zero: Array
    d_range: Array
    size_range: Array
    level: float | None


def mode_tables(
    sysdata: Any, quantity: str, level: float, label: str | Sequence[str] | None
) -> tuple[list[ModeTable], list[str], str]:
    """Tables of modes, names of the ports and title for `modes_plot`, whose arguments these are."""
    _checks.choice("quantity", quantity, QUANTITIES)
    given = list(sysdata) if isinstance(sysdata, list | tuple) else [sysdata]
    systems = as_systems(sysdata)
    labels = labels_of(sysdata, systems, label)
    tables = [_table(*one, quantity, level) for one in zip(given, systems, labels, strict=True)]
    return tables, systems[0].output_labels, title_of("Modes", systems, label is not None)


def _table(given: Any, sys: Any, label: str, quantity: str, level: float) -> ModeTable:
    modes = (sys if isinstance(sys, LosslessSystem) else ph(sys)).modes
    size = (modes.kappa if quantity == "kappa" else modes.r).reshape(modes.n - len(modes.rigid), modes.nports)
    at_zero = np.atleast_2d(modes.kappa_0).diagonal() if quantity == "kappa" else np.zeros(modes.nports)
    unknown = np.full((len(modes.d), 2), np.nan)
    if not hasattr(given, "confidence_interval"):
        return ModeTable(label, modes.d, size, at_zero, unknown, unknown, None)
    intervals = given.confidence_interval(level)
    sizes = np.asarray(intervals["r"])
    if quantity == "kappa":
        sizes = kappa_intervals(modes.d, modes.r, np.asarray(given.covariance), sizes)
    return ModeTable(label, modes.d, size, at_zero, np.asarray(intervals["d"]), sizes, level)


def kappa_intervals(d: Array, r: Array, covariance: Array, r_intervals: Array) -> Array:
    """Confidence intervals of `kappa = r d`, shape (n, 2), from those of `r` and the covariance of `(d, r, ..)`."""
    n = len(d)
    dd, rr, dr = (np.diagonal(covariance[i : i + n, j : j + n]) for i, j in ((0, 0), (n, n), (0, n)))
    with np.errstate(invalid="ignore", divide="ignore"):
        # in units of those of r, so that one level serves both
        stretch = np.sqrt(np.maximum(d**2 * rr + r**2 * dd + 2 * d * r * dr, 0.0) / rr)
        ends = (r * d)[:, None] + stretch[:, None] * (r_intervals - r[:, None])
        # an end cut off at 0 says nothing of the width; the upper one does
        half = (ends[:, 1] - r * d)[:, None] * np.array([-1.0, 1.0])
    return np.maximum((r * d)[:, None] + half, 0.0)


# --- poles and zeros -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PoleZeroMap:
    """Poles and zeros of one system; `on_axis` if all of them are on the imaginary axis."""

    label: str
    poles: ComplexArray
    zeros: ComplexArray
    on_axis: bool
    discrete: bool
    ports: int = 1

    @property
    def upper(self) -> tuple[Array, Array]:
        """Imaginary parts of poles and zeros on the upper half of the axis, 0 included, ascending."""
        w, z = np.sort(self.poles.imag), np.sort(self.zeros.imag)
        return w[w >= 0], z[z >= 0]

    @property
    def cancelled(self) -> int:
        """Number of poles on the upper half of the axis that a zero lies on."""
        poles, zeros = self.upper
        return int(np.isin(poles, zeros).sum())

    @property
    def alternating(self) -> bool:
        """Whether poles and zeros alternate on the upper half of the axis, as those of a lossless one-port do."""
        poles, zeros = self.upper
        places = np.concatenate([poles, zeros])
        kinds = np.repeat([True, False], [len(poles), len(zeros)])[np.argsort(places, kind="stable")]
        return bool(len(np.unique(places)) == len(places) and (kinds[1:] != kinds[:-1]).all())


def pole_zero_maps(sysdata: Any, label: str | Sequence[str] | None) -> tuple[list[PoleZeroMap], str]:
    """Poles and zeros for `pole_zero_plot`, and its title."""
    systems = as_systems(sysdata)
    if len({sys.isdtime(strict=True) for sys in systems}) > 1:
        raise StructureError("continuous-time and discrete-time poles are in different planes; draw them apart")
    labels = labels_of(sysdata, systems, label)
    maps = [_map(sys, name) for sys, name in zip(systems, labels, strict=True)]
    return maps, title_of("Poles and zeros", systems, label is not None)


def _map(sys: Any, label: str) -> PoleZeroMap:
    if isinstance(sys, LosslessSystem) and not sys._integrated:
        # those of the transfer function: the matrices have 0 twice where a mass is free, and show one of them
        return PoleZeroMap(label, sys.modes.poles, sys.modes.zeros, True, False, sys.ninputs)
    try:
        poles, zeros = (np.asarray(points, complex) for points in (sys.poles(), sys.zeros()))
    except NotImplementedError as error:
        raise StructureError(f"{label}: {error} Convert the system with control.ss") from None
    points = np.concatenate([poles, zeros])
    discrete = bool(sys.isdtime(strict=True))
    near = np.abs(points.real) <= _ON_AXIS * np.abs(points).max(initial=0.0)
    return PoleZeroMap(label, poles, zeros, bool(near.all()) and not discrete, discrete, sys.ninputs)


def strips(maps: Sequence[PoleZeroMap], count: int | None = None) -> list[tuple[float, float]]:
    """Frequency ranges that hold equally many poles each, few enough to be told apart; `count` of them if given."""
    marks = np.sort(np.concatenate([np.concatenate(one.upper) for one in maps]))
    poles = np.sort(np.concatenate([one.upper[0] for one in maps]))
    if not len(marks):
        return [(0.0, 1.0)] * (count or 1)
    if count is None:
        count = min(max(1, -(-max(len(one.upper[0]) for one in maps) // _POLES_IN_STRIP)), _STRIPS)
    cuts = _cuts(marks, poles, count)
    low, high = float(marks[0]), float(marks[-1])
    # from 0 on, unless all are far from it
    bottom = low if low > 0.3 * high else 0.0
    inner = [bottom, *cuts, high]
    margins = [0.03 * (inner[1] - inner[0]), 0.03 * (inner[-1] - inner[-2])]
    least = 0.1 * high or 1.0
    edges = [bottom - (margins[0] or least), *cuts, high + (margins[1] or least)]
    return list(itertools.pairwise(edges))


def _cuts(marks: Array, poles: Array, count: int) -> list[float]:
    """Where to part the axis: below poles that leave about equally many in each strip, in the middle of wide gaps."""
    cuts: list[float] = []
    spread = len(poles) // (6 * count)
    for target in np.arange(1, count) * len(poles) // count:
        near = poles[max(1, target - spread) : target + spread + 1]
        below = np.array([marks[marks < w].max(initial=0.0) for w in near])
        if len(near):
            widest = int(np.argmax(near - below))
            cuts.append(0.5 * float(below[widest] + near[widest]))
    return sorted(set(cuts))
