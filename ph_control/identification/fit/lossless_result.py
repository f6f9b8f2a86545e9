"""The result of a lossless fit: model, uncertainty, quality, and a plain verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import control as ct
import numpy as np

from ... import _checks
from ..._frozen import ReadOnlyMapping
from ..._types import Array, ArrayLike, ComplexArray
from ..._units import common_unit, with_unit
from ...exceptions import StructureError
from ...modal.discretization import Hold
from ...modal.modal_form import ModalForm, imaginary
from ...systems.base import inherited_names
from ...systems.port_hamiltonian import PortHamiltonian, modes, ph
from ..data.experiments import as_record
from ..data.time_record import Record
from ..diagnosis.verdict import HypothesisTest, Outcome
from ..regression.prediction import (
    FittedExperiment,
    estimated_state,
    observed_system,
    response_on,
    step_after,
)
from ..search.circumstances import Finding
from ..search.order_selection import order_selection
from ..search.path import Start
from ..search.response_noise import NoiseLaw
from ..structure.layout import POWERS
from ..uncertainty.draws import ModeSamples, draw
from ..uncertainty.fisher import Information
from ..uncertainty.state_coordinates import InCoordinates
from .bootstrap import Resampled
from .damped_result import DampedModel
from .report import LosslessReport, residue_errors
from .result import OrderRow, PEMResult
from .stabilisation import Orders


@dataclass(frozen=True, eq=False, repr=False)
class LosslessResult(LosslessReport, Resampled, InCoordinates, PEMResult):
    """Result of `pem`: a lossless model.

    Attributes
    ----------
    system : PortHamiltonian
        The identified model, in Williamson coordinates; a `control.StateSpace` from the input to the velocity of the
        port.
    experiments : tuple of FittedExperiment
        What the fit says of each experiment: data, initial state, offset, prediction and residuals.
    covariance : ndarray, shape (N, N)
        Of `(d, r, initial state of each record)`, N = 2n + 2n for each record in time; rows and columns of weights held
        at 0, and of what was not estimated, are NaN.
    offset_stderr : ndarray, shape (E,)
        Standard error of the offset of each experiment; NaN if none was estimated.
    stderr : mapping
        Standard errors under the keys 'd', 'r', 'initial_state' (in one row for each record if there are several),
        'offset', one for each record, and 'natural_frequencies', 'damping_ratios' (0), 'residues' and 'shapes'.
    noise_variance : float
        Estimated variance of the output noise; of a frequency response, of its real and imaginary parts at unit weight.
    noise : NoiseLaw
        What was taken for the variance of the noise at each point: constant, given by `weights`, or for responses
        without weights, where a constant is refused, estimated with a part that grows with the gain.
    loss : float
        Mean squared residual over the observed samples.
    loglik, aic, bic : float
        Gaussian log-likelihood and the criteria made of it.
    fit_percent : float
        `100 (1 - |y - yhat| / |y - mean(y)|)`, all experiments together; of responses in the scale of their weights.
    active : tuple of int
        Modes whose weight `r` is held at 0 by the constraint `r >= 0`.
    unseen : tuple of int
        Modes that were asked for but have no trace in the record; their `r` is 0 and their `d` a placeholder.
    identifiability : Information
        What the data tell of each parameter: rank, blind combinations, condition.
    whiteness : float
        p-value of the Ljung-Box test on the residuals; small means that the model leaves part of the data unexplained.
    order_table : tuple of OrderRow
        The forward path: loss and criteria for each order tried.
    starts : tuple of Start
        The ways in which the minimum was looked for, and the loss each of them ended with.
    success : bool
        Whether the refinement converged, uninterrupted.
    outcome : Outcome
        What the fit amounts to; the verdict in a few words is its value.
    message : str
        What it rests on, in sentences.
    n_iterations : int
        Iterations of the refinement, all orders together.
    method, intersample : str
        How the model meets the samples.
    quantity : str
        What was measured of the port.
    representation : str
        Whether modes without weight may move: 'observable', or not: 'controllable'.
    findings : tuple of Finding
        What the data show beside the modes: a constant or drift, the hold of the input, a delay, noise that is not
        white or on the input; each with its `cause`, its `values` and its `gain` in log-likelihood.
    tests : tuple of HypothesisTest
        The model against wider ones: hypothesis, likelihood ratio, degrees of freedom, p-value.
    damped : DampedModel or None
        Modes with damping and residues of any phase, where the data speak for these: natural frequencies, damping
        ratios, residues, their standard errors, and a `system`.
    """

    system: PortHamiltonian
    experiments: tuple[FittedExperiment, ...]
    covariance: Array
    offset_stderr: Array
    noise_variance: float
    noise: NoiseLaw
    loss: float
    loglik: float
    aic: float
    bic: float
    fit_percent: float
    active: tuple[int, ...]
    unseen: tuple[int, ...]
    identifiability: Information
    whiteness: float
    order_table: tuple[OrderRow, ...]
    starts: tuple[Start, ...]
    success: bool
    outcome: Outcome
    message: str
    n_iterations: int
    method: str
    intersample: str
    quantity: str
    representation: str
    findings: tuple[Finding, ...] = ()
    tests: tuple[HypothesisTest, ...] = ()
    damped: DampedModel | None = None
    stderr: Mapping[str, Array] = field(init=False)

    def __post_init__(self) -> None:
        n = len(self.d)
        deviation = np.sqrt(np.diag(self.covariance))
        states = deviation[2 * n :]
        parts = {
            "d": deviation[:n],
            "r": deviation[n : 2 * n],
            "initial_state": states.reshape(-1, 2 * n) if len(states) > 2 * n else states,
            "offset": self.offset_stderr,
            "natural_frequencies": deviation[:n],
            "damping_ratios": np.zeros(n),
            "residues": self._residue_errors[:, None, None],
            "shapes": self._shape_errors[:, None],
        }
        object.__setattr__(self, "stderr", ReadOnlyMapping(parts))
        with_unit(self.system, self.time_unit)
        super().__post_init__()

    # --- as modes of any structure ---------------------------------------------------------------------------------

    structure = "lossless"
    ports = ((0, 0),)
    shapes_scaled = True

    @property
    def poles(self) -> ComplexArray:
        """Poles of positive imaginary part, `i d`, shape (n,)."""
        return imaginary(self.d)

    @property
    def natural_frequencies(self) -> Array:
        """Natural frequencies, ascending, rad per unit time: `d`."""
        return np.asarray(self.d)

    @property
    def damping_ratios(self) -> Array:
        """Damping ratios, shape (n,): 0."""
        return np.zeros(self.order)

    @property
    def residues(self) -> ComplexArray:
        """Residues at `poles` of what was measured, shape (n, 1, 1)."""
        return (self._per_weight * self.r)[:, None, None]

    @property
    def feedthrough(self) -> Array:
        """Response at infinity of what was measured, shape (1, 1)."""
        return np.array([[float(self.modes.kappa.sum()) if self.quantity == "acceleration" else 0.0]])

    @property
    def shapes(self) -> ComplexArray:
        """Mode shapes of unit modal mass, shape (n, 1): the root of `kappa = r d`."""
        return np.sqrt(self.modes.kappa).astype(complex)[:, None]

    @property
    def participation(self) -> ComplexArray:
        """What the input makes of each mode, shape (n, 1): residues are `shape participation`."""
        weight = np.where(self.r > 0, np.sqrt(self.r), 0.0)
        return (self._per_weight * weight / np.sqrt(self.d))[:, None]

    @property
    def _per_weight(self) -> ComplexArray:
        """Residues of unit weights `r`: `(i d)^k / 2i`, exactly real or imaginary."""
        power = POWERS[self.quantity]
        return np.asarray((-0.5j, 0.5, 0.5j)[power] * self.d**power)

    @property
    def _residue_errors(self) -> ComplexArray:
        """Standard errors of real and imaginary parts of the residues."""
        n, power = self.order, POWERS[self.quantity]
        d, r, C, l = self.d, self.r, self.covariance, np.arange(self.order)
        by_d = power * r * d ** max(power - 1, 0)
        variance = by_d**2 * C[l, l] + d ** (2 * power) * C[n + l, n + l] + 2 * by_d * d**power * C[l, n + l]
        return np.asarray(0.5 * np.sqrt(np.maximum(variance, 0.0)) * (1 if power == 1 else 1j))

    @property
    def _shape_errors(self) -> ComplexArray:
        """Standard errors of the shapes, `sqrt(kappa)`."""
        kappa = self.modes.kappa
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(residue_errors(self) / (2 * np.sqrt(kappa)), complex)

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
    def rank_deficiency(self) -> int:
        """Number of parameter combinations that the data do not determine."""
        return self.identifiability.deficiency

    @property
    def observed_system(self) -> Any:
        """Linear system from the input to the quantity that was measured; `system` itself if that is the velocity."""
        return observed_system(self.system, self.quantity)

    # --- experiments -----------------------------------------------------------------------------------------------

    @property
    def initial_state(self) -> Array:
        """State of `system` at the first sample, shape (2n,), of a fit to one experiment."""
        return self._only("initial_state").initial_state

    @property
    def initial_states(self) -> tuple[Array, ...]:
        """State of `system` at the first sample of each record."""
        return tuple(one.initial_state for one in self.experiments)

    @property
    def offsets(self) -> Array:
        """Constant added to the output in each experiment; 0 where none was estimated."""
        return np.array([one.offset for one in self.experiments])

    # --- uncertainty -----------------------------------------------------------------------------------------------

    @property
    def _spare(self) -> int:
        """Real residuals less what was estimated."""
        parts = sum(int(one.record.observed.sum()) * (2 - isinstance(one.record, Record)) for one in self.experiments)
        estimated = sum(int(np.isfinite(part).sum()) for part in (np.diag(self.covariance), self.offset_stderr))
        return max(1, parts - estimated)

    def sample(self, k: int, rng: Any = None) -> ModeSamples:
        """Models drawn from the distribution of the estimate, for bands and for designs that must hold for all.

        Parameters
        ----------
        k : int
            Number of models.
        rng : numpy.random.Generator or int, optional
            Random numbers, or a seed of them; fresh ones by default.

        Returns
        -------
        ModeSamples
            Frequencies, weights and initial states of each, and the bands of their responses.

        Raises
        ------
        StructureError
            If `k` or `rng` is not of this form.

        Notes
        -----
        From the normal distribution with `covariance`, restricted to `r >= 0` and `d > 0`; what is held stays.
        O(n^3 + k n^2).

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> rng = np.random.default_rng(0)
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), rng.standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
        >>> y = y + 0.1 * rng.standard_normal(500)
        >>> models = phc.pem((u, y), 1, dt=0.1).sample(200, rng=1)
        >>> models.magnitude_band([0.5, 2.0]).shape
        (2, 2)
        """
        n = self.order
        states = np.concatenate([np.zeros(0), *[one.initial_state for one in self.experiments]])
        mean = np.concatenate([self.d, self.r, states])
        place = np.arange(len(mean))
        found = draw(mean, self.covariance, k, rng, nonnegative=(place >= n) & (place < 2 * n), positive=place < n)
        return ModeSamples(found[:, :n], found[:, n : 2 * n], found[:, 2 * n :])

    def sample_systems(self, k: int, rng: Any = None) -> list[PortHamiltonian]:
        """Systems of models drawn as by `sample`, for controllers that must do for all of them.

        Parameters
        ----------
        k : int
            Number of systems.
        rng : numpy.random.Generator or int, optional
            Random numbers, or a seed of them; fresh ones by default.

        Returns
        -------
        list of PortHamiltonian
            Each as `system` is.

        Raises
        ------
        StructureError
            If `k` or `rng` is not of this form.

        Notes
        -----
        As `sample`.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> rng = np.random.default_rng(0)
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0)), rng.standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
        >>> result = phc.pem((u, y + 0.1 * rng.standard_normal(500)), 1, dt=0.1)
        >>> loops = [phc.damping_injection(plant, 0.5) for plant in result.sample_systems(40, rng=1)]
        >>> np.percentile([loop.damping_ratios.min() for loop in loops], [2.5, 97.5]).round(2)
        array([0.25, 0.26])
        """
        names = inherited_names(self.system, {}, "inputs", "outputs")
        draws = self.sample(k, rng)
        return [with_unit(ph(modes(d, r), **names), self.time_unit) for d, r in zip(draws.d, draws.r, strict=True)]

    def _orders_about(self, most: int) -> Orders:
        """Poles and shapes of models of one mode more each, this result among them."""
        selection = order_selection(
            [one.record for one in self.experiments], most, method=self.method, intersample=self.intersample,
            initial_state="estimate" if any(one.free_amplitudes.any() for one in self.experiments) else "zero",
            offset=bool(np.isfinite(self.offset_stderr).any()), quantity=self.quantity,
            representation=self.representation,
        )  # fmt: skip
        found = {len(d): d for d in selection.frequencies if len(d)} | {self.order: self.d}
        return [(np.asarray(1j * found[n]), np.ones((n, 1), np.complex128)) for n in sorted(found)]

    # --- prediction ------------------------------------------------------------------------------------------------

    def _hold(self, dt: float) -> Hold:
        return Hold(dt, self.method, self.intersample)

    def _record_in_time(self, what: str) -> Record:
        record = self._only("record").record
        if not isinstance(record, Record):
            raise StructureError(f"this fit is to a frequency response, which has no {what}")
        return record

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
        record = self._record_in_time("end")
        return step_after(self.system, record, self.initial_state, self._hold(record.dt), next_input)

    def predict(
        self, data: Any, *, initial_state: ArrayLike | str | None = None, dt: float | None = None
    ) -> ct.TimeResponseData:
        """Output of the model on another record.

        Parameters
        ----------
        data : TimeResponseData, pair (u, y), or array of inputs (T,)
            Inputs, with the step of the record that was fitted; `(None, y)` is a free motion.
        initial_state : array_like, shape (2n,), float, or {'estimate', 'fitted', 'final', 'zero'}, optional
            State at the first sample; a number is every entry of it.  'estimate' fits it to the outputs of `data`,
            'fitted' takes the one of this result, 'final' goes on where the fitted record ended.  Default: 'estimate'
            if `data` has outputs, else 'fitted', or 'zero' after a fit to a frequency response.
        dt : float, optional
            Time between samples, for arrays; by default that of the record that was fitted.

        Returns
        -------
        control.TimeResponseData
            Predicted output, with the states of `system`.

        Raises
        ------
        StructureError
            If the data do not fit the model, or outputs are needed and absent.

        Notes
        -----
        The output is the quantity that was measured; an offset belongs to its record, and is estimated along with the
        state, kept from the fitted record, or 0.  O(T n).

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
        >>> rng = np.random.default_rng(0)
        >>> t, u = 0.1 * np.arange(400), rng.standard_normal(400)
        >>> y = phc.forced_response(plant, t, u, intersample="zoh").outputs
        >>> result = phc.pem((u[:300], y[:300]), order=2, dt=0.1)
        >>> ahead = result.predict(u[300:], initial_state="final")
        >>> bool(np.allclose(ahead.outputs, y[300:], atol=1e-9))
        True
        """
        if not isinstance(data, ct.TimeResponseData | Record) and not (isinstance(data, tuple) and len(data) == 2):
            data = (data, None)
        first = self.experiments[0].record
        fitted_dt = first.dt if isinstance(first, Record) else None
        record = as_record(data, fitted_dt if dt is None else dt, input_needed=False, output_needed=False)
        record = replace(record, time_unit=common_unit(record, self))
        hold = self._hold(record.dt)
        if initial_state is None:
            fallback = "fitted" if isinstance(first, Record) else "zero"
            initial_state = "estimate" if record.observed.any() else fallback
        if isinstance(initial_state, str):
            state, offset = self._named_state(record, initial_state, hold)
        else:
            state, offset = self._given_state(initial_state), 0.0
        return response_on(self.system, record, state, hold, self.quantity, offset)

    def _named_state(self, record: Record, name: str, hold: Hold) -> tuple[Array, float]:
        _checks.choice("initial_state", name, ("estimate", "fitted", "final", "zero"))
        if name == "zero":
            return np.zeros(2 * self.order), 0.0
        if name == "final":
            # a drift is not foretold: it stays where it was at the end
            one = self.experiments[0]
            return self._state_after(record.u[0]), one.offset + one.drift * one.record.samples * record.dt
        if name == "fitted":
            self._record_in_time("initial state")
            return self.initial_state, float(self.offsets[0])
        if not record.observed.any():
            raise StructureError(
                "the record has no outputs to estimate the initial state from; pass initial_state='zero', 'fitted', "
                "'final' or a state"
            )
        return estimated_state(self.system, record, hold, self.quantity, bool(np.isfinite(self.offset_stderr).any()))
