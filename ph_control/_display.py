"""How objects show themselves: as text that evaluates back, and in a notebook as HTML with formulas in LaTeX."""

from __future__ import annotations

import html
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from ._types import RealOrComplex

_DIGITS = 8  # of a number in a table before it takes an exponent
_MOST_DIGITS = 12  # where its standard error asks for them

_ROWS = 12  # of a table, beyond which its middle is left out
_TERMS = 5  # of a formula
# what is in such an element is text, dollar signs too, whatever typesets the formulas of the page
_TEXT = '<div class="tex2jax_ignore mathjax_ignore">{}</div>'


def literal(array: RealOrComplex) -> str:
    """Text that evaluates to the same array, bit for bit; beyond 1000 entries the corners and the shape, as numpy does.

    Such a text does not evaluate, which is better than to a smaller array.
    """
    if not array.size:
        return f"array([]).reshape{array.shape}"
    with np.printoptions(floatmode="unique", threshold=1000):
        text = repr(array)
    # numpy itself says the shape from 2.2 on
    return text if array.size <= 1000 or "shape=" in text else f"{text[:-1]}, shape={array.shape})"


def listed_or_literal(vector: RealOrComplex) -> str:
    """The same for a call that takes lists: shorter where every entry is there."""
    if vector.size > 1000 or not vector.size:
        return literal(vector)
    numbers = ", ".join(repr(float(value)) for value in vector)
    return "[" + textwrap.fill(numbers, 100, subsequent_indent=" ", break_on_hyphens=False) + "]"


def escaped(text: object) -> str:
    """Text as it is read in HTML."""
    return html.escape(str(text)).replace("$", "&#36;")


def latex_number(value: float) -> str:
    """Number in the format that python-control is configured to show matrices in."""
    from control import config

    digits, _, power = format(float(value), config.defaults["statesp.latex_num_format"]).partition("e")
    return rf"{digits}\cdot 10^{{{int(power)}}}" if power else digits


def latex_matrix(array: RealOrComplex) -> str:
    """Matrix in brackets."""
    rows = (" & ".join(latex_number(value) for value in row) for row in array)
    return r"\begin{bmatrix}" + r" \\ ".join(rows) + r"\end{bmatrix}"


def fits_in_a_formula(sys: Any) -> bool:
    """Whether python-control would show the matrices of a system of this size in a notebook."""
    from control import config

    return bool(sys.nstates + max(sys.ninputs, sys.noutputs) <= config.defaults["statesp.latex_maxsize"])


def latex_response(modes: Any) -> str:
    """Transfer function of a modal form as partial fractions, written out if they are few."""
    if modes.nports != 1 or modes.n > _TERMS:
        scalar = modes.nports == 1
        free = (r"\frac{\kappa_0}{s} + " if scalar else r"\frac{K_0}{s} + ") * bool(len(modes.rigid))
        weight = r"\kappa_l s" if scalar else r"\mathrm{Re} K_l s + \mathrm{Im} K_l d_l"
        meaning = "" if scalar else r", \quad K_l = d_l \bar\nu_l \nu_l^\top"
        return rf"G(s) = {free}\sum_{{l=1}}^{{{len(modes.d)}}} \frac{{{weight}}}{{s^2 + d_l^2}}{meaning}"
    terms = [rf"\frac{{{latex_number(modes.kappa_0)}}}{{s}}"] * bool(len(modes.rigid))
    terms += [
        rf"\frac{{{latex_number(kappa)}\, s}}{{s^2 + {latex_number(d)}^2}}"
        for d, kappa in zip(modes.d, modes.kappa, strict=True)
    ]
    return "G(s) = " + (" + ".join(terms) or "0")


def html_formula(latex: str) -> str:
    """Displayed formula."""
    return f"$${html.escape(latex, quote=False)}$$"


def html_heading(text: str) -> str:
    """Line above a formula or a table."""
    return _TEXT.format(f"<code>{escaped(text)}</code>")


def html_report(text: str) -> str:
    """Report whose columns are aligned by spaces."""
    return _TEXT.format(f"<pre>{escaped(text)}</pre>")


def html_table(head: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> str:
    """Table; of many rows the first and the last."""
    lines = [f"<caption>{escaped(caption)}</caption>"] * bool(caption)
    lines.append("<tr>" + "".join(f"<th>{escaped(name)}</th>" for name in head) + "</tr>")
    shown = [*rows[: _ROWS // 2], ["⋮"] * len(head), *rows[-_ROWS // 2 :]] if len(rows) > _ROWS else rows
    lines += ["<tr>" + "".join(f"<td>{escaped(cell)}</td>" for cell in row) + "</tr>" for row in shown]
    return _TEXT.format('<table style="text-align: right">' + "".join(lines) + "</table>")


def modes_table(modes: Any) -> str:
    """Table of natural frequencies and weights; of a pole at 0 its residue."""
    ports = range(modes.nports)
    tags = [""] if modes.nports == 1 else [f", port {k + 1}" for k in ports]
    head = ["mode", "d", *(f"r{tag}" for tag in tags), *(f"κ = r d{tag}" for tag in tags)]
    at_zero = np.atleast_2d(modes.kappa_0).diagonal()
    rows = [["free", "0", *["" for _ in ports], *(f"{at_zero[k]:.7g}" for k in ports)]] * bool(len(modes.rigid))
    r, kappa = (np.reshape(values, (len(modes.d), modes.nports)) for values in (modes.r, modes.kappa))
    # of many rows only those that are seen are written
    seen = range(len(modes.d)) if len(modes.d) <= _ROWS else [*range(_ROWS), *range(len(modes.d) - _ROWS, len(modes.d))]
    rows += [[str(l + 1), *(f"{value:.7g}" for value in (modes.d[l], *r[l], *kappa[l]))] for l in seen]
    return html_table(head, rows, counted(modes.n, "mode"))


class ShownModes:
    """What a modal form shows of itself."""

    def __repr__(self) -> str:
        modes: Any = self
        if modes.nports == 1 and not len(modes.rigid) and np.array_equal(modes.nu[:, 0], np.sqrt(modes.r)):
            return f"modes({listed_or_literal(modes.d)}, {listed_or_literal(modes.r)})"
        arrays = [modes.d, modes.nu, modes.rigid]
        square = np.abs(modes.nu) ** 2
        if not np.array_equal(square[:, 0] if modes.nports == 1 else square, modes.r):
            arrays.append(modes.r)
        return "ModalForm(\n" + ",\n".join(literal(array) for array in arrays) + ")"

    def _repr_latex_(self) -> str:
        return f"$${latex_response(self)}$$"

    def _repr_html_(self) -> str:
        return html_formula(latex_response(self)) + modes_table(self)


class Report:
    """What a result shows of itself: one line, and its whole report where it is printed or shown in a notebook."""

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self._headline()}>"

    def _headline(self) -> str:
        return str(self).partition("\n")[0]

    def _repr_html_(self) -> str:
        return html_report(str(self))


def to_its_error(value: float, error: float) -> str:
    """Text of a number down to the second digit of its standard error, of few digits where that is not known."""
    if np.isnan(value) or not value:
        return "-" if np.isnan(value) else "0"
    if np.isinf(value):
        return str(value)
    power = int(np.floor(np.log10(abs(value))))
    fine = int(np.floor(np.log10(error))) if 0 < error < np.inf else power - _DIGITS // 2
    digits = min(max(power - fine + 2, 1), _MOST_DIGITS)
    fixed = -5 < power < max(_DIGITS - 1, digits)
    return f"{value:.{max(digits - 1 - power, 0)}f}" if fixed else f"{value:.{digits - 1}e}"


def with_error(value: float, error: float) -> list[str]:
    """Cells of a number and its standard error, empty where that is not known."""
    return [to_its_error(value, error), f"{error:.2g}" if error > 0 else ""]


def aligned(table: list[list[str]]) -> list[str]:
    """Lines of a table of texts, the first row a head, right-aligned but for the last column."""
    widths = [max(map(len, column)) for column in zip(*table, strict=True)]
    # an error stands close to its number
    widths = [width + (head != "+-") for head, width in zip(table[0], widths, strict=True)]
    return [
        f" {' '.join(text.rjust(width) for text, width in zip(row[:-1], widths, strict=False))}  {row[-1]}".rstrip()
        for row in table
    ]


def first_of(texts: Sequence[str], most: int, others: str = " and {} more") -> str:
    """The first few of some texts, and that there are others."""
    return ", ".join(texts[:most]) + others.format(len(texts) - most) * (len(texts) > most)


def counted(number: int, noun: str) -> str:
    """Number and noun, plural where it must be."""
    return f"{number} {noun}{'s' * (number != 1)}"


def counted_poles(modes: int, real: int) -> list[str]:
    """Numbers of modes and of real poles, of which there are some."""
    return [counted(modes, "mode")] * bool(modes or not real) + [counted(real, "real pole")] * bool(real)


def p_value(p: float) -> str:
    """Text of a p-value; never 0."""
    if np.isnan(p):
        return "p unknown"
    return "p < 1e-300" if p < 1e-300 else f"p = {p:.2g}"


def starred(p: float, level: float) -> str:
    """Cell of a p-value, with a star below a level."""
    return "-" if np.isnan(p) else f"{p:.2g}" + "*" * bool(p < level)


def percent(fit: float) -> str:
    """Text of a fit; never rounded up to a perfect one, nor wider than it can be read."""
    if 99.995 <= fit < 100.0:
        return "above 99.99 %"
    return f"{fit:.2f} %" if fit > -1e4 else f"{fit:.3g} %"
