"""From any linear system to its lossless modes: the test (M) and what it refuses.

A strictly proper real rational matrix `G` is the transfer function of a port-Hamiltonian system iff its
poles are on the imaginary axis and simple, and the residue matrix of each is Hermitian and positive
semidefinite (for one port: Foster's reactance theorem).  Every route of `partial_fractions.py` ends in a list
of poles with residues and a bound of the error of each; the decision is then the same for all.
"""

from __future__ import annotations

from typing import NamedTuple

import control as ct
import numpy as np
import scipy.signal

from .. import _checks
from .._options import Discretisation, Interpolation
from .._types import Array, ComplexArray, Mask, RealOrComplex
from ..exceptions import NotLosslessError, StructureError
from ..numerics import definiteness as _definite
from ..numerics import pole_residue
from ..numerics.pole_residue import SAFETY, PoleResidueForm, clusters
from ..numerics.polynomials import COEFFICIENT_LIMIT
from ..numerics.rational import LinearSystem
from ..symplectic.forms_and_williamson import apply_form
from .discretization import Hold, continuous, sampling_rule
from .modal_form import ModalForm
from .propagation import transfer_function

_POINTS = 6  # at which modes are held against the matrices that they were found in
_UNSEEN = 1e-4  # of the whole: a residue lost in its error bound must also be small to count as zero


class Judged(NamedTuple):
    """Modes of a system, and how far rounding of its data may have moved frequencies and residues, (n,) each."""

    modes: ModalForm
    d_error: Array
    kappa_error: Array


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # what overflows is refused where it matters
def lossless_modes_with_errors(
    sys: LinearSystem, method: Discretisation | None = None, intersample: Interpolation = "zoh"
) -> Judged:
    """Minimal modal form and the bounds of its errors that the decision used.

    Takes a continuous-time `control.StateSpace` or `control.TransferFunction` (so also what `control.zpk`
    gives) and the systems of `scipy.signal`.  A state-space system never passes through polynomials.
    """
    if isinstance(sys, scipy.signal.dlti):
        raise NotLosslessError(
            [f"the system is discrete-time (dt = {sys.dt}); give it as a control.StateSpace, with how it was sampled"]
        )
    if not isinstance(sys, ct.StateSpace | ct.TransferFunction | scipy.signal.lti):
        raise StructureError(
            f"no port-Hamiltonian form of an object of type {_checks.type_of(sys)}; pass a StateSpace, a "
            "TransferFunction, a zero-pole-gain system, a ModalForm, or the matrices Q and B"
        )
    rule = sampling_rule(sys, method, intersample) if _is_sampled(sys) else None
    _refuse_other_than_ports(sys)
    form = given = _poles_and_residues(sys, rule)
    if rule is not None:
        form = continuous(given, rule)
    try:
        judged = decide(form)
    except (NotLosslessError, StructureError):
        if rule is None and isinstance(sys, ct.TransferFunction) and sys.issiso():
            _refuse_lost_coefficients(sys.num_list[0][0], sys.den_list[0][0], form)
        raise
    if given.resolvents:
        _confirm(judged.modes, given, rule)
    return judged


@np.errstate(over="ignore", divide="ignore", invalid="ignore")
def of_sampled(sys: LinearSystem, method: Discretisation | None, intersample: Interpolation) -> PoleResidueForm:
    """Poles and residues in continuous time of any system that was sampled."""
    rule = sampling_rule(sys, method, intersample)
    return continuous(_poles_and_residues(sys, rule), rule)


def _is_sampled(sys: LinearSystem) -> bool:
    return isinstance(sys, ct.InputOutputSystem) and bool(sys.isdtime(strict=True))


def _confirm(modes: ModalForm, form: PoleResidueForm, rule: Hold | None) -> None:
    """Refuse modes that do not have the transfer function of the matrices."""
    rest = 0.0 if rule is None else 1.0
    distance = np.abs(form.poles[form.poles != rest] - rest)
    if not len(distance):
        distance = np.array([1.0 if rule else max(np.linalg.norm(part.T) for part in form.resolvents) or 1.0])
    # off the axis, and off the bisectors of its quadrants
    points = rest + (0.5 + 0.8j) * np.geomspace(0.1 * distance.min(), 10 * distance.max(), _POINTS)
    parts = [part.evaluate(points) for part in form.resolvents]
    true = form.feedthrough + sum(values for values, _ in parts)
    size = np.abs(true).max(axis=(1, 2))
    allowed = SAFETY**2 * (sum(error for _, error in parts) + len(form.poles) * _checks.EPS * size)
    off = np.abs(transfer_function(modes, points, rule) - true).max(axis=(1, 2))
    # not "greater than": NaN is no agreement
    if not (off <= allowed).all():
        k = int(np.argmax(~(off <= allowed)))
        raise StructureError(
            f"the system is too ill-conditioned to convert: at {_complex(complex(points[k]))} the transfer function of "
            f"the modes that were found differs from that of the matrices by {off[k]:.3g} of {size[k]:.3g}, allowed "
            f"{allowed[k]:.1e}; give it in better scaled states, or as zeros, poles and gain"
        )


def _poles_and_residues(sys: LinearSystem, rule: Hold | None) -> PoleResidueForm:
    """Poles and residues of a system of any kind, by the route of its kind."""
    if isinstance(sys, scipy.signal.ZerosPolesGain):
        zeros, poles = _checks.conjugate_closed("zeros", sys.zeros), _checks.conjugate_closed("poles", sys.poles)
        return pole_residue.from_zeros_poles(zeros, poles, float(_checks.real_array("the gain", sys.gain, 0)))
    if isinstance(sys, ct.StateSpace | scipy.signal.StateSpace):
        A, B, C, D = (_checks.real_array(name, np.atleast_2d(getattr(sys, name)), 2) for name in "ABCD")
        for name, matrix in zip("ABC", (A, B, C), strict=True):
            _checks.in_range(name, matrix)
        return pole_residue.from_state_space(A, B, C, D, rest=0.0 if rule is None else 1.0)
    plain = isinstance(sys, ct.TransferFunction)
    tables = (sys.num_list, sys.den_list) if plain else ([[np.atleast_1d(sys.num)]], [[np.atleast_1d(sys.den)]])
    return pole_residue.from_fractions(*(
        [[_checks.real_array(name, polynomial, 1) for polynomial in row] for row in table]
        for name, table in zip(("the numerator", "the denominator"), tables, strict=True)
    ))  # fmt: skip


def _refuse_lost_coefficients(num: Array, den: Array, form: PoleResidueForm) -> None:
    """Refuse the coefficients of what may be lossless where their rounding has lost its poles."""
    with np.errstate(divide="ignore", invalid="ignore"):
        lost = float(np.nanmax(form.pole_error / np.abs(form.poles), initial=0.0))
    odd = not (np.any(den[-2::-2]) or np.any(num[-1::-2]))
    if odd and lost >= COEFFICIENT_LIMIT:
        raise StructureError(
            f"the coefficients of the transfer function carry {max(0.0, -np.log10(lost)):.1f} digits of its poles, "
            f"needed {-np.log10(COEFFICIENT_LIMIT):.0f}: the rest is lost in their rounding to doubles; give natural "
            "frequencies and weights, zeros, poles and gain, or a state space instead"
        ) from None


def _refuse_other_than_ports(sys: LinearSystem) -> None:
    """Refuse a system without inputs, or with another number of outputs."""
    if isinstance(sys, scipy.signal.lti) and not isinstance(sys, scipy.signal.StateSpace):
        return
    outputs, inputs = (sys.outputs, sys.inputs) if isinstance(sys, scipy.signal.lti) else (sys.noutputs, sys.ninputs)
    if outputs != inputs:
        raise NotLosslessError(
            [f"the system has {inputs} inputs and {outputs} outputs, expected as many of both: each pair is a port"]
        )
    if inputs == 0:
        raise StructureError("the system has no inputs; a port-Hamiltonian system needs at least one port")


def decide(form: PoleResidueForm) -> Judged:
    """Hold poles and residues against (M): the modal form, or `NotLosslessError` naming each offence."""
    form.check_range()
    violations = _feedthrough(form)
    axis_poles: list[_AxisPole] = []
    hidden: list[tuple[float, float, str]] = []
    # wider than the distance within which residues are held to mix, so that such poles are never judged alone
    for group in clusters(form.poles, 2 * SAFETY * form.pole_error):
        R = form.residues[group].sum(axis=0)
        size = float(np.abs(R).max())
        error = SAFETY * float(form.residue_error[group].sum()) + SAFETY * _checks.EPS * size
        weight = np.abs(form.residues[group]).sum(axis=(1, 2))
        pole = complex(np.average(form.poles[group], weights=weight if weight.any() else None))
        pole_error = SAFETY * float(form.pole_error[group].max())
        shown = (part if abs(part) > pole_error else 0.0 for part in (pole.real, pole.imag))
        label = f"pole {_complex(complex(*shown))}"
        worst = group[np.argmax(form.growth[group] - SAFETY * form.growth_error[group])]
        growth, allowed = form.growth[worst], SAFETY * form.growth_error[worst]
        if pole.imag < -pole_error:
            continue
        if growth > allowed:
            violations.append(
                f"{label} is repeated: coefficient of 1/(s - pole)^2 is {growth:.3g}, allowed {allowed:.1e}; "
                "the motion grows with time"
            )
        elif size <= error:
            hidden.append((size, error, label))
        elif abs(pole.real) > pole_error:
            violations.append(
                f"{label} is off the imaginary axis: real part {pole.real:.3g}, allowed {pole_error:.1e} "
                f"({'damped' if pole.real < 0 else 'unstable'})"
            )
        else:
            sigma, W, offences = _positive_part(R, error)
            violations += [f"{label}: {offence}" for offence in offences]
            frequency = 0.0 if abs(pole.imag) <= pole_error else pole.imag
            spread = float(np.abs(form.poles[group] - pole).max())
            axis_poles.append(_AxisPole(frequency, sigma, W, pole_error + spread, 2 * error))
    if violations:
        raise NotLosslessError(violations)
    _all_unseen(hidden, max((mode.sigma.max(initial=0.0) for mode in axis_poles), default=form.gain))
    return _modal_form(axis_poles, form.residues.shape[1])


def _feedthrough(form: PoleResidueForm) -> list[str]:
    away = np.abs(form.poles) > SAFETY * form.pole_error
    static = np.abs(form.residues[away]).sum(axis=(1, 2)) / np.abs(form.poles[away])
    allowed = 8 * _checks.EPS * float(static.sum())
    if np.max(np.abs(form.feedthrough), initial=0.0) <= allowed:
        return []
    return [
        f"feedthrough D = {_show(form.feedthrough)}, allowed 0 within {allowed:.1e}: "
        "a port-Hamiltonian system is strictly proper"
    ]


def _all_unseen(hidden: list[tuple[float, float, str]], whole: float) -> None:
    """Refuse to drop a pole whose residue is lost in its error bound, but not small."""
    residue, error, label = max(hidden, default=(0.0, 0.0, ""))
    if residue > _UNSEEN * whole:
        raise StructureError(
            f"the system is too ill-conditioned to tell whether it is lossless: the residue of {label} is "
            f"{residue:.3g}, but known only within {error:.1e}, expected within {_UNSEEN * whole:.1e}; "
            "give it in better scaled states, or as zeros, poles and gain"
        )


class _AxisPole(NamedTuple):
    """A pole on the axis: frequency, eigenvalues and vectors of its residue, errors of frequency and of kappa."""

    frequency: float
    sigma: Array
    W: ComplexArray
    d_error: float
    kappa_error: float


def _modal_form(axis_poles: list[_AxisPole], ports: int) -> Judged:
    """Modes from frequencies, with the eigenvalues and eigenvectors of their residues."""
    d, nu, rigid = [np.zeros(0)], [np.zeros((0, ports), complex)], [np.zeros((0, ports))]
    errors = [np.zeros((2, 0))]
    for mode in sorted(axis_poles, key=lambda mode: mode.frequency):
        if mode.frequency == 0.0:
            rigid.append((np.sqrt(mode.sigma)[:, None] * mode.W.T).real)
        else:
            d.append(np.full(len(mode.sigma), mode.frequency))
            nu.append(np.sqrt(2 * mode.sigma / mode.frequency)[:, None] * mode.W.T)
            errors.append(np.repeat([[mode.d_error], [mode.kappa_error]], len(mode.sigma), axis=1))
    modes = ModalForm._of(np.concatenate(d), np.concatenate(nu), np.concatenate(rigid))
    _checks.representable("the modal weights of the system", modes.r, modes.kappa)
    d_error, kappa_error = np.concatenate(errors, axis=1)
    return Judged(modes, d_error, kappa_error)


def _positive_part(R: ComplexArray, error: float) -> tuple[Array, ComplexArray, list[str]]:
    """Positive eigenvalues and vectors of the Hermitian part of a residue, and what contradicts positivity."""
    offences = []
    skew = float(np.abs(R - R.conj().T).max()) / 2
    if skew > error:
        what = "residue" if R.size == 1 else "residue matrix"
        need = "real" if R.size == 1 else "Hermitian"
        # that of the velocity, divided by s or times it
        turned = R.size == 1 and abs(R[0, 0].real) <= error
        hint = "; imaginary, as that of a displacement (see affine) or an acceleration" if turned else ""
        offences.append(f"{what} {_show(R)} is not {need}: off by {skew:.3g}, allowed {error:.1e}{hint}")
    sigma, W = np.linalg.eigh(0.5 * (R + R.conj().T))
    if sigma[0] < -error:
        what = "residue" if R.size == 1 else "smallest eigenvalue of the residue matrix"
        cause = ", the sensor away from the actuator or of the wrong sign" * (R.size == 1)
        offences.append(f"{what} {sigma[0]:.6g} is negative, allowed >= {-error:.1e}: not passive{cause}")
    kept = sigma > error
    vectors = W[:, kept]
    # gauge: the largest component of each is real and positive
    lead = vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])]
    return sigma[kept], vectors * (np.abs(lead) / lead), offences


def _complex(value: complex) -> str:
    return f"{value.real:.6g}{value.imag:+.6g}i"


def _show(M: RealOrComplex) -> str:
    if M.size == 1:
        value = complex(M.ravel()[0])
        return _complex(value) if value.imag else f"{value.real:.6g}"
    return np.array2string(M, precision=4, threshold=9, separator=", ").replace("\n", "")


@np.errstate(over="ignore", invalid="ignore")  # what overflows is in no normal form
def hamiltonian_form(sys: ct.StateSpace) -> tuple[Array, Array] | None:
    """`(Q, B)` if the matrices of a system are `(J Q, B, B^T Q, 0)` already, else None."""
    A, B, C, D = (np.asarray(M, dtype=float) for M in (sys.A, sys.B, sys.C, sys.D))
    if len(A) % 2 or len(A) == 0 or D.size == 0 or D.any() or B.shape != C.T.shape:
        return None
    Q = -apply_form(A)
    close = 8 * len(A) * _checks.EPS
    # each entry against what it may be of in size: a large one must not hide what is wrong elsewhere
    root = np.sqrt(np.abs(np.diag(Q)))
    if not np.all(np.abs(Q - Q.T) <= close * np.outer(root, root)):
        return None
    if not np.all(np.abs(B.T @ Q - C) <= close * (np.abs(B).T @ np.abs(Q))):
        return None
    try:
        return _definite.hamiltonian_matrix(Q), _checks.port_matrix(B, len(Q))
    except StructureError:
        return None


@np.errstate(over="ignore", invalid="ignore")
def modes_of_energy(energy: tuple[Array, ComplexArray, Array], B: Array) -> ModalForm:
    """Modes of a system given by the energy coordinates of its `Q`, and its input matrix."""
    d, E, E0 = energy
    modes = ModalForm._of(d.copy(), (E @ B) / np.sqrt(d)[:, None], E0 @ B)
    what = "the modal weights of this Q and B"
    _checks.representable(what, modes.r, modes.kappa, nonzero=_stands_out(E, B).reshape(modes.r.shape))
    if len(E0):
        _checks.representable(what, modes.rigid**2, nonzero=_stands_out(E0, B))
    return modes


def _stands_out(rows: RealOrComplex, B: Array) -> Mask:
    """Which entries of `rows @ B` are more than its rounding."""
    return np.abs(rows @ B) > len(B) * _checks.EPS * (np.abs(rows) @ np.abs(B))
