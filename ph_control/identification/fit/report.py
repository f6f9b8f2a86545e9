"""What a result looks like on paper."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np

from ..._display import Report, aligned, counted, html_heading, html_report, html_table, p_value, percent, to_its_error
from ..._types import Array
from ..._units import hertz_size, rate, step_of
from ...exceptions import printable, shortened
from ..data.quantities import measured_by
from ..data.time_record import Record

_SHOWN = 6  # experiments listed one by one
_NAMED = 4  # channels
_BACKGROUND = 0.01  # of the response, from which it is told


class FitReport(Report):
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


class LosslessReport(FitReport):
    """What the result of a lossless fit shows of itself."""

    def _headline(self: Any) -> str:
        return f"{counted(self.order, 'mode')}, fit {percent(self.fit_percent)}, {self.verdict}"

    def _mode_table(self) -> list[list[str]]:
        return mode_table(self)

    def _tables(self: Any) -> list[list[str]]:
        damped = [] if self.damped is None else [damped_lines(self.damped)]
        return [aligned(self._mode_table()), *damped]

    def _lines(self: Any) -> list[str]:
        first = self.experiments[0].record
        missing = sum(int((~one.record.observed).sum()) for one in self.experiments)
        driven = [one.record for one in self.experiments if not isinstance(one.record, Record) or one.record.driven]
        source = f" from {driven[0].input_label!r}" if driven else " in free motion"
        return [
            f"Port-Hamiltonian model of {first.output_label!r}{source}: {counted(self.order, 'mode')}",
            f"  verdict         {self.verdict}",
            *_data_lines(self, missing),
            f"  fit             {self.fit_percent:.2f} %",
            f"  noise           standard deviation {self.noise.floor:.4g}"
            + f", and {100 * self.noise.share:.2g} % of the gain" * bool(self.noise.share),
            _criteria_line(self),
        ]


def _criteria_line(result: Any) -> str:
    return f"  BIC             {result.bic:.6g}   (AIC {result.aic:.6g}, log-likelihood {result.loglik:.6g})"


def mode_table(result: Any) -> list[list[str]]:
    """Frequencies, residues and weights with their standard errors, to the digits that these leave; a head first."""
    unit, d, r, stderr = result.time_unit, result.d, result.r, result.stderr
    head = ["mode", f"d [{rate(unit)}]", "+-", f"f [{'1/time' if unit is None else 'Hz'}]"]
    columns = [(d, stderr["d"]), (result.hertz, stderr["d"] / hertz_size(unit))]
    columns += [(r * d, residue_errors(result)), (r, stderr["r"])]
    cells = [
        [(to_its_error(*pair), to_its_error(pair[1], pair[1])) for pair in zip(*each, strict=True)] for each in columns
    ]
    rows = [
        [str(l + 1), *cells[0][l], cells[1][l][0], *cells[2][l], *cells[3][l], _note(result, l)]
        for l in range(result.order)
    ]
    return [[*head, "residue kappa", "+-", "weight r", "+-", "note"], *rows]


def residue_errors(result: Any) -> Array:
    """Standard errors of the residues `kappa = r d`; NaN where the weight is held."""
    n, d, r = result.order, result.d, result.r
    C = result.covariance
    l = np.arange(n)
    return np.sqrt(np.maximum(r**2 * C[l, l] + d**2 * C[n + l, n + l] + 2 * r * d * C[l, n + l], 0.0))


def _note(result: Any, l: int) -> str:
    return "not seen" if l in result.unseen else "held at 0" if l in result.active else ""


def _data_lines(result: Any, missing: int) -> list[str]:
    """What was measured, and how the model meets it."""
    records = [one.record for one in result.experiments]
    tail = f", {missing} outputs missing" * bool(missing)
    sensor = [f"  measured        {result.quantity} of the port"] * (result.quantity != "velocity")
    if not isinstance(records[0], Record):
        points = sum(record.samples for record in records)
        return [f"  response        {points} frequencies{tail}", *sensor]
    if len(records) == 1:
        lines = [f"  record          {records[0].samples} samples, {step_of(records[0])}{tail}"]
    else:
        samples = sum(record.samples for record in records)
        lines = [f"  experiments     {len(records)}, {samples} samples{tail}"]
        for k, one in enumerate(result.experiments[:_SHOWN], start=1):
            step = f"{one.record.samples} samples, {step_of(one.record)}, fit {one.fit_percent:.2f} %"
            lines.append(f"    {k:4d}          {step}")
    method = result.method + (
        f", {result.intersample} input" if result.method != "euler" else " (not lossless: its energy grows)"
    )
    lines += [f"  discretisation  {method}", *sensor]
    if np.isfinite(result.offset_stderr).any():
        shown = ", ".join(
            f"{value:.6g} +- {error:.2g}"
            for value, error in zip(result.offsets[:_SHOWN], result.offset_stderr[:_SHOWN], strict=True)
        )
        lines.append(f"  offset          {shown}")
    return lines


# --- damped modes ----------------------------------------------------------------------------------------------------


def damped_lines(model: Any) -> list[str]:
    """Damped modes as a table of frequencies, damping ratios and residues, with their standard errors."""
    through = to_its_error(model.feedthrough, float(model.stderr["feedthrough"]))
    fed = f", fed through {through}" * bool(model.feedthrough)
    return [f"  With damping, sensor anywhere: fit {model.fit_percent:.2f} %{fed}", *aligned(damped_table(model))]


def damped_table(model: Any) -> list[list[str]]:
    """Cells of that table, a head first; of one input and output the residue, with the error of its size."""
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
        last = [f"{np.degrees(np.angle(one)):.1f}" for one in rho]
    elif hasattr(model, "phase_collinearity"):
        head.append("collinearity")
        last = [f"{one:.3f}" for one in model.phase_collinearity]
    else:
        head.append("")
    rows = []
    for k in range(n):
        pairs = [(values[k], errors[k]) for values, errors in columns]
        cells = [text for value, error in pairs for text in (to_its_error(value, error), to_its_error(error, error))]
        rows.append([str(k + 1), *cells, last[k]])
    return [head, *rows]


def real_pole_table(model: Any) -> list[list[str]]:
    """Cells of a table of the real poles, a head first: time constants, of one input and output with residues."""
    n, unit = model.order, model.time_unit or "time"
    poles, constants, stderr = model.real_poles, model.time_constants, model.stderr
    residues = np.reshape(model.residues[n:], (len(poles), model.residues.size // max(1, len(model.poles))))
    alone = residues.shape[1] == 1
    head = ["real pole", f"p [1/{unit}]", "+-", f"time constant [{unit}]", "+-", *(["residue", "+-"] if alone else [])]
    errors = np.reshape(stderr["residues"][n:], residues.shape).real
    rows = []
    for k, pole in enumerate(poles.tolist()):
        pairs = [(pole, stderr["real_poles"][k]), (constants[k], stderr["time_constants"][k])]
        pairs += [(residues[k, 0].real, errors[k, 0])] if alone else []
        cells = [text for value, error in pairs for text in (to_its_error(value, error), to_its_error(error, error))]
        rows.append([str(k + 1), *cells])
    return [head, *rows]


class DampedReport(FitReport):
    """What the result of a fit of damped modes shows of itself."""

    def _headline(self: Any) -> str:
        return f"{counted_poles(self)}, {self.structure}, fit {percent(self.fit_percent)}, {self.verdict}"

    def _mode_table(self) -> list[list[str]]:
        return damped_table(self)

    def _tables(self: Any) -> list[list[str]]:
        shown = (self._mode_table(), real_pole_table(self), test_table(self.tests))
        return [aligned(one) for one in shown if len(one) > 1]

    def _lines(self: Any) -> list[str]:
        inputs, outputs = self.input_labels, self.output_labels
        source = f" from {_listed(inputs)}" if inputs else " in free motion"
        ports = [f"{outputs[o]}:{inputs[i]}" for o, i in self.ports]
        scale = "unit modal mass" if self.shapes_scaled else "the largest entry 1, unscaled"
        return [
            f"{counted_poles(self)} of {_listed(outputs)}{source}",
            f"  verdict         {self.verdict}",
            f"  structure       {self.structure}",
            *_channel_lines(self),
            *[f"  ports           {_listed(ports)}"] * bool(ports),
            *_delay_line(self),
            *[f"  mode shapes     {scale}"] * (len(outputs) > 1),
            f"  fit             {self.fit_percent:.2f} %",
            _criteria_line(self),
        ]


def _delay_line(result: Any) -> list[str]:
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
    more = f" and {len(shown) - _NAMED} more" * (len(shown) > _NAMED)
    return [f"  delay           {', '.join(shown[:_NAMED])}{more}{unit}, in predictions and not in system"]


def counted_poles(result: Any) -> str:
    """How many modes and real poles there are."""
    parts = [counted(result.order, "mode")] * (result.order > 0 or not len(result.real_poles))
    return " and ".join(parts + [counted(len(result.real_poles), "real pole")] * (len(result.real_poles) > 0))


def test_table(tests: Any) -> list[list[str]]:
    """Cells of the tests of structures, a head first."""
    rows = [[one.hypothesis, f"{one.likelihood_ratio:.4g}", str(one.dof), p_value(one.p)] for one in tests]
    return [["hypothesis", "likelihood ratio", "dof", ""], *rows]


def _listed(labels: Any) -> str:
    shown = ", ".join(repr(label) for label in labels[:_NAMED])
    return shown + f" and {len(labels) - _NAMED} more" * (len(labels) > _NAMED)


def _channel_lines(result: Any) -> list[str]:
    """What was measured."""
    records = [one.record for one in result.experiments]
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


def _background_line(result: Any) -> list[str]:
    """What a fit of responses has beside its modes, and `system` has not; nothing where that is small."""
    shares = [np.zeros(0)]
    for one in result.experiments if result.order else ():
        modes = result.observed_system(1j * one.record.omega, squeeze=False, warn_infinite=False)
        if np.size(one.predicted) != modes.size:
            continue
        predicted = np.reshape(one.predicted, modes.shape)
        with np.errstate(all="ignore"):
            share = np.abs(predicted - modes) / np.abs(predicted)
        shares.append(share[np.isfinite(share)])
    together = np.concatenate(shares)
    typical = float(np.median(together)) if len(together) else 0.0
    if not typical >= _BACKGROUND:
        return []
    size = f"{100 * typical:.{int(typical < 0.1)}f}"
    return [f"  background      {size} % of the response (median), in predicted and not in system"]
