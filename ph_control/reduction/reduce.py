"""Smaller port-Hamiltonian systems: modal, balanced, or of least H2 error."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cached_property

import control as ct
import numpy as np
from scipy.linalg import block_diag

from .. import _checks
from .._options import REDUCTIONS, Reduction
from .._threads import on_one_thread
from .._types import Array
from ..exceptions import StructureError
from ..modal.positive_real import split_axis
from ..structures.second_order_system import SecondOrderSystem, truncation_errors
from ..systems.base import Convertible, inherited_names
from ..systems.dissipative import parts_of, restored
from ..systems.passive_form import PortRows, equations, joined, lossless_parts, minimal_part, stored_parts
from ..systems.port_hamiltonian import PortHamiltonian, ph
from .interior_point import FixedPoles, closest_passive
from .modal_truncation import Parts, Wanted, lossless_truncated, projected, truncated, with_unit_energy
from .optimal import Full, Matrices, best_passive, stationary_models

_TOLERANCE = 1e-8  # relative, of norms
_UNDAMPED = 1e-12  # damping ratio of what is called undamped
_BEYOND = 1.5  # times the end of the band: up to where modes of a large structure are computed


@on_one_thread
def reduce(
    sys: Convertible | SecondOrderSystem,
    order: int | None = None,
    *,
    tolerance: float | None = None,
    band: tuple[float, float] | None = None,
    method: Reduction = "modal",
    residual_modes: bool = True,
) -> PortHamiltonian:
    """Approximate a passive system by a smaller one that is port-Hamiltonian.

    Parameters
    ----------
    sys : PortHamiltonian, SecondOrderSystem, or any system that `ph` takes
        The system; outputs after those of the ports are sensors.
    order : int, optional
        Number of states, at most; a pair of complex poles has two.  By 'balanced' and 'h2' that of all but the poles on
        the imaginary axis, which are kept beside them.
    tolerance : float, optional
        The fewest states with `error_bound` at most this part of the largest gain of `sys`, its H-infinity norm.
    band : (float, float), optional
        Of the method 'modal': keep the modes with natural frequencies between these, rad per unit time; with `order`
        the most important of them.  Of a `SecondOrderSystem`, with any method: the frequencies of interest.
    method : {'modal', 'balanced', 'h2'}
        'modal' keeps poles: those in the band, or those with the highest resonances.  'balanced' is positive-real
        balanced truncation: it keeps what differs least between the least and the largest storage.  'h2' minimises
        the H2 norm of the difference, over all port-Hamiltonian systems of this order near the best linear one.
    residual_modes : bool
        Of the method 'modal': add the static deflections under forces at the ports, which make the response at low
        frequencies right, by two states for each port; they count among `order`, and are left out where it has no room.
        In a system with losses they have dampers, so that they do not resonate.

    Returns
    -------
    PortHamiltonian
        Its `error_bound` is the largest difference of the transfer functions over all frequencies, computed as the
        H-infinity norm of the difference.  Lossless systems stay lossless; their difference is unbounded at poles left
        out, and the bound is that over `band`, or from 0 to the highest frequency kept.  Of a `SecondOrderSystem` it
        holds for `band`, or up to the natural frequency number `order // 2` less the number of ports.

    Raises
    ------
    StructureError
        If none or too many of `order`, `tolerance` and `band` are given, none of the modes is in the band, or the
        method is not for this system: a lossless one has neither a finite H2 norm nor more than one storage.
    NotPassiveError
        If the system has no port-Hamiltonian form; `nearest_passive` makes one.

    Notes
    -----
    In coordinates in which the energy is `|z|^2 / 2` any orthogonal projection is port-Hamiltonian: of an invariant
    subspace for modes, of the leading states of the balanced storage, whose extremes are `diag(s)` and its inverse.
    'h2' takes the best stationary models of all, found by iterated projection from a dozen starts (seeded, so that
    calls repeat), moves their outputs until they are passive, and goes downhill in `J`, `R` and `G` by exact gradients.
    Of a `SecondOrderSystem` a model is reduced that has residual modes and all modes up to 1.5 times the end of the
    band, or `order` modes.  What it leaves out is bounded by its forces that are not in balance, in the norm of the
    flexibility.  The bound is evaluated at some hundred frequencies of the band, dense at resonances.
    O(n^3) each, and O(n^2 r) a step of 'h2'.  Computed on one thread of BLAS, so that the number of threads changes
    nothing.

    Examples
    --------
    >>> import ph_control as phc
    >>> chain = phc.msd_chain(10)
    >>> small = phc.reduce(chain, 8, method="balanced")
    >>> small.nstates, bool(small.error_bound < 0.1), phc.passivity(small).is_passive
    (8, True, True)
    >>> lossless = phc.spring_chain([1.0] * 20, 4.0, ground=1.0)
    >>> phc.reduce(lossless, band=(0.0, 1.5)).is_lossless
    True
    """
    _checks.choice("method", method, REDUCTIONS)
    _checks.flags(residual_modes=residual_modes)
    if isinstance(sys, SecondOrderSystem):
        return _of_structure(sys, order, tolerance, band, method, residual_modes)
    wanted = _wanted(order, tolerance, band, method, residual_modes)
    system = sys if isinstance(sys, PortHamiltonian) else ph(sys)
    if wanted.order is not None and wanted.order >= system.nstates and band is None:
        return _finished(system, parts_of(system), 0.0) if not _is_plain(system) else _copy(system)
    if _is_plain(system):
        return _of_lossless(system, wanted, tolerance, method)
    reducer = _Reducer(system, method, wanted)
    if tolerance is None:
        parts, error = reducer.made(wanted.order)
    else:
        parts, error = _smallest(reducer.made, len(reducer.A), tolerance * reducer.gain)
    return _finished(system, parts, error)


def _wanted(
    order: int | None, tolerance: float | None, band: tuple[float, float] | None, method: str, residual_modes: bool
) -> Wanted:
    if tolerance is not None and (order is not None or band is not None):
        raise StructureError("tolerance chooses the number of states; give it without order and band")
    if order is None and tolerance is None and band is None:
        raise StructureError("give the order, a tolerance, or (method 'modal') a band: order=10, or tolerance=0.01")
    if band is not None and method != "modal":
        raise StructureError(f"band chooses modes; method {method!r} has none: give its order, or use method='modal'")
    if order is not None:
        order = _checks.whole_number("order", order, 1)
    if tolerance is not None and not 0 < float(_checks.real_array("tolerance", tolerance)) < 1:
        raise StructureError(f"tolerance is {_checks.shown(tolerance)}; it must be between 0 and 1, a part of the gain")
    return Wanted(order, None if band is None else _checks.band(band), residual_modes)


def _is_plain(system: PortHamiltonian) -> bool:
    """Whether it is lossless, without feedthrough and sensors, in the normal form."""
    return type(system) is PortHamiltonian


def _copy(system: PortHamiltonian) -> PortHamiltonian:
    again = ph(system)
    again.error_bound = 0.0
    return again


def _finished(system: PortHamiltonian, parts: Parts, error: float) -> PortHamiltonian:
    names = inherited_names(system, {}, "inputs", "outputs")
    small = restored(parts, names, system.time_unit)
    small.error_bound = error
    return small


def _of_lossless(system: PortHamiltonian, wanted: Wanted, tolerance: float | None, method: str) -> PortHamiltonian:
    if method != "modal" or tolerance is not None:
        reason = {
            "modal": "its response has no largest gain that a tolerance could be a part of: give order or band",
            "balanced": "all its states are stored and given back alike, so that none is less important: use "
            "method='modal'",
            "h2": "its H2 norm is infinite: use method='modal', or add damping",
        }[method]
        raise StructureError(f"the system is lossless; {reason}")
    modes, error = lossless_truncated(system.modes, wanted)
    small = ph(modes, **inherited_names(system, {}, "inputs", "outputs"))
    small.time_unit, small.error_bound = system.time_unit, error
    return small


def _of_structure(
    sys: SecondOrderSystem,
    order: int | None,
    tolerance: float | None,
    band: tuple[float, float] | None,
    method: Reduction,
    residual_modes: bool,
) -> PortHamiltonian:
    """By a model of more modes than are kept, whose difference from the structure is bounded below those left out."""
    if tolerance is not None:
        raise StructureError(
            "a tolerance is not for a large structure, whose largest gain is not known: give its order"
        )
    wanted = _wanted(order, None, band if method == "modal" else None, method, residual_modes)
    if band is None:
        assert wanted.order is not None
        modal = sys.modal_model(modes=min(wanted.order, int(np.count_nonzero(sys.M.diagonal()))))
        frequencies = modal.structural_modes.natural_frequencies
        number = max(wanted.order // 2 - sys.F.shape[1], 1)
        low, high = 0.0, float(frequencies[min(number, len(frequencies)) - 1])
    else:
        low, high = _checks.band(band)
        modal = sys.modal_model(band=(0.0, _BEYOND * high))
    small = reduce(modal, order, band=wanted.band, method=method, residual_modes=residual_modes)
    small.error_bound = _error_in_band(sys, modal, small, low, high)
    return small


def _error_in_band(
    structure: SecondOrderSystem, modal: PortHamiltonian, small: PortHamiltonian, low: float, high: float
) -> float:
    """Largest difference of a reduced model from the structure in a band, by the model of modes between them."""
    omega, left_out = truncation_errors(structure, modal.structural_modes, low, high)
    shape = modal.noutputs, modal.ninputs, len(omega)
    large, little = (np.reshape(system(1j * omega), shape) for system in (modal, small))
    both = np.linalg.norm(np.moveaxis(large - little, 2, 0), 2, axis=(1, 2)) + left_out
    return float(both.max()) if not _loses_undamped(modal, small, low, high) else np.inf


def _loses_undamped(modal: PortHamiltonian, small: PortHamiltonian, low: float, high: float) -> bool:
    """Whether the small model lacks a resonance without damping in a band."""
    poles = modal.poles()
    size, rounding = np.abs(poles), np.sqrt(_UNDAMPED)
    undamped = poles[(np.abs(poles.real) <= _UNDAMPED * size) & (size >= max(low, rounding * high)) & (size <= high)]
    distance = np.abs(undamped[:, None] - small.poles()).min(axis=1, initial=np.inf)
    return bool((distance > rounding * np.abs(undamped)).any())


def _smallest(made: Callable[[int], tuple[Parts, float]], most: int, allowed: float) -> tuple[Parts, float]:
    """The smallest model with an error that is allowed, by halving."""
    low, high = 0, most
    best = None
    while high - low > 1:
        middle = (low + high) // 2
        candidate = made(middle)
        if candidate[1] <= allowed:
            best, high = candidate, middle
        else:
            low = middle
    return best or made(most)


class _Reducer:
    """The part of a system off the imaginary axis, its poles on it, and reduced models of it."""

    def __init__(self, system: PortHamiltonian, method: str, wanted: Wanted) -> None:
        self.method, self.wanted = method, wanted
        self.m = system.ninputs
        self.parts = parts_of(system)
        conversion = getattr(system, "conversion", None)
        self.has_mean_storage = conversion is not None and conversion.energy == "mean"
        self.through = self.parts["sensor_feedthrough"]
        split = split_axis(*(np.array(M, float) for M in (system.A, system.B, system.C)))
        self.axis = split.axis
        self.A, self.B, self.C = minimal_part(*split.rest, self.m)
        self.D = np.array(system.D, float)

    @property
    def gain(self) -> float:
        """Largest gain of the part off the axis."""
        return _largest_gain(self.A, self.B, self.C, self.D)

    def made(self, order: int | None) -> tuple[Parts, float]:
        """A model of some order, and its error."""
        if self.method == "modal":
            wanted = Wanted(order, self.wanted.band, self.wanted.residual_modes)
            parts = truncated(with_unit_energy(self.parts), wanted)
            return parts, self._whole_error(parts)
        assert order is not None
        small = self._balanced(order) if self.method == "balanced" else self._optimal(order)
        error = _difference((self.A, self.B, self.C), equations(small)[:3])
        return joined([small, *lossless_parts(self.axis, self.m)], self.through), error

    @cached_property
    def _stored(self) -> Parts:
        """Balanced coordinates of the storages, the leading states first."""
        if self.has_mean_storage and not self.axis:
            return self.parts
        return stored_parts(PortRows(self.A, self.B, self.C, self.D), "mean")

    def _balanced(self, order: int) -> Parts:
        parts = self._stored
        return projected(parts, np.eye(len(parts["Q"]))[:, :order])

    def _optimal(self, order: int) -> Parts:
        """The best passive model next to the best linear ones, or else next to the balanced one."""
        if order >= len(self.A):
            return self._stored
        # in units in which the system is of size 1, so that steps downhill do not depend on those given
        rate, size = _sizes(self.A, self.B, self.C, self.D)
        gain = np.sqrt(rate * size)
        full, D = Full(self.A / rate, self.B / gain, self.C / gain), self.D / size
        best: tuple[Parts, float] | None = None
        for value, model in stationary_models(full, order):
            if best and best[1] <= value:
                break
            with suppress(StructureError):  # a model that cannot be made passive
                start = _passive(model, D, self.m)
                candidate = best_passive(full, start) if len(start["Q"]) else None
                best = candidate if best is None or (candidate and candidate[1] < best[1]) else best
        best = best or best_passive(full, _in_units(self._balanced(order), 1 / rate, 1 / size))
        return _in_units(best[0], rate, size)

    def _whole_error(self, parts: Parts) -> float:
        """Of models that keep poles on the axis or leave them out."""
        split = split_axis(*equations(parts)[:3])
        if len(split.axis) != len(self.axis):
            return np.inf
        return _difference((self.A, self.B, self.C), split.rest)


def _passive(model: Matrices, D: Array, m: int) -> Parts:
    """Port-Hamiltonian form of the passive model closest to one."""
    A, B, C = model
    family = FixedPoles(A, B, scattering=False)
    moved = closest_passive(family, C[:m], D[:m])
    return stored_parts(PortRows(A, B, np.vstack([moved.C, C[m:]]), D), "mean")


def _in_units(parts: Parts, rate: float, size: float) -> Parts:
    """The same system with time and responses in other units, and the energy of its states as it was."""
    gain = np.sqrt(rate * size)
    factors = {"J": rate, "R": rate, "G": gain, "P": gain, "sensor_rows": gain, "S": size, "N": size,
               "sensor_feedthrough": size}  # fmt: skip
    return parts | {name: factor * parts[name] for name, factor in factors.items()}


def _sizes(A: Array, B: Array, C: Array, D: Array) -> tuple[float, float]:
    rate = float(np.linalg.norm(A)) or 1.0
    return rate, float(np.linalg.norm(B) * np.linalg.norm(C)) / rate + float(np.linalg.norm(D)) or 1.0


def _difference(first: Matrices, second: Matrices) -> float:
    """Largest gain of the difference of two systems of the same feedthrough."""
    A = block_diag(first[0], second[0])
    B, C = np.vstack([first[1], second[1]]), np.hstack([first[2], -second[2]])
    return _largest_gain(A, B, C, np.zeros((len(C), B.shape[1])))


def _largest_gain(A: Array, B: Array, C: Array, D: Array) -> float:
    """H-infinity norm, from above."""
    if not len(A):
        return float(np.linalg.norm(D, 2))
    rate, size = _sizes(A, B, C, D)
    scale = np.sqrt(rate * size)
    gain, _ = ct.linfnorm(ct.ss(A / rate, B / scale, C / scale, D / size), tol=_TOLERANCE)
    return float(gain * size * (1 + 2 * _TOLERANCE))
