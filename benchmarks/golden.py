"""A gate for changes of the identification: 199 fits with the truth beside them, frozen, and compared.

    python -m benchmarks.golden record FILE [--kind NAME ...]
    python -m benchmarks.golden compare OLD NEW [--errors 1.02] [--time 1.0]

`record` fits the records of `golden_records` and writes what was found; `compare` prints a line for each kind and exits
with status 1 if an order is right less often in any kind, the errors of a kind are larger, or the fits take longer.
Errors are those of fits whose order is right in both files; errors below `EXACT` are rounding, and count as that.
Results are read by their public attributes only, and what a version does not have is null, and not compared.
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

import ph_control as phc

from .golden_records import KINDS, Plant, record

Array = NDArray[Any]

DIGITS = 6
EXACT = 1e-9  # relative error that is rounding
UNDAMPED = 1e-3  # damping ratio that errors of smaller ones are relative to
ERRORS = ("frequencies", "damping", "residues")

# --- recording -------------------------------------------------------------------------------------------------------


def rounded(value: Any) -> Any:
    """Value in JSON, numbers to six digits, complex ones as pairs, null where not finite."""
    if isinstance(value, dict):
        return {key: rounded(one) for key, one in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [rounded(one) for one in value]
    if isinstance(value, complex):
        return [rounded(value.real), rounded(value.imag)]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None
    return value


def numbers(result: Any, name: str, kind: type = float) -> Array | None:
    """Attribute of a result as an array, None where a version has no such attribute."""
    try:
        value = getattr(result, name, None)
        return None if value is None else np.asarray(value, kind)
    except Exception:  # a property that another version refuses
        return None


def error_of(result: Any, name: str) -> Array | None:
    """Standard errors under a name, None where there are none."""
    errors = getattr(result, "stderr", None)
    return np.asarray(errors[name], float) if errors is not None and name in errors else None


def distances(plant: Plant, poles: Array, residues: Array | None) -> dict[str, list[float] | None]:
    """Relative errors of the poles and residues that are nearest to the true ones."""
    true, found = linear_sum_assignment(np.abs(plant.poles[:, None] - poles[None, :]) / np.abs(plant.poles)[:, None])
    sizes = np.abs(plant.poles[true])
    zeta, estimate = (-p.real / np.abs(p) for p in (plant.poles[true], poles[found]))
    made: dict[str, Any] = {
        "frequencies": np.abs(poles[found]) / sizes - 1, "damping": (estimate - zeta) / np.maximum(zeta, UNDAMPED),
        "residues": None,
    }  # fmt: skip
    if residues is not None and residues.shape[1:] == plant.residues.shape[1:] and plant.residues.shape[2]:
        difference = residues[found] - plant.residues[true]
        norms = [np.sqrt((np.abs(one) ** 2).sum(axis=(1, 2))) for one in (difference, plant.residues[true])]
        made["residues"] = norms[0] / norms[1]
    return made


def fitted(name: str, place: int) -> dict[str, Any]:
    """Fit to one record, and what is compared of it."""
    seed, made = record(name, place)
    known = {"kind": name, "place": place, "seed": seed, "true_order": len(made.plant.poles)}
    start = process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            result: Any = phc.pem(made.data, **made.keywords)
    except Exception as error:
        return {**known, "order": None, "error": type(error).__name__, "seconds": process_time() - start}
    seconds = process_time() - start
    poles, residues = numbers(result, "poles", complex), numbers(result, "residues", complex)
    poles = np.zeros(0, complex) if poles is None else poles
    driven = not (isinstance(made.data, tuple) and made.data[0] is None)
    outcome, findings = getattr(result, "outcome", None), getattr(result, "findings", ())
    return {
        **known, "order": len(poles), "error": None, "seconds": seconds, "true_poles": made.plant.poles, "poles": poles,
        "residues": residues, "stderr_frequencies": error_of(result, "natural_frequencies"),
        "stderr_damping": error_of(result, "damping_ratios"), "loss": numbers(result, "loss"),
        "bic": numbers(result, "bic"), "structure": getattr(result, "structure", None),
        "outcome": getattr(outcome, "name", None),
        "findings": sorted({one.cause.name for one in findings if getattr(one, "cause", None) is not None}),
        "errors": distances(made.plant, poles, residues if driven else None),
    }  # fmt: skip


def recorded(names: Sequence[str]) -> dict[str, Any]:
    """Fits of the kinds, with the versions they were made with."""
    fitted("plain", 0)  # what is imported or compiled first is not timed
    fits = []
    for name in names:
        rows = [fitted(name, place) for place in range(KINDS[name][0])]
        right = sum(row["order"] == row["true_order"] for row in rows)
        print(f"{name:24} {right}/{len(rows)} {sum(row['seconds'] for row in rows):8.2f} s", flush=True)
        fits += rows
    total = sum(row["seconds"] for row in fits)
    print(f"{'all':24} {len(fits)} fits {total:8.2f} s")
    version = getattr(phc, "__version__", None)
    return rounded({"version": version, "numpy": np.__version__, "seconds": total, "fits": fits})


def text_of(document: dict[str, Any]) -> str:
    """JSON with a line for each fit."""
    head = {key: value for key, value in document.items() if key != "fits"}
    lines = ",\n".join(json.dumps(row, separators=(",", ":")) for row in document["fits"])
    return f'{json.dumps(head)[:-1]}, "fits": [\n{lines}\n]}}\n'


# --- comparing -------------------------------------------------------------------------------------------------------


def pooled(fits: Iterable[dict[str, Any]], name: str) -> float | None:
    """Root mean square of the relative errors of fits; None where there are none."""
    values = [one for row in fits for one in (row.get("errors") or {}).get(name) or [] if one is not None]
    return max(float(np.sqrt(np.mean(np.square(values)))), EXACT) if values else None


def share(count: int, total: int) -> str:
    """Text of a share."""
    return f"{count}/{total}"


def compared(old: dict[str, Any], new: dict[str, Any], *, errors: float, seconds: float) -> tuple[list[str], list[str]]:
    """Lines of a table, and reasons against the new one."""
    sides = [{(row["kind"], row["place"], row["seed"]): row for row in one["fits"]} for one in (old, new)]
    common = [key for key in sides[0] if key in sides[1]]
    lines = [f"{'kind':24} {'order':>9} {'old, new, ratio of the errors of ' + ', '.join(ERRORS):78} {'same':>6} time"]
    against = [] if common else ["the files have no fit in common"]
    if len(common) < len(sides[0]):
        against.append(f"{len(sides[0]) - len(common)} of {len(sides[0])} fits are missing in the new file")
    changes = []
    for name in dict.fromkeys(key[0] for key in common):
        pairs = [(sides[0][key], sides[1][key]) for key in common if key[0] == name]
        right = [[row["order"] == row["true_order"] for row in side] for side in zip(*pairs, strict=True)]
        if sum(right[1]) < sum(right[0]):
            against.append(f"{name}: the order is right in {sum(right[1])} fits, before in {sum(right[0])}")
        both = [pair for pair, a, b in zip(pairs, *right, strict=True) if a and b]
        cells = []
        for what in ERRORS:
            # of numbers that both have
            fair = [pair for pair in both if all((row.get("errors") or {}).get(what) for row in pair)]
            before, after = (pooled(side, what) for side in zip(*fair, strict=True)) if fair else (None, None)
            if before is None or after is None:
                cells.append(f"{'-':>26}")
                continue
            cells.append(f"{before:9.2e} {after:9.2e} {after / before:6.3f}")
            if after > errors * before:
                against.append(f"{name}: errors of {what} are {after:.3e}, before {before:.3e}")
        same = sum(a.get("structure") == b.get("structure") for a, b in pairs)
        times = [sum(row["seconds"] for row in side) for side in zip(*pairs, strict=True)]
        orders = f"{share(sum(right[0]), len(pairs))}, {share(sum(right[1]), len(pairs))}"
        lines.append(
            f"{name:24} {orders:>9} {' '.join(cells)} {share(same, len(pairs)):>6} {times[1] / max(times[0], 1e-9):.2f}"
        )
        changes += [change for pair in pairs for change in changed(*pair)]
    totals = [sum(side[key]["seconds"] for key in common) for side in sides]
    lines.append(f"{'all':24} {totals[0]:.1f} s, {totals[1]:.1f} s, ratio {totals[1] / max(totals[0], 1e-9):.3f}")
    if totals[1] > seconds * totals[0]:
        against.append(f"the fits take {totals[1]:.1f} s, before {totals[0]:.1f} s")
    return [*lines, *changes], against


def changed(old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """What differs in a fit beside its numbers."""
    place, lines = f"{old['kind']} {old['place']}", []
    for name in ("order", "structure", "outcome", "error"):
        if old.get(name) != new.get(name):
            lines.append(f"  {place}: {name} {old.get(name)} -> {new.get(name)} (true order {old['true_order']})")
    before, after = ({*(row.get("findings") or [])} for row in (old, new))
    signed = [f"-{one}" for one in sorted(before - after)] + [f"+{one}" for one in sorted(after - before)]
    return lines + ([f"  {place}: findings {' '.join(signed)}"] if signed else [])


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.golden", description=(__doc__ or "").partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    make = commands.add_parser("record", help="fit, and write what was found")
    make.add_argument("file", type=Path)
    make.add_argument("--kind", nargs="+", choices=tuple(KINDS), default=tuple(KINDS), metavar="NAME")
    judge = commands.add_parser("compare", help="compare two files")
    judge.add_argument("old", type=Path)
    judge.add_argument("new", type=Path)
    judge.add_argument("--errors", type=float, default=1.02, help="ratio of errors that is allowed")
    judge.add_argument("--time", type=float, default=1.0, help="ratio of processor times that is allowed")
    options = parser.parse_args(argv)
    if options.command == "record":
        options.file.write_text(text_of(recorded(options.kind)), encoding="utf-8")
        return 0
    documents = [json.loads(path.read_text(encoding="utf-8")) for path in (options.old, options.new)]
    lines, against = compared(*documents, errors=options.errors, seconds=options.time)
    print("\n".join([*lines, "", *(against or ["the new one is no worse"])]))
    return int(bool(against))


if __name__ == "__main__":
    sys.exit(main())
