"""From any linear system to its lossless modes: the test (M) and what it refuses.

A strictly proper real rational matrix `G` is the transfer function of a port-Hamiltonian system iff its
poles are on the imaginary axis and simple, and the residue matrix of each is Hermitian and positive
semidefinite (for one port: Foster's reactance theorem).  Every route below ends in a list of poles with
residues and an honest bound on the error of each; the decision is then the same for all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
import scipy.signal
from numpy.typing import NDArray
from scipy.linalg import eig, matrix_balance
from scipy.sparse.csgraph import connected_components
from slycot import tb01pd

from . import _checks
from .exceptions import NotLosslessError, StructureError
from .modal import ModalForm

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_SAFETY = 32.0  # between a first-order error bound and what is called an error


@dataclass(frozen=True)
class PoleResidueForm:
    """Poles (N,), residue matrices (N, p, m), error bounds of both (N,), feedthrough (p, m).

    A defective pole is one of several at the same place that share an eigenvector.
    """

    poles: ComplexArray
    residues: ComplexArray
    pole_error: Array
    residue_error: Array
    defective: NDArray[np.bool_]
    feedthrough: Array


def lossless_modes(sys: Any) -> ModalForm:
    """Minimal modal form of any lossless linear time-invariant system, or `NotLosslessError`.

    Takes a continuous-time `control.StateSpace` or `control.TransferFunction` (so also what `control.zpk`
    gives) and the systems of `scipy.signal`.  A state-space system never passes through polynomials.
    """
    if isinstance(sys, scipy.signal.lti):
        return decide(_from_scipy(sys))
    if not isinstance(sys, ct.StateSpace | ct.TransferFunction):
        raise StructureError(
            f"a {type(sys).__name__} has no port-Hamiltonian form; pass a StateSpace, a TransferFunction, "
            "a zero-pole-gain system, a ModalForm, or the matrices Q and B"
        )
    if sys.isdtime(strict=True):
        raise StructureError(
            f"the system is discrete-time (dt = {sys.dt}); a port-Hamiltonian system is continuous-time: "
            "convert it to continuous time first"
        )
    _square(sys.noutputs, sys.ninputs)
    if isinstance(sys, ct.StateSpace):
        return decide(from_state_space(sys.A, sys.B, sys.C, sys.D))
    if sys.issiso():
        return decide(from_polynomials(sys.num_list[0][0], sys.den_list[0][0]))
    entries = [
        [from_polynomials(sys.num_list[i][j], sys.den_list[i][j]) for j in range(sys.ninputs)]
        for i in range(sys.noutputs)
    ]
    return decide(_assemble(entries))


def _square(noutputs: int, ninputs: int) -> None:
    if noutputs != ninputs:
        raise StructureError(
            f"the system has {ninputs} inputs and {noutputs} outputs; a port-Hamiltonian system has as many outputs "
            "as inputs, each pair a port"
        )


def _from_scipy(sys: scipy.signal.lti) -> PoleResidueForm:
    if isinstance(sys, scipy.signal.ZerosPolesGain):
        return from_zeros_poles(np.atleast_1d(sys.zeros), np.atleast_1d(sys.poles), float(sys.gain))
    if isinstance(sys, scipy.signal.TransferFunction):
        return from_polynomials(np.atleast_1d(sys.num), np.atleast_1d(sys.den))
    _square(sys.outputs, sys.inputs)
    return from_state_space(*(np.atleast_2d(M) for M in (sys.A, sys.B, sys.C, sys.D)))


# --- state space -----------------------------------------------------------------------------------------------


def from_state_space(A: Array, B: Array, C: Array, D: Array) -> PoleResidueForm:
    """Poles and residues of `C (sI - A)^{-1} B + D` by eigenvectors of the balanced `A`.

    Where `A` has no usable set of eigenvectors (Jordan blocks, most often in a part that no port sees), the
    staircase algorithm of slycot first takes out what is not reachable or not observable.
    """
    A, B, C, D = (_checks.real_array(name, M, 2) for name, M in zip("ABCD", (A, B, C, D), strict=True))
    if len(A) == 0 or not B.any() or not C.any():
        return _static(D)
    form = _eigenvector_form(A, B, C, D)
    if not form.defective.any():
        return form
    A, B, C = _staircase(A, B, C)
    return _eigenvector_form(A, B, C, D) if len(A) else _static(D)


def _static(D: Array) -> PoleResidueForm:
    none = np.zeros(0)
    return PoleResidueForm(none.astype(complex), np.zeros((0, *D.shape), complex), none, none, none.astype(bool), D)


def _staircase(A: Array, B: Array, C: Array) -> tuple[Array, Array, Array]:
    n, m, p = len(A), B.shape[1], C.shape[0]
    B_work, C_work = np.zeros((n, max(m, p))), np.zeros((max(m, p), n))
    B_work[:, :m], C_work[:p] = B, C
    A, B_work, C_work, order = tb01pd(n, m, p, A.copy(), B_work, C_work, job="M", equil="S", tol=0.0)[:4]
    return A[:order, :order], B_work[:order, :m], C_work[:p, :order]


def _eigenvector_form(A: Array, B: Array, C: Array, D: Array) -> PoleResidueForm:
    """Modal decomposition; the bounds are first-order perturbations for a backward error `n eps ||A||`."""
    A, (scale, _) = matrix_balance(A, permute=False, separate=True)
    B, C = B / scale[:, None], C * scale
    values, left, right = eig(A, left=True, right=True)
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    defective = overlap < len(A) * np.sqrt(_checks.EPS)
    backward = len(A) * _checks.EPS * float(np.linalg.norm(A))
    condition = 1.0 / np.maximum(overlap, _checks.EPS)
    inverse = np.linalg.pinv(right) if defective.any() else np.linalg.inv(right)
    outputs, inputs = (C @ right).T, inverse @ B
    distance = np.abs(values[:, None] - values)
    # modes at the same place mix freely: only their sum is used, so they do not disturb one another
    pole_error = np.minimum(backward * condition, _checks.EPS**0.25 * np.linalg.norm(A))
    apart = distance > _SAFETY * (pole_error[:, None] + pole_error)
    coupling = np.where(apart, backward / np.where(apart, distance, 1.0), 0.0)
    out_size, in_size = np.linalg.norm(outputs, axis=1), np.linalg.norm(inputs, axis=1)
    out_error = coupling @ (out_size * condition) + _checks.EPS * np.linalg.norm(C)
    in_error = condition * (coupling @ in_size + _checks.EPS * np.linalg.norm(B))
    return PoleResidueForm(
        values,
        outputs[:, :, None] * inputs[:, None, :],
        pole_error,
        out_error * in_size + out_size * in_error + out_error * in_error,
        defective,
        D,
    )


# --- polynomials and zero-pole-gain ------------------------------------------------------------------------------


def from_polynomials(num: Array, den: Array) -> PoleResidueForm:
    """Poles and residues of `num/den` (descending powers), in a time scaled to the size of the poles.

    Roots are polished and carry the bound that the rounding of the coefficients implies.  Where roots of the
    denominator coincide within it, common factors go through a companion form and the staircase algorithm.
    """
    num = np.trim_zeros(_checks.real_array("the numerator", num, 1), "f")
    den = np.trim_zeros(_checks.real_array("the denominator", den, 1), "f")
    if len(den) == 0:
        raise StructureError("the denominator is zero; a transfer function needs a non-zero denominator")
    if len(num) > len(den):
        raise NotLosslessError(
            [
                f"the transfer function is improper: numerator of degree {len(num) - 1} over degree {len(den) - 1}, "
                "needed less"
            ]
        )
    while len(num) and num[-1] == 0 and den[-1] == 0:
        num, den = num[:-1], den[:-1]
    order = len(den) - 1
    scale = _time_scale(den)
    powers = scale ** -np.arange(order + 1.0)
    top = den[0]
    den = den / top * powers
    num = np.concatenate([np.zeros(order + 1 - len(num)), num]) / top * powers
    feedthrough, num = num[0], (num - num[0] * den)[1:]
    D = np.array([[feedthrough]])
    if order == 0 or not num.any():
        return _static(D)
    poles, pole_error, derivative = _polished_roots(den)
    distance = np.abs(poles[:, None] - poles) + np.diag(np.full(order, np.inf))
    if np.all(distance > 2 * _SAFETY * (pole_error[:, None] + pole_error)):
        top_value = np.polyval(num, poles)
        residues = top_value / derivative
        size = np.abs(poles)
        moved = np.abs(np.polyval(np.polyder(num), poles)) + np.abs(residues * np.polyval(np.polyder(den, 2), poles))
        rounding = 2 * order * _checks.EPS * np.polyval(np.abs(num), size)
        slope_rounding = 2 * order * _checks.EPS * np.polyval(np.polyder(np.abs(den)), size) * np.abs(residues)
        error = (moved * pole_error + rounding + slope_rounding) / np.abs(derivative)
        form = PoleResidueForm(poles, residues[:, None, None], pole_error, error, np.zeros(order, bool), D)
    else:
        A = np.diag(np.ones(order - 1), -1)
        A[0] = -den[1:]
        B = np.eye(order)[:, :1]
        form = from_state_space(*_staircase(A, B, num[None, :]), D)
    # residues carry the unit of 1/time as the poles do
    return PoleResidueForm(
        form.poles * scale,
        form.residues * scale,
        form.pole_error * scale,
        form.residue_error * scale,
        form.defective,
        D,
    )


def _time_scale(den: Array) -> float:
    """Power of two near the geometric mean of the non-zero roots."""
    nonzero = np.flatnonzero(den)
    first, last = nonzero[0], nonzero[-1]
    if first == last:
        return 1.0
    mean = np.log2(np.abs(den[last] / den[first])) / (last - first)
    return float(2.0 ** np.round(mean))


def _polished_roots(den: Array) -> tuple[ComplexArray, Array, ComplexArray]:
    """Roots after Newton steps, the bound of their error, and the derivative there."""
    order = len(den) - 1
    slope = np.polyder(den)
    roots = np.roots(den).astype(complex)
    for _ in range(3):
        derivative = np.polyval(slope, roots)
        step = np.polyval(den, roots) / np.where(derivative == 0, 1.0, derivative)
        roots = roots - np.where(np.abs(step) < 0.1 * np.abs(roots), step, 0.0)
    derivative = np.polyval(slope, roots)
    rounding = 2 * order * _checks.EPS * np.polyval(np.abs(den), np.abs(roots))
    # n times the first-order radius holds a root also where the slope itself is lost in rounding
    error = rounding / np.maximum(np.abs(derivative), np.finfo(float).tiny)
    return roots, error, derivative


def from_zeros_poles(z: ComplexArray, p: ComplexArray, gain: float) -> PoleResidueForm:
    """Poles and residues of `gain prod(s - z) / prod(s - p)`, by products: no polynomial is formed."""
    zeros, poles = list(np.asarray(z, complex)), list(np.asarray(p, complex))
    if len(zeros) > len(poles):
        raise NotLosslessError([f"the system is improper: {len(zeros)} zeros over {len(poles)} poles, needed less"])
    close = 8 * max(1, len(poles)) * _checks.EPS
    for zero in tuple(zeros):
        match = [pole for pole in poles if abs(pole - zero) <= close * abs(zero)]
        if match:
            zeros.remove(zero)
            poles.remove(match[0])
    z, p = np.array(zeros, complex), np.array(poles, complex)
    D = np.array([[gain if len(z) == len(p) else 0.0]])
    if gain == 0 or len(p) == 0:
        return _static(D)
    gaps = np.abs(p[:, None] - p) + np.diag(np.full(len(p), np.inf))
    defective = gaps.min(axis=1) <= close * np.abs(p)
    residues = np.empty(len(p), complex)
    relative = np.empty(len(p))
    for l, pole in enumerate(p):
        others = np.delete(p, l)
        down = np.where(pole == others, 1.0, pole - others)
        up = pole - z
        # interleaved so that long products neither over- nor underflow
        ratio = np.concatenate([up[: len(down)], np.ones(max(0, len(down) - len(up)))]) / down
        residues[l] = gain * np.prod(ratio) * np.prod(up[len(down) :])
        sizes = np.concatenate([np.abs(z / np.where(up == 0, 1.0, up)), np.abs(others / down)])
        relative[l] = _checks.EPS * (2 * len(p) + sizes.sum())
    return PoleResidueForm(
        p, residues[:, None, None], _checks.EPS * np.abs(p), relative * np.abs(residues), defective, D
    )


def _assemble(entries: list[list[PoleResidueForm]]) -> PoleResidueForm:
    """One form from those of the entries; `decide` merges the poles they share."""
    p, m = len(entries), len(entries[0])
    poles, residues, pole_error, residue_error, defective = [], [], [], [], []
    D = np.zeros((p, m))
    for i, row in enumerate(entries):
        for j, entry in enumerate(row):
            placed = np.zeros((len(entry.poles), p, m), complex)
            placed[:, i, j] = entry.residues[:, 0, 0]
            poles.append(entry.poles)
            residues.append(placed)
            pole_error.append(entry.pole_error)
            residue_error.append(entry.residue_error)
            defective.append(entry.defective)
            D[i, j] = entry.feedthrough[0, 0]
    return PoleResidueForm(
        np.concatenate(poles), np.concatenate(residues), np.concatenate(pole_error), np.concatenate(residue_error),
        np.concatenate(defective), D,
    )  # fmt: skip


# --- the decision ------------------------------------------------------------------------------------------------


def decide(form: PoleResidueForm) -> ModalForm:
    """Hold poles and residues against (M): the modal form, or `NotLosslessError` naming each offence."""
    violations: list[str] = []
    away = np.abs(form.poles) > _SAFETY * form.pole_error
    size = np.abs(form.residues[away]).sum(axis=(1, 2)) / np.abs(form.poles[away])
    allowed = 8 * _checks.EPS * float(size.sum())
    if np.max(np.abs(form.feedthrough), initial=0.0) > allowed:
        violations.append(
            f"feedthrough D = {_show(form.feedthrough)}, allowed 0 within {allowed:.1e}: "
            "a port-Hamiltonian system is strictly proper"
        )
    frequencies: list[float] = []
    rows: list[ComplexArray] = []
    ports = form.residues.shape[1]
    rigid = np.zeros((0, ports))
    for group in _clusters(form):
        R = form.residues[group].sum(axis=0)
        R_error = _SAFETY * float(form.residue_error[group].sum()) + _SAFETY * _checks.EPS * float(np.abs(R).max())
        defective = form.defective[group].any()
        if np.abs(R).max() <= R_error and not defective:
            continue
        weight = np.abs(form.residues[group]).sum(axis=(1, 2))
        pole = complex(np.average(form.poles[group], weights=weight if weight.any() else None))
        pole_error = _SAFETY * float(form.pole_error[group].max())
        if pole.imag < -pole_error:
            continue
        label = f"pole {_complex(pole)}"
        if defective:
            violations.append(
                f"{label} is repeated: {len(group)} poles within {pole_error:.1e} share an eigenvector, allowed 1; "
                "the motion grows with time"
            )
        elif abs(pole.real) > pole_error:
            violations.append(
                f"{label} is off the imaginary axis: real part {pole.real:.3g}, allowed {pole_error:.1e} "
                f"({'damped' if pole.real < 0 else 'unstable'})"
            )
        else:
            sigma, W, offences = _positive_part(R, R_error)
            violations += [f"{label}: {offence}" for offence in offences]
            if abs(pole.imag) <= pole_error:
                rigid = np.concatenate([rigid, (np.sqrt(sigma)[:, None] * W.T).real])
            else:
                frequencies += [pole.imag] * len(sigma)
                rows.append(np.sqrt(2 * sigma / pole.imag)[:, None] * W.T)
    if violations:
        raise NotLosslessError(violations)
    nu = np.concatenate([np.zeros((0, ports), complex), *rows])
    d = np.array(frequencies, dtype=float)
    order = np.argsort(d, kind="stable")
    return ModalForm(d[order], nu[order], rigid)


def _positive_part(R: ComplexArray, error: float) -> tuple[Array, ComplexArray, list[str]]:
    """Positive eigenvalues and vectors of the Hermitian part of a residue, and what contradicts positivity."""
    offences = []
    skew = float(np.abs(R - R.conj().T).max()) / 2
    if skew > error:
        what = "residue" if R.size == 1 else "residue matrix"
        need = "real" if R.size == 1 else "Hermitian"
        offences.append(f"{what} {_show(R)} is not {need}: off by {skew:.3g}, allowed {error:.1e}")
    sigma, W = np.linalg.eigh(0.5 * (R + R.conj().T))
    if sigma[0] < -error:
        what = "residue" if R.size == 1 else "smallest eigenvalue of the residue matrix"
        offences.append(f"{what} {sigma[0]:.6g} is negative, allowed >= {-error:.1e}: not passive")
    kept = sigma > error
    vectors = W[:, kept]
    # gauge: the largest component of each is real and positive
    lead = vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])]
    return sigma[kept], vectors * (np.abs(lead) / lead), offences


def _clusters(form: PoleResidueForm) -> list[NDArray[np.intp]]:
    """Groups of poles that their error bounds do not tell apart."""
    radius = _SAFETY * form.pole_error
    near = np.abs(form.poles[:, None] - form.poles) <= radius[:, None] + radius
    count, label = connected_components(near, directed=False)
    return [np.flatnonzero(label == k) for k in range(count)]


def _complex(value: complex) -> str:
    return f"{value.real:.6g}{value.imag:+.6g}i"


def _show(M: NDArray[Any]) -> str:
    if M.size == 1:
        value = complex(M.ravel()[0])
        return _complex(value) if value.imag else f"{value.real:.6g}"
    return np.array2string(M, precision=4, threshold=9, separator=", ").replace("\n", "")
