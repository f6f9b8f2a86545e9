"""Prediction-error fitting: the public call."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

from ... import _checks
from ..._heartbeat import Callback, heard_by
from ..._options import (
    CRITERIA,
    DISCRETISATIONS,
    FITTED_INTERPOLATIONS,
    INITIAL_STATES,
    NOISE_KINDS,
    REPRESENTATIONS,
    STRUCTURE_CHOICES,
    STRUCTURES,
    Criterion,
    Discretisation,
    FittedInterpolation,
    InitialState,
    InterpolationOrAuto,
    NoiseKind,
    Representation,
    SensorQuantity,
    Structure,
)
from ..._threads import on_one_thread
from ..._types import Array, ArrayLike, ComplexArray, OneOrEach, PortPairs, RandomSource
from ..._workers import check_workers
from ...exceptions import IdentifiabilityWarning, StructureError
from ...systems.base import Convertible
from ..data.channels import Channels, ResponseHold
from ..data.experiments import as_channels
from ..data.quantities import ports_of, quantity_of
from ..diagnosis.verdict import WHITE, Outcome
from ..estimates.force_noise import beside_hammer_noise
from ..parameters.model_function import ModelFunction
from ..structure.parametric import PARAMETRIC, for_channels
from .modal_fit import fit_channels
from .options import Options, request_of, starting_poles
from .pem_result import PEMResult


@on_one_thread
def pem(
    data: Any,
    order: int | Literal["auto"] = "auto",
    *,
    dt: OneOrEach = None,
    method: Discretisation = "exact",
    intersample: FittedInterpolation = "auto",
    initial_state: InitialState = "estimate",
    offset: bool | Literal["auto"] = "auto",
    quantity: SensorQuantity | Sequence[SensorQuantity] | Mapping[str, SensorQuantity] | None = None,
    representation: Representation = "observable",
    initial_guess: PEMResult | Convertible | tuple[ArrayLike, ArrayLike] | None = None,
    weights: OneOrEach = None,
    criterion: Criterion = "bic",
    max_order: int | None = None,
    workers: Any = 1,
    rng: RandomSource = None,
    callback: Callback | None = None,
    structure: Structure = "auto",
    ports: PortPairs | None = None,
    real_poles: int | Literal["auto"] = "auto",
    delay: ArrayLike | Literal["auto"] = "auto",
    input_delay: ArrayLike | Literal["auto"] = "auto",
    noise: NoiseKind = "auto",
    window: ArrayLike | None = None,
    model: Callable[[Array], Convertible] | None = None,
    parameters: ArrayLike | Mapping[str, float] | None = None,
    bounds: Sequence[ArrayLike] | None = None,
) -> PEMResult:
    """Fit modes and real poles to recordings or frequency responses, by prediction-error minimisation.

    Finds natural frequencies, damping ratios, time constants and residues, with what belongs to each experiment, that
    minimise the squared output error: with white output noise, of each output its own, the maximum-likelihood estimate.
    No starting guess is needed.  The model is the simplest that the data do not reject, from lossless to free.

    Parameters
    ----------
    data : control.TimeResponseData, control.FrequencyResponseData, data frame, pair (u, y), or list of these
        Inputs and outputs on a uniform grid, or frequency responses; several experiments in a list, each with its own
        length, step and initial state.  Signals of several channels have one row each, (m, T) and (p, T); experiments
        may have different channels, matched by their labels, or their places where there are none.  `(None, y)` is a
        free motion, or one that forces which nobody measured keep up.  NaN outputs are missing samples.  Not modified.
    order : int or 'auto'
        Number of modes n, pairs of real poles among them; 'auto' takes the one that `criterion` prefers.  0 where the
        number of `real_poles` is given: two of these that come together turn into a mode.
    dt : float, or sequence of float, one for each experiment, optional
        Time between samples; required with arrays.  Of a response with a window that of the record which it was
        estimated from; by default its frequencies are taken for neighbouring lines.
    method : {'exact', 'midpoint', 'euler'}
        Discretisation of the model; 'exact' for real recordings, the others for data made by such an integrator,
        which a lossless model is fitted to.
    intersample : {'auto', 'zoh', 'foh', 'bandlimited'}
        Input between samples: held, or linear; 'auto' takes what the data prefer, where they cannot tell that with
        which the structure is simpler or shapes are more nearly real, and else 'zoh'.  Of a response with a window also
        'bandlimited', as behind the filters of an analyser; a response with a `dt` is that of samples, any other was
        divided by that of the hold.  'auto' takes what the response states by an attribute `intersample`, and else the
        first of these that leaves white residuals and a structure with classical damping, if any does, of samples that
        were not divided by that of the hold as well.
    initial_state : {'estimate', 'zero'}
        Whether the records may start in motion.  Where no output moves before an input first changes they are taken to
        be at rest, held by the inputs they have then, unless a motion explains more; 'zero' has no input before.
    offset : bool or 'auto'
        Whether a constant is added to the output of each record, and estimated; 'auto' adds one, or one that drifts,
        where that explains more than a slow mode does.
    quantity : {'velocity', 'displacement', 'acceleration', 'free'}, or sequence or dict of these, optional
        Measured quantity: of all outputs, of each, or by label; 'free' is any other sensor.  Default: what the data
        give by an attribute `quantity`, a dict as `read_uff` gives it, or by labels and units such as `Accel (g)`;
        'velocity' where no output has such a label.
    representation : {'observable', 'controllable'}
        Whether a mode without weight may still move at the output, as in the observable form, or not, as in every state
        of the controllable one; of lossless models of one input and output.
    initial_guess : pair (d, r), ModalForm, PEMResult, or system of this package, optional
        Model to start from, in place of the search; with a given order, modes are added to it if it has fewer.
    weights : array_like, shape (K,) or (p, m, K), or list of these, optional
        What the squared error at each frequency of a response counts; by default all the same, unless the residuals
        show that the noise grows with the gain: then by the law of the noise of each response that is estimated, among
        the `findings`.
    criterion : {'bic', 'aicc', 'aic', 'holdout'}
        What 'auto' minimises; 'holdout' is the error over the last third of each record, of models fitted to the rest.
    max_order : int, optional
        Largest order tried by 'auto'; by default 20, and 40 of frequency responses.
    workers : int, executor, Dask client or map-like callable
        Without effect, as the search runs in one process; `fit_many` fits several recordings at a time.
    rng : numpy.random.Generator or int, optional
        Without effect, as the search has no random starts.
    callback : callable, optional
        `show_progress`, or a function of your own. Called as `callback(progress)` after each iteration, `progress` with
        `order`, `max_order`, `iteration`, `loss`; also once a second within long stages, which `progress.stage` names.
        If it raises `StopIteration`, or on `KeyboardInterrupt`, the best model so far is returned, and says so.
    structure : {'auto', 'lossless', 'classical', 'passive', 'free'}
        What is assumed: no losses and sensors at the actuators; damping that the real modes of the lossless plant
        decouple; a plant that gives no energy; nothing.  'auto' takes the simplest that is not rejected at 5 %,
        and has poles near those of the free fit.
    ports : list of (output, input), or mapping from output to input, optional
        Driving points, where an output is measured where and along which an input acts: labels, or numbers from 0.
        They set the scale of mode shapes.  Default: what the data give by an attribute `ports`, as `read_uff` does;
        one input and output are taken for one.
    real_poles : int or 'auto'
        Number of real poles beside the modes, as of a lag, a motor or an RC circuit; 'auto' takes that which
        `criterion` prefers, beside a number of modes that is given where these alone leave what is no noise, or have no
        peak.  A lossless model has none.
    delay : 'auto', or float, or sequence of float, one for each output
        Time by which outputs come later than the response to the inputs, or earlier where it is negative: that of an
        anti-aliasing filter, of sampling one channel after the other, or dead time.  'auto' estimates one of all
        outputs, or one of each, where a structure, the first samples of the answer, or heavily damped poles of a
        response show it, in parts of a sample where the data tell these, with its error as `stderr["delay"]`: NaN where
        only whole samples are told, or the structure is passive.
    input_delay : 'auto', or float, or sequence of float, one for each input
        Dead times of several inputs: the time by which each acts later than it was recorded, in whole samples of the
        recordings.  'auto' finds those that differ between inputs where `delay` is 'auto' as well; what all inputs have
        in common is a `delay`.  0 for none.
    noise : {'auto', 'white', 'correlated', 'coloured', 'forces'}
        What is beside the response to the inputs: white noise of each output, with one covariance of all outputs,
        or coloured, an autoregression of each; or forces that nobody measured, and noise of recorded inputs, which
        come through the plant.  'auto' takes the simplest that the data do not reject.  Of outputs alone 'forces' says
        that wind, traffic or the like kept the plant in motion, and 'auto' whether they did, or a motion decays.
    window : (name, N), (name, N, blocks), or array_like, shape (N,), optional
        Window of the blocks of N samples, overlapping by half, that frequency responses were estimated from (H1), by
        its name in `scipy.signal.get_window` or by its values; the input was white or nearly so.  The number of blocks
        says how large errors are about resonances, where few lines tell it.  Default: what the data state by attributes
        `window` and `segments`, as `spectral_estimate` does; none otherwise.
    model : callable, optional
        Function from physical parameters, an array (P,), to a system with the inputs and outputs of the data, as a
        `StateSpace`, a `TransferFunction` or any system of this package: springs and masses, `from_second_order` of
        dense or sparse matrices, `read_netlist(path, parameters=[..])`.  Its parameters are fitted, next to the modes
        of a free fit, and it is tested within the free model.  A unit of time that it states, as a netlist does, must
        be that of the data.
    parameters : array_like, shape (P,), or mapping from name to value, optional
        Where parameters of the `model` start, to a factor of two or so; zero ones have the size 1.  Default: the
        `values` of the function, as those of a netlist.
    bounds : pair of array_like, shape (P,) or numbers, optional
        Lower and upper bounds of the parameters, numbers or vectors (P,), as in `scipy.optimize.least_squares`.

    Returns
    -------
    PEMResult
        Model, standard errors, order table, residuals and a verdict.

    Raises
    ------
    StructureError
        If the data or options are not of this form.
    IdentificationError
        If the record is too short for a mode, or its signals cannot show one.

    Warns
    -----
    IdentifiabilityWarning
        If the input leaves combinations of parameters undetermined.

    Notes
    -----
    Given the poles, residues and what belongs to each experiment solve a linear problem; only the poles are refined
    (variable projection, Levenberg-Marquardt).  The loss has many minima in each frequency, about `2 pi / (T dt)` wide,
    so modes and real poles are added one by one, each where a local fit around the bins of the Fourier transform
    explains most of what is left, and all are refined jointly, each output with the variance of its own noise.  The
    structures are then constraints on that minimum: each has a minimum of its own, and the likelihood that it costs is
    its test.
    O(T n^2) an iteration; memory does not grow with T n.

    With a `model` the loss is minimised over its parameters by Levenberg and Marquardt's method in the rows of the free
    fit: same hold, delay, constants, noise, and weights.  All outputs of a record share the state that it begins in,
    and responses have no background: a model has all modes.  Derivatives are differences, of steps of a fiftieth of a
    standard error; the function is called 20 times for each parameter at most.  `result.parameters`,
    `stderr["parameters"]`, `fitted_parameters.correlations`; the first of the `tests`, 'parametric', is that of the
    function.  Combinations of parameters that leave no trace, and parameters at a bound, are among the `findings`.

    A mode that is not significant among all the places where noise could have shown one is dropped from an automatic
    choice.  Parts of one record given as two experiments have two initial states to estimate.

    A response that was estimated with a window is fitted as the window shows the modes.  The law of its errors is that
    of noise and of the motion in which blocks begin, by the modes and the noise of each output that the residuals show:
    lines are whitened by it, unless `weights` are given, which are those of noise alone.

    An output `y` whose values are whole steps `s` apart was rounded.  Steps larger than its noise are no evidence of
    modes, and it is fitted by the probability `Phi((y + s / 2 - x) / sigma) - Phi((y - s / 2 - x) / sigma)` of its step
    at a predicted output `x`, with noise of deviation `sigma` before it was rounded; `findings` say so.

    The force of a hammer counts as 0 outside its contacts where that explains the outputs better than the noise that
    its channel shows there; `findings` say so, and the records of the result have that force.

    Examples
    --------
    >>> import control as ct, numpy as np, ph_control as phc
    >>> plant = phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
    >>> rng = np.random.default_rng(0)
    >>> t, u = 0.1 * np.arange(1000), rng.standard_normal(1000)
    >>> y = phc.forced_response(plant, t, u, intersample="zoh").outputs + 0.01 * rng.standard_normal(1000)
    >>> result = phc.pem((u, y), dt=0.1)
    >>> result.d.round(3)
    array([0.5, 2. ])

    A damped structure, two inputs and three outputs, the first of which is a driving point:

    >>> poles, shapes = [-0.01 + 1j, -0.02 + 2j], rng.standard_normal((2, 3))
    >>> frame = phc.modes(poles, shapes, shapes[:, :2]).state_space()
    >>> u = rng.standard_normal((2, 1000))
    >>> y = ct.forced_response(ct.c2d(frame, 0.1), t, u).outputs
    >>> result = phc.pem((u, y + 0.1 * rng.standard_normal(y.shape)), dt=0.1, structure="free", ports=[(0, 0)])
    >>> result.order, result.shapes.shape, result.shapes_scaled
    (2, (2, 3), True)
    """
    for name, value, allowed in (
        ("criterion", criterion, CRITERIA), ("structure", structure, STRUCTURE_CHOICES),
        ("method", method, DISCRETISATIONS), ("representation", representation, REPRESENTATIONS),
        ("intersample", intersample, FITTED_INTERPOLATIONS),
        ("initial_state", initial_state, INITIAL_STATES),
        ("noise", noise, NOISE_KINDS),
    ):  # fmt: skip
        _checks.choice(name, value, allowed)
    check_workers(workers)
    _checks.random_generator(rng)
    quantity = quantity_of(data) if quantity is None else quantity
    ports = ports_of(data, quantity) if ports is None else ports
    function = _checked_model(model, parameters, bounds, structure)
    channels = as_channels(data, dt, weights=weights, window=window, hold=intersample)
    others = _otherwise_sampled(data, channels, intersample)
    held = _of_records(intersample, channels)
    options = Options.checked(
        channels, order=order, method=method, intersample=held, offset=offset, max_order=max_order,
        criterion=criterion, callback=callback, moving=initial_state == "estimate", weighted=weights is not None,
        real_poles=real_poles, delay=delay, input_delay=input_delay, reachable=representation == "controllable",
        noise=noise,
    )  # fmt: skip
    request = request_of(channels, structure, ports, quantity, options)
    if function is not None:
        request = replace(request, structure=PARAMETRIC, function=for_channels(function, channels))
    start = starting_poles(initial_guess, channels, options)

    def fit(
        data: Any,
        poles: ComplexArray | None = start,
        plain: bool = False,
        structure: str = request.structure,
        **more: Any,
    ) -> PEMResult:
        wanted = replace(request, structure=structure, coloured=request.coloured and not plain)
        return fit_channels(data, wanted, options.plain(data) if plain else options, poles, **more)

    with heard_by(callback) as heartbeat:
        options = replace(options, callback=heartbeat)
        result = beside_hammer_noise(channels, request, fit, is_open=isinstance(options.order, str))
        for hold in others:
            if result.outcome is Outcome.INTERRUPTED or _is_explained(result, structure):
                break
            other = fit(as_channels(data, dt, weights=weights, window=window, hold=hold))
            result = max(result, other, key=_plainness)
    if result.blind:
        warnings.warn(
            result.message, IdentifiabilityWarning, stacklevel=3
        )  # the line that calls the decorated function
    return result


def _otherwise_sampled(data: object, channels: Channels, intersample: FittedInterpolation) -> tuple[ResponseHold, ...]:
    """How windowed responses that do not tell it may have been estimated otherwise."""
    every = data if isinstance(data, list | tuple) else [data]
    stated = any(getattr(part, "dt", None) or getattr(part, "intersample", None) for part in every)
    windowed = all(getattr(part, "window", None) is not None for part in channels)
    return ("sampled", "bandlimited") if windowed and intersample == "auto" and not stated else ()


def _is_explained(result: PEMResult, structure: str) -> bool:
    """Whether nothing asks for another way in which responses were estimated."""
    return result.whiteness >= WHITE and (structure != "auto" or result.structure in STRUCTURES[:2])


def _plainness(result: PEMResult) -> tuple[bool, int, float]:
    """White residuals first, then the simplest structure."""
    order = STRUCTURES.index(result.structure) if result.structure in STRUCTURES else 0
    return result.whiteness >= WHITE, -order, result.whiteness


def _checked_model(
    model: Any, parameters: ArrayLike | Mapping[str, float] | None, bounds: Sequence[ArrayLike] | None, structure: str
) -> ModelFunction | None:
    """A model function with its parameters; None without one."""
    if model is None:
        for name, value in (("parameters", parameters), ("bounds", bounds)):
            if value is not None:
                raise StructureError(f"{name} are those of a model function; give that too, model=f")
        return None
    if structure != "auto":
        raise StructureError(f"structure={structure!r} is no choice beside a model, which has its own: leave it out")
    return ModelFunction.checked(model, parameters, bounds)


def _of_records(intersample: FittedInterpolation, channels: Channels) -> InterpolationOrAuto:
    """What is assumed of the inputs of records; those of windowed responses have theirs in the window."""
    if intersample != "bandlimited":
        return intersample
    if any(getattr(data, "window", None) is None for data in channels):
        raise StructureError(
            "intersample='bandlimited' is for responses that were estimated with a window; give that, window=('hann', "
            "N), or use 'zoh' or 'foh' for records"
        )
    return "zoh"


prediction_error_fit = pem
