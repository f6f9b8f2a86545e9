"""The estimated initial state in the coordinates of the three forms of the paper.

With `a_l` the free motion of mode l in the velocity of the port, `Re(a_l exp(-i d_l t))`:

* in Williamson coordinates the state of the mode is `q + i p = a_l / (d_l conj(nu_l))`;
* in the controllable form the modes have the coordinates `w_l = a_l / (r_l d_l)`, whatever the port sees of them;
* the observable form holds the coefficients of the numerator of the free motion, `sum_k s_k s^{k-1} / P(s)`: it takes
  every `a_l`, also of modes whose weight is 0.

The maps are those of `controllable_morphism` and `observable_morphism`, here written with the modal amplitudes, so that
the one is inverted, and the other goes beyond the modes that the port reaches, without solving a Vandermonde system.
"""

from __future__ import annotations

import warnings
from typing import Any, Literal, get_args

import numpy as np

from ... import _checks
from ..._types import Array, ComplexArray
from ...exceptions import ConditioningWarning, StructureError
from ...numerics.polynomials import companion_maps
from ..data.time_record import Record
from ..regression.modal_regressors import output_weight
from ..regression.prediction import chosen_experiment

StateForm = Literal["ph", "ch", "oh"]

_ENOUGH = 6.0  # decimal digits of the motion that a state should carry


class InCoordinates:
    """Initial states of a result in the coordinates of its forms."""

    def initial_state_in(self: Any, form: StateForm, experiment: int = 0) -> Array:
        """Initial state in the coordinates of another form of the model, with the same output.

        Parameters
        ----------
        form : {'ph', 'ch', 'oh'}
            Of `system`, of the controllable form `ch(system)`, or of the observable form `oh(system)`.
        experiment : int
            Which of several experiments, counted from 0.

        Returns
        -------
        ndarray, shape (2n,)
            State at the first sample.  Only 'oh' has all of the motion where a mode without weight moves freely.

        Raises
        ------
        StructureError
            If there is no such form or experiment, the experiment is a frequency response, or, with 'ch', the
            record asks for a free motion of a mode without weight, which no state of that form shows at its output.

        Warns
        -----
        ConditioningWarning
            If less than six decimal digits of the free motion survive the rounding of the state to doubles.

        Notes
        -----
        The state does not depend on what was measured of the port: displacement, velocity and acceleration are
        outputs of the same state.  In the controllable form modes without weight are at rest.  The entries are right
        to rounding, but states of companion matrices rest on powers of the frequencies: digits of the motion are lost
        with every mode and with frequencies that are close, for 'oh' about as `oh(system).digits` tells; 'ph' loses
        none.  O(n^2).

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> plant, rng = phc.ph(phc.modes([1.0, 2.0], [1.0, 0.5])), np.random.default_rng(0)
        >>> t, u = 0.1 * np.arange(400), rng.standard_normal(400)
        >>> y = phc.forced_response(plant, t, u, [1.0, 0.0, 0.0, 2.0], intersample="zoh").outputs
        >>> result = phc.pem((u, y), order=2, dt=0.1)
        >>> state = result.initial_state_in("oh")
        >>> again = phc.forced_response(phc.oh(result.system), t, u, state, intersample="zoh")
        >>> bool(np.allclose(again.outputs, y, atol=1e-9))
        True
        """
        _checks.choice("form", form, get_args(StateForm))
        experiment_fit = chosen_experiment(self.experiments, experiment)
        if not isinstance(experiment_fit.record, Record):
            raise StructureError("a frequency response has no initial state; only records in time have one")
        if self.structure != "lossless" or not experiment_fit.record.driven:
            raise StructureError(
                f"the forms of the paper are those of driven lossless models, and this fit is {self.structure!r}: use "
                "initial_state, a state of observed_system"
            )
        if form == "ph":
            return np.array(experiment_fit.initial_state)
        # velocity of the port, whatever was measured of it
        amplitudes = experiment_fit.free_amplitudes.conj() / output_weight(self.d, self.quantity)
        if form == "oh":
            state, digits = observable_state(self.d, amplitudes)
        else:
            _refuse_unreachable(self.r, amplitudes)
            state, digits = controllable_state(self.d, self.r, amplitudes)
        if digits < _ENOUGH:
            warnings.warn(
                f"the state of the {'observable' if form == 'oh' else 'controllable'} form of {self.order} modes "
                f"carries {digits:.1f} decimal digits of the free motion: rounding to doubles loses the others; use "
                "that of the system itself, initial_state",
                ConditioningWarning,
                stacklevel=2,
            )
        return state


def _refuse_unreachable(r: Array, amplitudes: ComplexArray) -> None:
    """Refuse free motions of modes that the controllable form does not show."""
    lost = np.flatnonzero((r == 0) & (amplitudes != 0))
    if len(lost):
        named = ", ".join(str(l + 1) for l in lost)
        largest = float(np.abs(amplitudes[lost]).max() / np.abs(amplitudes).max())
        raise StructureError(
            f"mode{'s' * (len(lost) > 1)} {named} moves freely, by {largest:.2g} of the largest mode, but has r = 0: "
            "the output of the controllable form does not show it from any state; take form='oh', or fit with "
            "representation='controllable'"
        )


@np.errstate(over="ignore", invalid="ignore")  # what overflows is refused
def observable_state(d: Array, amplitudes: ComplexArray) -> tuple[Array, float]:
    """State of OH(d, v) with these free motions (n,) in its output, and the digits of them that it carries."""
    W, L = companion_maps(d)
    state = (W.T @ amplitudes).real
    _checks.representable(f"the entries of the observable state of {len(d)} modes", state)
    return state, _digits(np.abs(L) @ (np.abs(W).T @ np.abs(amplitudes)), amplitudes)


@np.errstate(over="ignore", invalid="ignore")
def controllable_state(d: Array, r: Array, amplitudes: ComplexArray) -> tuple[Array, float]:
    """State of CH(d, v) with these free motions in its output, all other modes at rest, and the digits it carries.

    The inverse of `controllable_morphism`, without a solution of equations.
    """
    W, L = companion_maps(d)
    kappa = r * d
    w = np.where(amplitudes == 0, 0.0, amplitudes / np.where(kappa > 0, kappa, 1.0))
    state = (L.T @ w).real
    _checks.representable(f"the entries of the controllable state of {len(d)} modes", state)
    return state, _digits(kappa * (np.abs(W) @ (np.abs(L).T @ np.abs(w))), amplitudes)


def _digits(lost: Array, amplitudes: ComplexArray) -> float:
    """Decimal digits of the motion that survive a relative error of eps in every term of the state; at least 0."""
    largest = float(np.abs(amplitudes).max(initial=0.0))
    if largest == 0:
        return -float(np.log10(_checks.EPS))
    worst = float(lost.max()) / largest * _checks.EPS
    return max(0.0, -float(np.log10(worst))) if np.isfinite(worst) else 0.0
