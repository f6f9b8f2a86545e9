"""What a result looks like on paper."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._display import Report, html_heading, html_report, html_table
from ..fit_data import percent
from .data import Record

_SHOWN = 6  # experiments listed one by one


class FitReport(Report):
    """What the result of a fit shows of itself."""

    def __str__(self) -> str:
        return summary_of(self)

    def _headline(self) -> str:
        result: Any = self
        return f"{_modes(result.order)}, fit {percent(result.fit_percent)}, {result.verdict}"

    def _repr_html_(self) -> str:
        """HTML for notebooks: the summary, its modes as a table."""
        result: Any = self
        above, _, _ = summary_of(self).partition("\n\n")
        title, _, lines = above.partition("\n")
        d, r = result.d, result.r
        errors = [[_error(value).strip() for value in result.stderr[name]] for name in ("d", "r")]
        rows = [
            [
                str(l + 1), f"{d[l]:.10g}", errors[0][l], f"{d[l] / 2 / np.pi:.8g}", f"{r[l]:.7g}", errors[1][l],
                _note(result, l),
            ]
            for l in range(result.order)
        ]  # fmt: skip
        head = ["mode", "d [rad/time]", "±", "cycles/time", "r", "±", "note"]
        return html_heading(title) + html_report(lines) + html_table(head, rows) + html_report(result.message)


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
        f"  noise           standard deviation {np.sqrt(result.noise_variance):.4g}",
        f"  BIC             {result.bic:.6g}   (AIC {result.aic:.6g}, log-likelihood {result.loglik:.6g})",
        "",
        "   mode        d [rad/time]     +-          cycles/time    r               +-          note",
    ]
    for l in range(result.order):
        lines.append(
            f"  {l + 1:5d}  {result.d[l]:18.10g}  {_error(result.stderr['d'][l])}  {result.d[l] / 2 / np.pi:15.8g}"
            f"  {result.r[l]:14.7g}  {_error(result.stderr['r'][l])}  {_note(result, l)}".rstrip()
        )
    return "\n".join([*lines, "", *_wrap(result.message)])


def _modes(order: int) -> str:
    return f"{order} mode{'s' * (order != 1)}"


def _note(result: Any, l: int) -> str:
    return "not in the record" if l in result.unseen else "constraint active" if l in result.active else ""


def _data_lines(result: Any, missing: int) -> list[str]:
    """What was measured, and how the model meets it."""
    records = [one.record for one in result.experiments]
    tail = f", {missing} outputs missing" * bool(missing)
    sensor = [f"  measured        {result.quantity} of the port"] * (result.quantity != "velocity")
    if not isinstance(records[0], Record):
        points = sum(record.samples for record in records)
        return [f"  response        {points} frequencies{tail}", *sensor]
    if len(records) == 1:
        lines = [f"  record          {records[0].samples} samples, step {records[0].dt:g}{tail}"]
    else:
        samples = sum(record.samples for record in records)
        lines = [f"  experiments     {len(records)}, {samples} samples{tail}"]
        for k, one in enumerate(result.experiments[:_SHOWN], start=1):
            step = f"{one.record.samples} samples, step {one.record.dt:g}, fit {one.fit_percent:.2f} %"
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


def _error(value: float) -> str:
    return f"{'-':>8}" if np.isnan(value) else f"{value:8.2g}"


def _wrap(text: str, width: int = 98) -> list[str]:
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) + 1 > width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return ["  " + line for line in lines]
