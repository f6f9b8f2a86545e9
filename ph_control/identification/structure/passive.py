"""The passive model that the data object to least: linear constraints at the worst frequencies, in their own metric.

`G(jw) + G(jw)^H >= 0` at all frequencies for the mobility between ports, poles in the left half-plane.  With `theta`
the poles, residues and feedthrough, the loss about its minimum is `(theta - theta_0)^T C^-1 (theta - theta_0)`; each
violated frequency with its direction `v` is one constraint `v^H (G + G^H) v >= 0`.  The exact test of passivity finds
where the next ones are, until there is none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import nnls

from ..._heartbeat import alive
from ..._types import Array, ComplexArray, Indices
from ...modal.general_form import real_matrices
from ...modal.positive_real import Passivity, lowest_places
from ..regression.free import FreeProjection, GivenResidues
from .coordinates import ChannelLayout

_INSIDE = 1e-6  # standard errors of a constraint by which it is kept, so that rounding does not break it
_STEADY = 1e-3  # those of a decay rate by which poles are kept from the axis
_ROUNDS = 30  # of new worst frequencies
_NEAR = 2  # rounds about the centre: one for stability, one for passivity
_STEPS = 2  # of the metric and the loss evaluated anew
_ROUNDING = 1e-13  # of the largest eigenvalue
_NEARBY = 0.05  # of the distance of a frequency to the next pole: from there its curvature is taken
_AGREES = 0.01  # of the squared distance: so near to it is the cost, that the metric need not be evaluated anew
_FAR = 1e3  # squared distance in standard errors beyond which there is no need for digits
_SETTLED = 1e-3  # change of the squared distance in standard errors, at the last
_SHOWN = 1e-2  # of the largest eigenvalue of the correlations of active constraints: below, two are one
_MEET = 1e-6  # of a pole: its imaginary part where the two of a mode are taken to meet

# worst frequencies
_ABOUT = 57  # points about each pole
_ZOOMS = 4  # towards a minimum between three points, to a hundredth of their distance squared

# the least distance
_EMPTY = 1e-12  # of a unit vector: a rest so small says that no point meets the constraints


@dataclass(frozen=True)
class PassivePoint:
    """The nearest passive model: the data there, its active constraints, the inverse of the information along them."""

    data: GivenResidues
    active: int
    inverse: Array

    @property
    def deficiency(self) -> int:
        """Number of combinations of residues that leave no trace in the data."""
        return self.data.deficiency

    def covariance(self, variance: float) -> Array:
        """Covariance of what may move, for a variance of the rows."""
        return variance * self.inverse


@dataclass(frozen=True)
class _Constraint:
    """`2 Re sum rho beta + sum D delta`, linear in residues and feedthrough: at a frequency, in a direction.

    `beta` (n, P, P) for outputs and inputs of ports, `slope` its derivative by the poles, `delta` (P, P).
    """

    beta: ComplexArray
    slope: ComplexArray
    delta: Array


@dataclass(frozen=True)
class _Ports:
    """The mobility between ports of models `theta`: imaginary and real parts of poles, `shared` by outputs."""

    projection: FreeProjection
    layout: ChannelLayout

    @cached_property
    def _outputs(self) -> Indices:
        return np.array([o for o, _ in self.layout.ports])

    @cached_property
    def _inputs(self) -> Indices:
        return np.array([i for _, i in self.layout.ports])

    @cached_property
    def _integrations(self) -> Indices:
        """Powers of the pole that make residues of velocities of those of each port."""
        return 1 - self.layout.powers[self._outputs]

    @property
    def n(self) -> int:
        """Number of modes."""
        return len(self.projection.p)

    def theta(self, projection: FreeProjection) -> Array:
        """The numbers of a model."""
        return np.concatenate([projection.pole_parts, projection.shared.T.ravel()])

    def data(self, theta: Array) -> GivenResidues:
        """The data at a model."""
        n = self.n
        shared = theta[2 * n :].reshape(self.projection.shared.shape[::-1]).T
        return self.projection.with_unknowns(theta[n : 2 * n] + 1j * theta[:n], shared)

    @cached_property
    def _has_velocity_feedthrough(self) -> bool:
        """Whether a velocity may be fed through."""
        _, through = self.layout.split(self.projection.excited_unknowns.astype(float), self.n)
        return bool(np.any(through[np.ix_(self._outputs, self._inputs)][self._integrations == 0] != 0))

    @property
    def is_strictly_proper(self) -> bool:
        """Whether mobilities vanish at infinite frequency, whatever the parameters."""
        return not self._has_velocity_feedthrough and not np.any(self._integrations == 1)

    @property
    def vanishes_at_zero(self) -> bool:
        """Whether mobilities vanish at frequency 0, whatever the parameters: those of measured displacements."""
        return bool(np.all(self._integrations == 1))

    def mobility(self, theta: Array) -> tuple[ComplexArray, ComplexArray, Array]:
        """Poles, residues (n, P, P) of velocities, and what is fed through to them."""
        n = self.n
        p = theta[n : 2 * n] + 1j * theta[:n]
        shared = theta[2 * n :].reshape(self.projection.shared.shape[::-1]).T
        residues, through = self.layout.split(shared, n)
        block = np.ix_(np.arange(n), self._outputs, self._inputs)
        rho, k = residues[block], self._integrations
        D = np.where((k == 0)[:, None], through[np.ix_(self._outputs, self._inputs)], 0.0)
        D = D + np.where((k == 1)[:, None], 2 * rho.sum(axis=0).real, 0.0)
        return p, rho * (p[:, None] ** k)[:, :, None], D

    def constraint(self, theta: Array, w: float, M: ComplexArray) -> _Constraint:
        """Trace of `M (G + G^H)` at a frequency, M Hermitian; at an end where it vanishes its second order."""
        n, k = self.n, self._integrations
        p = (theta[n : 2 * n] + 1j * theta[:n])[:, None, None]
        W, power = M.T, k[:, None]
        delta = np.where(power == 0, 2 * W.real, 0.0) * (not (np.isinf(w) and self.is_strictly_proper))
        if w == 0 and self.vanishes_at_zero:
            return _Constraint(2 * W / p**2, -4 * W / p**3, delta)
        if np.isfinite(w):
            ahead, behind = 1 / (1j * w - p), 1 / (-1j * w - p)
            beta = p**power * (W * ahead + W.conj() * behind)
            slope = power / p * beta + p**power * (W * ahead**2 + W.conj() * behind**2)
        elif self.is_strictly_proper:
            beta, slope = -2 * W * p ** (power + 1), -2 * W * (power + 1) * p**power
        else:
            beta = slope = np.zeros((n, len(M), len(M)), complex)
        return _Constraint(beta + np.where(power == 1, 2 * W.real, 0.0), slope, delta)

    def symmetry(self, theta: Array) -> list[_Constraint]:
        """Differences that are 0: at an end of the axis where mobilities vanish, their first order is symmetric."""
        constraints, P = list[_Constraint](), len(self._outputs)
        p, no_feedthrough = theta[self.n : 2 * self.n] + 1j * theta[: self.n], np.zeros((P, P))
        ends = [np.full(P, -1)] * self.vanishes_at_zero + [self._integrations] * (not self._has_velocity_feedthrough)
        for k in ends:
            for a in range(P):
                for b in range(a):
                    beta, slope = np.zeros((2, self.n, P, P), complex)
                    beta[:, a, b], beta[:, b, a] = p ** float(k[a]), -(p ** float(k[b]))
                    slope[:, a, b], slope[:, b, a] = k[a] * p ** (k[a] - 1.0), -k[b] * p ** (k[b] - 1.0)
                    constraints.append(_Constraint(beta, slope, no_feedthrough))
        return constraints

    def value_and_gradient(self, theta: Array, constraint: _Constraint) -> tuple[float, Array]:
        """Value of a constraint and its gradient by `theta`."""
        n, layout, width = self.n, self.layout, self.projection.shared.shape[0]
        shared = theta[2 * n :].reshape(self.projection.shared.shape[::-1]).T
        residues, through = layout.split(shared, n)
        gradient, value = np.zeros(len(theta)), 0.0
        for a, o in enumerate(self._outputs):
            for b, i in enumerate(self._inputs):
                rho, beta = residues[:, o, i], constraint.beta[:, a, b]
                value += float(2 * np.sum(rho * beta).real + through[o, i] * constraint.delta[a, b])
                by_pole = 2 * rho * constraint.slope[:, a, b]
                gradient[:n] -= by_pole.imag
                gradient[n : 2 * n] += by_pole.real
                output, column = (o * layout.inputs + i, 0) if layout.per_entry else (o, i)
                first = 2 * n + output * width + column * (2 * n + self.projection.has_feedthrough)
                gradient[first : first + n] += 2 * beta.real * layout.scales[output]
                gradient[first + n : first + 2 * n] -= 2 * beta.imag * layout.scales[output]
                if self.projection.has_feedthrough:
                    gradient[first + 2 * n] += constraint.delta[a, b] * layout.scales[output]
        return value, gradient

    def violations(self, theta: Array) -> list[tuple[float, ComplexArray]]:
        """Frequencies and directions in which a stable model is active, the worst of each band.

        From a grid while that shows any; the exact test has the last word.
        """
        model = self.mobility(theta)
        directions = self._directions(model, self._candidate_frequencies(model))
        return directions or self._directions(model, self._worst_frequencies(model))

    def _directions(
        self, model: tuple[ComplexArray, ComplexArray, Array], frequencies: list[float]
    ) -> list[tuple[float, ComplexArray]]:
        directions = []
        for w in frequencies:
            values, vectors = np.linalg.eigh(self._phi(*model, np.array([w]))[0])
            rounding = _ROUNDING * max(np.abs(values).max(), self._end_term_size(model, w))
            directions += [(w, v) for value, v in zip(values, vectors.T, strict=True) if value < -rounding]
        return directions

    def _end_term_size(self, model: tuple[ComplexArray, ComplexArray, Array], w: float) -> float:
        """Size of the terms of the modes whose sum remains at an end of the axis: rounding is a part of these."""
        order = (
            (1 if self.is_strictly_proper else -1) if np.isinf(w) else -3 if w == 0 and self.vanishes_at_zero else None
        )
        return (
            0.0 if order is None else float(4 * np.sum(np.abs(model[0]) ** order * np.abs(model[1]).max(axis=(1, 2))))
        )

    def _worst_frequencies(self, model: tuple[ComplexArray, ComplexArray, Array]) -> list[float]:
        """Worst frequency of each band, and ends of the axis that lie in one."""
        p, R, D = model
        n, P = R.shape[:2]
        input_rows, output_columns = np.tile(np.eye(P), (n, 1)), 2 * R.transpose(0, 2, 1).reshape(n * P, P)
        A, B, C = real_matrices(np.repeat(p, P), input_rows.astype(complex), output_columns.T)
        bands = Passivity((A, B, C, D), scattering=False).bands()
        ends = [end for band in bands for end in (band.low, band.high) if end in (0.0, np.inf)]
        return sorted({*(band.worst for band in bands), *ends})

    def _candidate_frequencies(self, model: tuple[ComplexArray, ComplexArray, Array]) -> list[float]:
        """Ends of the axis, and minima of the smallest eigenvalue between points that are dense about the poles."""
        frequencies = _minima(lambda omega: np.asarray(np.linalg.eigvalsh(self._phi(*model, omega))[:, 0]), model[0])
        return [0.0, *frequencies, np.inf]

    def curvature(self, theta: Array, w: float, v: ComplexArray) -> Array:
        """Vectors `a` such that the smallest eigenvalue bends as `-sum (a^T d)^2 / 2`, as directions and `w` follow."""
        model, bends = self.mobility(theta), []
        values, vectors = np.linalg.eigh(self._phi(*model, np.array([w]))[0])
        lowest = int(np.argmax(np.abs(vectors.conj().T @ v)))
        for k in np.flatnonzero(np.arange(len(values)) != lowest):
            cross = np.outer(v, vectors[:, k].conj())
            gap = max(float(values[k] - values[lowest]), np.finfo(float).tiny)
            for M in (cross + cross.conj().T, 1j * (cross - cross.conj().T)):
                bends.append(self.value_and_gradient(theta, self.constraint(theta, w, M))[1] / np.sqrt(2 * gap))
        if 0 < w < np.inf:
            step, M = _NEARBY * np.abs(1j * w - model[0]).min(), np.outer(v, v.conj())
            eigenvalues = np.linalg.eigvalsh(self._phi(*model, w + step * np.arange(-1.0, 2.0)))[:, 0]
            second_difference = float(eigenvalues[0] - 2 * eigenvalues[1] + eigenvalues[2])
            if second_difference > 0:
                ends = [
                    self.value_and_gradient(theta, self.constraint(theta, w + offset * step, M))[1]
                    for offset in (-0.5, 0.5)
                ]
                bends.append((ends[1] - ends[0]) / np.sqrt(second_difference))
        return np.reshape(bends, (len(bends), len(theta)))

    def _phi(self, p: ComplexArray, R: ComplexArray, D: Array, omega: Array) -> ComplexArray:
        """`G + G^H` at frequencies, shape (K, P, P); at an end where it vanishes its second order."""
        s = 1j * np.where(np.isinf(omega), 1.0, omega)[:, None]
        G = np.einsum("kl,lab->kab", 1 / (s - p), R) + np.einsum("kl,lab->kab", 1 / (s - p.conj()), R.conj()) + D
        at_infinity = -2 * np.einsum("l,lab->ab", p, R).real if self.is_strictly_proper else D
        G[np.isinf(omega)] = at_infinity
        if self.vanishes_at_zero:
            G[omega == 0] = 2 * np.einsum("l,lab->ab", p**-3.0, R).real
        return np.asarray(G + G.conj().transpose(0, 2, 1))


def nearest_passive(
    projection: FreeProjection, layout: ChannelLayout, variance: float, max_distance: float = np.inf
) -> PassivePoint | None:
    """The passive model of least loss, about the minimum of a free fit whose rows have this variance.

    None if the constraints leave nothing, or nothing within `max_distance`, squared and in standard errors.  Poles
    move with the residues; loss and metric are evaluated anew at the first answer.
    """
    ports, best = _Ports(projection, layout), None
    centre, C = ports.theta(projection), projection.covariance(variance)
    theta = centre
    for _ in range(_STEPS):
        alive("structure passive")
        minimum = _constrained_minimum(ports, centre, C, theta, max_distance)
        if minimum is None:
            break
        theta, data = minimum.theta, ports.data(minimum.theta)
        if best is not None and data.loss >= best.data.loss:
            break
        best = PassivePoint(data, minimum.active, minimum.covariance / variance)
        predicted, cost = minimum.distance, (data.loss - projection.loss) / variance
        if not minimum.active or predicted > _FAR or abs(predicted - cost) < _AGREES * (1 + predicted):
            break
        if np.any((data.p.imag != 0) & (np.abs(data.p.imag) < _MEET * np.abs(data.p))):
            break  # where poles of a mode meet its residues have no slopes
        C = data.covariance(variance)
        centre = theta - C @ _gradient(data) / variance
    return best


def classical_passive(classical: FreeProjection, layout: ChannelLayout, active: int, inverse: Array) -> PassivePoint:
    """A model with classical damping, so many unknowns fewer: poles that grow are brought to the axis."""
    ports = _Ports(classical, layout)  # pairs of poles may have turned real
    theta, n = ports.theta(classical), ports.n
    theta[n : 2 * n] = np.minimum(theta[n : 2 * n], -_least_decay_rates(classical.covariance(1.0), n, theta))
    residues, through = layout.split(classical.shared, n)
    block = np.ix_([o for o, _ in layout.ports], [i for _, i in layout.ports])
    values, vectors = np.linalg.eigh(0.5 * (through[block] + through[block].T))
    through[block] += vectors @ np.diag(np.maximum(-values, 0.0)) @ vectors.T
    theta[2 * n :] = layout.joined(residues, through, classical.has_feedthrough).T.ravel()
    return PassivePoint(ports.data(theta), active, inverse)


def _least_decay_rates(C: Array, n: int, theta: Array) -> Array:
    """Least decay rates, which keep poles from the axis."""
    frequencies = np.where(theta[:n] > 0, theta[:n], np.inf)
    return np.asarray(_STEADY * np.minimum(np.sqrt(np.diag(C)[n : 2 * n]), frequencies))


def _gradient(data: GivenResidues) -> Array:
    """Half the gradient of the loss by `theta`."""
    n, width = len(data.p), data.shared.shape[0]
    gradient = np.zeros(2 * n + data.shared.size)
    for outputs, residual, by_poles, by_shared in data.sensitivities():
        gradient[: 2 * n] += by_poles.T @ residual
        places = 2 * n + width * np.asarray(outputs)[:, None] + np.arange(width)
        gradient[places.ravel()] += by_shared.T @ residual
    return gradient


def _constrained_minimum(
    ports: _Ports, centre: Array, C: Array, theta: Array, max_distance: float
) -> _ConstrainedMinimum | None:
    """Passive model next to the centre: constraints, `cuts` among them, are linearised anew at each answer."""
    n, cuts, no_rows = ports.n, list[tuple[float, ComplexArray]](), np.zeros((0, len(theta)))
    current: _ConstrainedMinimum | None = None
    best: _ConstrainedMinimum | None = None
    multipliers = np.zeros(0)
    decay_bounds = -_least_decay_rates(C, n, theta)
    for iteration in range(_ROUNDS):
        stable = bool(np.all(theta[n : 2 * n] < 0))
        violations = ports.violations(theta) if stable else []
        if stable and not violations:
            if current is None and not ports.symmetry(theta):
                return _ConstrainedMinimum(theta, 0.0, no_rows, no_rows, C)
            if current is not None:
                change = np.inf if best is None else abs(current.distance - best.distance)
                if best is None or current.distance < best.distance:
                    curvatures = [
                        np.sqrt(multiplier) * ports.curvature(theta, *cuts[k])
                        for k, multiplier in enumerate(multipliers)
                        if multiplier
                    ]
                    best = replace(current, curvatures=np.concatenate([no_rows, *curvatures]))
                if change < _SETTLED * (1 + best.distance):
                    break
        cuts = cuts + violations
        values, A, equation_count = _constraints(ports, theta, cuts, decay_bounds)
        margins = np.repeat([0.0, _INSIDE, 0.0], [equation_count, len(cuts), n])
        with np.errstate(all="ignore"):
            lengths = np.sqrt(np.einsum("ij,ij->i", A @ C, A))
            A = A / np.where(lengths > 0, lengths, 1.0)[:, None]
            M, h = A @ C @ A.T, margins - values / np.where(lengths > 0, lengths, 1.0) + A @ (theta - centre)
        if not (np.isfinite(M).all() and np.isfinite(h).all()):
            break  # modes that the data do not show
        solution = _least_distance(M, h, equation_count)
        if solution is None:
            break
        theta = centre + C @ (A.T @ solution)
        multipliers = solution[equation_count : len(solution) - n] / lengths[equation_count : len(solution) - n]
        current = _ConstrainedMinimum(theta, float(solution @ M @ solution), A[solution != 0], no_rows, C)
        if iteration < _NEAR and current.distance > max_distance:
            break  # where constraints are nearly linear, those that are added only take more
    return best


def _constraints(
    ports: _Ports, theta: Array, cuts: list[tuple[float, ComplexArray]], decay_bounds: Array
) -> tuple[Array, Array, int]:
    """Values and gradients of constraints: equations first, then passivity, stability; and the number of equations."""
    n = ports.n
    equations = [ports.value_and_gradient(theta, constraint) for constraint in ports.symmetry(theta)]
    passivity = [ports.value_and_gradient(theta, ports.constraint(theta, w, np.outer(v, v.conj()))) for w, v in cuts]
    stability = zip(decay_bounds - theta[n : 2 * n], -np.eye(n, len(theta), n), strict=True)
    values, gradients = zip(*equations, *passivity, *stability, strict=True)
    return np.array(values), np.array(gradients), len(equations)


@dataclass(frozen=True)
class _ConstrainedMinimum:
    """A passive model, its squared distance from the centre, and the active constraints.

    `rows` are the gradients of these, `curvatures` vectors by which they are curved, by the roots of the multipliers.
    """

    theta: Array
    distance: float
    rows: Array
    curvatures: Array
    C: Array

    @property
    def active(self) -> int:
        """Directions in which constraints hold the model: their number, and what their curvature adds.

        Where the nearest point of a convex set follows the centre by a share only, the rest is held: `u / (1 + u)` for
        a radius of `1 / u` distances (Meyer and Woodroofe 2000).  Nearly the same constraints count once.
        """
        if not len(self.rows):
            return 0
        values = np.linalg.eigvalsh(self.rows @ self.C @ self.rows.T)
        ratios = np.maximum(np.linalg.eigvalsh(self.curvatures @ self.covariance @ self.curvatures.T), 0.0)
        return int(np.sum(values > _SHOWN * values.max())) + round(float(np.sum(ratios / (1 + ratios))))

    @property
    def covariance(self) -> Array:
        """Covariance of what may still move along the constraints."""
        if not len(self.rows):
            return self.C
        cross = self.C @ self.rows.T
        return np.asarray(self.C - cross @ np.linalg.pinv(self.rows @ cross, hermitian=True) @ cross.T)


def _minima(least: Callable[[Array], Array], poles: ComplexArray) -> list[float]:
    """Local minima between 0 and infinity of `least`, a function of frequencies (K,) that varies as its poles do."""
    grid = _grid(poles)
    values = least(grid)
    inner = lowest_places(values)
    if not len(inner):
        return []
    low, high = grid[inner - 1], grid[inner + 1]
    for _ in range(_ZOOMS):
        closer = low[:, None] + (high - low)[:, None] * np.linspace(0.0, 1.0, 17)
        values = least(closer.ravel()).reshape(closer.shape)
        k = np.argmin(values, axis=1)
        rows = np.arange(len(k))
        low, high = closer[rows, np.maximum(k - 1, 0)], closer[rows, np.minimum(k + 1, 16)]
    return [float(w) for w in closer[rows, k]]


def _grid(poles: ComplexArray) -> Array:
    """Frequencies dense about the poles, evenly spaced between them, and beyond."""
    size = float(np.abs(poles).max())
    near = (poles.imag[:, None] + poles.real[:, None] * np.sinh(np.linspace(-7.0, 7.0, _ABOUT))).ravel()
    even = np.linspace(0.0, 2 * size, 20 * len(poles))
    return np.unique(np.concatenate([near[near > 0], even, np.geomspace(2, 100, 20) * size]))


def _least_distance(M: Array, h: Array, equal: int) -> Array | None:
    """Multipliers of the point nearest to the origin with `A z >= h`, the first few equal; `M = A A^T`.

    The point is `A^T` times them; None if there is none.  Lawson and Hanson's way to non-negative least squares.
    """
    scale = float(np.abs(h).max(initial=0.0)) or 1.0
    both = np.concatenate([np.arange(len(h)), np.arange(equal)])
    sign = np.concatenate([np.ones(len(h)), -np.ones(equal)])
    values, vectors = np.linalg.eigh(M)
    root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    E = np.concatenate([root[:, both] * sign, (sign * h[both])[None] / scale])
    target = np.append(np.zeros(len(root)), 1.0)
    solution, _ = nnls(E, target, maxiter=100 * len(both))
    residual = 1.0 - E[-1] @ solution
    if not residual > _EMPTY:
        return None
    multipliers = np.zeros(len(h))
    np.add.at(multipliers, both, sign * solution * (scale / residual))
    return multipliers
