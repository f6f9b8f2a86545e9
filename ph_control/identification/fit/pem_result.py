"""The result of a fit: modes and real poles with their errors, what was tested, predictions, and a plain verdict."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import control as ct
import numpy as np

from ... import _checks
from ..._display import counted
from ..._frozen import ReadOnlyMapping
from ..._options import PREDICTED_STATES, Discretisation, Interpolation, PredictedState
from ..._types import Array, ArrayLike, ComplexArray, Indices, RandomSource, RealOrComplex, SystemNames
from ..._units import DERIVATIVES, common_unit, hertz_size, with_unit
from ...analysis.spectral_window import SpectralWindow
from ...exceptions import ConditioningWarning, NoSuchQuantityError, NotPassiveError, StructureError
from ...modal.discretization import Hold
from ...modal.general_form import from_vectors, real_matrices
from ...modal.modal_form import ModalForm, from_frequencies, imaginary
from ...reduction.nearest_passive import nearest_passive
from ...systems.port_hamiltonian import PortHamiltonian, ph
from ..change.monitored import Monitored
from ..data.channels import Channels, Recording, several
from ..data.experiments import as_channels, one_recording
from ..data.time_record import InTime
from ..data.windowed import windowed_response
from ..diagnosis.verdict import HypothesisTest, Outcome
from ..estimates.scaled_shapes import ModeShapes, Ports
from ..estimates.stabilisation import Orders
from ..growth.growing import orders_about
from ..innovations.ambient import orders_of
from ..parameters.fitted_parameters import FittedParameters
from ..regression.free import Lateness
from ..regression.prediction import (
    FittedChannels,
    FittedExperiment,
    ResponseBackground,
    estimated_motion,
    halved,
    moved_freely,
    output_gain,
    predicted_outputs,
    unknown_samples,
)
from ..search.channel_rows import RowOptions
from ..search.findings import Cause, Finding
from ..structure.coordinates import residue_of_unit_weight, weights_of
from ..structure.parametric import PARAMETRIC
from ..uncertainty.draws import draw
from ..uncertainty.modal_draws import ModalSamples
from ..uncertainty.noise_model import NoiseModel
from ..uncertainty.state_coordinates import InCoordinates
from .bootstrap import Resampled
from .prediction_ahead import Foretelling, ahead, ahead_of_growth, checked_horizon, grows
from .report import ModalReport
from .result import FittedModes, OrderRow

_MADE_AGAIN = ("system", "observed_system", "_noisy_plant", "_filter")
_NO_SIZE = 1e-9  # of the largest singular value of a residue: what a state of its own does not stand for


@dataclass(frozen=True, eq=False, repr=False)
class PEMResult(ModalReport, Resampled, InCoordinates, Foretelling, Monitored, FittedModes):
    """Result of `pem`: modes and real poles of m inputs and p outputs.

    Attributes
    ----------
    structure : {'lossless', 'classical', 'passive', 'free', 'parametric'}
        What the model assumes of losses and sensors; 'parametric' is a function of parameters that was given.
    poles : ndarray of complex, shape (N,)
        Those of positive imaginary part, by their natural frequencies, then the real ones, the slowest first.
    residues : ndarray of complex, shape (N, p, m)
        Of the outputs as measured, at these poles.
    feedthrough : ndarray, shape (p, m)
        Response at infinity.
    covariance : ndarray, shape (K, K)
        Of sizes `|p|` of the poles, damping ratios, real and imaginary parts of the residues and the feedthrough,
        matrices row by row, K = 2N + (2N + 1) p m; rows and columns of what was not estimated are NaN, those of what
        is real by nature 0.
    shapes : ndarray of complex, shape (n, p)
        Mode shapes in units of velocity: of unit modal mass where `shapes_scaled`, else with the largest entry 1.
    participation : ndarray of complex, shape (n, m)
        What the inputs make of each mode: residues are `shape participation^T`, of outputs of other quantities times
        powers of the pole.
    shape_stderr : ndarray of complex, shape (n, p)
        Standard errors of real and imaginary parts of the shapes.
    shapes_scaled : bool
        Whether a driving point sets the scale of all shapes.
    ports : tuple of (int, int)
        Output and input of each driving point.
    quantities : tuple of str
        What each output is: 'velocity', 'displacement', 'acceleration', or 'free' for any other.
    noise_variance : ndarray, shape (p,) or (p, m)
        Estimated variance of the noise of each output; of each entry of a frequency response, of real and imaginary
        parts at unit weight.
    experiments : tuple of FittedChannels, or of FittedExperiment
        What the fit says of each experiment: data, free motions, offsets, prediction and residuals; of one input and
        one output with the initial state, that of `system` if it is lossless, else of `observed_system`.
    background : ResponseBackground or None
        Of a frequency response: constant, slope, and what modes outside the band leave, with standard errors.
    loss : float
        Mean squared residual; of several outputs, or entries of a response, the geometric mean of theirs.
    loglik, aic, bic : float
        Gaussian log-likelihood and the criteria made of it.
    fit_percent : float
        `100 (1 - sqrt(mean |y - yhat|^2 / |y - mean(y)|^2))`, the mean over outputs.
    unknowns : int
        Number of estimated numbers, noise variances included.
    whiteness : float
        p-value of the Ljung-Box test on the residuals of all outputs.
    order_table : tuple of OrderRow
        Loss and criteria for each order tried.
    tests : tuple of HypothesisTest
        Structures against wider ones: hypothesis, likelihood ratio, degrees of freedom, p-value.
    findings : tuple of Finding
        What the data show beside the modes, and which assumptions they reject.
    success : bool
        Whether the refinement converged, uninterrupted.
    outcome : Outcome
        What the fit amounts to; `verdict` is its text.
    message : str
        What it rests on, in sentences.
    intersample, method : str
        Input between the samples, 'zoh' or 'foh', and the discretisation of the model.
    noise : NoiseModel or None
        Noise of the outputs at the samples: its covariance, colours, forces on the plant, and spectrum; None of
        frequency responses.
    blind : bool
        Whether the input does not show the residues: other residues, with other initial motions, give the same outputs.
    fitted_parameters : FittedParameters or None
        Of a fit of a model function: names, `values`, `covariance`, `stderr` and `correlations` of its parameters, and
        the number of `evaluations` of the function.
    parameters : ndarray, shape (P,)
        Their values.
    delay, delay_stderr : ndarray, shape (p,)
        Time by which each output comes later than the response to the inputs, 0 where none was found, and its standard
        error: 0 of a delay that was given, NaN of one that is known to a sample only.  Predictions have it, `system`
        not.
    input_delay : ndarray, shape (m,)
        Time by which each of several inputs acts later than it was recorded, whole samples and without a standard
        error; 0 where no dead time was found.  Beside `delay`, and as this in predictions only.
    system : PortHamiltonian or control.StateSpace
        The identified model.
    natural_frequencies, damping_ratios : ndarray, shape (n,)
        Of modes, `|p|`, ascending, rad per unit time, and `-Re p / |p|`; the former also as `d`.
    real_poles, time_constants : ndarray, shape (r,)
        Real poles, the slowest first, and `-1/p`; negative where one grows.
    states : int
        Number of all poles, `2 n + r`.
    r, kappa : ndarray, shape (n,)
        Weights of the paper and `kappa = r d`, of lossless and classical models of one input and one output.
    stderr : mapping
        Standard errors under the keys 'natural_frequencies', 'hertz', 'damping_ratios', 'real_poles',
        'time_constants', 'residues', 'shapes', 'feedthrough', 'delay', 'offset', 'd', and where they mean something
        'r', 'kappa', 'initial_state' and 'parameters'; those of complex numbers are complex, of real and imaginary
        part.  NaN for what was not estimated, and for a delay that is known to a sample only; infinite for what the
        input does not show.

    Examples
    --------
    See `pem`.
    """

    structure: str
    poles: ComplexArray
    residues: ComplexArray
    feedthrough: Array
    covariance: Array
    shapes: ComplexArray
    participation: ComplexArray
    shape_stderr: ComplexArray
    shapes_scaled: bool
    ports: tuple[tuple[int, int], ...]
    quantities: tuple[str, ...]
    noise_variance: Array
    experiments: tuple[FittedChannels, ...] | tuple[FittedExperiment, ...]
    loss: float
    loglik: float
    aic: float
    bic: float
    fit_percent: float
    unknowns: int
    whiteness: float
    order_table: tuple[OrderRow, ...]
    tests: tuple[HypothesisTest, ...]
    findings: tuple[Finding, ...]
    success: bool
    outcome: Outcome
    message: str
    intersample: Interpolation
    delay: Array = field(default_factory=lambda: np.zeros(1))
    delay_stderr: Array = field(default_factory=lambda: np.zeros(1))
    input_delay: Array = field(default_factory=lambda: np.zeros(1))
    method: Discretisation = "exact"
    blind: bool = False
    noise: NoiseModel | None = None
    fitted_parameters: FittedParameters | None = None
    stderr: Mapping[str, RealOrComplex] = field(init=False)

    def __post_init__(self) -> None:
        outputs, inputs = len(self.output_labels), len(self.input_labels)
        for name, count in (("delay", outputs), ("delay_stderr", outputs), ("input_delay", inputs)):
            value = np.array(np.broadcast_to(getattr(self, name), count), float)
            object.__setattr__(self, name, _checks.readonly(value))
        n, count, shape = self.order, len(self.poles), self.residues.shape
        deviation = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        real, imaginary = np.split(deviation[2 * count : 2 * (count + self.residues.size)], 2)
        rates = deviation[n:count]
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = rates / self.real_poles**2
        parts = {
            "natural_frequencies": deviation[:n],
            "hertz": deviation[:n] / hertz_size(self.time_unit),
            "damping_ratios": deviation[count : count + n],
            "real_poles": rates,
            "time_constants": relative,
            "residues": _complex(real, imaginary, shape),
            "shapes": self.shape_stderr,
            "feedthrough": deviation[2 * (count + self.residues.size) :].reshape(shape[1:]),
            "delay": self.delay_stderr,
            "offset": np.array([data.offset_stderr for data in self.experiments]),
            "d": deviation[:n],
        }
        if self.blind:
            unknown = np.isnan(parts["residues"])
            parts["residues"] = np.where(unknown, complex(np.inf, np.inf), parts["residues"])
        if self._has_weights:
            parts |= self._weight_errors()
        if self.fitted_parameters is not None:
            parts["parameters"] = self.fitted_parameters.stderr
        if self._moves_as_state:
            states = [data.initial_stderr for data in self.experiments if isinstance(data, FittedExperiment)]
            parts["initial_state"] = states[0] if len(states) == 1 else np.array(states)
        object.__setattr__(self, "stderr", ReadOnlyMapping(parts))
        record = self.experiments[0].record
        noise = self.noise
        if noise is None and isinstance(record, InTime) and not self.is_ambient:
            noise = NoiseModel(np.diag(self.noise_variance), record.dt)  # of a fit in an older file
        object.__setattr__(self, "noise", None if noise is None else self._with_plant(noise))
        super().__post_init__()

    def __getstate__(self) -> dict[str, object]:
        """What was estimated; systems are made again."""
        return {name: value for name, value in vars(self).items() if name not in _MADE_AGAIN}

    # --- channels --------------------------------------------------------------------------------------------------

    @property
    def quantity(self) -> str:
        """What the outputs are, joined by commas where they differ."""
        return ", ".join(dict.fromkeys(self.quantities))

    @property
    def is_ambient(self) -> bool:
        """Whether forces that nobody measured kept the plant in motion, as wind or traffic does."""
        return any(finding.cause is Cause.AMBIENT for finding in self.findings)

    @property
    def damping_ratios(self) -> Array:
        """Damping ratios `-Re p / |p|` of the modes, shape (n,); negative where one grows."""
        return 0.0 - self.poles[: self.order].real / self.natural_frequencies

    @property
    def d(self) -> Array:
        """Natural frequencies: `natural_frequencies`."""
        return self.natural_frequencies

    @property
    def parameters(self) -> Array:
        """Parameters of the model function, shape (P,)."""
        if self.fitted_parameters is None:
            raise NoSuchQuantityError(
                "this fit has modes and no physical parameters; pem(data, model=f, parameters=theta0) estimates those "
                "of a function f"
            )
        return self.fitted_parameters.values

    # --- weights of models of one input and one output -------------------------------------------------------------

    @property
    def _has_weights(self) -> bool:
        alone = self.residues.shape[1:] == (1, 1) and not len(self.real_poles)
        return alone and self.structure in ("lossless", "classical") and self.quantities != ("free",)

    @property
    def r(self) -> Array:
        """Weights `r = kappa / d` of the modes, shape (n,)."""
        if not self._has_weights:
            raise NoSuchQuantityError(
                f"weights r are those of lossless and classical modes of one input and one output; this fit is "
                f"{self.structure!r}, with {self.residues.shape[2]} inputs, {self.residues.shape[1]} outputs and "
                f"{counted(len(self.real_poles), 'real pole')}: see residues"
            )
        return weights_of(self.poles, self.residues[:, 0, 0], self.quantity)

    @property
    def kappa(self) -> Array:
        """Residues `kappa = r d` of the modes in the velocity of the port, shape (n,)."""
        return self.r * self.d

    def _weight_errors(self) -> dict[str, Array]:
        """Standard errors of `r` and `kappa`, by the derivatives of `r` by frequency, damping ratio and residue."""
        n, power = self.order, DERIVATIVES[self.quantity]
        zeta, d, r, l = self.damping_ratios, self.d, self.r, np.arange(n)
        turn = np.sqrt(1 - zeta**2)
        pole = -zeta + 1j * turn
        per_weight = residue_of_unit_weight(d, power, zeta)
        # of p = d (-zeta + i turn): the weight is the residue over d^k (pole)^k / (2 i turn)
        by_zeta = power * (-1 - 1j * zeta / turn) / pole + zeta / turn**2
        J = np.zeros((n, len(self.covariance)))
        J[l, l], J[l, n + l] = -power * r / d, -(r * by_zeta).real
        J[l, 2 * n + l], J[l, 3 * n + l] = (1 / per_weight).real, (1j / per_weight).real
        known = ~np.isnan(np.diag(self.covariance))
        inner = np.where(known[:, None] & known, self.covariance, 0.0)
        of_kappa = J * d[:, None]
        of_kappa[l, l] += r
        seen = known[2 * n + l] | known[3 * n + l]
        lost = np.inf if self.blind else np.nan
        return {
            name: np.where(seen, np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", T, inner, T), 0.0)), lost)
            for name, T in (("r", J), ("kappa", of_kappa))
        }

    # --- models ----------------------------------------------------------------------------------------------------

    @property
    def modes(self) -> ModalForm:
        """Modal form of what was measured, of residues of rank one; a free motion has no inputs and none."""
        if not self.input_labels:
            raise StructureError(
                "the fit of a free motion has no inputs, and so no modal form; its poles and shapes are the attributes "
                "of that name, and observed_system is a system with them"
            )
        if self.structure == "lossless" and self._has_weights:
            return from_frequencies(self.d, self.r)
        return from_vectors(self.poles, *self._factors)

    @property
    def _factors(self) -> tuple[ComplexArray, ComplexArray]:
        """Factors (N, p) and (N, m) of the rank-one matrices next to the residues."""
        U, s, V = _singular(self.poles, self.residues)
        return U[:, :, 0], s[:, :1] * V[:, 0]

    @cached_property
    def observed_system(self) -> ct.StateSpace:
        """Linear system from the inputs to what was measured, in real modal coordinates.

        Two states for each mode, and for each singular value of its residue that is not 0.
        """
        return self._state_space(self.residues, self.feedthrough, self.output_labels)

    def _state_space(self, residues: ComplexArray, through: Array, outputs: tuple[str, ...]) -> ct.StateSpace:
        n, p, m = residues.shape
        poles, shapes, participation = [], [np.zeros((0, p), complex)], [np.zeros((0, m), complex)]
        if min(p, m) == 1:
            # the states of one output are the contributions to it
            c, b = (np.ones((n, 1), complex), residues[:, 0]) if p == 1 else (residues[:, :, 0], np.ones((n, 1)) + 0j)
            poles, shapes, participation = list(self.poles), [c], [b]
        elif m:
            U, s, V = _singular(self.poles, residues)
            for l, rank in enumerate(np.sum(s > _NO_SIZE * s[:, :1], axis=1)):
                poles += [self.poles[l]] * int(rank)
                shapes.append(U[l, :, :rank].T)
                participation.append(s[l, :rank, None] * V[l, :rank])
        else:
            # an input that has no effect, as python-control needs one
            shapes, through = [self.shapes, np.ones((n - self.order, p), complex)], np.zeros((p, 1))
            poles, participation = list(self.poles), [np.zeros((n, 1), complex)]
        every = np.array(poles, complex)
        pairs = np.where(every.imag == 0, 1.0, 2.0)[:, None]
        A, B, C = real_matrices(every, pairs * np.concatenate(participation), np.concatenate(shapes).T)
        names = {"outputs": _checks.without_dots(outputs)}
        names |= {"inputs": _checks.without_dots(self.input_labels)} if m else {}
        return with_unit(ct.StateSpace(A, B, C, through, remove_useless_states=False, **names), self.time_unit)

    @cached_property
    def system(self) -> PortHamiltonian | ct.StateSpace:
        """The model: with ports and losses that are 0, classical or passive a `PortHamiltonian`, else a `StateSpace`.

        The port outputs are velocities; what was measured otherwise are sensors beside them.  Where that is not
        passive, or an input has no port, it is `observed_system`.
        """
        inputs = [i for _, i in self.ports]
        if self.structure == "lossless" and self._has_weights and inputs:
            known_as: SystemNames = {"inputs": _checks.without_dots(self.input_labels),
                                     "outputs": _checks.without_dots(self.output_labels)}  # fmt: skip
            return with_unit(PortHamiltonian._from_modes(self.modes, **known_as), self.time_unit)
        if (
            self.structure in ("free", PARAMETRIC)
            or sorted(inputs) != list(range(len(self.input_labels)))
            or not inputs
        ):
            return self.observed_system
        ports = sorted(self.ports, key=lambda port: port[1])
        velocities = [o for o, _ in ports]
        powers = np.array([DERIVATIVES[quantity] for quantity in self.quantities])
        with np.errstate(all="ignore"):
            turned = self.residues * (self.poles[:, None] ** (1.0 - powers))[:, :, None]
        if not np.all(np.isfinite(turned)):
            return self.observed_system  # an integrator of a displacement
        known = [o for o in velocities if self.quantities[o] in ("velocity", "free")]
        others = [o for o in range(len(self.output_labels)) if o not in known]
        labels = [self.output_labels[o] if o in known else f"velocity of {self.output_labels[o]}" for o in velocities]
        through = np.where(np.isin(velocities, known)[:, None], self.feedthrough[velocities], 0.0)
        residues = np.concatenate([turned[:, velocities], self.residues[:, others]], axis=1)
        names = (*labels, *(self.output_labels[o] for o in others))
        plant = self._state_space(residues, np.concatenate([through, self.feedthrough[others]]), names)
        try:
            return with_unit(ph(plant, ports=[(k, k) for k in range(len(inputs))]), self.time_unit)
        except (NotPassiveError, StructureError):
            return self.observed_system

    def with_delay(self, pade: int = 3) -> ct.StateSpace:
        """`observed_system` with the delays of outputs and inputs, by a rational approximation.

        Parameters
        ----------
        pade : int
            Order of the approximation of Pade, and number of states for each output or input with a delay.

        Returns
        -------
        control.StateSpace
            Linear system from the inputs to what was measured.

        Raises
        ------
        StructureError
            If an output comes earlier than the response to the inputs, which no system does.

        Notes
        -----
        The phase is right up to frequencies of about `pade / delay`.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> rng = np.random.default_rng(0)
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0, damping=0.02)), rng.standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
        >>> result = phc.pem((u[3:], y[:-3]), 1, dt=0.1, quantity="free")
        >>> result.delay.round(6), result.with_delay(2).nstates
        (array([0.3]), 4)
        """
        order = _checks.whole_number("pade", pade, 1)
        early = np.flatnonzero(self.delay < 0)
        if early.size:
            name = self.output_labels[int(early[0])]
            raise StructureError(
                f"{name!r} comes {-self.delay[early[0]]:.3g} before the response to the inputs, and a system has no "
                "negative delay: shift the inputs of the record, or use observed_system"
            )
        plant = self.observed_system
        delayed = ct.ss(_late(self.delay, order) * plant)
        if self.input_delay.any():
            delayed = ct.ss(delayed * _late(self.input_delay, order))
        A, B, C, D = delayed.A, delayed.B, delayed.C, delayed.D
        names = {"inputs": list(plant.input_labels), "outputs": list(plant.output_labels)}
        return with_unit(ct.StateSpace(A, B, C, D, remove_useless_states=False, **names), self.time_unit)

    # --- uncertainty -----------------------------------------------------------------------------------------------

    @property
    def _spare(self) -> int:
        """Real residuals less what was estimated."""
        parts = sum(
            int(experiment.record.observed.sum()) * (1 + np.iscomplexobj(experiment.predicted))
            for experiment in self.experiments
        )
        return max(1, parts - self.unknowns)

    def sample(self, k: int, rng: RandomSource = None) -> ModalSamples:
        """Models drawn from the distribution of the estimate, for bands and for designs that must hold for all.

        Parameters
        ----------
        k : int
            Number of models.
        rng : numpy.random.Generator or int, optional
            Random numbers, or a seed of them; fresh ones by default.

        Returns
        -------
        ModalSamples
            Poles, residues, feedthrough and shapes of each, and the bands of their responses.

        Raises
        ------
        StructureError
            If `k` or `rng` is not of this form.

        Notes
        -----
        From the normal distribution with `covariance`; what is held stays.  O(N^3 + k N^2) for N parameters.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> rng = np.random.default_rng(0)
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0, damping=0.02)), rng.standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
        >>> result = phc.pem((u, y + 0.1 * rng.standard_normal(500)), 1, dt=0.1, structure="free")
        >>> result.sample(200, rng=1).magnitude_band([0.5, 1.0]).shape
        (2, 2)
        """
        (n, p, m), size = self.residues.shape, self.residues.size
        d, rho = np.abs(self.poles), self.residues.ravel()
        zeta = -self.poles.real / np.where(d > 0, d, 1.0)
        mean = np.concatenate([d, zeta, rho.real, rho.imag, self.feedthrough.ravel()])
        weights = np.zeros(len(mean), bool)
        sign = np.ones(len(mean))
        if self.structure == "lossless" and self._has_weights:
            # weights stay positive: of a displacement that is the sign of minus the imaginary part
            power = DERIVATIVES[self.quantity]
            weights[(2 + (power != 1)) * n :][:n] = True
            sign[weights] = -1.0 if power == 0 else 1.0
        draws = sign * draw(
            sign * mean, self.covariance * np.outer(sign, sign), k, rng, positive=np.arange(len(mean)) < n,
            nonnegative=weights,
        )  # fmt: skip
        d, zeta = draws[:, :n], draws[:, n : 2 * n]
        poles = d * (-zeta + 1j * np.sqrt(np.maximum(1 - zeta**2, 0.0)))
        residues = (draws[:, 2 * n :][:, :size] + 1j * draws[:, 2 * n + size :][:, :size]).reshape(len(draws), n, p, m)
        shapes = np.broadcast_to(self.shapes, (len(draws), self.order, p))
        if m:
            modes, of_modes = (part[:, : self.order] for part in (poles, residues))
            shaped = ModeShapes.of(modes.ravel(), of_modes.reshape(-1, p, m), self.quantities, self._scaling)
            shapes = shaped.shapes.reshape(len(draws), self.order, p)
        through = draws[:, 2 * n + 2 * size :].reshape(len(draws), p, m)
        return ModalSamples(poles, residues, through, shapes, self.background, self.delay, self.input_delay)

    def sample_systems(self, k: int, rng: RandomSource = None) -> list[PortHamiltonian | ct.StateSpace]:
        """Systems of models drawn as by `sample`, for controllers that must do for all of them.

        Parameters
        ----------
        k : int
            Number of systems.
        rng : numpy.random.Generator or int, optional
            Random numbers, or a seed of them; fresh ones by default.

        Returns
        -------
        list of PortHamiltonian, or of control.StateSpace
            Each as `system` is.  With driving points for all inputs, and a structure other than 'free', each is
            passive: where rounding or the curvature of the set of such models makes a draw active, the passive model
            next to it in the H2 norm takes its place.

        Raises
        ------
        StructureError
            If `k` or `rng` is not of this form, or a draw has no passive model next to it.

        Notes
        -----
        A free fit draws active models wherever the data allow them; `nearest_passive` of the fit, or
        ``structure="passive"``, brings in what is known.  About 0.1 s a system of
        a few modes, where that is needed.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> rng = np.random.default_rng(0)
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0, damping=0.02)), rng.standard_normal(500)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(500), u, intersample="zoh").outputs
        >>> y = y + 0.1 * rng.standard_normal(500)
        >>> result = phc.pem((u, y), 1, dt=0.1, structure="classical", ports=[(0, 0)])
        >>> loops = [phc.damping_injection(plant, 0.5) for plant in result.sample_systems(40, rng=1)]
        >>> np.percentile([loop.damping_ratios.min() for loop in loops], [2.5, 97.5]).round(2)
        array([0.27, 0.28])
        """
        draws = self.sample(k, rng)
        ported = sorted(i for _, i in self.ports) == list(range(len(self.input_labels))) and len(self.ports) > 0
        systems = []
        with warnings.catch_warnings():
            # draws that touch the bound lose digits, far beyond those of an estimate
            warnings.simplefilter("ignore", ConditioningWarning)
            for poles, residues, through in zip(draws.poles, draws.residues, draws.feedthrough, strict=True):
                drawn = replace(self, poles=poles, residues=residues, feedthrough=through)
                active = (
                    self.structure not in ("free", PARAMETRIC)
                    and ported
                    and not isinstance(drawn.system, PortHamiltonian)
                )
                systems.append(nearest_passive(drawn, weight="h2") if active else drawn.system)
        return systems

    @property
    def _scaling(self) -> Ports:
        """Driving points that set the scale of the shapes."""
        return self.ports if self.shapes_scaled else ()

    def _orders_about(self, most: int) -> Orders:
        """Poles and shapes of models of one mode more each, this result among them; of lossless modes without decay."""
        records: Any = self._channels
        if self.is_ambient:
            rows = [(poles, shapes[:, :, None]) for poles, shapes in orders_of(records, most)]
        else:
            constants = int(self.offsets.any())
            form = RowOptions(self.quantities, self.intersample, constants, self._moving, self.method, self._lateness)
            rows = orders_about(records, self.poles, most, form)
        return [
            (self.poles[: self.order], self.shapes) if len(poles) == self.order
            else (
                imaginary(poles.imag) if self.structure == "lossless" else poles,
                ModeShapes.of(poles, residues, self.quantities, ()).shapes,
            )
            for poles, residues in rows
        ]  # fmt: skip

    # --- prediction ------------------------------------------------------------------------------------------------

    @property
    def _lateness(self) -> Lateness:
        """Delays of outputs and inputs."""
        return Lateness(self.delay, self.input_delay)

    @property
    def _latest(self) -> Array:
        """Time (p,) by which each output comes later than the latest of its inputs."""
        return self.delay + self.input_delay.max(initial=0.0)

    def _forced(self, record: Recording, lasting: bool = True) -> Array:
        """Outputs (p, T) from a state of zero, beside inputs that had their first values before a record, or were 0."""
        hold = Hold(record.dt, self.method, self.intersample)
        return predicted_outputs(
            self.poles, self.residues, self.feedthrough, record.u, hold, self.delay, self.input_delay, lasting=lasting
        )

    @property
    def _channels(self) -> Channels:
        """Experiments as they were fitted, but for the units of their noise, and for hum."""
        channels: Any = as_channels([experiment.record for experiment in self.experiments])
        return tuple(
            channel.adjusted(steady=channel.first_inputs[0]) if resting else channel
            for channel, resting in zip(channels, self._resting, strict=True)
        )

    @property
    def _resting(self) -> list[bool]:
        """Whether each experiment begins at rest, held by its inputs."""
        return [bool(getattr(experiment, "resting", False)) for experiment in self.experiments]

    @property
    def _moving(self) -> bool:
        """Whether records with inputs may start in motion, as others do."""
        return any(
            not resting and bool(np.any(getattr(data.record, "u", 0)) and np.any(getattr(data, "free_amplitudes", 0)))
            for data, resting in zip(self.experiments, self._resting, strict=True)
        )

    @property
    def _moves_as_state(self) -> bool:
        return all(isinstance(data, FittedExperiment) and data.initial_state.size for data in self.experiments)

    @property
    def initial_state(self) -> Array:
        """State at the first sample, of a fit to one experiment of one input and one output.

        Of `system` if it is lossless, else of `observed_system`.
        """
        data = self._only("initial_state")
        if not isinstance(data, FittedExperiment):
            raise NoSuchQuantityError("outputs of several channels move freely each for itself: free_amplitudes has it")
        return data.initial_state

    @property
    def initial_states(self) -> tuple[Array, ...]:
        """The same of each experiment."""
        states = [data.initial_state for data in self.experiments if isinstance(data, FittedExperiment)]
        if len(states) < len(self.experiments):
            raise NoSuchQuantityError("outputs of several channels move freely each for itself: free_amplitudes has it")
        return tuple(states)

    @property
    def offsets(self) -> Array:
        """Constant added to each output in each experiment, shape (E, p); (E,) of one input and output."""
        return np.array(
            [getattr(experiment, "offsets", getattr(experiment, "offset", 0.0)) for experiment in self.experiments]
        )

    @property
    def background(self) -> ResponseBackground | None:
        """What the response of the first experiment has beside modes and feedthrough; None without such terms.

        Several experiments have a background each, `experiments[k].background`.
        """
        return self.experiments[0].background

    @property
    def window(self) -> SpectralWindow | None:
        """Window with which the response of the first experiment was estimated; None of other data."""
        return getattr(self.experiments[0].record, "window", None)

    def estimated_response(self, omega: ArrayLike) -> ComplexArray:
        """Mean of the response that is estimated with the window of the data, for a white input.

        Without background and delay, as `observed_system` is without a window.

        Parameters
        ----------
        omega : array_like, shape (K,)
            Frequencies, rad per unit time.

        Returns
        -------
        ndarray of complex, shape (p, m, K)

        Raises
        ------
        StructureError
            If the data were not estimated with a window.

        Examples
        --------
        >>> import control as ct, numpy as np, ph_control as phc
        >>> plant, u = phc.modes(1.0, 1.0, damping=0.01), np.random.default_rng(0).standard_normal(8192)
        >>> y = phc.forced_response(phc.ph(plant), 0.5 * np.arange(8192), u, intersample="zoh")
        >>> result = phc.pem(phc.spectral_estimate(y, segments=31), 1, structure="classical")
        >>> broad, narrow = result.estimated_response([1.0]), result.observed_system(1j)
        >>> bool(abs(broad[0, 0, 0]) < 0.6 * abs(narrow))
        True
        """
        if self.window is None:
            raise StructureError(
                "this result was not fitted to responses that were estimated with a window; its response is "
                "result.observed_system(1j * omega)"
            )
        halves = halved(self.poles, self.residues)
        frequencies = _checks.real_array("omega", omega, 1)
        return windowed_response(self.window, frequencies, self.poles, halves, self.feedthrough)

    def predict(
        self, data: object, *, initial_state: ArrayLike | PredictedState | None = None, dt: float | None = None,
        horizon: int | None = None,
    ) -> ct.TimeResponseData:  # fmt: skip
        """Outputs of the model on another record, simulated or predicted some steps ahead.

        Parameters
        ----------
        data : TimeResponseData, pair (u, y), or array of inputs, shape (T,) or (m, T)
            Inputs, with the outputs that the free motion is estimated from; `(None, y)` is a free motion.
        initial_state : {'estimate', 'fitted', 'final', 'zero'}, or array_like, shape (2n + r,), or float, optional
            Motion at the first sample: 'estimate' fits it to the outputs of `data`, 'fitted' takes that of this result,
            'final' goes on where the fitted record ended.  Of one input and output also a state, as `initial_state`; a
            number is every entry of it.  Default: 'estimate' if `data` has outputs, else 'fitted', or 'zero' after
            a fit to a frequency response or several experiments.
        dt : float, optional
            Time between samples, for arrays; by default that of the record that was fitted.
        horizon : int, optional
            Predict each output from the inputs and outputs up to so many samples before, by the `noise` of the fit;
            None, or infinity, simulates it from inputs and motion alone.

        Returns
        -------
        control.TimeResponseData
            Predicted outputs.

        Raises
        ------
        StructureError
            If the data do not fit the model, or outputs are needed and absent.

        Notes
        -----
        A constant is estimated along with the motion if one was in the fit.  Outputs have their `delay`, and inputs
        their `input_delay`; what an output that comes late is before all inputs of the record reach it is a guess, from
        what it is then.  O(T n (m + p)).

        With a horizon the noise is what the steady filter of `predictor` makes of the past, which is 0 before the
        record; a sample that is missing tells nothing.  Motion and constant are still those of the simulation, fitted
        to the whole record, but of plants with a pole that grows, whose simulation leaves the outputs behind: there
        they are those that leave the filter the least to be told.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> plant, u = phc.ph(phc.modes(1.0, 1.0, damping=0.02)), np.random.default_rng(0).standard_normal(800)
        >>> y = phc.forced_response(plant, 0.1 * np.arange(800), u, intersample="zoh").outputs
        >>> result = phc.pem((u[:500], y[:500]), 1, dt=0.1, structure="free")
        >>> again = result.predict((u[500:], y[500:]))
        >>> bool(np.allclose(again.outputs, y[500:], atol=1e-6))
        True
        """
        fitted = self.experiments[0].record
        p, m = len(self.output_labels), len(self.input_labels)
        if not isinstance(data, ct.TimeResponseData | Recording) and not (isinstance(data, tuple) and len(data) == 2):
            data = (data, None)
        step = getattr(fitted, "dt", None) if dt is None else dt
        record = one_recording(data, step, p)
        if (len(record.u), len(record.y)) != (m, p):
            raise StructureError(
                f"the record has {len(record.u)} inputs and {len(record.y)} outputs; this model has {m} and {p}"
            )
        record = replace(
            record, input_labels=self.input_labels, output_labels=self.output_labels,
            time_unit=common_unit(record, self),
        )  # fmt: skip
        steps = checked_horizon(horizon)
        outputs = self._outputs_on(record, initial_state) if steps is None else (
            self._predicted_on(record, initial_state, steps)
        )  # fmt: skip
        prediction = ct.TimeResponseData(
            record.time, outputs, inputs=record.u if m else None, issiso=p == m == 1, output_labels=self.output_labels,
            input_labels=list(self.input_labels) if m else None, title=record.title or "Prediction",
        )  # fmt: skip
        return with_unit(prediction, self.time_unit)

    def _outputs_on(self, record: Recording, initial_state: ArrayLike | str | None) -> Array:
        """Outputs on a record, from a motion of some name."""
        seen = bool(record.observed.any())
        if initial_state is not None and not isinstance(initial_state, str):
            first = unknown_samples(self._latest, record.dt, record.u)
            return self._outputs_from(self._motion_of(initial_state), record, first)
        alone = len(self.experiments) == 1 and not np.iscomplexobj(self.experiments[0].predicted)
        name = initial_state or ("estimate" if seen else "fitted" if alone else "zero")
        _checks.choice("initial_state", name, PREDICTED_STATES)
        hold = Hold(record.dt, self.method, self.intersample)
        if name in ("fitted", "final"):
            if len(self.experiments) > 1:
                raise StructureError(
                    f"this result was fitted to {len(self.experiments)} experiments, each with a motion of its own; "
                    "use 'estimate' or 'zero'"
                )
            data: Any = self.experiments[0]
            if np.iscomplexobj(data.predicted):
                raise StructureError(
                    "this fit is to a frequency response, which has no motion; use 'estimate' or 'zero'"
                )
            return self._going_on(data, record) if name == "final" else self._beginning_as(data, record)
        forced = self._forced(record, name != "zero")
        if name == "zero":
            return forced
        if not seen:
            raise StructureError(
                "the record has no outputs to estimate the motion from; pass initial_state='zero', 'fitted', 'final' "
                "or a state"
            )
        return forced + estimated_motion(self.poles, record, forced, hold, bool(self.offsets.any()), self._latest)

    def _predicted_on(self, record: Recording, initial_state: ArrayLike | str | None, horizon: int) -> Array:
        """Outputs some steps ahead."""
        if not record.observed.any():
            raise StructureError(
                "the record has no outputs to predict others from; pass the pair (u, y), or leave out the horizon"
            )
        named = initial_state is None or isinstance(initial_state, str)
        if named and initial_state in (None, "estimate", "zero") and grows(self):
            return ahead_of_growth(self, record.u, record.y, record.dt, horizon, initial_state != "zero")
        return ahead(self, self._outputs_on(record, initial_state), record.y, record.dt, horizon)

    def _beginning_as(self, data: Any, record: Recording) -> Array:
        """Outputs from the motion, and with the offset and drift, of an experiment of the fit."""
        level, slope = (data.offsets, data.drifts) if isinstance(data, FittedChannels) else (data.offset, data.drift)
        background = np.reshape(level, (-1, 1)) + np.outer(slope, record.dt * np.arange(record.samples))
        return self._outputs_from(data.free_amplitudes, record, _unpredicted(data)) + background

    def _going_on(self, data: Any, record: Recording) -> Array:
        """Outputs where a record begins at the end of an experiment of the fit; a drift stays where it was."""
        fitted: Any = several(data.record)
        u = fitted.u if len(fitted.u) else np.zeros((len(record.u), fitted.samples))
        both = replace(record, u=np.concatenate([u, record.u], axis=1), y=np.concatenate([fitted.y, record.y], axis=1),
                       time=record.dt * np.arange(float(fitted.samples + record.samples)))  # fmt: skip
        level, slope = (data.offsets, data.drifts) if isinstance(data, FittedChannels) else (data.offset, data.drift)
        background = np.reshape(level, (-1, 1)) + np.reshape(slope, (-1, 1)) * record.dt * fitted.samples
        return self._outputs_from(data.free_amplitudes, both, _unpredicted(data))[:, fitted.samples :] + background

    def _motion_of(self, state: Any) -> ComplexArray:
        """Motions (n + r,) of a state."""
        if self.residues.shape[1] != 1 or self.residues.shape[2] > 1:
            raise StructureError("initial_state is a state; of several channels it is 'estimate', 'fitted' or 'zero'")
        every, n = self._given_state(state), self.order
        if self.structure == "lossless" and self._has_weights:
            gain = output_gain(self.modes, self.quantity)
            return np.asarray((gain * (every[:n] + 1j * every[n:])).conj())
        return np.concatenate([every[: 2 * n : 2] + 1j * every[1 : 2 * n : 2], every[2 * n :]])

    def _outputs_from(self, motion: ComplexArray, record: Recording, first: Indices) -> Array:
        """Outputs from free motions (n + r,) or (n + r, p), which those before a `first` sample (p,) do not tell."""
        hold, outputs = Hold(record.dt, self.method, self.intersample), len(self.output_labels)
        forced = self._forced(record)
        motion = motion.reshape(len(self.poles), -1) if motion.size else np.zeros((len(self.poles), 1), complex)
        motion = np.broadcast_to(motion, (len(self.poles), outputs))
        return forced + moved_freely(self.poles, motion, hold, record.samples, first)


def _unpredicted(data: FittedExperiment | FittedChannels) -> Indices:
    """Number of first samples (p,) of each output that are not predicted."""
    unknown = np.isnan(np.atleast_2d(data.predicted))
    return np.where(unknown.all(axis=1), 0, np.argmin(unknown, axis=1))


def _late(delay: Array, order: int) -> ct.StateSpace:
    """Delays of several signals by approximations of Pade."""
    parts = (ct.ss(ct.tf(*ct.pade(late, order))) if late else ct.ss([], [], [], [[1.0]]) for late in delay.tolist())
    return ct.append(*parts)


def _singular(poles: ComplexArray, residues: ComplexArray) -> tuple[ComplexArray, Array, ComplexArray]:
    """Singular values and vectors of residues (N, p, m), real ones of those of real poles."""
    U, s, V = np.linalg.svd(residues, full_matrices=False)
    real = poles.imag == 0
    if real.any():
        U[real], s[real], V[real] = np.linalg.svd(residues[real].real, full_matrices=False)
    return U, s, V


def _complex(real: Array, imaginary: Array, shape: tuple[int, ...]) -> ComplexArray:
    values = np.empty(len(real), complex)
    values.real, values.imag = real, imaginary
    return values.reshape(shape)
