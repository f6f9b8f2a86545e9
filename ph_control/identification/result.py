"""The result of a fit: model, uncertainty, quality, and a plain verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import chi2

from .. import _checks
from ..exceptions import StructureError
from ..files import save
from ..modal import ModalForm
from ..plots import fit_plot
from ..response import forced_response
from ..systems import PortHamiltonian
from .data import Record, as_record
from .regressors import Hold
from .solver import Problem

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class OrderRow:
    """One row of the order table: what the best model found with `order` modes achieves."""

    order: int
    loss: float
    aic: float
    bic: float
    d: Array


@dataclass(frozen=True, eq=False)
class PEMResult:
    """Result of `pem`.

    Attributes
    ----------
    system : PortHamiltonian
        The identified model, in Williamson coordinates; a `control.StateSpace`.
    initial_state : ndarray, shape (2n,)
        State of `system` at the first sample.
    free_amplitudes : ndarray, shape (n,), complex
        Free motion of each mode at the output, `Re(amplitude * lambda^k)`.  It agrees with `initial_state`, except for
        modes whose weight is held at 0: no state of a port-Hamiltonian system shows them at its output.
    covariance : ndarray, shape (4n, 4n)
        Of `(d, r, initial_state)`; rows and columns of weights held at 0 are NaN.
    stderr : mapping
        Standard errors under the keys 'd', 'r', 'initial_state'.
    noise_variance : float
        Estimated variance of the output noise.
    loss : float
        Mean squared residual over the observed samples.
    loglik, aic, bic : float
        Gaussian log-likelihood and the criteria made of it.
    fit_percent : float
        `100 (1 - |y - yhat| / |y - mean(y)|)`.
    active : tuple of int
        Modes whose weight `r` is held at 0 by the constraint `r >= 0`.
    unseen : tuple of int
        Modes that were asked for but have no trace in the record; their `r` is 0 and their `d` a placeholder.
    rank_deficiency : int
        Number of combinations of weights and initial states that the record does not show at all.
    whiteness : float
        p-value of the Ljung-Box test on the residuals; small means that something is left unexplained.
    order_table : tuple of OrderRow
        The forward path: loss and criteria for each order tried.
    success : bool
        Whether the refinement converged.
    verdict : str
        The verdict, in a few words.
    message : str
        What it rests on, in sentences.
    n_iterations : int
        Iterations of the refinement, all orders together.
    method, intersample : str
        How the model meets the samples.
    record : Record
        The data.
    predicted, residuals : ndarray, shape (T,)
        Predicted output and what it leaves; NaN residuals where the output is missing.
    """

    system: PortHamiltonian
    initial_state: Array
    free_amplitudes: ComplexArray
    covariance: Array
    noise_variance: float
    loss: float
    loglik: float
    aic: float
    bic: float
    fit_percent: float
    active: tuple[int, ...]
    unseen: tuple[int, ...]
    rank_deficiency: int
    whiteness: float
    order_table: tuple[OrderRow, ...]
    success: bool
    verdict: str
    message: str
    n_iterations: int
    method: str
    intersample: str
    record: Record
    predicted: Array
    residuals: Array
    stderr: Mapping[str, Array] = field(init=False)

    def __post_init__(self) -> None:
        n = len(self.d)
        deviation = np.sqrt(np.diag(self.covariance))
        parts = {"d": deviation[:n], "r": deviation[n : 2 * n], "initial_state": deviation[2 * n :]}
        object.__setattr__(self, "stderr", MappingProxyType(parts))
        locked = (self.initial_state, self.free_amplitudes, self.covariance, self.predicted, self.residuals)
        for array in (*locked, *parts.values()):
            _checks.readonly(array)

    @property
    def modes(self) -> ModalForm:
        """Modal form of the model."""
        return self.system.modes

    @property
    def d(self) -> Array:
        """Natural frequencies, ascending, rad per unit time."""
        return self.system.d

    @property
    def r(self) -> Array:
        """Weights in the order of `d`."""
        return self.system.r

    @property
    def order(self) -> int:
        """Number of modes n."""
        return self.system.n

    @property
    def final_state(self) -> Array:
        """State one step after the last sample: where a record that goes on starts, shape (2n,).

        Raises `StructureError` with an interpolated input, where it depends on the next sample: there use
        `predict(u, initial_state='final')`.
        """
        if self.intersample == "foh":
            raise StructureError(
                "with intersample='foh' the state after the record depends on the next input sample; "
                "use predict(u, initial_state='final')"
            )
        return self._state_after(0.0)

    def _state_after(self, next_input: float) -> Array:
        t = self.record.dt * np.arange(self.record.samples + 1)
        response = forced_response(
            self.system, t, np.append(self.record.u, next_input), self.initial_state,
            method=self.method, intersample=self.intersample,
        )  # fmt: skip
        return np.asarray(response.x[:, -1])

    def predict(self, data: Any, *, initial_state: ArrayLike | str | None = None) -> ct.TimeResponseData:
        """Output of the model on another record.

        Parameters
        ----------
        data : TimeResponseData, pair (u, y), or array of inputs (T,)
            Inputs, with the step of the record that was fitted.
        initial_state : array_like, shape (2n,), or {'estimate', 'fitted', 'final', 'zero'}, optional
            State at the first sample.  'estimate' fits it to the outputs of `data`, 'fitted' takes the one of this
            result, 'final' goes on where the fitted record ended.  Default: 'estimate' if `data` has outputs, else
            'fitted'.

        Returns
        -------
        control.TimeResponseData
            Predicted output, with the states of `system`.

        Raises
        ------
        StructureError
            If the data do not fit the model, or outputs are needed and absent.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
        >>> rng = np.random.default_rng(0)
        >>> t, u = 0.1 * np.arange(400), rng.standard_normal(400)
        >>> y = phc.forced_response(plant, t, u).outputs
        >>> result = phc.pem((u[:300], y[:300]), order=2, dt=0.1)
        >>> ahead = result.predict(u[300:], initial_state="final")
        >>> bool(np.allclose(ahead.outputs, y[300:], atol=1e-9))
        True
        """
        if not isinstance(data, ct.TimeResponseData | Record) and not (isinstance(data, tuple) and len(data) == 2):
            data = (data, None)
        record = as_record(data, self.record.dt, output_needed=False)
        if initial_state is None:
            initial_state = "estimate" if record.observed.any() else "fitted"
        if isinstance(initial_state, str):
            state = self._named_state(record, initial_state)
        else:
            state = _checks.real_array("initial_state", initial_state)
        return forced_response(
            self.system, record.time, record.u, state, method=self.method, intersample=self.intersample
        )

    def _named_state(self, record: Record, name: str) -> Array:
        _checks.choice("initial_state", name, ("estimate", "fitted", "final", "zero"))
        if name == "final":
            return self._state_after(record.u[0])
        if name == "fitted":
            return self.initial_state
        if name == "zero":
            return np.zeros(2 * self.order)
        if not record.observed.any():
            raise StructureError(
                "the record has no outputs to estimate the initial state from; pass initial_state='zero', 'fitted', "
                "'final' or a state"
            )
        return estimate_initial_state(self.system, record, Hold(record.dt, self.method, self.intersample))

    def summary(self) -> str:
        """Report for people: model, uncertainty, quality, verdict.

        Returns
        -------
        str
            Several lines, at most 100 characters wide; `-` stands for the error of a weight held at 0.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), np.random.default_rng(0).standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u).outputs
        >>> print(phc.pem((u, y), dt=0.1).summary())
        Port-Hamiltonian model of 'y' from 'u': 1 mode
          verdict         consistent with the record
          record          500 samples, step 0.1
        ...
          The record is reproduced to rounding.
        """
        lines = [
            f"Port-Hamiltonian model of {self.record.output_label!r} from {self.record.input_label!r}: "
            f"{self.order} mode{'s' * (self.order != 1)}",
            f"  verdict         {self.verdict}",
            f"  record          {self.record.samples} samples, step {self.record.dt:g}"
            + (f", {missing} outputs missing" if (missing := int((~self.record.observed).sum())) else ""),
            f"  discretisation  {self.method}"
            + (f", {self.intersample} input" if self.method != "euler" else " (not lossless: its energy grows)"),
            f"  fit             {self.fit_percent:.2f} %",
            f"  noise           standard deviation {np.sqrt(self.noise_variance):.4g}",
            f"  BIC             {self.bic:.6g}   (AIC {self.aic:.6g}, log-likelihood {self.loglik:.6g})",
            "",
            "   mode        d [rad/time]     +-          cycles/time    r               +-          note",
        ]
        for l in range(self.order):
            note = "not in the record" if l in self.unseen else "constraint active" if l in self.active else ""
            lines.append(
                f"  {l + 1:5d}  {self.d[l]:18.10g}  {_error(self.stderr['d'][l])}  {self.d[l] / 2 / np.pi:15.8g}"
                f"  {self.r[l]:14.7g}  {_error(self.stderr['r'][l])}  {note}".rstrip()
            )
        lines += ["", *_wrap(self.message)]
        return "\n".join(lines)

    def plot(self, **kwargs: Any) -> Any:
        """Picture of measured and predicted output with the residual below.

        Parameters
        ----------
        **kwargs
            Passed to the plotting function: labels and units.

        Returns
        -------
        control.ControlPlot

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), np.random.default_rng(0).standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u).outputs
        >>> picture = phc.pem((u, y), dt=0.1).plot(output_unit="m/s")
        >>> picture.figure.savefig("fit.png")  # doctest: +SKIP
        """
        # a label such as "velocity [m/s]" carries its unit
        name, bracket, unit = self.record.output_label.partition(" [")
        kwargs.setdefault("output_label", name)
        if bracket:
            kwargs.setdefault("output_unit", unit.removesuffix("]"))
        return fit_plot(self.record.time, self.record.y, self.predicted, fit_percent=self.fit_percent, **kwargs)

    def save(self, path: str | Path, *, overwrite: bool = False) -> None:
        """Write the result as JSON; `load` gives it back.

        Parameters
        ----------
        path : str or Path
            File to write.
        overwrite : bool
            Whether an existing file may be replaced.

        Raises
        ------
        OutputExistsError
            If the file exists and `overwrite` is false.

        Examples
        --------
        >>> import pathlib, tempfile, numpy as np, ph_control as phc
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), np.random.default_rng(0).standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u).outputs
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder, "result.json")
        ...     phc.pem((u, y), dt=0.1).save(path)
        ...     phc.load(path).order
        1
        """
        save(self, path, overwrite=overwrite)


def estimate_initial_state(system: PortHamiltonian, record: Record, hold: Hold) -> Array:
    """State at the first sample that fits the outputs best, by least squares; shape (2n,)."""
    modes = system.modes
    zero = forced_response(
        system, record.time, record.u, method=hold.method, intersample=hold.intersample, return_states=False
    )
    problem = Problem(np.zeros(record.samples), record.y - np.reshape(zero.y, -1), record.observed, hold)
    live = np.flatnonzero(modes.r > 0)
    regress = problem.project(modes.d[live]).regressors
    columns = np.concatenate([regress.cosine, regress.sine], axis=1)[record.observed]
    amplitudes = np.zeros(len(modes.d), complex)
    found = np.linalg.lstsq(columns, problem.target, rcond=None)[0]
    amplitudes[live] = found[: len(live)] + 1j * found[len(live) :]
    return state_from_amplitudes(modes, amplitudes)


def state_from_amplitudes(modes: ModalForm, amplitudes: ComplexArray) -> Array:
    """State in Williamson coordinates from the free motion of each mode at the output; 0 where `r` is 0."""
    gain = modes.d * modes.nu[:, 0].conj()
    x = np.where(gain == 0, 0.0, amplitudes / np.where(gain == 0, 1.0, gain))
    return np.concatenate([x.real, x.imag])


def ljung_box(residuals: Array, lags: int) -> float:
    """p-value of the Ljung-Box test that the residuals (T,) are white; NaN residuals count as 0."""
    e = np.where(np.isnan(residuals), 0.0, residuals)
    power = float(e @ e)
    samples = len(e)
    if power == 0 or lags < 1:
        return 1.0
    rho = np.array([float(e[k:] @ e[:-k]) for k in range(1, lags + 1)]) / power
    statistic = samples * (samples + 2) * float(np.sum(rho**2 / (samples - np.arange(1, lags + 1))))
    return float(chi2.sf(statistic, lags))


def _error(value: float) -> str:
    return f"{'-':>8}" if np.isnan(value) else f"{value:8.2g}"


def _wrap(text: str, width: int = 98) -> list[str]:
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) + 1 > width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return ["  " + line for line in lines]
