"""The noise of a model: white noise and colour of each output, and forces that nobody measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import control as ct
import numpy as np

from ... import _checks
from ..._display import counted
from ..._frozen import Frozen
from ..._types import Array, ArrayLike, ComplexArray
from ...exceptions import StructureError

_ROUNDING = 1e-10  # of the largest eigenvalue: by how much a covariance may be indefinite
_SAME_STATES = 1e-6  # relative error of states that are those of another system
_TINY = np.finfo(float).tiny


@dataclass(frozen=True, eq=False, repr=False)
class NoiseModel(Frozen):
    """Noise of the outputs of a model at samples of a step `dt`.

        x[k+1] = A x[k] + B u[k] + w[k]                  of the plant, w of covariance `forces`
        y[k] = C x[k] + D u[k] + v[k]
        v_o[k] = sum_i colours[o, i] v_o[k - 1 - i] + e_o[k],                   e of covariance `covariance`

    Parameters
    ----------
    covariance : array_like, shape (p, p)
        Covariance of the white noise `e` of the outputs from sample to sample; where an output has a colour, of its
        innovations.
    dt : float
        Time between samples, for which all of this holds.
    colours : array_like, shape (p, q), optional
        Coefficients of the autoregression of each output, the last sample first; 0 beyond its order.
    forces : array_like, shape (n, n), optional
        Covariance of what the states of the plant get at each sample, in the states of `PEMResult.observed_system`;
        None where nothing drives them but the inputs.
    cross : array_like, shape (n, p), optional
        Covariance of that with `e`, as of forces that accelerometers feel at once; None for 0.
    states : pair of ndarray, shapes (n, n) and (p, n), optional
        `A` (n, n) and `C` (p, n) of the states that the forces drive; a `PEMResult` enters its own.
    apart : bool
        Whether these states are beside those of the plant, with the same poles: what outputs see of a motion by forces
        is then estimated by itself, and the matrices above are those of `states`.

    Raises
    ------
    StructureError
        If shapes do not go together, a covariance is indefinite, or an autoregression grows.

    See Also
    --------
    NoiseModel.driven : the same of white forces in continuous time.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> noise = phc.NoiseModel([[0.19]], dt=0.1, colours=[[0.9]])
    >>> print(noise)
    noise of 1 output at steps of 0.1: standard deviation of the innovations 0.4359; autoregression of order 1
    >>> noise.spectrum([0.0, np.pi / 0.1]).real.round(4)  # one output: (1, 1, 2)
    array([[[1.9   , 0.0053]]])
    """

    covariance: Array
    dt: float
    colours: Array | None = None
    forces: Array | None = None
    cross: Array | None = None
    states: tuple[Array, Array] | None = None
    apart: bool = False

    def __post_init__(self) -> None:
        covariance = _covariance("covariance", self.covariance)
        object.__setattr__(self, "covariance", covariance)
        object.__setattr__(self, "dt", _checks.sampling_step(self.dt))
        p = len(covariance)
        if self.colours is not None:
            colours = _checks.real_array("colours", self.colours, 2).copy()
            _refuse_shape("colours", colours, (p, colours.shape[1]), f"a row for each of the {p} outputs")
            for place, row in enumerate(colours):
                size = float(np.max(np.abs(np.roots(np.append(1.0, -row))), initial=0.0))
                if size >= 1:
                    raise StructureError(
                        f"the autoregression of output {place} grows: its largest pole has the size {size:.6g}; "
                        "colours must have all poles within the unit circle"
                    )
            object.__setattr__(self, "colours", colours if colours.any() else None)
        if self.forces is not None:
            object.__setattr__(self, "forces", _covariance("forces", self.forces))
        if self.cross is not None:
            if self.forces is None:
                raise StructureError("cross is the covariance of forces with the noise of outputs: give forces too")
            cross = _checks.real_array("cross", self.cross, 2).copy()
            _refuse_shape("cross", cross, (len(self.forces), p), "a row for each state, a column for each output")
            object.__setattr__(self, "cross", cross)
            _covariance("the joint covariance", np.block([[self.forces, cross], [cross.T, covariance]]))
        super().__post_init__()

    @classmethod
    def driven(
        cls, system: Any, entry: ArrayLike, intensity: ArrayLike, covariance: ArrayLike, dt: float,
        colours: ArrayLike | None = None,
    ) -> NoiseModel:  # fmt: skip
        """Noise with white forces in continuous time: `x' = A x + B u + G w`, as `control.lqe` takes them.

        Parameters
        ----------
        system : control.StateSpace
            The plant, of whose states `x` the forces change: for the `noise` of a result, its `observed_system`.
        entry : array_like, shape (n, k)
            `G`, by which the forces enter.
        intensity : array_like, shape (k, k), or float
            Two-sided spectral density of the forces `w`: `E w(t) w(s)^T = intensity * delta(t - s)`.
        covariance, dt, colours
            As of a `NoiseModel`.

        Returns
        -------
        NoiseModel
            Its `forces` are the integral of `exp(A s) G intensity G^T exp(A^T s)` over a step.

        Raises
        ------
        StructureError
            If shapes do not go together, or the system is not in continuous time.

        Examples
        --------
        >>> import control as ct, numpy as np, ph_control as phc
        >>> lag = ct.ss([[-1.0]], [[1.0]], [[1.0]], 0)
        >>> noise = phc.NoiseModel.driven(lag, [[1.0]], 2.0, [[0.01]], dt=0.1)
        >>> noise.forces.round(4), bool(np.isclose(noise.forces[0, 0], 1 - np.exp(-0.2)))
        (array([[0.1813]]), True)
        """
        if not (isinstance(system, ct.StateSpace) and system.isctime()):
            raise StructureError(f"system is a {type(system).__name__}; pass a control.StateSpace in continuous time")
        A, G = np.asarray(system.A, float), _checks.real_array("entry", entry, 2)
        _refuse_shape("entry", G, (len(A), G.shape[1]), f"a row for each of the {len(A)} states")
        W = _covariance("intensity", np.atleast_2d(_checks.real_array("intensity", intensity)))
        _refuse_shape("intensity", W, (G.shape[1],) * 2, "a row and a column for each force")
        forces = sampled_intensity(A, G @ W @ G.T, _checks.sampling_step(dt))
        given: Any = covariance, colours
        return cls(given[0], dt, given[1], forces)

    @property
    def outputs(self) -> int:
        """Number of outputs p."""
        return len(self.covariance)

    @property
    def orders(self) -> tuple[int, ...]:
        """Order of the autoregression of each output; 0 where its noise is white."""
        if self.colours is None:
            return (0,) * self.outputs
        return tuple(int(np.flatnonzero(row)[-1]) + 1 if row.any() else 0 for row in self.colours)

    @property
    def is_white(self) -> bool:
        """Whether there is neither a colour nor a force, so that the best prediction is the simulation."""
        return self.colours is None and self.forces is None

    def _turned(self, T: Array, A: Array, C: Array) -> NoiseModel:
        """The noise in the states of a plant, which are `T` times its own."""
        assert self.forces is not None
        cross = None if self.cross is None else T @ self.cross
        scale = np.sqrt(np.maximum(np.diag(self.forces), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(self.forces / np.outer(scale, scale))
        # as a product with its own transpose, which rounding leaves a covariance
        root = T @ (scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))
        return replace(self, forces=root @ root.T, cross=cross, states=(A, C), apart=False)

    def _in_states_of(self, A: Array, C: Array) -> NoiseModel:
        """The noise with forces that act on the states of a plant, by least squares where its own are apart."""
        if not self.apart or self.states is None:
            return self
        return self._turned(turned(*self.states, A, C)[0], A, C)

    def spectrum(self, omega: ArrayLike) -> ComplexArray:
        """Spectral density of the noise of the outputs, forces through the plant included.

        Parameters
        ----------
        omega : array_like, shape (K,)
            Frequencies, rad per unit time, up to `pi / dt`.

        Returns
        -------
        ndarray of complex, shape (p, p, K)
            Two-sided: the covariance of the noise is the integral over omega from `-pi / dt` to `pi / dt`, divided by
            `2 pi`; white noise has `dt * covariance` everywhere.

        Raises
        ------
        StructureError
            If a frequency is not between `-pi / dt` and `pi / dt`, or a pole that forces drive; or there are forces
            without a plant.

        Notes
        -----
        `dt (H R H^H + G Q G^H + G S H^H + H S^T G^H)` with the colours `H = 1 / (1 - sum a_i z^-i)` and
        `G = C (z - A)^-1` at `z = exp(i omega dt)`.  O(K n^3).

        Examples
        --------
        See `NoiseModel`.
        """
        w = np.atleast_1d(_checks.real_array("omega", omega))
        highest = np.pi / self.dt * (1 + 1e-9)
        if w.ndim != 1 or np.any(np.abs(w) > highest):
            raise StructureError(
                f"omega must be a vector of frequencies up to pi / dt = {np.pi / self.dt:.6g}; it has shape {w.shape} "
                f"and values up to {np.abs(w).max(initial=0.0):.6g}"
            )
        z = np.exp(1j * w * self.dt)
        gain = np.ones((len(w), self.outputs), complex)
        if self.colours is not None:
            past = z[:, None] ** -np.arange(1.0, 1 + self.colours.shape[1])
            gain = 1 / (1 - past @ self.colours.T)
        density = gain[:, :, None] * self.covariance * gain.conj()[:, None]
        if self.forces is not None:
            density = density + self._through_plant(z, gain)
        return np.asarray(self.dt * np.moveaxis(density, 0, 2))

    def _through_plant(self, z: ComplexArray, gain: ComplexArray) -> ComplexArray:
        """What forces add to the density at some points (K,), with their covariance with the noise of outputs."""
        if self.states is None:
            raise StructureError("forces have a spectrum at the outputs of a plant only: use the noise of a PEMResult")
        A, C = self.states
        shifted = np.swapaxes(z[:, None, None] * np.eye(len(A)) - A, 1, 2)
        try:
            G = np.swapaxes(np.linalg.solve(shifted, np.broadcast_to(C.T, (len(z), *C.T.shape))), 1, 2)
        except np.linalg.LinAlgError:
            raise StructureError(
                "omega has a frequency at which the plant has a pole on the unit circle: forces make the noise "
                "infinite there; leave it out"
            ) from None
        back = np.swapaxes(G.conj(), 1, 2)
        density = G @ self.forces @ back
        if self.cross is not None:
            mixed = G @ self.cross * gain.conj()[:, None]
            density = density + mixed + np.swapaxes(mixed.conj(), 1, 2)
        return np.asarray(density)

    def __str__(self) -> str:
        """Say what there is of it in a line."""
        sizes = ", ".join(f"{size:.4g}" for size in np.sqrt(np.diag(self.covariance)))
        parts = [f"standard deviation of the innovations {sizes}"]
        if self.colours is not None:
            orders = ", ".join(map(str, self.orders))
            parts.append(f"autoregression{'s' * (self.outputs > 1)} of order {orders}")
        if self.forces is not None:
            parts.append(f"forces on {counted(len(self.forces), 'state')}")
        return f"noise of {counted(self.outputs, 'output')} at steps of {self.dt:.6g}: {'; '.join(parts)}"

    def __repr__(self) -> str:
        """The same in brackets."""
        return f"<{type(self).__name__}: {self}>"


def turned(A: Array, C: Array, of: Array, seen: Array) -> tuple[Array, float]:
    """States of a system with step `of` and outputs `seen` that move as those of one with step A and outputs C.

    Returns T with `of T = T A` and `seen T` next to C, and the relative error of this.  Poles are paired, each with the
    nearest; a pole without another of the same place leaves no state.
    """
    own, V = np.linalg.eig(A)
    other, W = np.linalg.eig(of)
    first, second = C @ V, seen @ W
    D = np.zeros((len(of), len(A)), complex)
    for k, value in enumerate(own):
        near = int(np.argmin(np.abs(other - value))) if len(other) else -1
        if near >= 0 and np.abs(other[near] - value) <= _SAME_STATES * (1 + np.abs(value)):
            size = max(np.vdot(second[:, near], second[:, near]).real, _TINY)
            D[near, k] = np.vdot(second[:, near], first[:, k]) / size
    T = np.asarray((W @ D @ np.linalg.inv(V)).real)
    return T, float(np.linalg.norm(seen @ T - C) / max(np.linalg.norm(C), _TINY))


def through_plant(noise: NoiseModel, A: Array, C: Array) -> NoiseModel:
    """The noise with the discrete states (n, n), and outputs of these (p, n), that its forces drive.

    One with states of its own has these where they are none of the plant.
    """
    if noise.forces is None:
        return noise
    if noise.apart and noise.states is not None:
        tied, error = turned(*noise.states, A, C)
        return noise if error > _SAME_STATES else noise._turned(tied, A, C)
    if len(noise.forces) != len(A):
        raise StructureError(
            f"the noise has forces on {counted(len(noise.forces), 'state')}; the plant has {len(A)}: give them in "
            "the states of observed_system"
        )
    return replace(noise, states=(A, C))


def sampled_intensity(A: Array, intensity: Array, h: float) -> Array:
    """Covariance of what white noise of some intensity (n, n) adds to `x' = A x` over a step, by doubling a short one.

    O(n^3) for each doubling, of which there are log2 of the norm of `h A`.
    """
    size = float(np.linalg.norm(A, 2)) * h
    doublings = max(0, int(np.ceil(np.log2(size))) + 3) if size > 0 else 0
    step = h / 2**doublings
    # powers of the step: F = exp(A step), and the integral of exp(A s) intensity exp(A^T s)
    F, term = np.eye(len(A)), np.eye(len(A))
    total, slope = step * intensity, step * intensity
    for k in range(1, 20):
        term = term @ A * (step / k)
        F = F + term
        slope = (A @ slope + slope @ A.T) * (step / (k + 1))
        total = total + slope
    for _ in range(doublings):
        total = total + F @ total @ F.T
        F = F @ F
    return np.asarray(0.5 * (total + total.T))


def intensity_of(A: Array, covariance: Array, h: float) -> Array:
    """White noise in continuous time that adds a covariance (n, n) over a step, the nearest that is not negative.

    In the eigenvectors of A the entries of the covariance are those of the intensity times
    `(exp((p_i + conj p_j) h) - 1) / (p_i + conj p_j)`.
    """
    p, V = np.linalg.eig(A)
    inner = np.linalg.solve(V, np.linalg.solve(V, covariance.astype(complex)).conj().T).conj().T
    x = np.add.outer(p, p.conj())
    weight = np.where(x == 0, h, np.expm1(x * h) / np.where(x == 0, 1.0, x))
    intensity = (V @ (inner / weight) @ V.conj().T).real
    values, vectors = np.linalg.eigh(0.5 * (intensity + intensity.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(root @ root.T)


def _covariance(name: str, value: ArrayLike) -> Array:
    """Check a covariance: symmetric, and not negative but for rounding."""
    matrix = np.array(_checks.real_array(name, value, 2))
    if matrix.shape[0] != matrix.shape[1]:
        raise StructureError(f"{name} has shape {matrix.shape}; it must be square")
    largest = float(np.abs(matrix).max(initial=0.0))
    if np.abs(matrix - matrix.T).max(initial=0.0) > _ROUNDING * largest:
        raise StructureError(
            f"{name} is not symmetric: entries differ from those across the diagonal by up to "
            f"{np.abs(matrix - matrix.T).max():.3g}"
        )
    matrix = 0.5 * (matrix + matrix.T)
    scale = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    least = float(np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min(initial=0.0)) if largest else 0.0
    if least < -_ROUNDING * len(matrix):
        raise StructureError(
            f"{name} is no covariance: at unit variances its least eigenvalue is {least:.6g}; it must be at least 0"
        )
    return matrix


def _refuse_shape(name: str, value: Array, shape: tuple[int, ...], what: str) -> None:
    if value.shape != shape:
        raise StructureError(f"{name} has shape {value.shape}; it must be {shape}, {what}")
