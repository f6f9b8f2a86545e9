"""Measured data: what `pem` says of them, and how peers predict and describe the same.

    python -m benchmarks.measured [--method TEXT ...]
    python -m benchmarks.measured --pictures docs

Two recordings and two sets of frequency responses, each by the default call: modes with 95 % intervals, and p-values of
the structures that were tested.  The recordings are fitted once more by their first half alone, and every model has to
predict the second, with the initial state and the offset that fit it best; peers have the setting that predicts best.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

import ph_control as phc

from .modal_methods import Discrete, Method, Modal, Record, Responses, methods
from .modal_peers import chosen
from .montecarlo import environment

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "measured"
STRUCTURES = ("lossless", "classical", "passive", "free")


@dataclass(frozen=True)
class Measured:
    """Data with what is known of them: keywords of `pem`, the unit of frequencies, numbers of modes for the peers.

    `picture` is the name of that of the documentation, `drawn` its keywords.
    """

    file: str
    about: str
    read: Callable[[str], Any]
    known: dict[str, Any]
    unit: str
    orders: tuple[int, ...] = ()
    near: tuple[float, ...] = ()
    picture: str = ""
    drawn: Any = None


def _arm(path: str) -> Any:
    u, y = np.loadtxt(path).T
    return ct.TimeResponseData(np.arange(len(u)), y, inputs=u, issiso=True)


def _player(path: str) -> Any:
    columns = [f"CD_player_arm_dat[{k}]" for k in range(4)]
    return phc.read_mat(path, dt=1.0, input=columns[:2], output=columns[2:])


def _beam(path: str) -> Any:
    """Lines of 1 Hz; that of frequency 0 is no measurement."""
    response = np.array([complex(line) for line in Path(path).read_text().split()])
    data = ct.frd(response[1:], 2 * np.pi * np.arange(1.0, len(response)))
    data.time_unit = "s"
    return data


def _receptances(path: str) -> Any:
    return phc.read_frequency_mat(path, frequency="Freq", response="Recep", frequency_unit="Hz")


CASES = (
    Measured(
        "robot_arm.dat", "flexible robot arm, torque to acceleration, sampling time unknown", _arm,
        {"quantity": "acceleration"}, "cycles/sample", (2, 3, 4), (), "measured_arm.png",
        {"segments": 1, "omega_limits": [0.01, 0.2], "title": "Flexible robot arm: torque to acceleration"},
    ),
    Measured(
        "CD_player_arm_dat.mat", "arm of a compact disc player in closed loop, 2 x 2, sampling time unknown", _player,
        {"quantity": "free"}, "cycles/sample", (4, 7, 8, 10, 14),
    ),
    Measured(
        "meas_point_1.txt", "accelerance of a free beam", _beam, {"quantity": "acceleration"}, "Hz", (),
        (51.5, 142.0, 278.5, 460.5, 688.0, 958.5), "measured_beam.png",
        {"title": "Free beam: force to acceleration"},
    ),
    # all residues of the first receptance have one sign: it is that of the driving point
    Measured(
        "mckiddat.mat", "three receptances of a structure with three modes", _receptances,
        {"quantity": "displacement", "ports": [(0, 0)]}, "Hz", (), (0.1029, 0.1962, 0.3247),
    ),
)  # fmt: skip


def answer(result: Any, unit: str) -> Iterator[str]:
    """What a result says: order, structure, modes with 95 % intervals, tests, findings."""
    yield f"  pem: {result.order} modes, {result.structure}, fit {result.fit_percent:.2f} %; {result.verdict}"
    yield f"  {'f [' + unit + ']':>20s}  {'95 % interval':>24s}   damping [%]  95 % interval"
    ends = result.confidence_interval()
    rows = zip(result.hertz, ends["hertz"], result.damping_ratios, ends["damping_ratios"], strict=True)
    for f, around, zeta, (low, high) in rows:
        text = f"{around[0]:.7g} to {around[1]:.7g}"
        yield f"  {f:20.7g}  {text:>24s}   {100 * zeta:11.4g}  {100 * low:.4g} to {100 * high:.4g}"
    for test in result.tests:
        yield f"  {test.hypothesis:>20s}: p {_p(test.p)}, likelihood ratio {test.likelihood_ratio:.4g}, dof {test.dof}"
    yield f"  {'white residuals':>20s}: p {_p(result.whiteness)}"
    yield f"  findings: {', '.join(finding.cause.name.lower() for finding in result.findings) or 'none'}"


def _p(value: float) -> str:
    return f"= {value:.2g}" if value > 1e-300 else "< 1e-300"


def structures(data: Any, result: Any, known: dict[str, Any]) -> str:
    """Fit of every structure with as many modes, as a share of that of the free one."""
    fits = [phc.pem(data, result.order, structure=one, **known).fit_percent for one in STRUCTURES]
    shares = [f"{name} {100 * fit / fits[-1]:.1f} %" for name, fit in zip(STRUCTURES, fits, strict=True)]
    return f"  fit over that of {result.order} free modes: chosen {100 * result.fit_percent / fits[-1]:.1f} %; " + (
        ", ".join(shares)
    )


def second_half(case: Measured, data: Any, wanted: Sequence[str] | None) -> Iterator[str]:
    """Prediction by models of the first half; signals without their means over it."""
    u, y = (np.atleast_2d(signal) for signal in (data.inputs, data.outputs))
    count = y.shape[1] // 2
    u, y = (x - x[:, :count].mean(axis=1, keepdims=True) for x in (u, y))
    first, rest = Record(u[:, :count], y[:, :count]), (u[:, count:], y[:, count:])
    yield f"  first {count} samples fitted; fit of the other {y.shape[1] - count} [%], by output"
    result = phc.pem((first.u, first.y), dt=1.0, **case.known)
    yield _row(result.order, f"ph_control pem, chosen: {result.structure}", *_predicted(result, rest))
    for n in case.orders:
        free = phc.pem((first.u, first.y), n, dt=1.0, structure="free", **case.known)
        yield _row(n, "ph_control pem, free", *_predicted(free, rest))
        for method in methods(lambda: np.zeros(0)):
            if method.package in ("nfoursid", "sippy_unipi") and chosen(method, wanted):
                yield _row(n, method.name, *_best(method, first, rest, n))


def _row(n: int, name: str, fits: Any, size: int | str) -> str:
    said = " / ".join(f"{one:6.1f}" for one in fits) + f"   {size} states" if len(fits) else size
    return f"  {n:3d} modes  {name:36s} {said}"


def _predicted(model: Any, rest: Any) -> tuple[Any, int]:
    """Fit of each output, and the number of states."""
    found = phc.compare(rest, model, dt=1.0, offset=True)
    return np.atleast_2d(found.output_fit_percent)[0], getattr(model, "observed_system", model).nstates


def _best(method: Method, first: Record, rest: Any, n: int) -> tuple[Any, int | str]:
    """Fit by the setting that predicts best, and the number of states; or nothing, and why."""
    best: tuple[Any, int | str] = ((), method.missing or "no model")
    for setting in () if method.missing else method.settings:
        try:
            model = method.identify(first, n, setting).model
            assert isinstance(model, Discrete)
            found = _predicted(ct.StateSpace(model.A, model.B, model.C, model.D, 1.0), rest)
        except (Exception, SystemExit) as reason:
            best = best if len(best[0]) else ((), f"{type(reason).__name__}: {str(reason)[:80]}")
            continue
        if not len(best[0]) or found[0].mean() > best[0].mean():
            best = found
    return best


def by_peers(case: Measured, data: Any, wanted: Sequence[str] | None) -> Iterator[str]:
    """Frequencies and damping ratios by all methods for responses; the picking of stable poles is told the former."""
    near = 2 * np.pi * np.array(case.near)
    keep = data.omega >= 0.4 * near[0]
    seen = Responses(data.omega[keep], data.frdata[..., keep], case.known["quantity"])
    for method in methods(lambda: near):
        if Responses in method.of and chosen(method, wanted):
            yield f"  {method.name:30s} {method.missing or _modes(method, seen, len(near))}"


def _modes(method: Method, data: Responses, n: int) -> str:
    """Modes of the setting with the smallest residual."""
    best, text = np.inf, "no model"
    for setting in method.settings:
        try:
            start = perf_counter()
            found = method.identify(data, n, setting)
            seconds = perf_counter() - start
        except (Exception, SystemExit) as reason:
            text = text if np.isfinite(best) else f"{type(reason).__name__}: {str(reason)[:80]}"
            continue
        assert isinstance(found.model, Modal)
        loss = float(np.linalg.norm(found.model.response(data.omega) - data.H) / np.linalg.norm(data.H))
        if loss < best:
            poles: NDArray[np.complex128] = found.poles[np.argsort(np.abs(found.poles))]
            pairs = ", ".join(f"{abs(p) / 2 / np.pi:.4g}: {-100 * p.real / abs(p):.3g}" for p in poles)
            best, text = loss, f"{pairs}   residual {100 * loss:.1f} %, {seconds:.2f} s"
    return text


def study(case: Measured, wanted: Sequence[str] | None) -> Iterator[str]:
    """Lines of one file."""
    yield f"\n{case.file}: {case.about}"
    if not (DATA / case.file).exists():
        yield f"  skipped: it is not in {DATA}"
        return
    data = case.read(str(DATA / case.file))
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # failures show in the numbers
        result = phc.pem(data, **case.known)
        yield from answer(result, case.unit)
        if case.orders:
            if result.ports:
                yield structures(data, result, case.known)
            yield from second_half(case, data, wanted)
        else:
            yield "  frequency [Hz]: damping ratio [%], with the number of modes given"
            yield from by_peers(case, data, wanted)


def draw(case: Measured, folder: Path) -> str:
    """Write the picture of a case: what was measured, and the model."""
    if not case.picture or not (DATA / case.file).exists():
        return f"{case.file}: no picture"
    plot = phc.frf_plot(phc.pem(case.read(str(DATA / case.file)), **case.known), **case.drawn)
    plot.figure.savefig(folder / case.picture, dpi=110)
    return f"{case.file}: {case.picture}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print what each file gives."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.measured", description=__doc__.splitlines()[0])
    parser.add_argument("--method", nargs="+", metavar="TEXT", help="only the methods with one of these in their names")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="write the pictures of the documentation there")
    options = parser.parse_args(arguments)
    if options.pictures:
        for case in CASES:
            print(draw(case, options.pictures))
        return
    print(f"measured: {environment(1)}")
    for case in CASES:
        for line in study(case, options.method):
            print(line, flush=True)


if __name__ == "__main__":
    main()
