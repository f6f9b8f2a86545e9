"""Base of the system classes: a `control.StateSpace` whose matrices are locked views, made when first looked at."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Generic, TypeAlias, TypeVar, cast, overload

import control as ct
import numpy as np
from control.iosys import InputOutputSystem

from .. import _checks
from .._display import fits_in_a_formula, html_formula, html_heading, latex_matrix, literal, modes_table
from .._types import Array, ArrayLike, ComplexArray, RealOrComplex, SystemNames, Unpack
from .._units import checked_unit, hertz_size
from ..exceptions import NotLosslessError, StructureError, printable
from ..modal.modal_form import ModalForm, imaginary
from ..numerics.rational import LinearSystem

if TYPE_CHECKING:
    from .port_hamiltonian import PortHamiltonian

Convertible: TypeAlias = LinearSystem | ModalForm  # what `ph` makes a port-Hamiltonian system of
Value = TypeVar("Value")
System = TypeVar("System", bound="LosslessSystem")

_ASIDE = 32 * _checks.EPS  # of a value on the imaginary axis: what is left beside it once a phase is rounded
_RIGHT = 1e-9  # of a frequency: how far to the right of the axis values show which way
LETTERS = {"states": "x", "outputs": "y", "inputs": "u"}  # of the names that python-control gives
_LOOKED_AT = 100  # degrees of freedom of a system whose matrices and modes are computed in order to show them


class View(Generic[Value]):
    """A matrix computed on first access, kept, and locked against rebinding and writing."""

    def __init__(self, compute: Callable[[Any], Value]) -> None:
        self.compute = compute
        self.__doc__ = compute.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, system: None, owner: type | None = None) -> View[Value]: ...
    @overload
    def __get__(self, system: LosslessSystem, owner: type | None = None) -> Value: ...
    def __get__(self, system: LosslessSystem | None, owner: type | None = None) -> View[Value] | Value:
        if system is None:
            return self
        if self.name not in system._views:
            value = self.compute(system)
            system._views[self.name] = _checks.readonly(value) if isinstance(value, np.ndarray) else value
        return system._views[self.name]

    def __set__(self, system: LosslessSystem, value: Value) -> None:
        raise AttributeError(
            f"{self.name} of a {type(system).__name__} cannot be changed: the system would no longer be lossless; "
            f"make a new one with {system._factory}, or a free StateSpace with control.ss(sys)"
        )


class LosslessSystem(ct.StateSpace):
    """Base of the system classes: names and sizes at once, matrices and modes on demand.

    A subclass gives `A`, `B`, `C` as views, its `modes`, the call `_factory` that makes it, `__reduce__`, and `_fill`,
    which takes its parts.
    """

    _factory: str
    _in_normal_form = True  # whether it has frequencies d and weights r
    _integrated = False  # whether the transfer function is that of the modes, or that divided by s
    _time_unit: str | None = None
    _views: dict[str, Any]
    params: dict[str, Any]
    _current_params: dict[str, Any]
    _state_index: dict[str, int] | None

    def _setup(self, nstates: int, nports: int, given: SystemNames, noutputs: int | None = None) -> None:
        names: dict[str, Any] = {**given}
        noutputs = nports if noutputs is None else noutputs
        if "dt" in names:
            raise StructureError(
                "dt cannot be given: a port-Hamiltonian system is continuous-time; use sample() of the system"
            )
        self._views = {}
        if names:
            _checks.known_keywords(f"a {type(self).__name__}", names)
            sizes = {"inputs": nports, "outputs": noutputs, "states": nstates}
            _checks.signal_names(names, **sizes)
            for kind, count in sizes.items():
                single = names.pop(kind[:-1], None)
                if names.get(kind) is None:
                    names[kind] = count if single is None else single
        # the constructors between would build dense matrices, and functions that hold the system
        InputOutputSystem.__init__(self, dt=0, **(names or {"inputs": nports, "outputs": noutputs}))
        self.params, self._current_params = {}, {}
        if not names:
            self.nstates, self._state_index = nstates, None

    @property
    def dt(self) -> int:
        """Time base, 0: the system is continuous."""
        return 0

    @dt.setter
    def dt(self, dt: float) -> None:
        # python-control sets it as well, to 0
        if dt != 0:
            raise AttributeError(
                f"dt of a {type(self).__name__} cannot be changed: the system is continuous; make a sampled one with "
                "ph_control.sample(sys, dt)"
            )

    @property
    def state_index(self) -> dict[str, int]:
        """Names of the states, each with its index; made on first access."""
        if self._state_index is None:
            self.set_states(self.nstates)
        assert self._state_index is not None
        return self._state_index

    @state_index.setter
    def state_index(self, index: dict[str, int]) -> None:
        self._state_index = index

    def updfcn(self, t: float, x: ArrayLike, u: ArrayLike, params: dict[str, Any]) -> Array:
        """Derivative of the state, as python-control asks for it."""
        return np.asarray(self.A @ np.atleast_1d(x) + self.B @ np.atleast_1d(u))

    def outfcn(self, t: float, x: ArrayLike, u: ArrayLike, params: dict[str, Any]) -> Array:
        """Output, as python-control asks for it."""
        return np.asarray(self.C @ np.atleast_1d(x) + self.D @ np.atleast_1d(u))

    @View
    def D(self) -> Array:
        """Feedthrough, zeros of shape (m, m), read-only."""
        return np.zeros((self.ninputs, self.ninputs))

    @property
    def modes(self) -> ModalForm:
        """Modal form: the truth behind the matrices."""
        raise NotImplementedError

    @property
    def is_lossless(self) -> bool:
        """Whether nothing is lost: always, but for port-Hamiltonian systems with losses."""
        return True

    @property
    def natural_frequencies(self) -> Array:
        """Natural frequencies `|p|` of the modes, rad per unit time; those of lossless systems are `d`."""
        return self.modes.natural_frequencies

    @property
    def damping_ratios(self) -> Array:
        """Damping ratios `-Re p / |p|` of the modes, in the order of `natural_frequencies`."""
        return self.modes.damping_ratios

    @property
    def time_unit(self) -> str | None:
        """Unit of time, one of 'ns', 'us', 'ms', 's', 'min', 'h', or None where it is not known."""
        return self._time_unit

    @time_unit.setter
    def time_unit(self, unit: str | None) -> None:
        self._time_unit = checked_unit(unit)

    @property
    def hertz(self) -> Array:
        """Natural frequencies in Hz; where `time_unit` is not known, in cycles per unit time."""
        return self.natural_frequencies / hertz_size(self.time_unit)

    @property
    def n(self) -> int:
        """Number of degrees of freedom; there are 2n states."""
        return int(self.nstates) // 2

    def _converted(self, **names: Unpack[SystemNames]) -> PortHamiltonian:
        """Return the port-Hamiltonian system that `ph` makes of this one."""
        raise NotImplementedError

    def _full_port_hamiltonian(self) -> PortHamiltonian:
        """Return a port-Hamiltonian system of the same size with the same transfer function."""
        raise NotImplementedError

    def _beyond_lossless(self) -> list[str]:
        """Return what the system has that lossless ones in the coordinates (q, p) have not."""
        return []

    def horner(self, x: ArrayLike, warn_infinite: bool = True) -> ComplexArray:
        """Transfer function at complex points, shape (m, m, N); `inf` at a pole, never NaN.

        Runs on modal coordinates: O(n) a point, accurate arbitrarily close to a pole.

        Parameters
        ----------
        x : array_like, shape (N,)
            Points of the complex plane.
        warn_infinite : bool
            As python-control has it; poles are met without a warning.

        Raises
        ------
        StructureError
            If the points are not a vector of numbers.

        Examples
        --------
        >>> import ph_control as phc
        >>> phc.ch(1.0, [1.0, 0.0]).horner([0.0, 1.0])
        array([[[0. +0.j, 0.5+0.j]]])
        """
        return self.modes.evaluate(x)

    def frequency_response(
        self, omega: ArrayLike | None = None, squeeze: bool | None = None
    ) -> ct.FrequencyResponseData:
        """Frequency response as data, a rounding to the right of the imaginary axis.

        There the phase of a lossless response jumps by a little less than half a turn, which would leave open which way
        it went: up at a zero, down at a pole.  What unwraps it, as `control.bode_plot` does, goes the same way.

        Parameters
        ----------
        omega : array_like, shape (N,), optional
            Angular frequencies, rad per unit time; by default those that python-control chooses.
        squeeze : bool, optional
            As in `control.frequency_response`.

        Examples
        --------
        >>> import ph_control as phc
        >>> response = phc.ph(phc.modes(1.0, 1.0)).frequency_response([0.5, 2.0])
        >>> response.magnitude.round(6), response.phase.round(6)
        (array([0.666667, 0.666667]), array([ 1.570796, -1.570796]))
        """
        response = super().frequency_response(omega, squeeze)
        parts = response.frdata.real, response.frdata.imag
        across, along = parts[::-1] if self._integrated else parts
        aside = (-_ASIDE if self._integrated else _ASIDE) * np.abs(along)
        if self.ninputs > 1:
            # entries of residues with either sign go either way
            beside = self.horner(response.omega * (1j + _RIGHT))
            aside = np.copysign(aside, beside.imag if self._integrated else beside.real)
        np.copyto(across, aside, where=(across == 0) & np.isfinite(along))
        return response

    def bode_plot(self, *args: Any, **kwargs: Any) -> ct.ControlPlot:
        """Bode plot of python-control; as `control.bode_plot`, with phases that start between -180 and 180 degrees.

        Raises
        ------
        TypeError
            If an argument is none of those of `control.bode_plot`.

        Examples
        --------
        >>> import ph_control as phc, matplotlib.pyplot as plt
        >>> figure = plt.figure()
        >>> plot = phc.ph(phc.modes(1.0, 1.0)).bode_plot()
        >>> plot.axes.shape
        (2, 1)
        >>> plt.close(figure)
        """
        if ct.config.defaults.get("freqplot.initial_phase") is None:
            kwargs.setdefault("initial_phase", 0)
        try:
            return super().bode_plot(*args, **kwargs)
        # python-control hands what it does not know to the lines of matplotlib, and does not count labels
        except (AttributeError, KeyError, IndexError) as error:
            raise TypeError(str(error)) from None

    def poles(self) -> ComplexArray:
        """Eigenvalues of A, shape (2n,): `±i d`, and 0 twice for each degree of freedom without a frequency.

        Examples
        --------
        >>> import ph_control as phc
        >>> phc.ch([1.0, 2.0], [1.0, 0.5, 0.0, 0.0]).poles().imag
        array([-2., -1.,  1.,  2.])
        """
        return self._poles(self.modes.d)

    def _poles(self, d: Array) -> ComplexArray:
        return imaginary(np.concatenate([-d[::-1], np.zeros(2 * (self.n - len(d))), d]))

    def zeros(self) -> ComplexArray:
        """Zeros; all on the imaginary axis.  See `ModalForm.zeros`.

        Examples
        --------
        >>> import ph_control as phc
        >>> phc.ph(phc.modes([1.0, 2.0], [1.0, 1.0])).zeros().imag.round(6)
        array([-1.414214,  0.      ,  1.414214])
        """
        return self.modes.zeros.copy()

    def _names(self) -> SystemNames:
        """Names of the system and its signals, as its factory takes them."""
        return {
            "name": self.name,
            "inputs": self.input_labels,
            "outputs": self.output_labels,
            "states": self.state_labels,
        }

    def _equations(self) -> str:
        A, B, C = (latex_matrix(matrix) for matrix in (self.A, self.B, self.C))
        return rf"\dot x = {A} x + {B} u, \quad y = {C} x"

    def _repr_latex_(self) -> str | None:
        return f"$${self._equations()}$$" if fits_in_a_formula(self) else None

    def _repr_html_(self) -> str:
        """HTML for notebooks: names, equations of a system no larger than `statesp.latex_maxsize`, and its modes."""
        equations = html_formula(self._equations()) if fits_in_a_formula(self) else ""
        shown = html_heading(f"{self.n} degrees of freedom")
        if self._modes_at_hand():
            shown = modes_table(self.modes) if self._in_normal_form else self.modes._repr_html_()
        return html_heading(self._repr_info_()) + equations + shown

    def __str__(self) -> str:
        if self.n <= _LOOKED_AT:
            return printable(str(super().__str__()))
        text = f"<{type(self).__name__}>: {printable(self.name)}\nInputs ({self.ninputs}): {self.input_labels}"
        text += f"\nOutputs ({self.noutputs}): {self.output_labels}\nStates ({self.nstates})"
        if not self._modes_at_hand():
            return text
        with np.printoptions(threshold=6):
            return f"{text}\n\nd = {self.modes.d}\nr = {self.modes.r}"

    @property
    def rigid_modes(self) -> int:
        """Number of rigid-body modes: free momenta, which no spring holds."""
        return len(self.modes.rigid)

    def _modes_at_hand(self) -> bool:
        """Whether modes may be shown: to look at a large system must not cost the spectrum of its Q."""
        return self.n <= _LOOKED_AT or getattr(self, "_modes", self) is not None

    def _label_repr(self, show_count: bool | None = None) -> str:
        """Names as keywords, those that are given by default left out; python-control does not quote quotes."""
        parts = [] if self._generic_name_check() else [f"name={self.name!r}"]
        for kind in LETTERS:
            if labels := self._given_labels(kind):
                parts.append(f"{kind}={labels}")
        return ", ".join(parts)

    def _given_labels(self, kind: str) -> list[str] | None:
        """Names of the inputs, outputs or states; None where they are those that python-control gives."""
        count, letter = getattr(self, f"n{kind}"), LETTERS[kind]
        if kind == "states" and self._state_index is None:
            return None
        labels: list[str] = getattr(self, f"{kind[:-1]}_labels")
        return None if labels == [f"{letter}[{k}]" for k in range(count)] else labels

    def _repr_of(self, *arrays: RealOrComplex) -> str:
        """A call of the factory that evaluates to the same system."""
        text = f"{self._factory.partition('(')[0]}(\n" + ",\n".join(literal(array) for array in arrays)
        labels = self._label_repr()
        return text + (f",\n{labels})" if labels else ")")


def restored(kind: type[System], *parts: object) -> System:
    """System of parts that have been checked; the constructor of a subclass may take other arguments."""
    self = object.__new__(kind)
    self._fill(*parts)
    return self


def in_normal_form(sys: object) -> bool:
    """Whether a system is one of the lossless classes, with frequencies `d` and weights `r`."""
    return isinstance(sys, LosslessSystem) and sys._in_normal_form


def refuse_losses(sys: object, what: str) -> None:
    """Refuse a system with losses where only lossless ones are defined."""
    if isinstance(sys, LosslessSystem) and not sys._in_normal_form:
        more = sys._beyond_lossless()
        raise NotLosslessError(
            more,
            f"{what} defined for lossless systems in the coordinates (q, p), and {sys.name!r} has {', '.join(more)}; "
            "its lossless_part() is the system of the same energy and ports without these",
        )


def inherited_names(source: object, names: SystemNames, *kinds: str) -> SystemNames:
    """Names given, completed by those of a system; python-control takes `input` for `inputs` and so on."""
    if not isinstance(source, ct.InputOutputSystem):
        return names
    kept: dict[str, object] = {} if source._generic_name_check() else {"name": source.name}
    for kind in kinds:
        if names.get(kind) is None and names.get(kind[:-1]) is None:
            kept[kind] = getattr(source, kind[:-1] + "_labels")
    kept |= {key: value for key, value in names.items() if value is not None or key not in kept}
    return cast(SystemNames, kept)
