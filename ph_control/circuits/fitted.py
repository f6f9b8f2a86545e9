"""Elements of a fitted one-port with their standard errors: Foster's form of its poles and residues.

A section has up to four elements.  Of an impedance these are a capacitor, a resistor and a coil side by side, and a
resistor in series with the coil,

    alpha (s + q) / (s^2 + 2 zeta d s + d^2):   C = 1/alpha,   1/R = C (2 zeta d - q),   L = 1/(C (d^2 - q/(C R))),

and `q L` in series; a real pole has the first two, or the middle two and a share in the resistance at infinity.  An
admittance has the dual elements.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from .._options import Immittance
from .._types import Array, ComplexArray, Mask
from ..exceptions import StructureError
from .elements import Element

_WITHIN = 3.0  # standard errors from 0: an element that the data do not show
_ROUNDING = 1e-9  # of what a difference is made of
_STEP = 1e-30  # of derivatives by complex steps, relative

_FIRST, _LOSS, _SECOND, _INNER_LOSS = range(4)  # C, R, L, and what is in series with L; dually L, R, C, and beside C
_LETTERS: dict[Immittance, str] = {"impedance": "CRLR", "admittance": "LRCR"}

Values: TypeAlias = Array | ComplexArray


def is_fit(sys: Any) -> bool:
    """Whether there is a result of a fit in the place of a system."""
    return hasattr(sys, "covariance") and hasattr(sys, "residues")


def is_fitted_one_port(sys: Any) -> bool:
    """Whether there is a result of a fit, of an impedance or admittance at one port."""
    return is_fit(sys) and sys.residues.shape[1:] == (1, 1) and sys.quantities[0] in ("velocity", "free")


def fitted_elements(fit: Any, kind: Immittance) -> tuple[Element, ...]:
    """Elements of Foster's form, with the standard errors that follow from the covariance of the fit."""
    _refuse_unstable(fit, kind)
    sections = [*_OnePort.of(fit).without_unseen(kind).sections(), *_of_background(fit)]
    wiring = _Wiring(kind, len(sections))
    for section in sections:
        wiring.add(section)
    return tuple(wiring.elements)


@dataclass(frozen=True)
class _Section:
    """Values (4,) of a section and their standard errors, 0 of elements that are absent.

    Of an impedance a capacitance, a conductance, an inductance and a resistance; of an admittance the dual.
    """

    values: Array
    errors: Array


@dataclass(frozen=True)
class _OnePort:
    """Sizes, damping ratios, parts of the residues and feedthrough in one vector, with its covariance."""

    theta: Array
    covariance: Array
    known: Mask
    is_real: Mask  # (n,) poles
    pairs: tuple[tuple[int, int], ...] = ()  # places of real poles that are a mode together
    absent: Mask | None = None  # (2 k + 1,) losses and inner losses of the k modes, and the resistor of its own

    @classmethod
    def of(cls, fit: Any) -> _OnePort:
        """Take the numbers of a fit in the order of its covariance."""
        poles, rho = fit.poles, fit.residues[:, 0, 0]
        is_real, size = poles.imag == 0, np.abs(poles)
        zeta = np.where(is_real, 1.0, -poles.real / np.where(is_real, 1.0, size))
        theta = np.concatenate([size, zeta, rho.real, rho.imag, np.ravel(fit.feedthrough)])
        known = np.isfinite(np.diag(fit.covariance))
        covariance = np.where(known[:, None] & known, fit.covariance, 0.0)
        return cls(theta, covariance, known | (theta == 0), is_real).with_pairs()

    @property
    def lone(self) -> list[int]:
        """Places of the real poles that are no part of a mode."""
        paired = {place for pair in self.pairs for place in pair}
        return [place for place in np.flatnonzero(self.is_real).tolist() if place not in paired]

    def modes(self, theta: Values) -> Values:
        """Coefficients (4, k) of the modes `(alpha s + beta) / (s^2 + loss s + square)`."""
        size, zeta, real, imag = theta[:-1].reshape(4, -1)
        l = np.flatnonzero(~self.is_real)
        turn = np.sqrt(1 - zeta[l] ** 2)
        broad = [2 * real[l], 2 * size[l] * (zeta[l] * real[l] - turn * imag[l]), 2 * zeta[l] * size[l], size[l] ** 2]
        i, j = np.array(self.pairs, int).reshape(-1, 2).T
        paired = [real[i] + real[j], real[i] * size[j] + real[j] * size[i], size[i] + size[j], size[i] * size[j]]
        return np.concatenate([np.array(broad), np.array(paired)], axis=1)

    def losses(self, theta: Values) -> Values:
        """Measures (2 k + 1,) of elements that may be 0: losses and inner losses of modes, resistor of its own."""
        alpha, beta, loss, _ = self.modes(theta)
        size, _, real, _ = theta[:-1].reshape(4, -1)
        above = sum(real[place] / size[place] for place in self.lone if real[place].real < 0)
        return np.concatenate([loss * alpha - beta, beta, [theta[-1] + above]])

    def with_pairs(self) -> _OnePort:
        """Join lags of negative residue with faster ones where no resistor is large enough for both."""
        one_port = self
        size, _, real, _ = self.theta[:-1].reshape(4, -1)
        while True:
            resistor = one_port.losses(self.theta)[-1]
            error = _deviations(_derivatives(one_port.losses, self.theta)[-1:], self.covariance)[0]
            slow = [place for place in one_port.lone if real[place] < 0]
            if resistor >= -_WITHIN * error or not slow:
                return one_port
            first = max(slow, key=lambda place: -real[place] / size[place])
            faster = [place for place in one_port.lone if real[place] > 0 and size[place] > size[first]]
            if not faster:
                return one_port
            pair = (first, min(faster, key=lambda place: size[place]))
            one_port = replace(one_port, pairs=(*one_port.pairs, pair))

    def without_unseen(self, kind: Immittance) -> _OnePort:
        """Leave out what is 0 within its errors, with all estimates given that it is; refuse negative elements."""
        values, J, C = self.losses(self.theta), _derivatives(self.losses, self.theta), self.covariance
        errors = _deviations(J, C)
        alpha, beta, loss, square = self.modes(self.theta)
        strength = loss * np.abs(alpha) + np.abs(beta) + np.sqrt(square) * np.abs(alpha)
        scale = np.concatenate([strength, strength, [2 * abs(self.theta[-1]) + abs(values[-1])]])
        absent = np.abs(values) <= _WITHIN * errors + _ROUNDING * scale
        for place in np.flatnonzero(~absent & (values < 0))[:1].tolist():
            frequency = None if place == 2 * len(square) else float(np.sqrt(square[place % len(square)]))
            raise _not_in_foster_form(kind, frequency, values[place], errors[place])
        # others are absent by the structure of the fit: their variance is the rounding of its terms
        estimated = absent & (errors**2 > _ROUNDING * (J**2 @ np.diag(C)))
        if not estimated.any():
            return replace(self, absent=absent)
        G = J[estimated] / errors[estimated, None]
        gain = C @ G.T @ np.linalg.pinv(G @ C @ G.T, hermitian=True)
        theta = self.theta - gain @ (values[estimated] / errors[estimated])
        return replace(self, theta=theta, covariance=C - gain @ G @ C, absent=absent)

    def sections(self) -> list[_Section]:
        """Sections: a resistor of its own, real poles, modes."""
        values, J = self._values(self.theta).real, _derivatives(self._values, self.theta)
        errors = np.where(np.any(J[:, ~self.known], axis=1), np.nan, _deviations(J, self.covariance))
        rows = [_Section(*pair) for pair in zip(values.reshape(-1, 4), errors.reshape(-1, 4), strict=True)]
        return [row for row in rows if row.values.any()]

    def _values(self, theta: Values) -> Values:
        """Values of all sections in a row."""
        size, _, real, _ = theta[:-1].reshape(4, -1)
        losses = self.losses(theta)
        losses = losses if self.absent is None else np.where(self.absent, 0.0, losses)
        rows = [[0.0, 1 / losses[-1] if losses[-1] else 0.0, 0.0, 0.0]]
        for place in self.lone:
            a, rho = size[place], real[place]
            if rho:  # rho/(s + a), or rho/(s + a) - rho/a
                rows.append([1 / rho, a / rho, 0.0, 0.0] if rho.real > 0 else [0.0, -a / rho, -rho / a**2, 0.0])
        alpha, _, _, square = self.modes(theta)
        outer, inner = losses[:-1].reshape(2, -1) / alpha
        second = alpha / (square - outer * inner)
        rows += np.array([1 / alpha, outer / alpha, second, inner * second]).T.tolist()
        return np.array(rows, complex).ravel()


def _derivatives(function: Callable[[Values], Values], theta: Array) -> Array:
    """Derivatives (K, k) of a real function, exact to rounding by complex steps."""
    steps = _STEP * np.where(theta == 0, 1.0, np.abs(theta))
    unit = np.eye(len(theta))
    return np.array([np.imag(function(theta + 1j * step * e)) / step for step, e in zip(steps, unit, strict=True)]).T


def _deviations(J: Array, covariance: Array) -> Array:
    return np.asarray(np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", J, covariance, J), 0.0)))


def _refuse_unstable(fit: Any, kind: Immittance) -> None:
    """Refuse poles without a section of positive elements, whatever the other numbers are."""
    poles, rho = fit.poles, fit.residues[:, 0, 0].real
    bad = (poles.real > 0) | ((poles.imag != 0) & (rho <= 0)) | ((poles == 0) & (rho < 0))
    for place in np.flatnonzero(bad)[:1].tolist():
        raise _not_in_foster_form(kind, float(abs(poles[place])))


def _not_in_foster_form(
    kind: Immittance, frequency: float | None, value: float | None = None, error: float = 0.0
) -> StructureError:
    part = "a resistor of its own" if frequency is None else f"the pole at {frequency:.4g} rad per unit time"
    measured = "" if value is None else f" (a loss of {value:.3g} +- {error:.2g}, which must not be negative)"
    other = "admittance" if kind == "impedance" else "impedance"
    return StructureError(
        f"{part} has no positive elements in Foster's form of this {kind}{measured}; fit the {other}, its reciprocal, "
        "or a circuit of your own, pem(data, model=read_netlist(text, parameters=[..])), or write controlled sources, "
        "netlist(result, 'state-space'); netlist(result.system) has elements of classical damping without errors"
    )


def _of_background(fit: Any) -> list[_Section]:
    """Sections of what a response has beside poles and feedthrough, `k/s` and `l s` with positive numbers."""
    if len(fit.experiments) > 1 or fit.background is None:
        return []
    sections = []
    for power, place in ((-1, _FIRST), (1, _SECOND)):
        value, error = (part[power + 2, 0, 0].real for part in (fit.background.coefficients, fit.background.stderr))
        if value > _WITHIN * error:
            values, errors = np.zeros(4), np.zeros(4)
            values[place] = value**power
            errors[place] = error / value * values[place]
            sections.append(_Section(values, errors))
    return sections


class _Wiring:
    """Sections one after the other for an impedance, side by side for an admittance."""

    def __init__(self, kind: Immittance, sections: int) -> None:
        self.elements: list[Element] = []
        self._kind, self._remaining, self._nodes, self._end = kind, sections, 1, "1"
        self._counts: dict[str, int] = {}

    def add(self, section: _Section) -> None:
        """Add the elements of the next section."""
        places = np.flatnonzero(section.values).tolist()
        nodes = self._in_series(places) if self._kind == "impedance" else self._side_by_side(places)
        # a resistor where the value is a conductance
        conductance = _LOSS if self._kind == "impedance" else _INNER_LOSS
        for place in places:
            value, error = float(section.values[place]), float(section.errors[place])
            if place == conductance:
                value, error = 1 / value, error / value**2
            letter = _LETTERS[self._kind][place]
            self._counts[letter] = self._counts.get(letter, 0) + 1
            self.elements.append(Element(f"{letter}{self._counts[letter]}", nodes[place], value, error))

    def _in_series(self, places: list[int]) -> dict[int, tuple[str, str]]:
        """Nodes of a section of an impedance: its elements side by side."""
        self._remaining -= 1
        begin, self._end = self._end, self._node() if self._remaining else "0"
        nodes = dict.fromkeys(places, (begin, self._end))
        if _INNER_LOSS in places:
            middle = self._node()
            nodes[_SECOND], nodes[_INNER_LOSS] = (begin, middle), (middle, self._end)
        return nodes

    def _side_by_side(self, places: list[int]) -> dict[int, tuple[str, str]]:
        """Nodes of a section of an admittance: its elements one after the other."""
        along = [place for place in places if place != _INNER_LOSS]
        ends = ["1", *(self._node() for _ in along[1:]), "0"]
        nodes = dict(zip(along, pairwise(ends), strict=True))
        if _INNER_LOSS in places:
            nodes[_INNER_LOSS] = nodes[_SECOND]
        return nodes

    def _node(self) -> str:
        self._nodes += 1
        return str(self._nodes)
