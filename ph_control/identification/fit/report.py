"""What a result looks like on paper."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..._display import (
    Report,
    aligned,
    counted_poles,
    first_of,
    html_heading,
    html_report,
    html_table,
    p_value,
    percent,
    to_its_error,
)
from ..._types import Array, RealOrComplex
from ..._units import step_of
from ...exceptions import printable, shortened
from ..data.quantities import measured_by

if TYPE_CHECKING:
    from ..diagnosis.verdict import HypothesisTest
    from ..parameters.fitted_parameters import FittedParameters
    from .pem_result import PEMResult

_SHOWN = 6  # experiments listed one by one
_NAMED = 4  # channels
_BACKGROUND = 0.01  # share of the response from which it is reported


class ModalReport(Report):
    """What the result of a fit shows of itself: lines on data and quality, tables, and its message."""

    def __str__(self: Any) -> str:
        lines = self._lines()
        for table in self._tables():
            lines += ["", *table]
        wrapped = textwrap.wrap(self.message, 100, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False)
        return printable(shortened("\n".join([*lines, "", *wrapped])))

    def _repr_html_(self: Any) -> str:
        """HTML for notebooks: the summary, its modes as a table."""
        title, *lines = self._lines()
        head, *rows = self._mode_table()
        head = [text.replace("+-", "±") for text in head]
        return html_heading(title) + html_report("\n".join(lines)) + html_table(head, rows) + html_report(self.message)

    def _headline(self: Any) -> str:
        return f"{poles_in_words(self)}, {self.structure}, fit {percent(self.fit_percent)}, {self.verdict}"

    def _mode_table(self: Any) -> list[list[str]]:
        return mode_table(self)

    def _tables(self: Any) -> list[list[str]]:
        shown = (
            parameter_table(self.fitted_parameters), self._mode_table(), real_pole_table(self), test_table(self.tests),
        )  # fmt: skip
        return [aligned(table) for table in shown if len(table) > 1]

    def _lines(self: Any) -> list[str]:
        inputs, outputs = self.input_labels, self.output_labels
        alone = " under ambient excitation" if self.is_ambient else " in free motion"
        source = f" from {_listed(inputs)}" if inputs else alone
        ports = [f"{outputs[o]}:{inputs[i]}" for o, i in self.ports]
        scale = "unit modal mass" if self.shapes_scaled else "the largest entry 1, unscaled"
        return [
            f"{poles_in_words(self)} of {_listed(outputs)}{source}",
            f"  verdict         {self.verdict}",
            f"  structure       {self.structure}",
            *_channel_lines(self),
            *[f"  ports           {_listed(ports)}"] * bool(ports),
            *_delay_line(self),
            *_input_delay_line(self),
            *[f"  mode shapes     {scale}"] * (len(outputs) > 1),
            *_offset_line(self),
            f"  fit             {self.fit_percent:.2f} %",
            _criteria_line(self),
        ]


def _offset_line(result: PEMResult) -> list[str]:
    """Offsets of the first experiments and outputs, with their errors, where any was estimated."""
    values, errors = np.ravel(result.offsets), np.ravel(result.stderr["offset"])
    if not np.isfinite(errors).any():
        return []
    pairs = [f"{value:.6g} +- {error:.2g}" for value, error in zip(values, errors, strict=True)]
    return [f"  offset          {first_of(pairs, _SHOWN, ', ...')}"]


def _criteria_line(result: PEMResult) -> str:
    return f"  BIC             {result.bic:.6g}   (AIC {result.aic:.6g}, log-likelihood {result.loglik:.6g})"


# --- tables ----------------------------------------------------------------------------------------------------------


def mode_table(model: PEMResult) -> list[list[str]]:
    """Cells of a table of modes, a head first; of one input and output with residues and the errors of their sizes."""
    n, stderr = model.order, model.stderr
    count = len(model.poles)
    residues = np.reshape(model.residues, (count, model.residues.size // max(1, count)))[:n]
    columns = [(model.hertz, stderr["hertz"]), (100 * model.damping_ratios, 100 * stderr["damping_ratios"])]
    head = ["mode", f"f [{'1/time' if model.time_unit is None else 'Hz'}]", "+-", "damping [%]", "+-"]
    last = [""] * n
    if residues.shape[1] == 1 and residues.any():
        rho = residues[:, 0]
        turned = np.exp(-1j * np.angle(rho))
        C, l = model.covariance[2 * count : 4 * count, 2 * count : 4 * count], np.arange(n)
        crossed = 2 * turned.real * turned.imag * C[l, count + l]
        along = turned.real**2 * C[l, l] + turned.imag**2 * C[count + l, count + l] - crossed
        columns.append((np.abs(rho), np.sqrt(np.maximum(along, 0.0))))
        head += ["|residue|", "+-", "phase [deg]"]
        last = [f"{np.degrees(np.angle(residue)):.1f}" for residue in rho]
    else:
        head.append("collinearity")
        last = [f"{value:.3f}" for value in model.phase_collinearity]
    return [head, *([str(k + 1), *_with_errors(columns, k), last[k]] for k in range(n))]


def _with_errors(columns: Sequence[tuple[Array, RealOrComplex]], k: int) -> list[str]:
    """Cells of the row `k` of columns of values and their errors."""
    pairs = [(values[k], errors[k]) for values, errors in columns]
    return [text for value, error in pairs for text in (to_its_error(value, error), to_its_error(error, error))]


def parameter_table(fitted: FittedParameters | None) -> list[list[str]]:
    """Cells of a table of the parameters of a model function, a head first; the head alone where there are none."""
    rows = [["parameter", "value", "+-", "[%]", "start"]]
    if fitted is None:
        return rows
    for name, value, error, start in zip(fitted.names, fitted.values, fitted.stderr, fitted.start, strict=True):
        share = f"{100 * error / abs(value):.2g}" if value and np.isfinite(error) else "-"
        rows.append([name, to_its_error(value, error), to_its_error(error, error), share, f"{start:.6g}"])
    return rows


def real_pole_table(model: PEMResult) -> list[list[str]]:
    """Cells of a table of the real poles, a head first: time constants, of one input and output with residues."""
    n, unit = model.order, model.time_unit or "time"
    poles, constants, stderr = model.real_poles, model.time_constants, model.stderr
    residues = np.reshape(model.residues[n:], (len(poles), model.residues.size // max(1, len(model.poles))))
    alone = residues.shape[1] == 1
    head = ["real pole", f"p [1/{unit}]", "+-", f"time constant [{unit}]", "+-", *(["residue", "+-"] if alone else [])]
    columns = [(poles, stderr["real_poles"]), (constants, stderr["time_constants"])]
    if alone:
        columns.append((residues[:, 0].real, np.reshape(stderr["residues"][n:], residues.shape).real[:, 0]))
    return [head, *([str(k + 1), *_with_errors(columns, k)] for k in range(len(poles)))]


def _delay_line(result: PEMResult) -> list[str]:
    """Delays of the outputs, in predictions and not in `system`."""
    delay, errors = result.delay, result.stderr["delay"]
    if not delay.any():
        return []
    pairs = list(zip(result.output_labels, delay.tolist(), errors.tolist(), strict=True))
    if np.ptp(delay) == 0:
        pairs = pairs[:1]
    shown = [to_its_error(late, error) + f" +- {to_its_error(error, error)}" * (error > 0) for _, late, error in pairs]
    if len(pairs) > 1:
        shown = [f"{label!r} {text}" for (label, *_), text in zip(pairs, shown, strict=True)]
    unit = f" {result.time_unit}" * (result.time_unit is not None)
    return [f"  delay           {first_of(shown, _NAMED)}{unit}, in predictions and not in system"]


def _input_delay_line(result: PEMResult) -> list[str]:
    """Dead times of inputs, in predictions and not in `system`."""
    times = zip(result.input_labels, result.input_delay.tolist(), strict=True)
    late = [f"{name!r} {time:.6g}" for name, time in times if time]
    unit = f" {result.time_unit}" * (result.time_unit is not None)
    return [f"  dead times      {first_of(late, _NAMED)}{unit}, in predictions and not in system"] * bool(late)


def poles_in_words(result: PEMResult) -> str:
    """How many modes and real poles there are."""
    return " and ".join(counted_poles(result.order, len(result.real_poles)))


def test_table(tests: Iterable[HypothesisTest]) -> list[list[str]]:
    """Cells of the tests of structures, a head first."""
    rows = [[test.hypothesis, f"{test.likelihood_ratio:.4g}", str(test.dof), p_value(test.p)] for test in tests]
    return [["hypothesis", "likelihood ratio", "dof", ""], *rows]


def _listed(labels: Sequence[str]) -> str:
    return first_of([*map(repr, labels)], _NAMED)


def _channel_lines(result: PEMResult) -> list[str]:
    """What was measured."""
    records = [experiment.record for experiment in result.experiments]
    missing = sum(int((~record.observed).sum()) for record in records)
    tail = f", {missing} values missing" * bool(missing)
    samples = sum(record.samples for record in records)
    several = f"{len(records)} experiments, " * (len(records) > 1)
    measured = [f"  measured        {measured_by(result.quantities, result.output_labels)}"]
    if not hasattr(records[0], "dt"):
        return [f"  response        {several}{samples} frequencies{tail}", *measured, *_background_line(result)]
    held = {"zoh": "held", "foh": "linear"}[result.intersample]
    between = f", input {held} between samples" * bool(result.input_labels)
    return [f"  record          {several}{samples} samples, {step_of(records[0])}{tail}{between}", *measured]


def _background_line(result: PEMResult) -> list[str]:
    """What a fit of responses has beside its modes, and `system` has not; nothing where that is small."""
    shares = [np.zeros(0)]
    for experiment in result.experiments if result.order else ():
        record: Any = experiment.record
        omega = record.omega
        if result.window is not None:
            modes = result.estimated_response(omega)
        else:
            modes = result.observed_system(1j * omega, squeeze=False, warn_infinite=False)
        if np.size(experiment.predicted) != modes.size:
            continue
        predicted = np.reshape(experiment.predicted, modes.shape)
        with np.errstate(all="ignore"):
            share = np.abs(predicted - modes) / np.abs(predicted)
        shares.append(share[np.isfinite(share)])
    together = np.concatenate(shares)
    typical = float(np.median(together)) if len(together) else 0.0
    if not typical >= _BACKGROUND:
        return []
    size = f"{100 * typical:.{int(typical < 0.1)}f}"
    return [f"  background      {size} % of the response (median), in predicted and not in system"]
