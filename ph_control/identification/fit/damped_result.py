"""The result of a fit of damped modes, of any number of inputs and outputs."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import control as ct
import numpy as np

from ... import _checks
from ..._display import Report, counted, percent
from ..._frozen import Frozen, ReadOnlyMapping
from ..._types import Array, ArrayLike, ComplexArray, Mask, NDArray
from ..._units import common_unit, hertz_size, with_unit
from ...exceptions import ConditioningWarning, NotPassiveError, StructureError
from ...modal.discretization import Hold
from ...modal.general_form import from_vectors, real_matrices
from ...reduction.nearest_passive import nearest_passive
from ...systems.port_hamiltonian import PortHamiltonian, ph
from ..data.channels import Recording, ResponseMatrix
from ..data.experiments import as_channels
from ..diagnosis.verdict import HypothesisTest, Outcome
from ..regression.free_prediction import (
    FittedChannels,
    estimated_motion,
    moved_freely,
    predicted_outputs,
    unknown_samples,
)
from ..regression.prediction import FittedExperiment, ResponseBackground
from ..search.circumstances import Finding
from ..search.modal_search import orders_about
from ..structure.layout import POWERS
from ..uncertainty.draws import draw
from ..uncertainty.modal_draws import ModalSamples
from .report import DampedReport, damped_lines
from .result import OrderRow, PEMResult
from .scaled_shapes import ModeShapes, Ports
from .stabilisation import Orders

_NO_SIZE = 1e-9  # of the largest singular value of a residue: what a state of its own does not stand for


@dataclass(frozen=True, eq=False, repr=False)
class DampedResult(DampedReport, PEMResult):
    """Result of `pem`: damped modes and real poles of m inputs and p outputs.

    Attributes
    ----------
    structure : {'lossless', 'classical', 'passive', 'free'}
        What the model assumes of losses and sensors.
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
    shapes, participation : ndarray of complex, shapes (n, p) and (n, m)
        As of every `PEMResult`.
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
        one output as in a lossless fit, `initial_state` that of `observed_system`.
    background : ResponseBackground or None
        Of a frequency response: constant, slope, and what modes outside the band leave, with standard errors.
    loss : float
        Mean squared residual in units of the noise of each output.
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
    intersample : str
        Input between the samples: 'zoh' or 'foh'.
    delay, delay_stderr : ndarray, shape (p,)
        Time by which each output comes later than the response to the inputs, 0 where none was found, and its standard
        error: 0 of a delay that was given, NaN of one that is known to a sample only.  Predictions have it, `system`
        not.
    stderr : mapping
        Standard errors under the keys 'natural_frequencies', 'hertz', 'damping_ratios', 'real_poles',
        'time_constants', 'residues', 'shapes', 'feedthrough' and 'delay'; those of complex numbers are complex, of
        real and imaginary part.
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
    intersample: str
    delay: Array = field(default_factory=lambda: np.zeros(1))
    delay_stderr: Array = field(default_factory=lambda: np.zeros(1))
    stderr: Mapping[str, Any] = field(init=False)

    def __post_init__(self) -> None:
        for name in ("delay", "delay_stderr"):
            value = np.array(np.broadcast_to(getattr(self, name), len(self.output_labels)), float)
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
        }
        object.__setattr__(self, "stderr", ReadOnlyMapping(parts))
        super().__post_init__()

    def __getstate__(self) -> dict[str, Any]:
        """What was estimated; systems are made again."""
        return {name: value for name, value in vars(self).items() if name not in ("system", "observed_system")}

    # --- channels --------------------------------------------------------------------------------------------------

    @property
    def quantity(self) -> str:
        """What the outputs are, joined by commas where they differ."""
        return ", ".join(dict.fromkeys(self.quantities))

    @property
    def damping_ratios(self) -> Array:
        """Damping ratios `-Re p / |p|` of the modes, shape (n,); negative where one grows."""
        return 0.0 - self.poles[: self.order].real / self.natural_frequencies

    @property
    def d(self) -> Array:
        """Natural frequencies: `natural_frequencies`."""
        return self.natural_frequencies

    @property
    def damped(self) -> DampedResult:
        """The damped model, which a lossless fit has beside it: this one."""
        return self

    # --- models ----------------------------------------------------------------------------------------------------

    @property
    def modes(self) -> Any:
        """Modal form of what was measured, of residues of rank one; a free motion has no inputs and none."""
        if not self.input_labels:
            raise StructureError(
                "the fit of a free motion has no inputs, and so no modal form; its poles and shapes are the attributes "
                "of that name, and observed_system is a system with them"
            )
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
    def system(self) -> Any:
        """The model: with ports and losses that are 0, classical or passive a `PortHamiltonian`, else a `StateSpace`.

        The port outputs are velocities; what was measured otherwise are sensors beside them.  Where that is not
        passive, or an input has no port, it is `observed_system`.
        """
        inputs = [i for _, i in self.ports]
        if self.structure == "free" or sorted(inputs) != list(range(len(self.input_labels))) or not inputs:
            return self.observed_system
        ports = sorted(self.ports, key=lambda port: port[1])
        velocities = [o for o, _ in ports]
        powers = np.array([POWERS[one] for one in self.quantities])
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
        """`observed_system` with the delay of each output, by a rational approximation.

        Parameters
        ----------
        pade : int
            Order of the approximation of Pade, and number of states for each output with a delay.

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
        parts = [
            ct.ss(ct.tf(*ct.pade(late, order))) if late else ct.ss([], [], [], [[1.0]]) for late in self.delay.tolist()
        ]
        plant = self.observed_system
        found = ct.ss(ct.append(*parts) * plant)
        A, B, C, D = found.A, found.B, found.C, found.D
        names = {"inputs": list(plant.input_labels), "outputs": list(plant.output_labels)}
        return with_unit(ct.StateSpace(A, B, C, D, remove_useless_states=False, **names), self.time_unit)

    # --- uncertainty -----------------------------------------------------------------------------------------------

    @property
    def _spare(self) -> int:
        """Real residuals less what was estimated."""
        parts = sum(int(one.record.observed.sum()) * (1 + np.iscomplexobj(one.predicted)) for one in self.experiments)
        return max(1, parts - self.unknowns)

    def sample(self, k: int, rng: Any = None) -> ModalSamples:
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
        found = draw(mean, self.covariance, k, rng, positive=np.arange(len(mean)) < n)
        d, zeta = found[:, :n], found[:, n : 2 * n]
        poles = d * (-zeta + 1j * np.sqrt(np.maximum(1 - zeta**2, 0.0)))
        residues = (found[:, 2 * n :][:, :size] + 1j * found[:, 2 * n + size :][:, :size]).reshape(len(found), n, p, m)
        shapes = np.broadcast_to(self.shapes, (len(found), self.order, p))
        if m:
            modes, of_modes = (part[:, : self.order] for part in (poles, residues))
            shaped = ModeShapes.of(modes.ravel(), of_modes.reshape(-1, p, m), self.quantities, self._scaling)
            shapes = shaped.shapes.reshape(len(found), self.order, p)
        through = found[:, 2 * n + 2 * size :].reshape(len(found), p, m)
        return ModalSamples(poles, residues, through, shapes, self.background, self.delay)

    def sample_systems(self, k: int, rng: Any = None) -> list[Any]:
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
                active = self.structure != "free" and ported and not isinstance(drawn.system, PortHamiltonian)
                systems.append(nearest_passive(drawn, weight="h2") if active else drawn.system)
        return systems

    @property
    def _scaling(self) -> Ports:
        """Driving points that set the scale of the shapes."""
        return self.ports if self.shapes_scaled else ()

    def _orders_about(self, most: int) -> Orders:
        """Poles and shapes of models of one mode more each, this result among them."""
        records: Any = as_channels([one.record for one in self.experiments])
        moving = any(bool(np.any(one.free_amplitudes)) for one in self.experiments)
        rows = orders_about(
            records, self.poles, most, quantities=self.quantities, intersample=self.intersample,
            offset=bool(self.offsets.any()), moving=moving, delay=self.delay,
        )  # fmt: skip
        return [
            (self.poles[: self.order], self.shapes) if len(poles) == self.order
            else (poles, ModeShapes.of(poles, residues, self.quantities, ()).shapes)
            for poles, residues in rows
        ]  # fmt: skip

    # --- prediction ------------------------------------------------------------------------------------------------

    @property
    def initial_state(self) -> Array:
        """State of `observed_system` at the first sample, of a fit to one experiment of one input and one output."""
        one = self._only("initial_state")
        if not isinstance(one, FittedExperiment):
            raise StructureError("outputs of several channels move freely each for itself: free_amplitudes has it")
        return one.initial_state

    @property
    def offsets(self) -> Array:
        """Constant added to each output in each experiment, shape (E, p); (E,) of one input and output."""
        return np.array([getattr(one, "offsets", getattr(one, "offset", 0.0)) for one in self.experiments])

    @property
    def background(self) -> ResponseBackground | None:
        """What the response of the first experiment has beside modes and feedthrough; None without such terms.

        Several experiments have a background each, `experiments[k].background`.
        """
        return self.experiments[0].background

    def predict(
        self, data: Any, *, initial_state: ArrayLike | str | None = None, dt: float | None = None
    ) -> ct.TimeResponseData:
        """Outputs of the model on another record.

        Parameters
        ----------
        data : TimeResponseData, pair (u, y), or array of inputs, shape (T,) or (m, T)
            Inputs, with the outputs that the free motion is estimated from; `(None, y)` is a free motion.
        initial_state : {'estimate', 'fitted', 'zero'}, or array_like, shape (2n,), or float, optional
            Motion at the first sample: 'estimate' fits it to the outputs of `data`, 'fitted' takes that of this result.
            Of one input and output also the state of `observed_system`; a number is every entry of it.  Default:
            'estimate' if `data` has outputs, else 'zero'.
        dt : float, optional
            Time between samples, for arrays; by default that of the record that was fitted.

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
        A constant is estimated along with the motion if one was in the fit.  Outputs have their `delay`; what an output
        that comes late is before inputs of the record reach it is a guess, from what it is then.  O(T n (m + p)).

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
        record = _recording(data, step, p)
        if (len(record.u), len(record.y)) != (m, p):
            raise StructureError(
                f"the record has {len(record.u)} inputs and {len(record.y)} outputs; this model has {m} and {p}"
            )
        record = replace(
            record, input_labels=self.input_labels, output_labels=self.output_labels,
            time_unit=common_unit(record, self),
        )  # fmt: skip
        outputs = self._outputs_on(record, initial_state)
        found = ct.TimeResponseData(
            record.time, outputs, inputs=record.u if m else None, issiso=p == m == 1, output_labels=self.output_labels,
            input_labels=list(self.input_labels) if m else None, title=record.title or "Prediction",
        )  # fmt: skip
        return with_unit(found, self.time_unit)

    def _outputs_on(self, record: Recording, initial_state: ArrayLike | str | None) -> Array:
        """Outputs on a record, from a motion of some name."""
        seen = bool(record.observed.any())
        if initial_state is not None and not isinstance(initial_state, str):
            return self._outputs_from(self._motion_of(initial_state), record)
        name = initial_state or ("estimate" if seen else "zero")
        _checks.choice("initial_state", name, ("estimate", "fitted", "zero"))
        hold = Hold(record.dt, "exact", self.intersample)
        forced = predicted_outputs(self.poles, self.residues, self.feedthrough, record.u, hold, self.delay)
        if name == "zero":
            return forced
        if name == "fitted":
            one = self._only("free_amplitudes")
            if np.iscomplexobj(one.predicted):
                raise StructureError(
                    "this fit is to a frequency response, which has no motion; use 'estimate' or 'zero'"
                )
            level, slope = (one.offsets, one.drifts) if isinstance(one, FittedChannels) else (one.offset, one.drift)
            background = np.reshape(level, (-1, 1)) + np.outer(slope, record.dt * np.arange(record.samples))
            return self._outputs_from(one.free_amplitudes, record) + background
        if not seen:
            raise StructureError("the record has no outputs to estimate the motion from; pass initial_state='zero'")
        return forced + estimated_motion(self.poles, record, forced, hold, bool(self.offsets.any()), self.delay)

    def _motion_of(self, state: Any) -> ComplexArray:
        """Motions (n,) of a state of `observed_system`."""
        if self.residues.shape[1:] != (1, 1):
            raise StructureError("initial_state is a state; of several channels it is 'estimate', 'fitted' or 'zero'")
        every, n = self._given_state(state), self.order
        return np.concatenate([every[: 2 * n : 2] + 1j * every[1 : 2 * n : 2], every[2 * n :]])

    def _outputs_from(self, motion: ComplexArray, record: Recording) -> Array:
        """Outputs from free motions (n,) or (n, p)."""
        hold, outputs = Hold(record.dt, "exact", self.intersample), len(self.output_labels)
        forced = predicted_outputs(self.poles, self.residues, self.feedthrough, record.u, hold, self.delay)
        motion = np.broadcast_to(motion.reshape(len(self.poles), -1), (len(self.poles), outputs))
        first = unknown_samples(self.delay, record.dt)
        return np.asarray(forced + moved_freely(self.poles, motion, record.dt, record.samples, first))


@dataclass(frozen=True, eq=False, repr=False)
class DampedModel(Report, Frozen):
    """Modes with damping and residues of any phase, fitted to the same data as the lossless model beside it.

    Arrays of modes leave out real poles, which `result` has.

    `G(s) = D + sum_l rho_l / (s - p_l) + conj(rho_l) / (s - conj(p_l))`, for an output that is what was measured; by
    maximum likelihood if the noise is white.  Sensors may be anywhere.  What is not listed is that of `result`.

    Attributes
    ----------
    result : DampedResult
        The same as the result of a fit, with an axis for outputs and one for inputs.
    damped, negative : ndarray of bool, shape (n,)
        Which damping ratios, and which weights below 0, stand out of the noise.
    poles : ndarray of complex, shape (n,)
        Those of positive imaginary part, by their natural frequencies.
    natural_frequencies, hertz, damping_ratios : ndarray, shape (n,)
        `|p|`, ascending, rad per unit time; in Hz, in cycles per unit of time where that is not known; `-Re p / |p|`.
    order : int
        Number of modes n.
    loglik, fit_percent, quantity, time_unit
        As those of the fit.
    """

    result: DampedResult
    damped: Mask
    negative: Mask

    def __getattr__(self, name: str) -> Any:
        if name == "result" or name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.result, name)

    @property
    def residues(self) -> ComplexArray:
        """`rho`, shape (n,); 0 for a free motion."""
        found = self.result.residues
        return found[: self.order, 0, 0] if found.size else np.zeros(self.order, complex)

    @property
    def feedthrough(self) -> float:
        """`D`."""
        return float(self.result.feedthrough.sum())

    @property
    def covariance(self) -> Array:
        """Of natural frequencies, damping ratios, real and imaginary parts of the residues, and D, (4n + 1, 4n + 1).

        NaN for what was not estimated.
        """
        n, every = self.order, len(self.result.poles)
        found = np.full((4 * every + 1,) * 2, np.nan)
        known = len(self.result.covariance)
        found[:known, :known] = self.result.covariance
        kept = np.append((every * np.arange(4)[:, None] + np.arange(n)).ravel(), 4 * every)
        return found[np.ix_(kept, kept)]

    @property
    def noise_variance(self) -> float:
        """Estimated variance of the noise."""
        return float(self.result.noise_variance.sum())

    @property
    def loss(self) -> float:
        """Mean squared residual over the observed samples."""
        samples = self.result._spare + self.result.unknowns
        return float(np.exp(-2 * self.result.loglik / samples - 1) / (2 * np.pi))

    @property
    def free_amplitudes(self) -> tuple[ComplexArray, ...]:
        """Free motion of each mode in each record, `Re(amplitude exp(p t))`; empty for a response."""
        return tuple(one.free_amplitudes for one in self.result.experiments)

    @property
    def initial_states(self) -> tuple[Array, ...]:
        """State of `system` at the first sample of each record: real and imaginary parts of `free_amplitudes`."""
        return tuple(one.initial_state for one in self.result.experiments if isinstance(one, FittedExperiment))

    @property
    def offsets(self) -> tuple[float, ...]:
        """Constant added to the output of each record."""
        return tuple(self.result.offsets.tolist())

    @property
    def predicted(self) -> tuple[NDArray[Any], ...]:
        """Output of each experiment as the model has it; of a response with a background of modes outside its band."""
        return tuple(one.predicted for one in self.result.experiments)

    @property
    def system(self) -> ct.StateSpace:
        """Linear system from the input to what was measured, in real modal coordinates: two states a mode."""
        return self.result.observed_system

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
        p = self.poles[: self.order]
        return np.asarray(2j * p.imag / p ** POWERS[self.quantity])

    def _headline(self) -> str:
        return f"{counted(self.order, 'damped mode')}, fit {percent(self.fit_percent)}"

    def __str__(self) -> str:
        return "\n".join(damped_lines(self))


def _singular(poles: ComplexArray, residues: ComplexArray) -> tuple[ComplexArray, Array, ComplexArray]:
    """Singular values and vectors of residues (N, p, m), real ones of those of real poles."""
    U, s, V = np.linalg.svd(residues, full_matrices=False)
    real = poles.imag == 0
    if real.any():
        U[real], s[real], V[real] = np.linalg.svd(residues[real].real, full_matrices=False)
    return U, s, V


def _complex(real: Array, imaginary: Array, shape: tuple[int, ...]) -> ComplexArray:
    found = np.empty(len(real), complex)
    found.real, found.imag = real, imaginary
    return found.reshape(shape)


def _recording(data: Any, dt: Any, outputs: int) -> Recording:
    """One recording; without outputs these are missing throughout."""
    blind = isinstance(data, tuple) and data[1] is None
    if blind:
        u = np.atleast_2d(_checks.real_array("the input", data[0]))
        data = (u, np.zeros((outputs, u.shape[1])))
    found: Any = as_channels(data, dt if isinstance(data, tuple) else None)
    if len(found) > 1 or isinstance(found[0], ResponseMatrix):
        raise StructureError(f"data is a {type(data).__name__} of {len(found)} experiments; pass one time record")
    return replace(found[0], y=np.full_like(found[0].y, np.nan)) if blind else found[0]
