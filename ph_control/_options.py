"""What options may be: the type of each, which editors and type checkers know, its values, and what they mean.

Public calls, command line, files and findings take them from here; nothing is imported that takes time, so that a help
is shown at once.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

# --- models and samples ----------------------------------------------------------------------------------------------

Discretisation = Literal["exact", "midpoint", "euler"]
DISCRETISATIONS: tuple[Discretisation, ...] = get_args(Discretisation)

Interpolation = Literal["zoh", "foh"]
INTERPOLATIONS: tuple[Interpolation, ...] = get_args(Interpolation)

# what a frequency response that was estimated from samples can have assumed of the input between them
ResponseInterpolation = Literal["zoh", "foh", "bandlimited"]
RESPONSE_INTERPOLATIONS: tuple[ResponseInterpolation, ...] = get_args(ResponseInterpolation)

InterpolationOrAuto = Literal["auto", "zoh", "foh"]
INTERPOLATIONS_OR_AUTO: tuple[InterpolationOrAuto, ...] = get_args(InterpolationOrAuto)

FittedInterpolation = Literal["auto", "zoh", "foh", "bandlimited"]
FITTED_INTERPOLATIONS: tuple[FittedInterpolation, ...] = get_args(FittedInterpolation)

InitialState = Literal["estimate", "zero"]
INITIAL_STATES: tuple[InitialState, ...] = get_args(InitialState)

ComparedState = Literal["estimate", "zero", "fitted"]
COMPARED_STATES: tuple[ComparedState, ...] = get_args(ComparedState)

PredictedState = Literal["estimate", "fitted", "final", "zero"]
PREDICTED_STATES: tuple[PredictedState, ...] = get_args(PredictedState)

# --- fits ------------------------------------------------------------------------------------------------------------

Structure = Literal["auto", "lossless", "classical", "passive", "free"]  # but for the first, the simplest first
STRUCTURE_CHOICES: tuple[Structure, ...] = get_args(Structure)
STRUCTURES = STRUCTURE_CHOICES[1:]

NoiseKind = Literal["auto", "white", "correlated", "coloured", "forces"]
NOISE_KINDS: tuple[NoiseKind, ...] = get_args(NoiseKind)

Criterion = Literal["bic", "aicc", "aic", "holdout"]
CRITERIA: tuple[Criterion, ...] = get_args(Criterion)

Representation = Literal["observable", "controllable"]
REPRESENTATIONS: tuple[Representation, ...] = get_args(Representation)

Motion = Literal["velocity", "displacement", "acceleration"]
SensorQuantity = Literal["velocity", "displacement", "acceleration", "free"]
SENSOR_QUANTITIES: tuple[SensorQuantity, ...] = get_args(SensorQuantity)

TestedParameters = Literal["all", "poles"]
TESTED_PARAMETERS: tuple[TestedParameters, ...] = get_args(TestedParameters)

# --- systems ---------------------------------------------------------------------------------------------------------

Storage = Literal["auto", "available", "required", "mean"]
STORAGES: tuple[Storage, ...] = get_args(Storage)

PortKind = Literal["immittance", "scattering"]
PORT_KINDS: tuple[PortKind, ...] = get_args(PortKind)

Reduction = Literal["modal", "balanced", "h2"]
REDUCTIONS: tuple[Reduction, ...] = get_args(Reduction)

CircuitForm = Literal["foster1", "foster2", "cauer1", "cauer2", "state-space"]
CIRCUIT_FORMS: tuple[CircuitForm, ...] = get_args(CircuitForm)

Immittance = Literal["admittance", "impedance"]
IMMITTANCES: tuple[Immittance, ...] = get_args(Immittance)

# --- files and pictures ----------------------------------------------------------------------------------------------

FrequencyUnit = Literal["rad/s", "Hz", "kHz", "MHz", "GHz"]
FREQUENCY_UNITS: tuple[FrequencyUnit, ...] = get_args(FrequencyUnit)

MagnitudeUnit = Literal["linear", "dB"]
MAGNITUDE_UNITS: tuple[MagnitudeUnit, ...] = get_args(MagnitudeUnit)

PhaseUnit = Literal["deg", "rad"]
PHASE_UNITS: tuple[PhaseUnit, ...] = get_args(PhaseUnit)

DecimalMark = Literal[".", ","]
DECIMAL_MARKS: tuple[DecimalMark, ...] = get_args(DecimalMark)

NetworkParameter = Literal["Z", "Y", "S"]
NETWORK_PARAMETERS: tuple[NetworkParameter, ...] = get_args(NetworkParameter)

AxisScale = Literal["log", "linear"]
AXIS_SCALES: tuple[AxisScale, ...] = get_args(AxisScale)

# --- what quantities and structures are ------------------------------------------------------------------------------


class Quantity(NamedTuple):
    """What an output measures.

    Attributes
    ----------
    derivatives : int
        How often the displacement is differentiated; 0 of any other sensor, of which nothing is known.
    words : tuple of str
        Words of labels that tell it.
    units : str
        Pattern of the units that tell it, whole.
    """

    derivatives: int
    words: tuple[str, ...]
    units: str


LENGTH = r"(?:[nuµμmck]?m|in|inch|ft|mil|met(?:er|re)s?|rad|deg|°)"
QUANTITIES = {
    "displacement": Quantity(
        0, ("displacement", "displacements", "disp", "displ", "position", "deflection", "receptance"), LENGTH
    ),
    "free": Quantity(0, ("strain", "microstrain"), r"[uµμ][εe]|[uµμ]?strain|[uµμm]?m/m"),
    "velocity": Quantity(1, ("velocity", "velocities", "vel", "speed", "mobility"), rf"{LENGTH}/s(?:ec)?|rpm"),
    "acceleration": Quantity(
        2,
        ("acceleration", "accelerations", "accel", "acc", "accelerometer", "accelerance", "inertance"),
        rf"{LENGTH}/s(?:ec)?(?:\^|\*\*)?[2²]|{LENGTH}/s/s|m?g_?n?",
    ),
}


class Hypothesis(NamedTuple):
    """A structure that is tested within the free model.

    Attributes
    ----------
    cause : str
        Name of the `Cause` that data show which reject it.
    simpler : tuple of str
        Hypotheses whose models are all among its own.
    channels : int
        Least number of inputs and of outputs with which it says anything.
    ports : int
        Least number of driving points.
    structure : str
        What a model is called for which it is chosen; by default as the hypothesis, which can be given then.
    chosen : bool
        Whether a fit takes it where it is the simplest that is not rejected.
    """

    cause: str
    simpler: tuple[str, ...] = ()
    channels: int = 0
    ports: int = 0
    structure: str = ""
    chosen: bool = True


_REAL_SHAPES = ("lossless", "classical")
HYPOTHESES = {  # the simplest first
    "lossless": Hypothesis("LOSSES"),
    "classical": Hypothesis("COMPLEX_SHAPES", ("lossless",), channels=1),
    "passive": Hypothesis("ACTIVITY", _REAL_SHAPES, channels=1, ports=1),
    "rank one": Hypothesis("SEVERAL_SHAPES", _REAL_SHAPES, channels=2, structure="free"),
    "reciprocal": Hypothesis("ONE_WAY", _REAL_SHAPES, ports=2, structure="free", chosen=False),
}
