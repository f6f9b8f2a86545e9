"""What a fit with a model of its noise foretells: the predictor, its Kalman gain, outputs some steps ahead."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import control as ct
import numpy as np

from ... import _checks
from ..._options import Discretisation, Interpolation
from ..._types import Array
from ..._units import with_unit
from ...exceptions import NoSuchQuantityError, StructureError
from ...modal.discretization import Hold
from ...systems.port_hamiltonian import PortHamiltonian
from ..data.time_record import InTime
from ..uncertainty.kalman import KalmanFilter, NoisyPlant, continuous_gain, foretold_colour, growing
from ..uncertainty.noise_model import NoiseModel, through_plant
from .result import FittedModes

_SAME_STEP = 0.01  # relative difference of steps that are the same, as of the instants of a record
_SAME_STATES = 1e-6  # relative difference up to which two systems are one in other states


def checked_horizon(value: object) -> int | None:
    """Steps ahead of a prediction; None where it is a simulation, as without a horizon or with an infinite one."""
    if value is None or (isinstance(value, float) and value == np.inf):
        return None
    return _checks.whole_number("horizon", value, 1)


class Foretelling(FittedModes):
    """The predictor of a fit and its gain, from its poles, residues, delays and `noise`."""

    if TYPE_CHECKING:
        noise: NoiseModel | None
        delay: Array
        method: Discretisation
        intersample: Interpolation

        @property
        def offsets(self) -> Array:
            """Constants of the outputs."""

        @cached_property
        def system(self) -> PortHamiltonian | ct.StateSpace:
            """The model."""

        @cached_property
        def observed_system(self) -> ct.StateSpace:
            """Linear system from the inputs to what was measured."""

    @property
    def predictor(self) -> ct.StateSpace:
        """Discrete system from inputs and measured outputs to the outputs predicted one step ahead.

        Inputs are those of the plant, then the measured outputs; outputs are the predictions of these, named
        'predicted y' of an output 'y'.  It is the steady Kalman filter in the form

            x[k+1] = A x[k] + B u[k] + K (y[k] - C x[k] - D u[k]),          yhat[k] = C x[k] + D u[k]

        of the step of the record, its hold and delays: with `P = result.predictor` and m inputs, `K = P.B[:, m:]`,
        `A = P.A + K P.C`, `B = P.B[:, :m] + K P.D[:, :m]`, `C = P.C` and `D = P.D[:, :m]` are the model that
        `control.dlqr` needs, and `K` is the gain of `control.dlqe` for it, that of the predictor: it takes `y[k]` into
        the state at k + 1.

        States are those of `observed_system`, once for each different delay; the inputs of earlier samples that delays
        need; and the past of the noise of outputs that have a colour.  Constants, drifts and tones are no part of it:
        subtract them from the outputs, or use `predict` with a horizon, which does.

        With white noise and no forces `K` is 0 and the predictor is the simulation; a pole that grows has the gain that
        stabilises its error.

        Raises
        ------
        NoSuchQuantityError
            After a fit to frequency responses, which have no samples.
        StructureError
            If an output comes so early that its prediction depends on inputs that are not known yet, or the filter has
            no steady state.
        """
        filter, noise = self._filter, self._noise_in_time
        inputs, outputs = self.input_labels, self.output_labels
        names = _checks.without_dots((*inputs, *outputs))
        if len(set(names)) < len(names):
            names[len(inputs) :] = [f"measured {name}" for name in names[len(inputs) :]]
        made = ct.StateSpace(
            *filter.predictor, noise.dt, remove_useless_states=False, inputs=names,
            outputs=[f"predicted {name}" for name in _checks.without_dots(outputs)],
        )  # fmt: skip
        return with_unit(made, self.time_unit)

    @property
    def kalman_gain(self) -> Array:
        """Gain `L` of the Kalman filter in continuous time, shape (states, p), as `control.lqe` gives it.

            xhat' = A xhat + B u + L (y - C xhat - D u)

        for the states of `system`, where `C` and `D` are its rows of the measured outputs `output_labels`: all rows
        where the outputs are velocities of ports, or the structure is 'free'.  The noise of the outputs, of covariance
        `R` at samples of step h, counts as white noise of intensity `h R`, and forces as the white ones that leave
        their covariance at the samples.  Of outputs that all come late it is the gain for the state a delay earlier.

        It is 0 where nothing but the inputs moves the plant, whatever the colour of the noise, as then the inputs tell
        the states: a controller needs the noise among its states, which `predictor` has.

        Raises
        ------
        NoSuchQuantityError
            After a fit to frequency responses; or where outputs have a colour, or different delays, and the plant is
            moved by forces or grows: the filter has more states then, all of which are in `predictor`.
        """
        A, _, C, _ = self._matrices
        noise = self._noise_in_time
        noise = noise._in_states_of(self._step(noise.dt), C)
        gain = continuous_gain(A, C, noise)
        if gain.any() and (noise.colours is not None or np.ptp(self.delay)):
            why = "outputs have a colour" if noise.colours is not None else "outputs have different delays"
            raise NoSuchQuantityError(
                f"the filter has more states than the plant, as {why}; predictor has all of them, and its gain is "
                f"predictor.B[:, {len(self.input_labels)}:]"
            )
        return _checks.readonly(gain if self.system is self.observed_system else self._of_system(gain))

    # --- the filter ------------------------------------------------------------------------------------------------

    @property
    def _grows(self) -> bool:
        """Whether there is a pole that grows."""
        return grows(self)

    def _innovations(self, rest: Array, dt: float) -> Array:
        """What the noise model does not foretell of outputs (p, T) less their simulation; NaN where missing."""
        return rest - ahead(self, np.zeros(rest.shape), rest, dt, 1)

    @property
    def _noise_in_time(self) -> NoiseModel:
        if self.noise is None and isinstance(self.experiments[0].record, InTime):
            raise NoSuchQuantityError(
                "this fit is to set-ups of different sensors, each of which has a predictor of its own: fit one of them"
            )
        if self.noise is None:
            raise NoSuchQuantityError(
                "this fit is to a frequency response, which has no samples to predict; noise_variance has the noise "
                "of its entries"
            )
        return self.noise

    @property
    def _matrices(self) -> tuple[Array, Array, Array, Array]:
        """Matrices of `observed_system`, without an input where there is none."""
        plant, m = self.observed_system, len(self.input_labels)
        return np.asarray(plant.A), np.asarray(plant.B)[:, :m], np.asarray(plant.C), np.asarray(plant.D)[:, :m]

    def _with_plant(self, noise: NoiseModel) -> NoiseModel:
        """The noise with the plant that its forces move."""
        if noise.outputs != len(self.output_labels):
            raise StructureError(f"the noise is of {noise.outputs} outputs, the fit of {len(self.output_labels)}")
        if noise.forces is None:
            return noise
        return through_plant(noise, self._step(noise.dt), self._matrices[2])

    @cached_property
    def _noisy_plant(self) -> NoisyPlant:
        noise = self._noise_in_time
        return NoisyPlant.of(self._matrices, noise, Hold(noise.dt, self.method, self.intersample), self.delay)

    @cached_property
    def _filter(self) -> KalmanFilter:
        return self._noisy_plant.steady()

    @property
    def _beside_simulation(self) -> KalmanFilter:
        """The filter for what a simulation leaves of the outputs, which no input moves."""
        A, _, C, _ = self._matrices
        noise, p = self._noise_in_time, len(C)
        without = A, np.zeros((len(A), 0)), C, np.zeros((p, 0))
        return NoisyPlant.of(without, noise, Hold(noise.dt, self.method, self.intersample), np.zeros(p)).steady()

    def _step(self, dt: float) -> Array:
        """Step of the states of `observed_system`."""
        A, B, _, _ = self._matrices
        return Hold(dt, self.method).step_of_matrices(A, B).F

    def _of_system(self, gain: Array) -> Array:
        """A gain for the states of `system`, from that for the states of `observed_system`.

        Both have the same inputs, which take the states of one to those of the other at any point of the plane.
        """
        first, second = self.observed_system, self.system
        size = np.abs(self.poles)
        apart = np.abs(self.poles[:, None] - self.poles) + np.diag(np.full(len(size), np.inf))
        near = np.minimum(apart.min(axis=1), np.where(size > 0, size, 1.0))
        points = np.concatenate([self.poles + turn * near for turn in (0.3, 0.3j, 0.2 - 0.2j)])
        states = []
        for system in (first, second):
            A, B = np.asarray(system.A), np.asarray(system.B)
            moved = np.concatenate([np.linalg.solve(s * np.eye(len(A)) - A, B) for s in points], axis=1)
            states.append(np.concatenate([moved.real, moved.imag], axis=1))
        units = np.linalg.norm(states[0], axis=0)
        own, other = (each / np.where(units > 0, units, 1.0) for each in states)
        turn = np.linalg.lstsq(own.T, other.T, rcond=None)[0].T
        if np.linalg.norm(turn @ own - other) > _SAME_STATES * np.linalg.norm(other):
            raise NoSuchQuantityError(
                "the states of system cannot be told from those of observed_system to six digits; the predictor is a "
                "system of the latter"
            )
        return np.asarray(turn @ gain)


# --- some steps ahead ------------------------------------------------------------------------------------------------


def grows(result: Foretelling) -> bool:
    """Whether a fit has a pole that grows, so that inputs alone do not tell where the plant is."""
    return result.noise is not None and bool(growing(result._step(result.noise.dt)).any())


def is_simulated(result: Foretelling) -> bool:
    """Whether outputs of the past tell a fit nothing, so that it foretells what it simulates."""
    return result.noise is None or (result.noise.is_white and not grows(result))


def ahead(result: Foretelling, simulated: Array, y: Array, dt: float, horizon: int) -> Array:
    """Outputs (p, T) predicted so many steps ahead, where a simulation of the plant is known."""
    noise = _noise_at(result, dt)
    if noise.is_white:
        return simulated
    rest = y - simulated
    if noise.forces is None and noise.colours is not None:
        return simulated + foretold_colour(noise.colours, rest, horizon)
    return simulated + result._beside_simulation.foretold(np.zeros((0, rest.shape[1])), rest, horizon)


def ahead_of_growth(result: Foretelling, u: Array, y: Array, dt: float, horizon: int, moving: bool) -> Array:
    """The same of a plant with a pole that grows, whose simulation leaves the outputs behind.

    The state at the first sample, and constants where the fit has them, are those that leave the least to be told;
    without motion the plant begins at rest.
    """
    _noise_at(result, dt)
    filter, offset = result._filter, np.zeros(len(y))
    start = np.zeros(len(filter.A))
    if moving:
        start, offset = filter.likely_start(u, y, bool(result.offsets.any()))
    return np.asarray(filter.foretold(u, y - offset[:, None], horizon, start) + offset[:, None])


def _noise_at(result: Foretelling, dt: float) -> NoiseModel:
    """Noise of a fit at a step, which has to be its own where samples of the past tell anything."""
    noise: NoiseModel = result._noise_in_time
    if not is_simulated(result) and abs(dt - noise.dt) > _SAME_STEP * noise.dt:
        raise StructureError(
            f"the record has the step {dt:.6g}, and the noise of this fit is known at the step {noise.dt:.6g} "
            "only: resample the record, or leave out the horizon"
        )
    return noise
