"""A fit as one HTML page: a summary to print first, tables, pictures, and what it takes to repeat it."""

from __future__ import annotations

import platform
import re
from base64 import b64encode
from collections.abc import Sequence
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import rc_context

from ..._display import escaped, html_report, html_table
from ...exceptions import StructureError
from ...plotting.style import imaginary_is_turned, told_gain_unit
from ..fit.pem_result import PEMResult
from ..fit.report import parameter_table, real_pole_table, test_table
from ..fit.result import PictureKind
from ..regression.prediction import shares_left

# kind of picture, its heading, and what it shows
_PICTURES: tuple[tuple[PictureKind, str, str], ...] = (
    ("fit", "Measured and predicted", "The data, the model, and below what the model leaves unexplained."),
    ("responses", "Frequency responses", "Of the model and of the data."),
    ("nyquist", "Nyquist curves", "Imaginary over real part of the model and of the data."),
    ("shapes", "Mode shapes", "Over the sensors, in the order of the outputs; of one sensor over the inputs."),
    ("assurance", "Modal assurance", "Likeness of the shapes of each two modes: 1 alike, 0 orthogonal."),
    ("stabilisation", "Stabilisation", "Poles of models of ascending order; those that stay are modes."),
    ("residuals", "Residuals", "What a good model leaves is white, and has nothing to do with the input."),
)
_OF_MODES = ("shapes", "assurance", "stabilisation")
_OF_SEVERAL = ("shapes", "assurance")  # that say nothing of one output and one input
_EXPERIMENTS = 4  # drawn one by one
_OUTPUTS = 4
_FIRST = 8  # sentences of the summary
_FINDINGS = "All findings"
_WIDTH = 9.6  # inches of a picture that is as wide as the page
_TALLER = 1.25  # as far as it may grow in height beside
_SETTINGS = (
    "structure", "quantity", "quantities", "intersample", "method", "representation", "ports", "shapes_scaled",
    "time_unit", "success", "n_iterations",
)  # fmt: skip
_KEYWORDS = ("ports", "intersample", "method", "representation")  # of pem, that a result has under the same names
_PACKAGES = ("ph_control", "control", "slycot", "numpy", "scipy", "matplotlib")
_NAME = slice(2, 18)  # of a line of the report, before its value
_SENTENCE = re.compile(r"(?<=[.!?]) +(?=[A-Z'])")
_STYLE = """
:root { color-scheme: light dark; --ink: #1b2430; --pale: #5a6472; --back: #fff; --band: #f4f5f7; --rule: #c9ccd1; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e7eb; --pale: #a5adb8; --back: #14181d; --band: #20262d; --rule: #48505a; } a { color: #8ab8ff; } }
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: var(--ink);
       background: var(--back); overflow-wrap: break-word; }
h1 { font-size: 1.6rem; margin-bottom: .2rem; } .when { color: var(--pale); margin-top: 0; }
h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid var(--rule); }
h3 { font-size: 1rem; margin: 1.2rem 0 .4rem; } nav ol { columns: 14rem; padding-left: 1.6rem; }
pre { white-space: pre-wrap; background: var(--band); padding: .8rem; font-size: .85rem; }
table { border-collapse: collapse; display: block; overflow-x: auto; margin: .6rem 0;
        font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .8rem; white-space: nowrap; } th { border-bottom: 1px solid var(--rule); }
tr:nth-child(even) { background: var(--band); }
.facts td { text-align: left; white-space: normal; vertical-align: top; }
.facts td:first-child { color: var(--pale); white-space: nowrap; } .facts th { display: none; }
figure { margin: 1rem 0; overflow-x: auto; } figcaption { color: var(--pale); font-size: .9rem; }
img { display: block; width: 100%; min-width: 36rem; height: auto; background: #fff; }
@media print {
  :root { --ink: #000; --pale: #444; --back: #fff; --band: #f4f5f7; --rule: #999; } @page { margin: 15mm; }
  body { margin: 0; max-width: none; padding: 0; font: 9pt/1.3 system-ui, sans-serif; } nav { display: none; }
  h1 { font-size: 14pt; } h2 { font-size: 11pt; margin-top: 1rem; } h3 { font-size: 9pt; margin: .6rem 0 .2rem; }
  h2, h3 { break-after: avoid; } tr, figure, pre { break-inside: avoid; } th, td { padding: .05rem .5rem; }
  ul { margin: .2rem 0; } figure { margin: .4rem 0; }
  img { min-width: 0; max-height: 225mm; width: auto; max-width: 100%; }
  #summary { break-after: page; } #summary img { max-height: 100mm; } table { display: table; }
}
"""


def page_of(result: PEMResult, title: str) -> str:
    """The whole page, with its pictures inside."""
    first = _kind_that_matters(result)
    sentences = _sentences(result)
    sections = [(_FINDINGS, [_listed([*map(escaped, sentences)])] if len(sentences) > _FIRST else [])]
    sections.append(("Tests of structure", _tests(result)))
    sections += [
        (heading, _pictures(result, kind, caption))
        for kind, heading, caption in _PICTURES
        # what the summary shows whole is not repeated
        if _applies(result, kind) and not (kind == first and _is_single(result, kind))
    ]
    sections += [("Orders tried", _orders(result)), ("To repeat it", _settings(result))]
    sections = [("Summary", _summary(result, first)), *((name, parts) for name, parts in sections if parts)]
    links = "".join(f'<li><a href="#{_anchor(name)}">{escaped(name)}</a></li>' for name, _ in sections)
    body = [
        f'<section id="{_anchor(name)}">\n<h2>{escaped(name)}</h2>\n' + "\n".join(parts) + "\n</section>"
        for name, parts in sections
    ]
    when = " · ".join([*_titles(result), date.today().isoformat(), f"ph_control {_version('ph_control')}"])
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escaped(title)}</title>\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<style>{_STYLE}</style>\n</head>\n'
        f'<body>\n<h1>{escaped(title)}</h1>\n<p class="when">{escaped(when)}</p>\n<nav><ol>{links}</ol></nav>\n'
        + "\n".join(body)
        + "\n</body>\n</html>\n"
    )


def _anchor(heading: str) -> str:
    return heading.lower().replace(" ", "-")


def _titles(result: PEMResult) -> list[str]:
    """What the data are called, as the files they were read from."""
    return list(dict.fromkeys(experiment.record.title for experiment in result.experiments if experiment.record.title))


# --- sections --------------------------------------------------------------------------------------------------------


def _summary(result: PEMResult, kind: PictureKind) -> list[str]:
    """What the result is, its modes and time constants with their errors, what was found, and one picture."""
    title, *lines = result._lines()
    facts = [[line[_NAME].strip(), line[_NAME.stop :].strip()] for line in lines]
    parts = [f"<p><strong>{escaped(title)}</strong></p>"]
    parts.append(html_table(["", ""], facts).replace("<table ", '<table class="facts" '))
    tables = [result._mode_table(), real_pole_table(result), parameter_table(result.fitted_parameters)]
    parts += [_with_errors(table) for table in tables if len(table) > 1]
    sentences = _sentences(result)
    more = [f'<a href="#{_anchor(_FINDINGS)}">and {len(sentences) - _FIRST} more</a>'] * (len(sentences) > _FIRST)
    items = [*map(escaped, sentences[:_FIRST]), *more]
    parts += ["<h3>What the data show</h3>", _listed(items)] if items else []
    heading, caption = next((heading, text) for name, heading, text in _PICTURES if name == kind)
    return [*parts, f"<h3>{escaped(heading)}</h3>", *_pictures(result, kind, caption, 1)]


def _sentences(result: PEMResult) -> list[str]:
    return [sentence for sentence in _SENTENCE.split(result.message) if sentence]


def _listed(items: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{item}</li>" for item in items) + "</ul>"


def _with_errors(table: list[list[str]]) -> str:
    head, *rows = table
    return html_table([name.replace("+-", "±") for name in head], rows)


def _tests(result: PEMResult) -> list[str]:
    head, *rows = test_table(result.tests)
    return [html_table([*head[:-1], "p"], rows)] if rows else []


def _orders(result: PEMResult) -> list[str]:
    orders = [[str(row.order), f"{row.loss:.6g}", f"{row.aic:.6g}", f"{row.bic:.6g}"] for row in result.order_table]
    return [html_table(["order", "loss", "AIC", "BIC"], orders)] if orders else []


def _settings(result: PEMResult) -> list[str]:
    settings = [[name, str(getattr(result, name))] for name in _SETTINGS if getattr(result, name, None) is not None]
    settings = [["data", ", ".join(_titles(result))]] * bool(_titles(result)) + settings
    packages = [f"{name} {_version(name)}" for name in _PACKAGES]
    table = html_table(["setting", "value"], settings).replace("<table ", '<table class="facts" ')
    machine = html_report("\n".join([f"Python {platform.python_version()}, {platform.machine()}", *packages]))
    return [html_report(_call(result)), table, machine]


def _call(result: PEMResult) -> str:
    """The call that fits this model to the same data, with what was found in place of the search."""
    given: dict[str, Any] = {"order": result.order, "structure": getattr(result, "structure", "lossless")}
    given |= {"real_poles": len(result.real_poles)} if len(result.real_poles) else {}
    given["quantity"] = getattr(result, "quantities", None) or getattr(result, "quantity", None)
    given |= {name: getattr(result, name, None) for name in _KEYWORDS}
    for name in ("delay", "input_delay"):
        late = np.asarray(getattr(result, name, 0.0)).tolist()
        given[name] = late if np.any(late) else None
    given = {name: list(value) if isinstance(value, tuple) else value for name, value in given.items() if value}
    if not np.iscomplexobj(result.predicted):
        given |= _beside_the_modes(result)
    return f"phc.pem(data, {', '.join(f'{keyword}={value!r}' for keyword, value in given.items())})"


def _beside_the_modes(result: PEMResult) -> dict[str, Any]:
    """Keywords of `pem` for motions, constants and drifts of recordings; drifts are found again."""
    given: dict[str, Any] = {}
    if result.order and not any(np.any(experiment.free_amplitudes) for experiment in result.experiments):
        given["initial_state"] = "zero"
    if not any(
        np.any(getattr(experiment, "drifts", getattr(experiment, "drift", 0.0))) for experiment in result.experiments
    ):
        given["offset"] = bool(np.any(result.offsets))
    return given


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "(from its folder)"


# --- pictures --------------------------------------------------------------------------------------------------------


def _kind_that_matters(result: PEMResult) -> PictureKind:
    """Picture of the first page."""
    if np.iscomplexobj(result.predicted):
        return "nyquist" if _is_impedance(result) else "responses"
    if result.order and result.is_ambient:
        return "stabilisation"
    return "responses" if result.order and result.input_labels else "fit"


def _is_single(result: PEMResult, kind: PictureKind) -> bool:
    """Whether one picture of a kind is all there is of it."""
    return kind != "fit" or (len(result.experiments) == 1 and len(result.output_labels) == 1)


def _is_impedance(result: PEMResult) -> bool:
    return imaginary_is_turned(None, [told_gain_unit(result.experiments[0].record)])


def _applies(result: PEMResult, kind: PictureKind) -> bool:
    """Whether a kind of picture says anything of such a plant and such data."""
    if kind in _OF_MODES and not result.order:
        return False
    if kind in _OF_SEVERAL and max(result.residues.shape[1:]) == 1:
        return False
    if kind == "nyquist":
        return _is_impedance(result) and np.iscomplexobj(result.predicted)
    if kind == "responses" and not result.input_labels:
        return False
    # the responses of the next section are the data themselves
    return not (kind == "fit" and np.iscomplexobj(result.predicted))


def _pictures(result: PEMResult, kind: PictureKind, caption: str, most: int | None = None) -> list[str]:
    """Pictures of one kind, at most so many, or why there is none."""
    several = kind in ("fit", "residuals")
    experiments = range(min(len(result.experiments), most or _EXPERIMENTS) if several else 1)
    count = len(result.output_labels)
    pictures = []
    try:
        for k in experiments:
            outputs = _worst_outputs(result, k, most or _OUTPUTS) if kind == "fit" and count > 1 else [None]
            which = f"Experiment {k + 1}. " if several and len(result.experiments) > 1 else ""
            for output in outputs:
                chosen = {} if output is None else {"output": output}
                pictures.append(_picture(result, kind, k, chosen, which + caption))
    except StructureError as error:
        pictures.append(f"<p>No picture: {escaped(error)}.</p>")
    if most is None and several and len(result.experiments) > len(experiments):
        pictures.append(f"<p>The first {len(experiments)} of {len(result.experiments)} experiments are drawn.</p>")
    if most is None and kind == "fit" and count > _OUTPUTS:
        pictures.append(f"<p>The {_OUTPUTS} of {count} outputs are drawn that are explained worst.</p>")
    return pictures


def _worst_outputs(result: PEMResult, experiment: int, most: int) -> Sequence[int]:
    """Outputs to draw, all or those that are explained worst, in their order."""
    fitted = result.experiments[experiment]
    shares = np.ravel(shares_left([(fitted.record, fitted.predicted)]))
    worst = np.argsort(np.nan_to_num(-shares, nan=np.inf), kind="stable")[:most]
    return sorted(worst.tolist())


def _picture(result: PEMResult, kind: PictureKind, experiment: int, chosen: dict[str, Any], caption: str) -> str:
    content = BytesIO()
    with rc_context({"svg.hashsalt": kind}):
        drawn = result.plot(experiment, kind=kind, **chosen)
        width, height = drawn.figure.get_size_inches()
        # cells of a matrix are square
        share = 1.0 if kind != "assurance" else width / _WIDTH
        if width < _WIDTH and share == 1.0:
            drawn.figure.set_size_inches(_WIDTH, height * min(_WIDTH / width, _TALLER))
        try:
            drawn.figure.savefig(content, format="svg", metadata={"Date": None, "Creator": None})
        finally:
            plt.close(drawn.figure)
    data = b64encode(content.getvalue()).decode("ascii")
    return (
        f'<figure><img alt="{escaped(caption)}" style="max-width: {min(share, 1.0):.0%}" '
        f'src="data:image/svg+xml;base64,{data}">'
        f"<figcaption>{escaped(caption)}</figcaption></figure>"
    )
