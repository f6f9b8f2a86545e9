"""A fit as one HTML page: summary, tables, pictures, and what it takes to repeat it."""

from __future__ import annotations

import platform
from base64 import b64encode
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import rc_context

from ..._display import escaped, html_report, html_table
from ...exceptions import StructureError
from ..fit.pem_result import PEMResult
from ..fit.report import real_pole_table, test_table

# kind of picture, its heading, and what it shows
_PICTURES = (
    ("fit", "Measured and predicted", "The data, the model, and below what the model leaves unexplained."),
    ("responses", "Frequency responses", "Of the model and of the data."),
    ("shapes", "Mode shapes", "Over the sensors, in the order of the outputs; of one sensor over the inputs."),
    ("assurance", "Modal assurance", "Likeness of the shapes of each two modes: 1 alike, 0 orthogonal."),
    ("stabilisation", "Stabilisation", "Poles of models of ascending order; those that stay are modes."),
    ("residuals", "Residuals", "What a good model leaves is white, and has nothing to do with the input."),
)
_OF_SEVERAL = ("shapes", "assurance")  # that say nothing of one output and one input
_EXPERIMENTS = 4  # drawn one by one
_SETTINGS = (
    "structure", "quantity", "quantities", "intersample", "method", "representation", "ports", "shapes_scaled",
    "time_unit", "success", "n_iterations",
)  # fmt: skip
_KEYWORDS = ("ports", "intersample", "method", "representation")  # of pem, that a result has under the same names
_PACKAGES = ("ph_control", "control", "slycot", "numpy", "scipy", "matplotlib")
_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem; color: #1b2430;
       background: #fff; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; border-bottom: 1px solid #c9ccd1; }
pre { white-space: pre-wrap; background: #f4f5f7; padding: .8rem; font-size: .85rem; }
table { border-collapse: collapse; display: block; overflow-x: auto; }
th, td { padding: .2rem .8rem; white-space: nowrap; }
tr:nth-child(even) { background: #f4f5f7; } figure { margin: 1rem 0; } img { max-width: 100%; height: auto; }
figcaption { color: #5a6472; font-size: .9rem; }
@media print { h2, figure { break-inside: avoid; } body { margin: 0; } }
"""


def page_of(result: PEMResult, title: str) -> str:
    """The whole page, with its pictures inside."""
    parts = [f"<h1>{escaped(title)}</h1>", result._repr_html_()]
    if len(result.real_poles):
        head, *rows = real_pole_table(result)
        parts += ["<h2>Real poles</h2>", html_table(head, rows)]
    if result.tests:
        head, *rows = test_table(result.tests)
        parts += ["<h2>Tests of structure</h2>", html_table([*head[:-1], "p"], rows)]
    for kind, heading, caption in _PICTURES:
        if kind in _OF_SEVERAL and max(result.residues.shape[1:]) == 1:
            continue
        # the responses of the next section are the data themselves
        if kind == "fit" and np.iscomplexobj(result.predicted):
            continue
        parts += _section(result, kind, heading, caption)
    settings = [[name, str(getattr(result, name))] for name in _SETTINGS if getattr(result, name, None) is not None]
    titles = list(
        dict.fromkeys(experiment.record.title for experiment in result.experiments if experiment.record.title)
    )
    settings = [["data", ", ".join(titles)]] * bool(titles) + settings
    orders = [[str(row.order), f"{row.loss:.6g}", f"{row.aic:.6g}", f"{row.bic:.6g}"] for row in result.order_table]
    parts += ["<h2>Orders tried</h2>", html_table(["order", "loss", "AIC", "BIC"], orders)] * bool(orders)
    parts += ["<h2>To repeat it</h2>", html_report(_call(result)), html_table(["setting", "value"], settings)]
    packages = [f"{name} {_version(name)}" for name in _PACKAGES]
    parts.append(html_report("\n".join([f"Python {platform.python_version()}, {platform.machine()}", *packages])))
    body = "\n".join(part for part in parts if part)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{escaped(title)}</title>\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<style>{_STYLE}</style>\n</head>\n'
        f"<body>\n{body}\n</body>\n</html>\n"
    )


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
        given["offset"] = any(
            bool(np.any(getattr(experiment, "offsets", getattr(experiment, "offset", 0.0))))
            for experiment in result.experiments
        )
    return given


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "(from its folder)"


def _section(result: PEMResult, kind: str, heading: str, caption: str) -> list[str]:
    """Heading and pictures of one kind, or why there is none."""
    several = kind in ("fit", "residuals")
    count = min(len(result.experiments), _EXPERIMENTS) if several else 1
    outputs = result.residues.shape[1] if kind == "fit" else 1
    pictures = []
    try:
        for experiment in range(count):
            for output in range(outputs):
                chosen = {"output": output} if outputs > 1 else {}
                which = f"Experiment {experiment + 1}. " if several and len(result.experiments) > 1 else ""
                pictures.append(_picture(result, kind, experiment, chosen, which + caption))
    except StructureError as error:
        pictures.append(f"<p>No picture: {escaped(error)}.</p>")
    if several and len(result.experiments) > count:
        pictures.append(f"<p>The first {count} of {len(result.experiments)} experiments are drawn.</p>")
    return [f"<h2>{escaped(heading)}</h2>", *pictures]


def _picture(result: PEMResult, kind: str, experiment: int, chosen: dict[str, Any], caption: str) -> str:
    content = BytesIO()
    with rc_context({"svg.hashsalt": kind}):
        drawn = result.plot(experiment, kind=kind, **chosen)
        try:
            drawn.figure.savefig(content, format="svg", metadata={"Date": None, "Creator": None})
        finally:
            plt.close(drawn.figure)
    data = b64encode(content.getvalue()).decode("ascii")
    return (
        f'<figure><img alt="{escaped(caption)}" src="data:image/svg+xml;base64,{data}">'
        f"<figcaption>{escaped(caption)}</figcaption></figure>"
    )
