"""Findings: what shapes data beside the modes, and what speaks against a model; their causes, and their wording.

Left out of a model, a delay, a drift or coloured noise looks like modes that are not there.  A search therefore asks
the likelihood which of two explains more: one more mode, or a circumstance.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from ..._display import first_of, p_value, to_its_error
from ..._options import HYPOTHESES
from ..._units import hertz_size
from ..regression.tuning import TUNING

_LISTED = 6  # values named one by one
_SHOWN = 4  # values of a finding in its representation


HOLDS = ("zoh", "foh")


class Cause(Enum):
    """What the data show beside lossless modes."""

    CONSTANT = "constant in the output"
    DRIFT = "drift of the output"
    HOLD = "hold of the input"
    DELAY = "delay of the input"
    INPUT_DELAY = "dead time of one of several inputs"
    FEEDBACK = "inputs that answer to the noise of an output at once"
    COLOURED_NOISE = "coloured noise"
    INPUT_NOISE = "noise on the input"
    GAIN_NOISE = "noise that grows with the gain"
    LOSSES = "losses, or residues that no lossless model has"
    COMPLEX_SHAPES = "mode shapes that are not real"
    SAME_COLUMNS = "two columns that are the same"
    SWAPPED = "an output as broad as a test signal, and an input with resonances"
    ACTIVITY = "energy that no passive model gives"
    SEVERAL_SHAPES = "residues of more than one shape"
    ONE_WAY = "responses that are not reciprocal"
    COLOURED_RESIDUALS = "residuals that are coloured"
    OUTLIERS = "values far out of the noise"
    SATURATION = "an output that stays at an end of its range"
    ROUNDED = "an output that is rounded to steps larger than its noise"
    WILD_LINES = "lines of a response far out of all others"
    POLARITY = "a sensor that points against the force"
    HUM = "tone that no input drives"
    UNEQUAL_NOISE = "noise that differs between experiments"
    FORCES = "forces that were not measured"
    CORRELATED_NOISE = "noise that outputs share"
    AMBIENT = "ambient excitation"
    CHANGING_NOISE = "noise that changes within a recording"
    CHANGING_FORCES = "forces that nobody measured and that change within a recording"
    SLOW_NOISE = "slow noise of a sensor, or forces that change slowly"
    STUCK = "an output that stays at one value for a part of a recording"
    CHANGING_MODE = "mode that differs between the halves of the recordings"
    MULTIPLE = "mode of a decay that is made of others by a law that is not linear"
    HAMMER_NOISE = "noise of a hammer's force between its contacts"
    CONTACT_NOISE = "noise of a hammer's force within its contacts"
    LARGEST_ORDER = "as many modes as the search may find"
    FEWER_MODES = "fewer modes than the order that was given"
    FASTEST_GROWTH = "poles that grow as much over a recording as they may"
    INTEGRATOR = "poles that the data do not tell from 0"
    WRONG_MODEL = "responses that no parameters of the model function give"
    PARAMETER_BOUND = "a parameter that ends at a bound"
    UNIDENTIFIED = "a combination of parameters that leaves no trace"


# what the data show where they reject a hypothesis
REJECTED = {name: Cause[hypothesis.cause] for name, hypothesis in HYPOTHESES.items()}
REJECTED |= {"parametric": Cause.WRONG_MODEL}


@dataclass(frozen=True)
class Finding:
    """A circumstance of the record, its size, and what it gains.

    Attributes
    ----------
    cause : Cause
        What it is.
    values : tuple of float
        Of a constant its value in each record; of a drift its change per unit time in each; of a delay the samples by
        which the output lags, or, where the model has it, the time and its standard error; of a dead time of one input
        that time; of a feedback the correlation of the noise with what is new in an input; of coloured noise the
        coefficients `phi` of `e_k = sum phi_j e_(k-j) + white`; of noise on the input its size over that of the input,
        and the standard deviation of the white noise beside it; of noise that grows with the gain its standard
        deviation over the gain, of each entry row by row; of a hold 0 for an input that was held, 1 for a linear one;
        of a hypothesis that is rejected its p-value and degrees of freedom; of a real pole its rate, and the share
        that it explains of what the modes leave; of coloured residuals the ends of the band about the peak of their
        spectrum, rad per unit time, the density there over its geometric mean, and the share of their power; of
        outliers their places, counted from 0; of an output that stays at an end of its range how many samples do, and
        that end or both; of one that is rounded the step, and how many values it takes; of the noise of a hammer's
        force its standard deviation, and the peak of the force; within contacts also how many times the standard
        errors of residues grow by it; of noise or forces that change the first sample of each span, counted from 0,
        and the noise there over its geometric mean, one after the other; of slow noise the rates of its real poles; of
        an output that stays at one value the first of these samples, how many they are, and that value; of a mode that
        changes its natural frequency in the first halves and in the second, and its damping ratios there; of a
        multiple its frequency, and those that it is the sum of; of wild lines their frequencies, rad per unit time; of
        the largest order that order; of fewer modes the order that was given, and how many reproduce the data; of
        poles that grow as they may the fastest rate, and the factor over the longest recording; of poles that may be 0
        how many they are, and the p-value of 0; of forces that were not measured the root mean square of what inputs
        do not explain over that of each output; of noise that outputs share the largest correlation; of a parameter at
        a bound its value; of a combination of parameters the relative changes of all that leave no trace together; of
        columns that are the same the factor between them; of swapped columns the flatness of the spectrum of the input
        and of the output, 1 for white noise.
    gain : float
        How much the log-likelihood grows by it; of a hold, over the other one; 0 of outliers and ends of the range, and
        of what is not taken into account.
    output : str
        The output that shows it, of several channels; of a response with its input; of a dead time the input; of
        parameters their names.
    experiment : int
        Which of several experiments has these outliers, or that range, counted from 0.
    """

    cause: Cause
    values: tuple[float, ...]
    gain: float
    output: str = ""
    experiment: int = 0

    def __repr__(self) -> str:
        values = first_of([f"{value:.4g}" for value in self.values], _SHOWN, ", ... {} more")
        parts = [f"({values})", f"gain={self.gain:.4g}"]
        parts += [f"output={self.output!r}"] * bool(self.output)
        parts += [f"experiment={self.experiment}"] * bool(self.experiment)
        return f"Finding({self.cause.name}, {', '.join(parts)})"


# --- in words --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Terms:
    """What a sentence about a finding is made of, beside the finding."""

    intersample: str
    time_unit: str | None

    @property
    def frequency_unit(self) -> str:
        """Hz where the unit of time is known."""
        return "Hz" if self.time_unit else "rad per unit time"

    def frequency(self, omega: float) -> float:
        """A frequency in that unit."""
        return omega / hertz_size(self.time_unit) if self.time_unit else omega


def _gain(finding: Finding) -> str:
    return f"log-likelihood {'-' if finding.gain < 0 else '+'} {abs(finding.gain):.3g}"


def _listed_values(finding: Finding) -> str:
    return first_of([f"{value:.3g}" for value in finding.values], 4, ", ...")


def _experiment(finding: Finding, word: str) -> str:
    return f" {word} experiment {finding.experiment + 1}" * bool(finding.experiment)


def _of_constant(finding: Finding, terms: _Terms) -> str:
    constants = _listed_values(finding)
    return f"The output has a constant of {constants} beside the modes ({_gain(finding)}), estimated along with them."


def _of_drift(finding: Finding, terms: _Terms) -> str:
    slopes = _listed_values(finding)
    return f"The output drifts by {slopes} per unit time ({_gain(finding)}), estimated along with the modes."


def _of_hold(finding: Finding, terms: _Terms) -> str:
    preferred = HOLDS[int(finding.values[0])]
    between = "held" if preferred == "zoh" else "linear"
    if preferred == terms.intersample and finding.gain < TUNING.sure:
        return (
            f"The record does not tell whether the input between samples was held or linear: it is taken as {between}; "
            "if you know it, pass intersample='zoh' or 'foh'."
        )
    if preferred == terms.intersample:
        return f"The input between samples was {between} ({_gain(finding)} over the other)."
    return f"The data show an input that was {between} between samples ({_gain(finding)}): intersample={preferred!r}."


def _of_delay(finding: Finding, terms: _Terms) -> str:
    late, error = finding.values
    which = repr(finding.output) if finding.output else "The output"
    unit = terms.time_unit or "units of time"
    if np.isnan(error):
        amount = f"{abs(late):.6g} {unit} (known to a sample only)"
    else:
        amount = f"{to_its_error(abs(late), error)} {unit}" + f" (+- {to_its_error(error, error)})" * (error > 0)
    return (
        f"{which} comes {amount} {'later' if late > 0 else 'earlier'} than the response to the input "
        f"({_gain(finding)}); the delay is in predictions, and not in system."
    )


def _of_input_delay(finding: Finding, terms: _Terms) -> str:
    return (
        f"The input {finding.output!r} acts {finding.values[0]:.6g} {terms.time_unit or 'units of time'} later "
        f"({_gain(finding)} by all dead times); that is in predictions, and not in system."
    )


def _of_fastest_growth(finding: Finding, terms: _Terms) -> str:
    return (
        f"A pole grows as fast as it may, by a factor of {finding.values[1]:.1g} over the recording: it stands for "
        "noise, or for a plant that is unstable and grows by more. Of such a plant cut recordings into parts in which "
        "it grows by 1e5 at most, and pass these as a list."
    )


def _of_feedback(finding: Finding, terms: _Terms) -> str:
    return (
        f"What is new in an input goes with the noise of {finding.output!r} in the same sample (correlation "
        f"{finding.values[0]:.2g}), as behind a controller: inputs are taken to be held, and to act from the next "
        "sample on."
    )


def _of_rejection(finding: Finding, terms: _Terms) -> str:
    hypothesis = next(name for name, cause in REJECTED.items() if cause is finding.cause)
    return f"The data show {finding.cause.value}: they reject {hypothesis!r} ({p_value(finding.values[0])})."


def _of_complex_shapes(finding: Finding, terms: _Terms) -> str:
    return (
        f"The data reject 'classical' ({p_value(finding.values[0])}): mode shapes are complex. Damping that is spread "
        "otherwise than mass and stiffness makes them so; channels sampled one after the other, and modes beyond the "
        "measured band, can too."
    )


def _of_same_columns(finding: Finding, terms: _Terms) -> str:
    factor = finding.values[0]
    times = "" if abs(factor - 1) < 1e-9 else f" up to a factor of {factor:.4g}"
    return f"The columns {finding.output} are the same{times}: probably one was chosen, or exported, twice; check both."


def _of_swapped(finding: Finding, terms: _Terms) -> str:
    return (
        f"The columns of input and output are probably swapped: {finding.output} is the response by its spectrum, "
        f"whose flatness is {finding.values[0]:.2g} beside {finding.values[1]:.2g}; exchange input= and output=."
    )


def _of_polarity(finding: Finding, terms: _Terms) -> str:
    return (
        f"The residues of {finding.output!r} at its driving point oppose the force in all modes: check the "
        "polarity of the sensor, or whether it is where the force acts."
    )


def _of_gain_noise(finding: Finding, terms: _Terms) -> str:
    sizes = dict.fromkeys(f"{100 * size:.2g} %" for size in (min(finding.values), max(finding.values)))
    return (
        f"The noise grows with the gain, by {' to '.join(sizes)} of it ({_gain(finding)}): each "
        "point is weighted by this estimate."
    )


def _of_coloured_residuals(finding: Finding, terms: _Terms) -> str:
    low, high, size, share = finding.values
    low, high = terms.frequency(low), terms.frequency(high)
    return (
        f"The residuals of {finding.output!r} are coloured ({_gain(finding)}): {100 * share:.0f} % of their power lies "
        f"between {low:.4g} and {high:.4g} {terms.frequency_unit}, at {size:.3g} times the mean density (geometric)."
    )


def _of_hum(finding: Finding, terms: _Terms) -> str:
    frequency, *parts = finding.values
    largest = float(np.hypot(parts[::2], parts[1::2]).max())
    return (
        f"A tone of {terms.frequency(frequency):.6g} {terms.frequency_unit}{_experiment(finding, 'in')} that no input "
        f"drives, with an amplitude of up to {largest:.3g} ({_gain(finding)}), is hum and no mode: it is part of the "
        "predictions."
    )


def _of_unequal_noise(finding: Finding, terms: _Terms) -> str:
    quiet, loud = int(np.argmin(finding.values)) + 1, int(np.argmax(finding.values)) + 1
    return (
        f"The noise of experiment {loud} is {max(finding.values) / min(finding.values):.3g} times that of experiment "
        f"{quiet} ({_gain(finding)}): each experiment counts by its own."
    )


def _of_forces(finding: Finding, terms: _Terms) -> str:
    shares = dict.fromkeys(f"{100 * share:.2g} %" for share in (min(finding.values), max(finding.values)))
    return (
        f"Forces that were not measured, or noise of the recorded inputs, move the plant ({_gain(finding)}): of the "
        f"outputs {' to '.join(shares)} is no response to the inputs. Errors and tests are those beside such forces; "
        "more force, or a longer record, makes them smaller. Noise of the inputs also makes residues smaller, by its "
        "share of their squares."
    )


def _of_ambient(finding: Finding, terms: _Terms) -> str:
    decay = f" rather than one motion that decays ({_gain(finding)})" * (finding.gain > 0)
    return (
        f"Forces that nobody measured, white over frequency, kept the plant in motion{decay}: predictions are one "
        "step ahead."
    )


def _of_correlated_noise(finding: Finding, terms: _Terms) -> str:
    return (
        f"The noise of the outputs is correlated ({_gain(finding)}), that of {finding.output} by "
        f"{finding.values[0]:.2g}, as with a common supply or ground: errors and tests are those of such noise."
    )


def _of_changing_noise(finding: Finding, terms: _Terms) -> str:
    which = f"The noise{f' of {finding.output!r}' * bool(finding.output)}"
    if not finding.gain:
        return (
            f"{_of_changing_levels(which, finding)}. Errors are those of noise that stays the same; look for what went "
            "on there, as a loose cable, and leave that part out, or the output."
        )
    return (
        f"{_of_changing_levels(which, finding)} ({_gain(finding)}). Each sample counts by the noise of its span; look "
        "for what went on there, as a loose cable or a machine nearby."
    )


def _of_changing_forces(finding: Finding, terms: _Terms) -> str:
    levels = _of_changing_levels("The size of what cannot be predicted", finding)
    if not finding.gain:
        return (
            f"{levels}, by forces or by noise of the sensors. Errors are those of a steady motion; fit the parts by "
            "fit_many, and compare them."
        )
    return f"{levels} ({_gain(finding)}): forces are not steady, and each sample counts by the size of its span."


def _of_changing_levels(which: str, finding: Finding) -> str:
    starts, sizes = finding.values[::2], finding.values[1::2]
    quiet, ends = min(sizes), (*starts[1:], np.inf)
    spans = [
        f"{size / quiet:.3g} times from sample {start:.0f}{f' to {end - 1:.0f}' if np.isfinite(end) else ' on'}"
        for start, end, size in zip(starts, ends, sizes, strict=True) if size > quiet
    ]  # fmt: skip
    listed = first_of(spans, _LISTED, ", ...")
    return f"{which}{_experiment(finding, 'in')} changes: beside its lowest level it is {listed}"


def _of_slow_noise(finding: Finding, terms: _Terms) -> str:
    poles = f"{'a real pole' if len(finding.values) == 1 else 'real poles'} of rate {_listed_values(finding)}"
    if finding.output:
        return (
            f"{finding.output!r} has slow motion of its own, {poles}: a drift or coloured noise of the sensor, and no "
            "mode."
        )
    return f"Outputs show slow motion, {poles}: forces that are not white, or sensors that wander, and no mode."


def _of_stuck(finding: Finding, terms: _Terms) -> str:
    first, count, value = finding.values
    return (
        f"{finding.output!r}{_experiment(finding, 'in')} stays at {value:.6g} for {count:.0f} samples from sample "
        f"{first:.0f} on: a sensor or cable that failed. Leave these samples out, or the output."
    )


def _of_changing_mode(finding: Finding, terms: _Terms) -> str:
    first, second, damping, then = finding.values
    unit = terms.frequency_unit
    return (
        f"A mode has {terms.frequency(first):.6g} {unit} and {100 * damping:.3g} % damping in the first half of the "
        f"recording, {terms.frequency(second):.6g} {unit} and {100 * then:.3g} % in the second ({_gain(finding)}): it "
        "depends on the amplitude, or the plant changed. Errors are those of one plant; fit the parts by fit_many, or "
        "repeat the test with less force."
    )


def _of_multiple(finding: Finding, terms: _Terms) -> str:
    own, *parts = finding.values
    made = " ".join(f"{'-' if part < 0 else '+'} {terms.frequency(abs(part)):.6g}" for part in parts).removeprefix("+ ")
    return (
        f"The mode at {terms.frequency(own):.6g} {terms.frequency_unit} has the frequency and the decay of {made}: "
        "distortion of a spring or a sensor that is not linear, and no mode. Repeat the decay from a smaller amplitude."
    )


def _of_hammer_noise(finding: Finding, terms: _Terms) -> str:
    noise, peak = finding.values
    return (
        f"Outside the contacts of the hammer the force was set to 0: noise of {noise:.2g} beside a peak of "
        f"{peak:.3g}, as a force, would explain the outputs less well."
    )


def _of_contact_noise(finding: Finding, terms: _Terms) -> str:
    noise, peak, growth = finding.values
    return (
        f"Within the contacts of the hammer that noise of {noise:.2g} beside a peak of {peak:.3g} errs in each hit "
        f"({_gain(finding)}): forces are corrected by what one hit has apart from the others, and standard errors of "
        f"residues are up to {growth:.2g} times those of noise of the outputs alone. More hits make them smaller, and "
        "a range of the force channel that its peak fills."
    )


def _of_saturation(finding: Finding, terms: _Terms) -> str:
    count, *ends = finding.values
    return (
        f"{finding.output!r}{_experiment(finding, 'in')} stays at {' or '.join(f'{end:.6g}' for end in ends)} for "
        f"{count:.0f} samples, the end of its range: a sensor or amplifier that saturates. Mark these samples with "
        "NaN, or repeat the test with less gain or force."
    )


def _of_wild_lines(finding: Finding, terms: _Terms) -> str:
    listed = first_of([f"{terms.frequency(line):.6g}" for line in finding.values], _LISTED, ", ...")
    return (
        f"The response{_experiment(finding, 'of')} was left out at {listed} {terms.frequency_unit}: values there "
        "do not go with the modes that explain all others, as where an integrated signal is divided by a frequency "
        "of 0. Mark them with NaN."
    )


def _of_largest_order(finding: Finding, terms: _Terms) -> str:
    order = finding.values[0]
    return f"The search ended at max_order={order:.0f}: there may be more modes; give a larger max_order."


def _of_fewer_modes(finding: Finding, terms: _Terms) -> str:
    given, enough = finding.values
    return (
        f"Of the {given:.0f} modes of the order that was given {enough:.0f}, real poles counted in pairs, reproduce "
        "the data as far as they show any; of others nothing is seen."
    )


def _of_integrator(finding: Finding, terms: _Terms) -> str:
    count, p_value = finding.values
    poles, plant = ("A pole", "an integrator") if count == 1 else ("Two poles", "a double integrator, as a free mass")
    return f"{poles} may be 0 (p = {p_value:.2g}): {plant}."


def _of_parameter_bound(finding: Finding, terms: _Terms) -> str:
    return (
        f"{finding.output} ended at its bound {finding.values[0]:.6g}, and is held there: others have their errors so."
    )


def _of_unidentified(finding: Finding, terms: _Terms) -> str:
    several = sum(abs(value) > 1e-3 for value in finding.values) > 1
    what = "The combination of relative changes" if several else "The parameter"
    return f"{what} {finding.output} leaves no trace in the data: hold it, or measure where it shows."


def _of_rounded(finding: Finding, terms: _Terms) -> str:
    step, count = finding.values
    return (
        f"{finding.output!r}{_experiment(finding, 'in')} is rounded to steps of {step:.3g} ({count:.0f} values), "
        "which are larger than its noise: each sample counts by how likely it is to be rounded so. More digits, or a "
        "converter with a smaller range, tell more."
    )


def _of_outliers(finding: Finding, terms: _Terms) -> str:
    which = f"Values of {finding.output!r}{_experiment(finding, 'in')}"
    return far_out(which, [str(int(place)) for place in finding.values])


def _of_input_noise(finding: Finding, terms: _Terms) -> str:
    size = finding.values[0]
    return (
        f"The residuals of {finding.output!r} grow with the response, as with {100 * size:.2g} % more input "
        f"({_gain(finding)}): unmeasured forces, or noise on the recorded input, which makes residues "
        f"smaller, by {100 * size**2 / (1 + size**2):.2g} % for white inputs."
    )


_SENTENCES: dict[Cause, Callable[[Finding, _Terms], str]] = {
    Cause.CONSTANT: _of_constant, Cause.DRIFT: _of_drift, Cause.HOLD: _of_hold, Cause.DELAY: _of_delay,
    Cause.INPUT_DELAY: _of_input_delay, Cause.FEEDBACK: _of_feedback,
    Cause.POLARITY: _of_polarity, Cause.GAIN_NOISE: _of_gain_noise, Cause.COLOURED_RESIDUALS: _of_coloured_residuals,
    Cause.HUM: _of_hum, Cause.UNEQUAL_NOISE: _of_unequal_noise, Cause.FORCES: _of_forces,
    Cause.CORRELATED_NOISE: _of_correlated_noise, Cause.AMBIENT: _of_ambient,
    Cause.CHANGING_NOISE: _of_changing_noise, Cause.CHANGING_FORCES: _of_changing_forces,
    Cause.SLOW_NOISE: _of_slow_noise, Cause.STUCK: _of_stuck,
    Cause.CHANGING_MODE: _of_changing_mode, Cause.MULTIPLE: _of_multiple,
    Cause.HAMMER_NOISE: _of_hammer_noise, Cause.CONTACT_NOISE: _of_contact_noise,
    Cause.SATURATION: _of_saturation, Cause.ROUNDED: _of_rounded, Cause.WILD_LINES: _of_wild_lines,
    Cause.LARGEST_ORDER: _of_largest_order, Cause.FEWER_MODES: _of_fewer_modes, Cause.OUTLIERS: _of_outliers,
    Cause.INPUT_NOISE: _of_input_noise, Cause.PARAMETER_BOUND: _of_parameter_bound, Cause.INTEGRATOR: _of_integrator,
    Cause.FASTEST_GROWTH: _of_fastest_growth,
    Cause.UNIDENTIFIED: _of_unidentified, **dict.fromkeys(REJECTED.values(), _of_rejection),
    Cause.COMPLEX_SHAPES: _of_complex_shapes, Cause.SAME_COLUMNS: _of_same_columns, Cause.SWAPPED: _of_swapped,
}  # fmt: skip

# what doubts the data comes first, then what doubts the model, then what the model has beside the modes
_FIRST = (
    Cause.SAME_COLUMNS, Cause.SWAPPED, Cause.POLARITY, Cause.STUCK, Cause.SATURATION, Cause.OUTLIERS, Cause.ROUNDED,
    Cause.WILD_LINES, Cause.CHANGING_MODE, Cause.MULTIPLE, Cause.WRONG_MODEL, Cause.UNIDENTIFIED, Cause.PARAMETER_BOUND,
    Cause.LARGEST_ORDER, Cause.FEWER_MODES, *REJECTED.values(), Cause.INPUT_NOISE, Cause.COLOURED_RESIDUALS,
)  # fmt: skip
_MOST = 9  # sentences about findings: some ten lines
# what several outputs show, in place of a sentence for each
_TOGETHER = {
    Cause.COLOURED_RESIDUALS: "The residuals of {} outputs are coloured ({}). The most so:",
    Cause.INPUT_NOISE: "The residuals of {} outputs grow with the response ({}). The most so:",
    Cause.OUTLIERS: "{} outputs have values far outside the noise ({}). Of them:",
    Cause.SATURATION: "{} outputs stay at an end of their range ({}). Of them:",
    Cause.ROUNDED: "{} outputs are rounded to steps larger than their noise ({}). Of them:",
    Cause.POLARITY: "{} sensors oppose the force at their driving points ({}). Of them:",
    Cause.CHANGING_NOISE: "The noise of {} outputs changes ({}). The most so:",
    Cause.DELAY: "{} outputs come later or earlier than the response to the inputs ({}), by delay. The most so:",
    Cause.INPUT_DELAY: "{} inputs act later ({}); input_delay has them all. The first:",
}


def sentences_of(findings: Sequence[Finding], intersample: str, time_unit: str | None = None) -> list[str]:
    """What findings say: the most important first, one sentence for several outputs, and at most a dozen lines."""
    place = {cause: k for k, cause in enumerate(_FIRST)}
    ordered = sorted(findings, key=lambda finding: place.get(finding.cause, len(place)))
    sentences = list[str]()
    for cause in dict.fromkeys(finding.cause for finding in ordered):
        alike = [finding for finding in ordered if finding.cause is cause]
        channels = list(dict.fromkeys(finding.output for finding in alike))
        if cause not in _TOGETHER or len(channels) < 2:
            sentences += [sentence_of(finding, intersample, time_unit) for finding in alike]
            continue
        largest = max(alike, key=_prominence)
        together = _TOGETHER[cause].format(len(channels), first_of([*map(repr, channels)], _LISTED))
        sentences.append(f"{together} {sentence_of(largest, intersample, time_unit)}")
    rest = len(sentences) - _MOST
    return sentences if rest < 2 else [*sentences[:_MOST], f"{rest} more are in findings."]


def _prominence(finding: Finding) -> float:
    """Size by which one finding of several outputs stands for all."""
    return abs(finding.values[0]) if finding.cause in (Cause.DELAY, Cause.SATURATION, Cause.ROUNDED) else finding.gain


def sentence_of(finding: Finding, intersample: str, time_unit: str | None = None) -> str:
    """What a finding says, and what to do about it; frequencies in Hz where the unit of time is known."""
    return _SENTENCES[finding.cause](finding, _Terms(intersample, time_unit))


def far_out(which: str, places: Sequence[str]) -> str:
    """That some values stand out of the noise, and what to do about it."""
    listed = first_of(places, _LISTED)
    return (
        f"{which} far outside the noise (counted from 0): {listed}. If they are measurement errors, mark them with NaN."
    )
