"""Draw docs/architecture.svg: the folders of the package in their order, and the data flow of three calls.

Run `python docs/architecture.py` after a folder has come or gone; tests/test_layout.py detects this.
"""

from __future__ import annotations

from pathlib import Path

# from the top down, as in the picture: a file imports from folders below its own only
FOLDERS = {
    "cli.commands": "one module per command",
    "cli": "the command line",
    "identification.validation": "models on new data",
    "identification.many": "many recordings, tracking",
    "identification.fit": "pem and its result",
    "identification.change": "has the plant changed",
    "identification.estimates": "parameters with errors",
    "identification.excitation": "what inputs show, test design",
    "identification.structure": "fits with a structure",
    "identification.diagnosis": "disturbances of a fit",
    "identification.innovations": "noise through the plant",
    "identification.moves": "drifts, delays, noise of a fit",
    "identification.growth": "modes join, choice of order",
    "identification.search": "rows, candidates, criteria",
    "identification.parameters": "system functions, updating",
    "identification.uncertainty": "noise, covariance, draws",
    "identification.regression": "residuals and Jacobians",
    "identification.data": "records and responses",
    "circuits": "Foster, Cauer, SPICE netlists",
    "io": "UFF, JSON, .mat, Touchstone",
    "io.tables": "tables of loggers: text, TDMS, WAV",
    "plotting": "data, then plots",
    "controllers": "damping, observers, LQG",
    "reduction": "smaller and passive models",
    "analysis": "time responses, energy, margins",
    "equivalence": "coordinates, morphisms",
    "structures": "mass, damping, stiffness",
    "systems": "subclasses of StateSpace",
    "modal": "poles and residues: the core",
    "symplectic": "Williamson, Darboux",
    "numerics": "beyond LAPACK and numpy",
    "ph_control": "validation, errors, display",
}

# the folders a call passes, in order; docs/architecture.md says what happens at each number
WAYS = {
    "ph(Q, B)": ("#0b6e4f", ["systems", "ph_control", "systems", "symplectic", "modal", "systems"]),
    "forced_response": ("#b3541e", ["analysis", "ph_control", "systems", "modal", "analysis"]),
    "pem(data)": (
        "#2c5aa0",
        [
            "identification.fit", "identification.data", "identification.growth", "identification.regression",
            "identification.moves", "identification.diagnosis", "identification.structure",
            "identification.estimates", "identification.fit",
        ],
    ),
}  # fmt: skip

TOP, ROW, BOX = 64, 46, 34  # pixels: above the first row, from row to row, height of a box
LEFT, NESTED, RIGHT = 20, 40, 400  # of the boxes
STEP, MARGIN = 36, 42  # from stop to stop, between two ways
INK, PAPER, GREY = "#1b2430", "#fbfaf6", "#c9ccd1"


def picture() -> str:
    """Return the picture as SVG, on a light ground of its own, so that it can be read on a dark page too."""
    middle = {name: TOP + ROW * row + BOX / 2 for row, name in enumerate(FOLDERS)}
    height = TOP + ROW * len(FOLDERS) + 8
    width = RIGHT + sum(MARGIN + STEP * len(stops) for _, stops in WAYS.values()) + 12
    parts = [
        f'<rect width="{width}" height="{height}" rx="10" fill="{PAPER}"/>',
        text(LEFT, 40, "folders: each imports from those below it", "14", "start"),
    ]
    parts += [line(RIGHT, y, width - 16, y, "#ececec") for y in middle.values()]
    inner = [y for name, y in middle.items() if name.startswith("identification.")]
    top, foot = inner[0] - BOX / 2 - 6, inner[-1] + BOX / 2 + 6
    parts += [
        f'<rect x="{LEFT}" y="{top}" width="{RIGHT - LEFT}" height="{foot - top}" rx="8" fill="#e4ebf5"/>',
        f'<g transform="translate({LEFT + 14} {(top + foot) / 2}) rotate(-90)">',
        text(0, 0, "identification", "14", "middle"),
        "</g>",
    ]
    for (name, words), y in zip(FOLDERS.items(), middle.values(), strict=True):
        parts += folder(name, words, y, last=name == "ph_control")
    x = RIGHT + MARGIN
    for call, (colour, stops) in WAYS.items():
        parts += way(call, colour, [(x + STEP * place, middle[stop]) for place, stop in enumerate(stops)])
        x += STEP * len(stops) + MARGIN
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" font-family="Helvetica, sans-serif">'
    )
    title = "<title>Folders of ph_control in their order, and the data flow of three calls</title>"
    return "\n".join([head, title, *parts, "</svg>", ""])


def folder(name: str, words: str, y: float, last: bool) -> list[str]:
    """Box of a folder, with an arrow to the next one below."""
    left = NESTED if name.startswith("identification.") else LEFT
    shown = f"{name.rpartition('.')[2]}{'' if last else '/'}"
    parts = [
        f'<rect x="{left}" y="{y - BOX / 2}" width="{RIGHT - 8 - left}" height="{BOX}" rx="5" fill="white"'
        f' stroke="{INK}"/>',
        text(left + 10, y + 5.5, shown, "16", "start", "bold"),
        text(RIGHT - 16, y + 5, words, "14", "end"),
    ]
    if not last:
        foot = y - BOX / 2 + ROW
        parts += [line(220, y + BOX / 2, 220, foot - 5, INK), arrowhead(220, foot, INK)]
    return parts


def way(call: str, colour: str, stops: list[tuple[float, float]]) -> list[str]:
    """Numbered stops of one call from left to right, joined by a line."""
    points = " ".join(f"{x},{y}" for x, y in stops)
    middle = (stops[0][0] + stops[-1][0]) / 2
    parts = [
        text(middle, 40, call, "16", "middle", "bold", colour),
        f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="3" stroke-linejoin="round"/>',
    ]
    for number, (x, y) in enumerate(stops, start=1):
        parts.append(f'<circle cx="{x}" cy="{y}" r="12.5" fill="{colour}"/>')
        parts.append(text(x, y + 5, str(number), "14", "middle", "bold", "white"))
    return parts


def text(x: float, y: float, words: str, size: str, anchor: str, weight: str = "normal", colour: str = INK) -> str:
    """Words at a point."""
    style = f'font-size="{size}" text-anchor="{anchor}" font-weight="{weight}" fill="{colour}"'
    return f'<text x="{x}" y="{y}" {style}>{words}</text>'


def line(x1: float, y1: float, x2: float, y2: float, colour: str) -> str:
    """Straight line."""
    return f'<line x1="{x1}" y1="{y1}" x2="{x2}" y2="{y2}" stroke="{colour}" stroke-width="1.5"/>'


def arrowhead(x: float, y: float, colour: str) -> str:
    """Head of an arrow that points down to (x, y)."""
    return f'<path d="M {x - 5} {y - 8} L {x + 5} {y - 8} L {x} {y} Z" fill="{colour}"/>'


if __name__ == "__main__":
    Path(__file__).with_suffix(".svg").write_text(picture(), encoding="utf-8")
