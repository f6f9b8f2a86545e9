"""Whether a system takes in energy at all frequencies, and where it does not."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import control as ct
import numpy as np

from .. import _checks
from .._display import Report
from .._frozen import Frozen
from .._options import PORT_KINDS, PortKind
from .._types import Array, ComplexArray
from .._units import common_unit, rate
from ..exceptions import StructureError
from ..modal.positive_real import Matrices, Passivity, split_axis, violations, well_conditioned
from ..numerics.rational import split_infinity, state_space
from ..systems.base import Convertible, in_normal_form
from ..systems.port_hamiltonian import PortHamiltonian


@dataclass(frozen=True, eq=False, repr=False)
class PassivityReport(Frozen, Report):
    """Where a system gives energy.

    Attributes
    ----------
    kind : {"immittance", "scattering"}
        What was asked: `G + G^H >= 0`, or `S^H S <= I`.
    bands : list of (float, float)
        Frequencies between which the system is active, `(low, high)` in rad per unit time, ascending; `high` may be
        infinite, and both are the same at a pole on the imaginary axis whose residue is not positive semidefinite; both
        are infinite for a pole at infinity, as of `R + s L` with a negative `L`, or of `s^2`.
    frequencies : ndarray, shape (number of bands,)
        Worst frequency of each band.
    sizes : ndarray, shape (number of bands,)
        Size of the violation there: minus the smallest eigenvalue of `(G + G^H) / 2`, or the largest singular value of
        `S` less 1; infinite at a pole on the axis.
    margin : float
        Infimum over all frequencies of the smallest eigenvalue of `(G + G^H) / 2`, or of 1 less the largest singular
        value; 0 for what touches the bound, as every mechanical mobility does at 0 and at infinity.  Minus infinity for
        unstable systems and for poles on the axis that are not passive.
    unstable : ndarray of complex, shape (k,)
        Poles in the right half plane that ports reach and see.
    time_unit : str or None
        Unit of time of the system; None where it is not known.

    Examples
    --------
    >>> import control as ct, ph_control as phc
    >>> report = phc.passivity(ct.tf([1.0, 1.0], [1.0, 0.2, 1.0]))
    >>> report.is_passive, [(round(low, 3), high) for low, high in report.bands]
    (False, [(1.118, inf)])
    """

    kind: str
    bands: list[tuple[float, float]]
    frequencies: Array
    sizes: Array
    margin: float
    unstable: ComplexArray
    _tested: Passivity | None = None
    time_unit: str | None = None

    def curve(self, reach: float = 30.0) -> tuple[Array, Array]:
        """Smallest eigenvalue of `(G + G^H) / 2`, or largest singular value of `S`, over frequency.

        Parameters
        ----------
        reach : float, optional
            How far to go beyond the lowest and the highest frequency at which something happens, as a factor.

        Returns
        -------
        omega, values : ndarray, shape (N,)
            Frequencies, dense at resonances; without the part of poles on the axis.

        Raises
        ------
        StructureError
            If the system is unstable.

        Examples
        --------
        >>> import control as ct, ph_control as phc
        >>> omega, values = phc.passivity(ct.tf([1.0, 1.0], [1.0, 0.2, 1.0])).curve()
        >>> bool(values.min() < -0.66), omega.shape == values.shape
        (True, True)
        """
        if self._tested is None:
            raise StructureError(
                f"the system is unstable, with the pole {self.unstable[0]:.4g}: there is no curve to draw"
            )
        omega = self._tested.dense_grid(reach)
        values = self._tested.smallest(omega)[0]
        return omega, np.sqrt(1 - values) if self.kind == "scattering" else 0.5 * values

    def plot(self, **kwargs: Any) -> ct.ControlPlot:
        """Picture of `curve` with the bands shaded.

        Parameters
        ----------
        **kwargs
            Keywords of `passivity_plot`.

        Returns
        -------
        control.ControlPlot

        Examples
        --------
        See `passivity_plot`.
        """
        from ..plotting.energy_plot import passivity_plot

        return passivity_plot(self, **kwargs)

    @property
    def is_passive(self) -> bool:
        """Whether the system is stable and takes in energy at all frequencies."""
        return not self.bands and not len(self.unstable)

    @property
    def worst(self) -> tuple[float, float] | None:
        """Frequency and size of the largest violation; None of a passive system."""
        if not self.bands:
            return None
        k = int(np.argmax(self.sizes))
        return float(self.frequencies[k]), float(self.sizes[k])

    def __str__(self) -> str:
        """Say whether, with what margin, and where not."""
        if self.is_passive:
            return f"passive ({self.kind}), margin {self.margin:.4g}"
        text = f"not passive ({self.kind})"
        if len(self.unstable):
            text += f": {len(self.unstable)} poles in the right half plane, the first at {self.unstable[0]:.4g}"
        rows, unit = zip(self.bands, self.frequencies, self.sizes, strict=True), rate(self.time_unit)
        return "\n".join(
            [text] + [f"  {low:.6g} to {high:.6g} {unit}: {size:.4g} at {w:.6g}" for (low, high), w, size in rows]
        )


def passivity(sys: Convertible, kind: PortKind = "immittance") -> PassivityReport:
    """Find all frequencies at which a system gives energy.

    Parameters
    ----------
    sys : control.StateSpace, control.TransferFunction or what they can be made of
        Continuous-time system with as many outputs as inputs, output k being the port variable of input k.
    kind : {"immittance", "scattering"}
        An impedance, admittance or mobility, passive if it is stable and `G(jw) + G(jw)^H >= 0` for all `w`; or a
        scattering matrix, passive if it is stable and `S(jw)^H S(jw) <= I`.

    Returns
    -------
    PassivityReport
        Bands, their worst frequencies and sizes, and the margin.

    Raises
    ------
    StructureError
        If the system is in discrete time, or has not as many outputs as inputs.

    Notes
    -----
    No grid of frequencies: `G + G^H` is singular at eigenvalues of a pencil of order `2n + m` on the axis, which part
    it into pieces of one sign; O((2n + m)^3).  What ports do not reach or do not see is left out, and poles on the
    imaginary axis, and at infinity, are judged by their residues.

    A `PortHamiltonian` is passive by its energy and its losses.  Of any other system a rounding of each entry of the
    matrices is allowed for, by its effect to first order, so that a bound that is touched is not crossed.  The units of
    time and gain make no difference.

    Examples
    --------
    >>> import numpy as np, control as ct, ph_control as phc
    >>> report = phc.passivity(ct.ss([[-1.0, 2.0], [-2.0, -1.0]], [[1.0], [0.0]], [[1.0, 0.0]], 0.0))
    >>> report.is_passive, report.margin
    (True, 0.0)
    """
    _checks.choice("kind", kind, PORT_KINDS)
    return replace(_report(sys, kind), time_unit=common_unit(sys))


def _report(sys: Any, kind: PortKind) -> PassivityReport:
    """Report without a unit of time."""
    if in_normal_form(sys) and not sys._integrated and kind == "immittance":
        # all its poles are on the axis, and beside them it neither takes nor gives energy
        m, none = sys.ninputs, np.zeros
        beside = Passivity((none((0, 0)), none((0, m)), none((m, 0)), none((m, m))), scattering=False)
        return PassivityReport(kind, [], none(0), none(0), 0.0, none(0, complex), beside)
    improper = isinstance(sys, ct.TransferFunction) and sys.isctime()
    plain, L = split_infinity(sys) if improper else (sys, np.zeros((0, 0)))
    plain = _state_space(plain)
    A, B, C, D = (np.array(getattr(plain, name), float) for name in "ABCD")
    with well_conditioned("judge"):
        # by its energy and its losses
        return _judged((A, B, C, D), L, kind, isinstance(sys, PortHamiltonian) and kind == "immittance")


def _judged(matrices: Matrices, L: Array, kind: str, certain: bool) -> PassivityReport:
    """Report of a proper system with the residue `L` at infinity; of a passive one only its margin is asked."""
    A, B, C, D = matrices
    split = split_axis(A, B, C)
    scattering = kind == "scattering"
    if L.any():
        split = replace(split, axis=[*split.axis, (np.inf, np.asarray(L, complex))])
    whole = Passivity((*split.rest, D), scattering=scattering, given=matrices)
    if certain:
        least = max(whole.margin(), 0.0)
        return PassivityReport(kind, [], np.zeros(0), np.zeros(0), least, np.zeros(0, complex), whole)
    tested = None if len(split.unstable) else whole
    bands = violations(split, tested, scattering=scattering)
    margin = -max((band.excess for band in bands), default=0.0) if tested is not None else -np.inf
    if tested is not None and not bands:
        margin = tested.margin()
    return PassivityReport(
        kind, [(band.low, band.high) for band in bands], np.array([band.worst for band in bands]),
        np.array([band.excess for band in bands]), float(margin), split.unstable, tested,
    )  # fmt: skip


def _state_space(sys: Convertible) -> ct.StateSpace:
    if isinstance(sys, ct.TransferFunction):
        sys = state_space(sys)
    if isinstance(sys, ct.FrequencyResponseData):
        raise StructureError(
            "this is a FrequencyResponseData, which tells nothing between its points; pass a model of it, such as "
            "result.system of pem. At the points a scattering matrix is passive if numpy.linalg.norm(data.frdata, 2, "
            "axis=(0, 1)) is at most 1, an impedance if the eigenvalues of its Hermitian part are not negative"
        )
    if not isinstance(sys, ct.StateSpace):
        raise StructureError(f"this is a {_checks.type_of(sys)}; pass a StateSpace or a TransferFunction")
    if sys.isdtime(strict=True):
        raise StructureError(f"the system is in discrete time, dt = {sys.dt}; passivity is tested in continuous time")
    if sys.ninputs != sys.noutputs or not sys.ninputs:
        raise StructureError(
            f"the system has {sys.ninputs} inputs and {sys.noutputs} outputs; pairs of port variables need as many of "
            "both: select them with sys[outputs, inputs]"
        )
    for name in "ABCD":
        matrix = np.asarray(getattr(sys, name))
        _checks.finite(name, matrix)
        _checks.in_range(name, matrix)
    return sys
