"""What records show of a plant with losses, or with several inputs and outputs, in numbers, a table and sentences."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..._display import Report, counted, counted_poles
from ..._frozen import Frozen
from ..._options import Discretisation, Interpolation
from ..._types import ArrayLike, ComplexArray
from ..._units import rate, step_of
from ...exceptions import IdentificationError, StructureError
from ...modal.discretization import Hold
from ..data.channels import Recording
from ..data.experiments import as_channels
from ..uncertainty.fisher import Information, listed, named_modes
from ..uncertainty.noise_model import NoiseModel
from .excited_band import ExcitedBand, excited_band
from .planned_plant import PlannedPlant, pole_tables
from .plant_information import RecordSensitivities, plant_information
from .remedy import multisine
from .report import OfInformation

_MARGIN = (0.5, 1.25)  # of the lowest and highest frequency: the band of an input that is tried instead
_FEW = 3  # combinations or poles described one by one


@dataclass(frozen=True, eq=False, repr=False)
class PlantExcitation(OfInformation, Report, Frozen):
    """What records show of a plant with losses, or of several inputs and outputs; made by `excitation`.

    Attributes
    ----------
    samples, observed : int
        Number of samples of all records, and of observed values of all outputs.
    dt : float
        Time between samples.
    method : str
        How the plant meets the samples.
    from_rest : bool
        Whether the initial state is known to be 0.
    poles : ndarray of complex, shape (N,)
        Of the plant: upper half-plane by natural frequencies, then real ones, the slowest first.
    information : Information
        The Fisher information of natural frequencies `d`, damping ratios `zeta`, real poles, residues of any phase and
        feedthrough, free motions eliminated; in units of the noise, or of unit noise of each output where that is not
        known.
    noise : NoiseModel or None
        Noise of the outputs, where it is known.
    bands : tuple of ExcitedBand
        Where each input of the longest record has power.
    above_nyquist : tuple of int
        Modes, counted from 0, that turn by more than half a turn a step.
    stderr : mapping
        Cramer-Rao bounds under the keys of `PEMResult.stderr`: 'natural_frequencies', 'hertz', 'damping_ratios',
        'real_poles', 'time_constants', 'residues', 'feedthrough', and 'poles'; infinite for what leaves no trace, NaN
        elsewhere where the noise is not known.
    values : mapping
        The quantities of the plant under the same keys.
    remedies : tuple of str
        What to change, each as an instruction.
    input_labels : tuple of str
        Names of the inputs.
    time_unit : str or None
        Unit of time of the records; None where it is not known.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> u = np.random.default_rng(0).standard_normal(1000)
    >>> plant = phc.modes([0.5, 2.0], [1.0, 0.25], damping=0.02)
    >>> report = phc.excitation((u, None), plant, dt=0.1, noise_std=0.1)
    >>> print(report)
    The record shows 2 modes with their damping and residues.
    >>> report.stderr["damping_ratios"].round(4)
    array([0.0008, 0.0007])
    """

    samples: int
    observed: int
    dt: float
    method: Discretisation
    from_rest: bool
    poles: ComplexArray
    information: Information
    noise: NoiseModel | None
    bands: tuple[ExcitedBand, ...]
    above_nyquist: tuple[int, ...]
    stderr: Mapping[str, Any]
    values: Mapping[str, Any]
    remedies: tuple[str, ...]
    input_labels: tuple[str, ...]
    time_unit: str | None = None

    @property
    def n(self) -> int:
        """Number of modes."""
        return int(np.sum(self.poles.imag != 0))

    @property
    def uncertain(self) -> tuple[str, ...]:
        """Quantities whose standard error exceeds their value, though they are not blind."""
        names = []
        for key, letter in (("natural_frequencies", "d"), ("damping_ratios", "zeta"), ("real_poles", "pole")):
            error, value, first = self.stderr[key], np.abs(self.values[key]), self.n if letter == "pole" else 0
            large = np.isfinite(error) & (error > value) & (value > 0)
            names += [f"{letter}_{first + l + 1}" for l in np.flatnonzero(large)]
        return tuple(names)

    @property
    def sufficient(self) -> bool:
        """Whether the records show all unknowns of the plant."""
        return not (self.information.is_weak or self.above_nyquist or self.uncertain)

    @property
    def _parts(self) -> str:
        """Numbers of modes and real poles."""
        return " and ".join(counted_poles(self.n, len(self.poles) - self.n))

    @property
    def headline(self) -> str:
        """The verdict, in a few words."""
        what = f"{self._parts} with their {'damping and ' * bool(self.n)}residues"
        if self.sufficient:
            return f"shows {what}"
        if self.blind:
            return f"does NOT show {listed(list(self.blind_parameters))}"
        if self.nearly_blind:
            return f"hardly shows {self.nearly_blind[0].words}"
        return f"is too noisy for {listed(list(self.uncertain))}" if self.uncertain else f"shows {what} in doubt"

    @property
    def message(self) -> str:
        """The gravest reason for the verdict and the first remedy, a sentence each; empty where all is well."""
        reasons = list(_reasons(self))[:1]
        return " ".join(reasons + [f"Remedy: {remedy}." for remedy in self.remedies[:1]])

    @property
    def details(self) -> str:
        """All that the verdict rests on, and all remedies, in sentences; empty if there is nothing to say."""
        remedies = [f"Remedies: {'; '.join(self.remedies)}."] * bool(self.remedies)
        return " ".join([*_reasons(self), *remedies])

    def __str__(self) -> str:
        return f"The record {self.headline}. {self.message}".rstrip()

    def summary(self) -> str:
        """Report for people: information, excited bands, bounds for each pole, verdict.

        Returns
        -------
        str
            Several lines.

        Notes
        -----
        O(N) on top of what was computed before.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> plant = phc.modes([0.5, 2.0], [1.0, 0.25], damping=0.02)
        >>> print(phc.excitation((np.sin(0.1 * np.arange(500)), None), plant, dt=0.1).summary())
        What the record shows of a plant of 2 modes
          verdict      does NOT show Re residue_1, Re residue_2, Im residue_1 and Im residue_2
          record       500 samples, step 0.1
          input u      1 spectral line, at 1 rad/time
        ...
        """
        size = len(self.names)
        names = [f"input {label}" for label in self.input_labels]
        rows = [
            ("verdict", self.headline), ("record", f"{counted(self.samples, 'sample')}, {step_of(self)}"),
            *zip(names, map(str, self.bands), strict=True),
            ("information", f"rank {self.rank} of {size}, condition {self.condition:.2g}"),
        ]  # fmt: skip
        width = max(len(name) for name, _ in rows) + 2
        lines = [
            f"What the record shows of a plant of {self._parts}",
            *(f"  {name:{width}}{text}" for name, text in rows),
        ]
        text = textwrap.wrap(self.details, 100, initial_indent="  ", subsequent_indent="  ")
        tables = pole_tables(self.values, self.stderr, self.time_unit, "")
        return "\n".join([*lines, "", *tables, *([""] * bool(text)), *text])


def _reasons(report: PlantExcitation) -> Iterator[str]:
    """What a verdict rests on, the gravest first."""
    if report.blind:
        shown = "; ".join(str(combination) for combination in report.blind[:_FEW])
        more = len(report.blind) - _FEW
        yield f"Blind: {shown}{f'; and {more} more' * (more > 0)} can change without any change of the outputs."
    if report.nearly_blind:
        worst = report.nearly_blind[0]
        yield f"Hardly seen, with errors inflated up to {worst.inflation:.2g} times: {worst.words}."
    if report.above_nyquist:
        named = named_modes([l + 1 for l in report.above_nyquist]).capitalize()
        yield f"{named} above the Nyquist frequency {np.pi / report.dt:.4g}."
    if report.uncertain:
        yield f"The standard error exceeds the value of {listed(list(report.uncertain))}."


# --- how it is made ---------------------------------------------------------------------------------------------------


def plant_excitation(
    data: object,
    model: Any,
    dt: float | None,
    hold_of: tuple[Discretisation, Interpolation],
    from_rest: bool,
    noise_std: ArrayLike | None,
) -> PlantExcitation:
    """Judge records at a plant; `hold_of` are method and behaviour of the input between the samples."""
    plant = replace(PlannedPlant.of(model), structure="free")
    records = [_matching(record, plant) for record in as_channels(data, dt, output_needed=False)]
    holds = [Hold(record.dt, *hold_of) for record in records]
    noise, motions = _noise_and_motions(plant, records, holds, from_rest, noise_std)
    known = noise or NoiseModel(np.eye(plant.outputs), records[0].dt)
    observed = [_observed(record) for record in records]
    information = plant_information(
        plant, [record.u for record in records], holds, known, motions, observed=observed, from_rest=from_rest
    )
    longest = max(records, key=lambda record: record.samples)
    above = np.flatnonzero(np.abs(plant.p[: plant.order].imag) * longest.dt >= np.pi)
    errors = plant.unknowns.stderr(information)
    if noise is None:
        errors = type(errors)({name: _without_size(value) for name, value in errors.items()})
    report = PlantExcitation(
        sum(record.samples for record in records), int(sum(seen.sum() for seen in observed)), longest.dt, hold_of[0],
        from_rest, plant.p, information, noise,
        tuple(excited_band(u, longest.dt, longest.time_unit) for u in longest.u),
        tuple(above.tolist()) if hold_of[0] == "exact" else (), errors, type(errors)(plant.values), (),
        longest.input_labels, longest.time_unit,
    )  # fmt: skip
    return replace(report, remedies=_remedies(report, plant, longest, known))


def _without_size(errors: Any) -> Any:
    """Errors of unknown noise: infinite ones stay."""
    if np.iscomplexobj(errors):
        pair = np.empty(errors.shape, complex)
        pair.real, pair.imag = _without_size(errors.real), _without_size(errors.imag)
        return pair
    return np.where(np.isinf(errors), errors, np.nan)


def _matching(record: object, plant: PlannedPlant) -> Recording:
    if not isinstance(record, Recording):
        raise StructureError(
            "the data are a frequency response; what an input shows is asked of records in time: pass (u, y) with dt"
        )
    measured = bool(record.observed.any())
    if len(record.u) != plant.inputs or (measured and len(record.y) != plant.outputs):
        raise StructureError(
            f"the record has {counted(len(record.u), 'input')} and {counted(len(record.y), 'output')}; the model has "
            f"{plant.inputs} and {plant.outputs}"
        )
    if record.samples <= 2 * len(plant.p):
        raise IdentificationError(
            f"{counted(len(plant.p), 'pole')} are more than can be judged with {record.samples} samples; record more "
            f"than {2 * len(plant.p)}"
        )
    if not measured:
        outputs = np.zeros((plant.outputs, record.samples))
        return replace(record, y=np.full_like(outputs, np.nan), output_labels=plant.output_labels)
    return record


def _observed(record: Recording) -> Any:
    """Where outputs count; without any, all of them are to be measured."""
    return record.observed if record.observed.any() else np.ones(record.observed.shape, bool)


def _noise_and_motions(
    plant: PlannedPlant, records: Sequence[Recording], holds: Sequence[Hold], from_rest: bool, noise_std: Any
) -> tuple[NoiseModel | None, list[ComplexArray]]:
    """Noise that is given, that of a fit, or what the plant leaves of the outputs; and free motions fitted to these."""
    noise = plant.noise_at(records[0].dt, noise_std)
    motions, squares, spare = [], np.zeros(plant.outputs), np.zeros(plant.outputs)
    for record, hold in zip(records, holds, strict=True):
        motion = np.zeros((len(plant.p), plant.outputs), complex)
        if record.observed.any():
            fitted = RecordSensitivities(plant, record.u, hold, motion, from_rest).fitted(record)
            motion, squares, spare = fitted[0], squares + fitted[1], spare + fitted[2]
        motions.append(motion)
    if noise is None and np.all(spare > 0) and np.all(squares > 0):
        noise = NoiseModel(np.diag(squares / spare), records[0].dt)
    return noise, motions


def _remedies(report: PlantExcitation, plant: PlannedPlant, record: Recording, noise: NoiseModel) -> tuple[str, ...]:
    """What to change, each tried before it is named."""
    instructions, unit = [], rate(report.time_unit)
    if report.above_nyquist:
        instructions.append(f"sample with a step below {np.pi / np.abs(plant.p.imag).max():.2g}")
    low, high = _MARGIN[0] * np.abs(plant.p).min(), _MARGIN[1] * np.abs(plant.p).max()
    high = min(high, 0.95 * np.pi / record.dt)
    if report.information.is_weak and low < high:
        size = float(np.abs(record.u).max()) or 1.0
        # copies later by a part of the record are all but orthogonal
        wave = size * multisine(record.samples, record.dt, max(low, 2 * np.pi / (record.samples * record.dt)), high)
        u = np.stack([np.roll(wave, k * record.samples // (2 * plant.inputs)) for k in range(plant.inputs)])
        hold = Hold(record.dt, report.method)
        if not plant_information(plant, [u], [hold], noise, from_rest=report.from_rest).is_weak:
            several = ", independent of one another," * (plant.inputs > 1)
            instructions.append(
                f"use white or multisine inputs{several} over {low:.2g} .. {high:.2g} {unit}, or those of design_input"
            )
        else:
            instructions.append("record longer, or leave out poles that no input reaches")
    elif report.uncertain:
        instructions.append("use a stronger input, or what design_input gives for this plant")
    return tuple(instructions)
