"""What a record shows of a model, in numbers, a table and sentences."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

import numpy as np

from ..._display import Report, aligned, counted
from ..._frozen import Frozen, ReadOnlyMapping
from ..._options import Discretisation
from ..._types import Array
from ..._units import rate, step_of
from ..uncertainty.fisher import Combination, Information, listed, named_modes
from .excited_band import ExcitedBand
from .scan import SPACING, Scan

_TOLD = 3  # combinations, modes or pairs described one by one


class OfInformation:
    """Names, rank and combinations without a trace, of a report that has the `information`."""

    information: Information

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns, modes and poles counted from 1."""
        return self.information.names

    @property
    def rank(self) -> int:
        """Number of independent combinations of unknowns that the records show."""
        return self.information.rank

    @property
    def singular_values(self) -> Array:
        """Singular values of the sensitivities scaled to unit length, descending; squared, those of the information."""
        return self.information.singular_values

    @property
    def condition(self) -> float:
        """Condition number of the information scaled to unit diagonal; `inf` where a combination is blind."""
        return self.information.condition

    @property
    def blind(self) -> tuple[Combination, ...]:
        """Combinations of unknowns that leave no trace in the outputs."""
        return self.information.blind

    @property
    def nearly_blind(self) -> tuple[Combination, ...]:
        """Combinations whose errors are inflated more than a hundred times."""
        return self.information.nearly_blind

    @property
    def blind_parameters(self) -> tuple[str, ...]:
        """Names of the unknowns that the records do not determine, however little the noise."""
        return self.information.blind_parameters


@dataclass(frozen=True, eq=False, repr=False)
class Excitation(OfInformation, Report, Frozen):
    """What a record can and cannot show; made by `excitation`.

    Attributes
    ----------
    samples : int
        Number of samples T.
    observed : int
        Number of them whose output counts.
    dt : float
        Time between samples.
    method : str
        How the model meets the samples.
    from_rest : bool
        Whether the initial state is known to be 0.
    d, r : ndarray, shape (n,)
        Model at which the record was judged; for a number of modes, modes spread over the excited band.
    apparent : ndarray, shape (n,)
        Frequencies at which the modes appear in the samples.
    information : Information
        The Fisher information, factored, for unit noise.
    noise_std : float
        Standard deviation of the output noise; NaN if not known.
    band : ExcitedBand
        Where the input has power, and its order of excitation.
    above_nyquist : tuple of int
        Modes, counted from 0, that turn by more than half a turn a step.
    unresolved : tuple of (int, int)
        Pairs of modes closer than one bin, `2 pi / (T dt)`.
    slow : tuple of int
        Modes that complete less than a period within the record.
    artefacts : tuple of Combination
        What only the integration rule shows: blind for an exact hold.
    driven_zeros : tuple of float
        Spectral lines of the input that lie on a zero of the model, which does not answer them.
    scan : Scan or None
        For a number of modes: what is shown at which frequencies.
    remedies : tuple of str
        What to change, each as an instruction.
    time_unit : str or None
        Unit of time of the record; None where it is not known.

    Examples
    --------
    >>> import numpy as np, ph_control as phc
    >>> u = np.random.default_rng(0).standard_normal(1000)
    >>> print(phc.excitation((u, None), phc.modes([0.5, 2.0], [1.0, 0.25]), dt=0.1))
    The record shows d, r and the initial state of 2 modes.
    """

    samples: int
    observed: int
    dt: float
    method: Discretisation
    from_rest: bool
    d: Array
    r: Array
    apparent: Array
    information: Information
    noise_std: float
    band: ExcitedBand
    above_nyquist: tuple[int, ...]
    unresolved: tuple[tuple[int, int], ...]
    slow: tuple[int, ...]
    artefacts: tuple[Combination, ...]
    driven_zeros: tuple[float, ...]
    scan: Scan | None
    remedies: tuple[str, ...]
    time_unit: str | None = None

    @property
    def n(self) -> int:
        """Number of modes."""
        return len(self.d)

    @property
    def inflation(self) -> Mapping[str, Array]:
        """Factors by which not knowing the other parameters enlarges the errors: keys 'd', 'r', 'initial_state'."""
        return self._parts(self.information.inflation)

    @property
    def stderr(self) -> Mapping[str, Array]:
        """Cramer-Rao bounds under the keys 'd', 'r', 'initial_state'.

        The initial state as `(Re x(0), Im x(0))`.  `inf` where blind; NaN elsewhere if the noise is not known.
        """
        return self._parts(self.information.stderr(self.noise_std))

    def _parts(self, values: Array) -> Mapping[str, Array]:
        n = self.n
        return ReadOnlyMapping({"d": values[:n], "r": values[n : 2 * n], "initial_state": values[2 * n :]})

    @property
    def uncertain(self) -> tuple[str, ...]:
        """Frequencies and weights whose standard error exceeds their value, though they are not blind."""
        names = []
        for key, value in (("d", self.d), ("r", self.r)):
            large = np.isfinite(self.stderr[key]) & (self.stderr[key] > value) & (value > 0)
            names += [f"{key}_{l + 1}" for l in np.flatnonzero(large)]
        return tuple(names)

    @property
    def sufficient(self) -> bool:
        """Whether the record shows all parameters of the model."""
        doubts = (self.above_nyquist, self.unresolved, self.artefacts, self.uncertain)
        nowhere = self.scan is not None and not self.scan.shown
        return not (self.information.is_weak or any(doubts) or nowhere)

    def _relative_error(self, name: str) -> float:
        """Standard error of a parameter such as `d_1` over its value."""
        l = int(name[2:]) - 1
        return float(self.stderr[name[0]][l] / (self.d if name[0] == "d" else self.r)[l])

    @property
    def headline(self) -> str:
        """The verdict, in a few words."""
        count = counted(self.n, "mode")
        what = "d and r" if self.from_rest else "d, r and the initial state"
        if self.sufficient:
            return f"shows {what} of {count}"
        if self.blind:
            direct = [name for name in self.blind_parameters if name[0] in "dr"]
            return f"does NOT show {listed(direct) if direct else 'the initial state'}"
        if self.artefacts:
            return f"shows {what} of {count} by an artefact of the integration rule only"
        if self.nearly_blind:
            return f"hardly shows {_first(self.nearly_blind)}"
        if self.uncertain:
            return f"is too noisy for {listed(list(self.uncertain))}"
        return f"shows {count} in doubt"

    @property
    def message(self) -> str:
        """The gravest reason for the verdict and the first remedy, a sentence each; empty where all is well."""
        return " ".join(_in_brief(self))

    @property
    def details(self) -> str:
        """All that the verdict rests on, and all remedies, in sentences; empty if there is nothing to say."""
        return " ".join(_sentences(self))

    def __str__(self) -> str:
        return f"The record {self.headline}. {self.message}".rstrip()

    def summary(self) -> str:
        """Report for people: information, bounds for each mode, excited band, verdict.

        Returns
        -------
        str
            Several lines: the table at most 120 characters wide, the sentences 100.

        Notes
        -----
        O(n) on top of what was computed before.

        Examples
        --------
        >>> import numpy as np, ph_control as phc
        >>> print(phc.excitation((np.sin(0.1 * np.arange(500)), None), ([0.5, 2.0], [1.0, 0.25]), dt=0.1).summary())
        What the record shows of 2 modes
          verdict         does NOT show r_1 and r_2
          record          500 samples, step 0.1: one bin is 0.1257 rad/time, Nyquist 31.42 rad/time
          excited band    1 spectral line, at 1 rad/time
        ...
        """
        information, unit = self.information, rate(self.time_unit)
        size = len(self.names)
        more = "at least " * self.band.full
        smallest = information.singular_values[-1] / max(information.singular_values[0], np.finfo(float).tiny)
        lines = [
            f"What the record shows of {counted(self.n, 'mode')}"
            + (" spread over the excited band" if self.scan is not None else ""),
            f"  verdict         {self.headline}",
            f"  record          {self.samples} samples, {step_of(self)}: one bin is {self.band.bin:.4g} {unit}, "
            f"Nyquist {np.pi / self.dt:.4g} {unit}",
            f"  excited band    {self.band}",
            f"  order           {more}{self.band.order} (of persistent excitation)",
            f"  information     rank {information.rank} of {size}, smallest singular value {smallest:.1e} relative",
            *([f"  shown at        {self.scan}"] if self.scan is not None else []),
            *([f"  noise           standard deviation {self.noise_std:.4g}"] if self.noise_std >= 0 else []),
            "",
        ]
        head = ["mode", f"d [{unit}]", "+-", "weight r", "+-", "d inflated", "r inflated", "note"]
        lines += aligned([head, *map(self._row, range(self.n))])
        if self.details:
            # a name such as "Re x_1(0)" is not broken
            text = self.details.replace("Re x", "Re\xa0x").replace("Im x", "Im\xa0x")
            wrapped = textwrap.wrap(text, 100, initial_indent="  ", subsequent_indent="  ")
            lines += ["", *(line.replace("\xa0", " ") for line in wrapped)]
        return "\n".join(lines)

    def _row(self, l: int) -> list[str]:
        note = "" if self.apparent[l] in self.band else "outside the band"
        if l in self.above_nyquist:
            note = f"above Nyquist, appears at {self.apparent[l]:.4g}"
        elif l in self.slow:
            note = "less than a period"
        d, r = (["-" if np.isnan(error) else f"{error:.2g}"] for error in (self.stderr["d"][l], self.stderr["r"][l]))
        inflated = [f"{self.inflation[key][l]:.3g}" for key in ("d", "r")]
        return [str(l + 1), f"{self.d[l]:.6g}", *d, f"{self.r[l]:.6g}", *r, *inflated, note]


def _in_brief(report: Excitation) -> Iterator[str]:
    """One reason and one remedy."""
    if report.blind and report.observed >= len(report.names):
        lost = _lost_weights(report)
        so = f", so {lost} cannot be learned from this record" if lost else ""
        yield f"Blind: {_first(report.blind)} can change without any change of the output{so}."
    elif report.nearly_blind and not report.artefacts:
        worst = report.nearly_blind[0].inflation
        yield f"Hardly seen, with errors inflated up to {worst:.2g} times: {_first(report.nearly_blind)}."
    else:
        yield from islice(_sentences(report), 1)
    if report.remedies:
        yield f"Remedy: {report.remedies[0]}."


def _lost_weights(report: Excitation) -> str:
    """Weights that the record does not determine, in words."""
    weights = [name for name in report.blind_parameters if name.startswith("r")]
    return "r" if len(weights) == report.n else listed(weights) if weights else ""


def _first(combinations: tuple[Combination, ...]) -> str:
    """The first combination in words, and how many others there are."""
    more = len(combinations) - 1
    return combinations[0].words + f", and {counted(more, 'other combination')}" * bool(more)


def _sentences(report: Excitation) -> Iterator[str]:
    """What the verdict rests on, the gravest first."""
    if report.observed < len(report.names):
        yield f"It has {counted(report.observed, 'observed sample')} for {counted(len(report.names), 'unknown')}."
    if not report.sufficient:
        yield from _of_blindness(report)
        yield from _of_the_input(report)
        yield from _of_errors(report)
        yield from _of_time(report)
    if report.scan is not None:
        group = f"{report.n} modes {SPACING:g} bins apart" if report.n > 1 else "One mode"
        where = "at " * bool(report.scan.shown) + str(report.scan)
        yield f"{group}, tried at {len(report.scan.frequencies)} frequencies: the weights are shown {where}."
    if report.remedies:
        word = "Remedies" if len(report.remedies) > 1 else "Remedy"
        yield f"{word}: " + "; ".join(report.remedies) + "."


def _some(combinations: tuple[Combination, ...]) -> str:
    more = len(combinations) - _TOLD
    shown = "; ".join(str(combination) for combination in combinations[:_TOLD])
    return shown + (f"; and {more} more" if more > 0 else "")


def _of_blindness(report: Excitation) -> Iterator[str]:
    if report.blind and report.observed >= len(report.names):
        yield f"Blind: {_some(report.blind)} can change without any change of the output."
    if lost := _lost_weights(report):
        yield f"So {lost} cannot be learned from this record, however little noise there is."
    silent = [l + 1 for l in range(report.n) if report.r[l] == 0]
    if silent:
        yield f"Of {named_modes(silent)} r is 0, so that the input says nothing of the frequency."
    if report.artefacts:
        yield (
            f"With an exact hold {_some(report.artefacts)} would be blind: what tells them apart here is the growth of "
            "Euler's rule, an artefact that no real recording has."
        )


def _of_the_input(report: Excitation) -> Iterator[str]:
    shown = report.band.shown_weights
    if not report.from_rest and report.information.deficiency >= report.n - shown > 0:
        most = f"at most {counted(int(shown), 'weight')}" if shown else "no weight"
        yield (
            f"The input ({report.band}; order of excitation {report.band.order}) shows {most} r beside an unknown free "
            f"motion, and the model has {report.n}."
        )
    unit = rate(report.time_unit)
    for zero in report.driven_zeros:
        yield f"The line at {zero:.4g} {unit} drives a zero of the model, which does not answer it in the long run."
    driven = [l for l in range(report.n) if report.r[l] > 0 and l not in report.above_nyquist]
    outside = [l + 1 for l in driven if report.apparent[l] not in report.band]
    if outside and report.band.intervals and report.scan is None:
        where = listed([f"{report.apparent[l - 1]:.4g}" for l in outside])
        yield f"Outside the excited band: {named_modes(outside)}, at {where} {unit}."


def _of_errors(report: Excitation) -> Iterator[str]:
    if report.nearly_blind:
        worst = report.nearly_blind[0]
        yield f"Hardly seen, with errors inflated up to {worst.inflation:.2g} times: {_some(report.nearly_blind)}."
    if report.uncertain:
        errors = [f"{report._relative_error(name):.2g} times {name}" for name in report.uncertain]
        yield f"With noise of standard deviation {report.noise_std:.3g} the standard error is {listed(errors)}."


def _of_time(report: Excitation) -> Iterator[str]:
    unit = rate(report.time_unit)
    for l in report.above_nyquist[:_TOLD]:
        yield (
            f"Mode {l + 1}, at {report.d[l]:.4g} {unit}, lies above the Nyquist frequency {np.pi / report.dt:.4g} and "
            f"looks like one at {report.apparent[l]:.4g}."
        )
    for j, k in report.unresolved[:_TOLD]:
        yield (
            f"Modes {j + 1} and {k + 1} are {abs(report.apparent[j] - report.apparent[k]):.2g} {unit} apart, less than "
            f"the {report.band.bin:.2g} that the record resolves."
        )
    more = sum(max(0, len(affected) - _TOLD) for affected in (report.above_nyquist, report.unresolved))
    if more:
        yield f"The same is true of {more} more."
    if report.slow:
        named = named_modes([l + 1 for l in report.slow]).capitalize()
        yield f"{named} complete{'s' * (len(report.slow) == 1)} less than a period in the record."
