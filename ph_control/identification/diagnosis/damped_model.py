"""The damped model of a fit: what the data say where nothing is assumed of losses and of the place of the sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

from ..._display import Report, aligned, counted, percent, to_its_error
from ..._frozen import Frozen, ReadOnlyMapping
from ..._types import Array, ComplexArray, Mask
from ..._units import hertz_size
from ...modal.general_form import real_matrices


@dataclass(frozen=True)
class HypothesisTest:
    """A hypothesis within a wider model, by the likelihood that it costs.

    Attributes
    ----------
    hypothesis : str
        What is tested: 'lossless'.
    likelihood_ratio : float
        Twice the log-likelihood that the wider model gains.
    dof : int
        Unknowns that it has more.
    p : float
        Probability of as much by chance.
    """

    hypothesis: str
    likelihood_ratio: float
    dof: int
    p: float


@dataclass(frozen=True, eq=False, repr=False)
class DampedModel(Report, Frozen):
    """Modes with damping and residues of any phase, fitted to the same data as the lossless model beside it.

    `G(s) = D + sum_l rho_l / (s - p_l) + conj(rho_l) / (s - conj(p_l))`, for an output that is what was measured; by
    maximum likelihood if the noise is white.  Sensors may be anywhere.

    Attributes
    ----------
    poles : ndarray of complex, shape (n,)
        Those of positive imaginary part, by their natural frequencies.
    residues : ndarray of complex, shape (n,)
        `rho`; 0 for a free motion.
    feedthrough : float
        `D`.
    covariance : ndarray, shape (4n + 1, 4n + 1)
        Of natural frequencies, damping ratios, real and imaginary parts of the residues, and D; NaN for what was not
        estimated.
    noise_variance, loss, loglik, fit_percent : float
        As those of the fit.
    free_amplitudes : tuple of ndarray of complex, shape (n,)
        Free motion of each mode at the output in each record, `Re(amplitude exp(p t))`; empty for a response.
    offsets : tuple of float
        Constant added to the output of each record.
    predicted : tuple of ndarray
        Output of each experiment as the model has it; of a response with a background of modes outside its band.
    damped, negative : ndarray of bool, shape (n,)
        Which damping ratios, and which weights below 0, stand out of the noise.
    quantity : str
        What was measured, as the fit was told.
    time_unit : str or None
        Unit of the times, where the data tell one.
    """

    poles: ComplexArray
    residues: ComplexArray
    feedthrough: float
    covariance: Array
    noise_variance: float
    loss: float
    loglik: float
    fit_percent: float
    free_amplitudes: tuple[ComplexArray, ...]
    offsets: tuple[float, ...]
    predicted: tuple[NDArray[Any], ...]
    damped: Mask
    negative: Mask
    quantity: str
    time_unit: str | None = None

    @property
    def order(self) -> int:
        """Number of modes n."""
        return len(self.poles)

    @property
    def natural_frequencies(self) -> Array:
        """`|p|`, ascending, rad per unit time."""
        return np.abs(self.poles)

    @property
    def hertz(self) -> Array:
        """Natural frequencies in Hz; in cycles per unit of time where that is not known."""
        return self.natural_frequencies / hertz_size(self.time_unit)

    @property
    def damping_ratios(self) -> Array:
        """`-Re p / |p|`; negative where a mode grows."""
        return -self.poles.real / np.abs(self.poles)

    @property
    def stderr(self) -> Mapping[str, Any]:
        """Standard errors: 'natural_frequencies', 'hertz', 'damping_ratios', 'residues', 'feedthrough'.

        Those of residues are complex: of their real and imaginary parts.
        """
        n, deviation = self.order, np.sqrt(np.diag(self.covariance))
        parts = {
            "natural_frequencies": deviation[:n],
            "hertz": deviation[:n] / hertz_size(self.time_unit),
            "damping_ratios": deviation[n : 2 * n],
            "residues": deviation[2 * n : 3 * n] + 1j * deviation[3 * n : 4 * n],
            "feedthrough": deviation[-1:].reshape(()),
        }
        return ReadOnlyMapping(parts)

    @property
    def complex_weights(self) -> ComplexArray:
        """Residues in units of `kappa = r d`, which is real where damping is light and positive at the actuator."""
        return self._per_residue * self.residues

    @property
    def weights(self) -> tuple[Array, Array]:
        """Real parts of `complex_weights`, and their standard errors."""
        n, factor = self.order, self._per_residue
        T = np.concatenate([np.diag(factor.real), np.diag(-factor.imag)], axis=1)
        inner = T @ self.covariance[2 * n : 4 * n, 2 * n : 4 * n] @ T.T
        return self.complex_weights.real, np.sqrt(np.diag(inner))

    @property
    def _per_residue(self) -> ComplexArray:
        power = {"velocity": 1, "displacement": 0, "acceleration": 2}[self.quantity]
        return np.asarray(2j * self.poles.imag / self.poles**power)

    @property
    def system(self) -> ct.StateSpace:
        """Linear system from the input to what was measured, in real modal coordinates: two states a mode.

        Its free motion from the real and imaginary parts of `free_amplitudes` is that of the record.
        """
        A, B, C = real_matrices(self.poles, 2 * self.residues[:, None], np.ones((1, self.order), complex))
        return ct.StateSpace(A, B, C, [[self.feedthrough]], remove_useless_states=False)

    @property
    def initial_states(self) -> tuple[Array, ...]:
        """State of `system` at the first sample of each record."""
        return tuple(np.stack([one.real, one.imag], axis=1).ravel() for one in self.free_amplitudes)

    def _headline(self) -> str:
        return f"{counted(self.order, 'damped mode')}, fit {percent(self.fit_percent)}"

    def __str__(self) -> str:
        return "\n".join(damped_lines(self))


def damped_lines(model: Any) -> list[str]:
    """Damped modes as a table of frequencies, damping ratios and residues, with their standard errors."""
    through = to_its_error(model.feedthrough, float(model.stderr["feedthrough"]))
    fed = f", fed through {through}" * bool(model.feedthrough)
    return [f"  With damping, sensor anywhere: fit {model.fit_percent:.2f} %{fed}", *aligned(damped_table(model))]


def damped_table(model: Any) -> list[list[str]]:
    """Cells of that table, a head first; of one input and output the residue, with the error of its size."""
    n, stderr, residues = model.order, model.stderr, np.reshape(model.residues, (model.order, -1))
    columns = [(model.hertz, stderr["hertz"]), (100 * model.damping_ratios, 100 * stderr["damping_ratios"])]
    head = ["mode", f"f [{'1/time' if model.time_unit is None else 'Hz'}]", "+-", "damping [%]", "+-"]
    last = [""] * n
    if residues.shape[1] == 1 and residues.any():
        rho = residues[:, 0]
        turned = np.exp(-1j * np.angle(rho))
        C, l = model.covariance[2 * n : 4 * n, 2 * n : 4 * n], np.arange(n)
        crossed = 2 * turned.real * turned.imag * C[l, n + l]
        along = turned.real**2 * C[l, l] + turned.imag**2 * C[n + l, n + l] - crossed
        columns.append((np.abs(rho), np.sqrt(np.maximum(along, 0.0))))
        head += ["|residue|", "+-", "phase [deg]"]
        last = [f"{np.degrees(np.angle(one)):.1f}" for one in rho]
    elif hasattr(model, "phase_collinearity"):
        head.append("collinearity")
        last = [f"{one:.3f}" for one in model.phase_collinearity]
    else:
        head.append("")
    rows = []
    for k in range(n):
        pairs = [(values[k], errors[k]) for values, errors in columns]
        cells = [text for value, error in pairs for text in (to_its_error(value, error), to_its_error(error, error))]
        rows.append([str(k + 1), *cells, last[k]])
    return [head, *rows]
