"""What a result looks like on paper."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np

from ..._display import Report, aligned, html_heading, html_report, html_table, percent, to_its_error
from ..._types import Array
from ..._units import hertz_size, rate, step_of
from ...exceptions import shortened
from ..data.time_record import Record
from ..diagnosis.damped_model import damped_lines

_SHOWN = 6  # experiments listed one by one


class FitReport(Report):
    """What the result of a lossless fit shows of itself."""

    def __str__(self) -> str:
        return summary_of(self)

    def _headline(self: Any) -> str:
        return f"{_modes(self.order)}, fit {percent(self.fit_percent)}, {self.verdict}"

    def _repr_html_(self: Any) -> str:
        """HTML for notebooks: the summary, its modes as a table."""
        above, _, _ = summary_of(self).partition("\n\n")
        title, _, lines = above.partition("\n")
        head, *rows = mode_table(self)
        head = [text.replace("+-", "±") for text in head]
        return html_heading(title) + html_report(lines) + html_table(head, rows) + html_report(self.message)


def summary_of(result: Any) -> str:
    """Report of a fit for people, at most 100 characters wide."""
    first = result.experiments[0].record
    missing = sum(int((~one.record.observed).sum()) for one in result.experiments)
    driven = [one.record for one in result.experiments if not isinstance(one.record, Record) or one.record.driven]
    source = f" from {driven[0].input_label!r}" if driven else " in free motion"
    lines = [
        f"Port-Hamiltonian model of {first.output_label!r}{source}: {_modes(result.order)}",
        f"  verdict         {result.verdict}",
        *_data_lines(result, missing),
        f"  fit             {result.fit_percent:.2f} %",
        f"  noise           standard deviation {result.noise.floor:.4g}"
        + f", and {100 * result.noise.share:.2g} % of the gain" * bool(result.noise.share),
        f"  BIC             {result.bic:.6g}   (AIC {result.aic:.6g}, log-likelihood {result.loglik:.6g})",
        "",
        *aligned(mode_table(result)),
    ]
    if result.damped is not None:
        lines += ["", *damped_lines(result.damped)]
    wrapped = textwrap.wrap(result.message, 100, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False)
    return shortened("\n".join([*lines, "", *wrapped]))


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


def _modes(order: int) -> str:
    return f"{order} mode{'s' * (order != 1)}"


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
