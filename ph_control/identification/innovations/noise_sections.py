"""Noise in innovations form: `H(z) = 1 + C (z - A)^{-1} K`, with the sections of the plant in `A`, and lags beside.

White forces of any number on a plant, with white noise of its sensors that may be correlated, have the spectrum
`H Sigma H^*` with `Sigma` the covariance of what the past of the outputs does not foretell.  `K` is the Kalman gain of
the predictor, whose poles are those of `A - K C`.  A section is `exp(h [[-decay, w], [-square / w, -decay]])` with a
reference `w` of its own: smooth through critical damping.  Forces that are not white, as of turbulence, come through
lags of their own, which inputs do not drive; noise of sensors that wander through such lags alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import solve_discrete_are
from scipy.sparse.linalg import LinearOperator, cg

from ..._types import Array, ComplexArray, Indices, Mask
from ..regression.sections import Sections

_WELL = 1e6  # condition of the modes of a predictor
_NEAR = 1e-4  # square of an angle below which a series has all digits
_PRECISE, _ITERATIONS = 2e-4, 300  # of missing samples, relative, and steps of their equations
_HALF_APART = 0.3  # of their size: half the least distance of two lags that stand for a section
_BESIDE = 1e-9  # of a bin to a pole that it falls on: the limit of what states and gain make of it has as many digits


def bins_of(samples: int, *, beside: bool = True) -> ComplexArray:
    """Where noise is evaluated for the Fourier bins of so many samples: on the unit circle.

    At frequency zero it is half a bin `beside` where inputs act: noise of a predictor with a pole there, with which
    likelihoods often have their maximum, would be nothing, and what the plant does there known without error.
    """
    z = np.exp(2j * np.pi * np.arange(samples // 2 + 1) / samples)
    if beside:
        z[0] = 1 + np.pi / samples
    return np.asarray(z)


@dataclass(frozen=True, eq=False)
class NoiseSections:
    """Sections that noise comes through, from innovations (p,) to outputs (p,).

    Attributes
    ----------
    sections : Sections
        Of the plant: k pairs of poles, and one first-order section or none.
    step : float
        Time between samples.
    references : ndarray, shape (k,)
        Frequency that scales the second state of each section.
    C : ndarray, shape (p, N)
        What outputs see of the states.
    K : ndarray, shape (N, p)
        Kalman gain of the predictor.
    lags : ndarray, shape (l,)
        Rates of first-order states that noise alone comes through: N = 2 k + l or 2 k + 1 + l states.
    apart : bool
        Whether noise comes through the lags alone, N = l, and not through the plant.
    """

    sections: Sections
    step: float
    references: Array
    C: Array
    K: Array
    lags: Array = field(default_factory=lambda: np.zeros(0))
    apart: bool = False

    @classmethod
    def without_states(cls, outputs: int) -> NoiseSections:
        """White noise of so many outputs."""
        sections = Sections.of(np.zeros(0, complex))
        return cls(sections, 1.0, np.zeros(0), np.zeros((outputs, 0)), np.zeros((0, outputs)))

    @property
    def states(self) -> int:
        """Number of states N."""
        return self.C.shape[1]

    @cached_property
    def passed(self) -> Sections:
        """Sections of the plant that noise comes through: all of them, or none."""
        return Sections.of(np.zeros(0, complex)) if self.apart else self.sections

    @property
    def pairs(self) -> int:
        """Number of second-order sections that noise comes through."""
        return len(self.passed.decay)

    @property
    def unknowns(self) -> int:
        """Lags, and numbers in `C` and `K` but for the bases of the sections, which are free."""
        return len(self.lags) + self.C.size + self.K.size - self.states

    @property
    def rates(self) -> Array:
        """Rates of all first-order states: that of the plant, and lags."""
        return np.concatenate([self.passed.rates, self.lags])

    @cached_property
    def x(self) -> Array:
        """Coordinates of the sections, then lags."""
        return np.concatenate([self.sections.x, self.lags])

    @cached_property
    def _turn(self) -> tuple[Array, Array, Array, Array]:
        """Of each section `cos(r h)` and `sin(r h) / r`, `r` the root of its square; derivatives by the square."""
        q, h = self.passed.square, self.step
        root = np.sqrt(np.abs(q))
        angle = root * h
        near = angle**2 < _NEAR
        safe = np.where(near, 1.0, root)
        cosine = np.where(q > 0, np.cos(angle), np.cosh(np.minimum(angle, 700.0)))
        sine = np.where(q > 0, np.sin(angle), np.sinh(np.minimum(angle, 700.0))) / safe
        sine = np.where(near, h * (1 - q * h**2 / 6 * (1 - q * h**2 / 20)), sine)
        far = (h * cosine - sine) / (2 * np.where(near, 1.0, q))
        by_square = np.where(near, -(h**3) / 6 * (1 - q * h**2 / 10), far)
        return cosine, sine, -0.5 * h * sine, by_square

    @cached_property
    def blocks(self) -> Array:
        """Blocks (k, 2, 2) of `A`."""
        cosine, sine, *_ = self._turn
        return self._in_blocks(cosine, sine, self.passed.square)

    def _in_blocks(self, cosine: Array, sine: Array, square: Array) -> Array:
        growth, w = np.exp(-self.passed.decay * self.step), self.references[: self.pairs]
        rows = [[cosine, w * sine], [-square / w * sine, cosine]]
        return np.moveaxis(growth * np.array(rows), 2, 0)

    @cached_property
    def slopes(self) -> list[tuple[int, Array]]:
        """Derivatives of `A` by the coordinates `x`: first state and block of each."""
        _, sine, cosine_by, sine_by = self._turn
        growth, w, q = np.exp(-self.passed.decay * self.step), self.references[: self.pairs], self.passed.square
        by_square = self._in_blocks(cosine_by, sine_by, q)
        by_square[:, 1, 0] -= growth * sine / w
        decay = self.passed.decay[:, None, None]  # that of a product moves the square as well
        by_decay = -self.step * self.blocks - 2 * decay * by_square
        none = np.zeros((0, 0))  # of what noise does not come through
        each = [(0, none)] * (len(self.sections.x) - len(self.passed.x))
        each += [(2 * k, block) for k, block in enumerate(by_decay)]
        each += [(2 * k, block) for k, block in enumerate(by_square)]
        single = -self.step * np.exp(-self.rates * self.step)
        return each + [(2 * self.pairs + k, np.array([[slope]])) for k, slope in enumerate(single)]

    @cached_property
    def A(self) -> Array:
        """Matrix (N, N) of the states."""
        A = np.zeros((self.states, self.states))
        for k, block in enumerate(self.blocks):
            A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = block
        for k, rate in enumerate(self.rates):
            A[2 * self.pairs + k, 2 * self.pairs + k] = np.exp(-rate * self.step)
        return A

    @property
    def is_stable(self) -> bool:
        """Whether the predictor forgets."""
        with np.errstate(over="ignore", invalid="ignore"):
            closed = self.A - self.K @ self.C
        return bool(np.isfinite(closed).all() and np.abs(np.linalg.eigvals(closed)).max(initial=0.0) < 1)

    def that_forgets(self, covariance: Array) -> NoiseSections:
        """The noise of the same spectrum whose predictor forgets, of innovations of a covariance (p, p).

        Poles of a predictor that grow are reflected at the unit circle.  The same noise where that has no solution.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            if self.is_stable or not np.isfinite(self.A).all():
                return self
        return self.seen_by(np.arange(len(self.C)), covariance) or self

    def seen_by(self, outputs: Indices, covariance: Array) -> NoiseSections | None:
        """The predictor of some outputs alone, of innovations of all of covariance (p, p); None where there is none."""
        with np.errstate(over="ignore", invalid="ignore"):
            C, R, S = self.C[outputs], covariance[np.ix_(outputs, outputs)], self.K @ covariance[:, outputs]
            if not self.states:
                return self.moved(self.sections, C, S)
            try:
                P = solve_discrete_are(self.A.T, C.T, self.K @ covariance @ self.K.T, R, s=S)
                K = np.linalg.solve(C @ P @ C.T + R, (self.A @ P @ C.T + S).T).T
            except (np.linalg.LinAlgError, ValueError):
                return None
        return self.moved(self.sections, C, np.asarray(K, float))

    @cached_property
    def _predictor(self) -> tuple[ComplexArray, ComplexArray, ComplexArray] | None:
        """Poles of the predictor (N,), `C` and `K` in its own modes; None where these are too near to one another."""
        poles, vectors = np.linalg.eig(self.A - self.K @ self.C)
        if len(poles) and not np.linalg.cond(vectors) < _WELL:
            return None
        return poles, self.C @ vectors, np.linalg.solve(vectors, self.K)

    def errors(self, z: ComplexArray, y: ComplexArray) -> ComplexArray:
        """Prediction errors `H^{-1} y` of outputs (p, bins)."""
        if self._predictor is None:
            H = np.eye(len(self.C)) + self.outputs_of_states(z) @ self.K
            return np.asarray(np.linalg.solve(H, y.T[:, :, None])[:, :, 0].T)
        poles, C, K = self._predictor
        return np.asarray(y - C @ ((K @ y) / (z - poles[:, None])))

    def likeliest_change(self, errors: Array, covariance: Array, missing: Mask) -> Array:
        """How outputs change where samples are `missing` (p, T), if these get the likeliest values beside the others.

        Of outputs that leave prediction errors (p, T) with a covariance (p, p), in the order of the missing ones.
        """
        samples, sizes = missing.shape[1], np.sqrt(np.diag(covariance))
        z = bins_of(samples)
        H = (np.eye(len(self.C)) + self.outputs_of_states(z) @ self.K) / sizes[:, None]
        inverse = np.linalg.inv(H @ covariance @ H.conj().transpose(0, 2, 1))

        def weighted(spectrum: ComplexArray) -> Array:
            whole = np.fft.irfft(np.einsum("bij,jb->ib", inverse, spectrum), samples)
            return np.asarray(whole[missing])

        def gram(values: Array) -> Array:
            y = np.zeros(missing.shape)
            y[missing] = values
            return weighted(np.fft.rfft(y))

        size = int(missing.sum())
        equations = LinearOperator((size, size), matvec=gram, dtype=float)
        disturbance = np.einsum("bij,jb->ib", H, np.fft.rfft(errors))
        change = cg(equations, -weighted(disturbance), rtol=_PRECISE, maxiter=_ITERATIONS)[0]
        return np.asarray(change * np.broadcast_to(sizes[:, None], missing.shape)[missing])

    def adjoint_errors(self, z: ComplexArray, e: ComplexArray) -> ComplexArray:
        """The adjoint `H^{-*} e` of values (p, bins)."""
        if self._predictor is None:
            H = np.eye(len(self.C)) + self.outputs_of_states(z) @ self.K
            return np.asarray(np.linalg.solve(H.conj().transpose(0, 2, 1), e.T[:, :, None])[:, :, 0].T)
        poles, C, K = self._predictor
        return np.asarray(e - K.conj().T @ ((C.conj().T @ e) / (z - poles[:, None]).conj()))

    def resolve(self, z: ComplexArray, values: ComplexArray, transposed: bool = False) -> ComplexArray:
        """States `(z - A)^{-1} values`, of values (N, ..., bins); with the transposed `A` if wanted."""
        k, resolved, z = self.pairs, np.empty(values.shape, complex), self._off_poles(z)
        first, second = values[0 : 2 * k : 2], values[1 : 2 * k : 2]
        shape = (k, *(1,) * (values.ndim - 1))
        a, b, c = (self.blocks[:, i, j].reshape(shape) for i, j in ((0, 0), (0, 1), (1, 0)))
        b, c = (c, b) if transposed else (b, c)
        over = 1.0 / ((z - a) ** 2 - b * c)
        resolved[0 : 2 * k : 2] = ((z - a) * first + b * second) * over
        resolved[1 : 2 * k : 2] = ((z - a) * second + c * first) * over
        for row in range(2 * k, self.states):
            resolved[row] = values[row] / (z - self.A[row, row])
        return resolved

    def _off_poles(self, z: ComplexArray) -> ComplexArray:
        """Bins (bins,), those that a pole of the plant falls on, as an integrator on that of frequency 0, beside it."""
        k = self.pairs
        a, b, c = (self.blocks[:, i, j, None] for i, j in ((0, 0), (0, 1), (1, 0)))
        single = np.diag(self.A)[2 * k :, None]
        on_pole = np.any((z - a) ** 2 == b * c, axis=0) | np.any(z == single, axis=0)
        return np.where(on_pole, z * (1 + _BESIDE), z)

    def outputs_of_states(self, z: ComplexArray) -> ComplexArray:
        """Transfer `C (z - A)^{-1}`, shape (bins, p, N)."""
        k, p = self.pairs, len(self.C)
        transfer = np.empty((len(z), p, self.states), complex)
        z = self._off_poles(z)[:, None, None]
        a, b, c = (self.blocks[:, i, j] for i, j in ((0, 0), (0, 1), (1, 0)))
        over = 1.0 / ((z - a) ** 2 - b * c)
        first, second = self.C[:, 0 : 2 * k : 2], self.C[:, 1 : 2 * k : 2]
        transfer[:, :, 0 : 2 * k : 2] = ((z - a) * first + c * second) * over
        transfer[:, :, 1 : 2 * k : 2] = ((z - a) * second + b * first) * over
        for row in range(2 * k, self.states):
            transfer[:, :, row] = self.C[:, row] / (z[:, 0] - self.A[row, row])
        return transfer

    def bases(self, real_shapes: bool = False, starts: Sequence[Array] = ()) -> Array:
        """Directions in `(C, K, *starts)` that change the bases of the states alone, orthonormal columns.

        `starts` are states (N,) of records, or the last of them.  There are N directions; where outputs see the first
        state of each mode alone, one fewer for each mode.
        """
        directions, width = [], len(starts[0]) if starts else 0
        states = np.zeros((len(starts), self.states))
        states[:, self.states - width :] = starts if starts else 0.0
        for first, block in self._commuting(real_shapes):
            place = slice(first, first + len(block))
            C, K = np.zeros(self.C.shape), np.zeros(self.K.shape)
            C[:, place], K[place] = self.C[:, place] @ block, -block @ self.K[place]
            moved = np.zeros(states.shape)
            moved[:, place] = -states[:, place] @ block.T
            directions.append(np.concatenate([C.ravel(), K.ravel(), moved[:, self.states - width :].ravel()]))
        if not directions:
            return np.zeros((self.C.size + self.K.size + len(starts) * width, 0))
        return np.asarray(np.linalg.qr(np.array(directions).T)[0])

    def _commuting(self, real_shapes: bool) -> Iterator[tuple[int, Array]]:
        """Matrices that commute with each block; with those of modes, that are diagonal, where shapes are real."""
        for k, (w, square) in enumerate(zip(self.references, self.passed.square, strict=False)):
            yield 2 * k, np.eye(2)
            if not (real_shapes and square > 0):
                yield 2 * k, np.array([[0.0, 1.0], [-square / w**2, 0.0]])
        for k in range(2 * self.pairs, self.states):
            yield k, np.eye(1)

    def of_real_shapes(self) -> NoiseSections:
        """The model in bases in which outputs see the first state of each mode alone, as far as shapes are real."""
        C, K = self.C.copy(), self.K.copy()
        for k in np.flatnonzero(self.sections.square > 0).tolist():
            both, turn = slice(2 * k, 2 * k + 2), np.sqrt(self.sections.square[k]) / self.references[k]
            shape = self.C[:, 2 * k] + 1j * turn * self.C[:, 2 * k + 1]
            # of (c e^{-i angle}) the imaginary part is the least
            angle = 0.5 * np.angle(np.sum(shape**2))
            back = np.cos(angle) * np.eye(2) - np.sin(angle) * np.array([[0.0, 1.0 / turn], [-turn, 0.0]])
            C[:, both], K[both] = self.C[:, both] @ back, np.linalg.solve(back, self.K[both])
            C[:, 2 * k + 1] = 0.0
        return self.moved(self.sections, C, K)

    def moved(self, sections: Sections, C: Array, K: Array, lags: Array | None = None) -> NoiseSections:
        """The model with other numbers."""
        return replace(self, sections=sections, C=C, K=K, lags=self.lags if lags is None else lags)

    def with_lag(self, rate: float, shape: Array, gain: Array) -> NoiseSections:
        """The model with a lag more, before what there is: innovations are `e = (1 + shape gain^T / (z - a)) e'`."""
        a = np.exp(-rate * self.step)
        # in a pole of the plant itself, as near to it as there is
        moved = np.linalg.lstsq(self.A - a * np.eye(self.states), self.K @ shape, rcond=None)[0]
        C = np.column_stack([self.C, shape - self.C @ moved])
        K = np.concatenate([self.K + np.outer(moved, gain), gain[None]])
        return replace(self, C=C, K=K, lags=np.append(self.lags, rate))

    def of_two_lags(self, section: int, driven: int) -> NoiseSections:
        """The model with a first-order section, and a lag, in place of a section; the slower or faster is `driven`.

        Poles nearer to one another than a part of their size are moved apart.  With a first-order section that there
        is, the one that is driven makes a section.
        """
        sections, both, k = self.sections, [2 * section, 2 * section + 1], self.pairs
        decay, w = sections.decay[section], self.references[section]
        half = np.sqrt(max(-sections.square[section], (_HALF_APART * decay) ** 2))
        order = [1, 0] if driven else [0, 1]
        basis = _first_order(half / w)[:, order]
        rate, lag = (decay + np.array([-half, half]))[order]
        others = np.delete(np.arange(2 * k), both)
        apart = replace(
            self, C=np.column_stack([self.C[:, others], self.C[:, both] @ basis, self.C[:, 2 * k :]]),
            K=np.concatenate([self.K[others], np.linalg.solve(basis, self.K[both]), self.K[2 * k :]]),
            references=np.delete(self.references, section), lags=np.insert(self.lags, 0, lag),
        )  # fmt: skip
        x = np.append(np.delete(sections.x, [section, k + section]), rate)
        if len(sections.rates):
            return apart._paired(x)
        return replace(apart, sections=Sections.from_coordinates(x))

    def _paired(self, x: Array) -> NoiseSections:
        """The model with a section of the last two of some coordinates, which are rates.

        States are those of k - 1 other sections, of the second rate, of a lag, and of the first rate, then other lags.
        """
        k = (len(x) - 2) // 2
        first, second = sorted([(x[-1], 2 * k), (x[-2], 2 * k + 2)])
        decay, half = 0.5 * (first[0] + second[0]), max(0.5 * (second[0] - first[0]), _HALF_APART * first[0])
        pair, basis = [first[1], second[1]], _first_order(1.0)
        kept, rest = np.arange(2 * k), [2 * k + 1, *range(2 * k + 3, self.states)]
        x = np.concatenate([x[:k], [decay], x[k : 2 * k], [decay**2 - half**2]])
        return replace(
            self, sections=Sections.from_coordinates(x), references=np.append(self.references, half),
            C=np.column_stack([self.C[:, kept], np.linalg.solve(basis.T, self.C[:, pair].T).T, self.C[:, rest]]),
            K=np.concatenate([self.K[kept], basis @ self.K[pair], self.K[rest]]),
        )  # fmt: skip


def _first_order(ratio: float) -> Array:
    """Basis in which a section of real poles is two first-order states, the slower first.

    `ratio` is that of half their distance to the reference.
    """
    return np.array([[1.0, 1.0], [ratio, -ratio]])
