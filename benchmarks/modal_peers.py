"""Identification of damped modes side by side: the same data, one run.

    python -m benchmarks.modal_peers [time] [frf] [--seeds N] [--method TEXT ...] [--json FILE]

`time` has records of random plants under white inputs, one input and output and two by four; `frf` the response of a
chain of three masses and of a random plant with two inputs and three outputs.  Every method knows the order, and is
given the best of its settings by the truth, of every data set anew; the picking of stable poles is told the true
frequencies.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.signal import lfilter

from .modal_methods import Discrete, Estimate, Method, Modal, Record, Responses, methods, states
from .montecarlo import environment
from .recordings import BAND, spaced_frequencies

Array = NDArray[np.float64]

AHEAD = 2000  # samples of the new input
BINS = 3.0  # smallest distance of two frequencies
NEAR = 0.3  # of the distance to the next mode: how far off a frequency may be and still be found
FACTOR = 2.0  # by which a damping ratio may be off and still be found
CHAIN = {"stiffness": 13000.0, "damping": 0.6, "mass": 0.3}
CHAIN_NOISE = 8.7e-6  # of each part of the receptance
FRF_NOISE = 0.02  # of the rms of an entry


@dataclass(frozen=True)
class Case:
    """Kind of the data, modes, samples or lines, outputs, inputs, signal-to-noise ratio in dB, damping ratios."""

    kind: str
    n: int
    size: int
    p: int = 1
    m: int = 1
    snr: float = 20.0
    damping: tuple[float, float] = (0.001, 0.02)

    def __str__(self) -> str:
        if self.kind == "chain":
            return "receptance of a chain of three masses, force at 1, sensor at 3"
        ports = f"{self.m} input{'s' * (self.m > 1)} x {self.p} output{'s' * (self.p > 1)}"
        return f"{self.kind}, {self.n} modes, {ports}, {self.size} {'samples' if self.kind == 'record' else 'lines'}"


CASES = {
    "time": (Case("record", 2, 1000), Case("record", 5, 2000), Case("record", 5, 2000, 4, 2)),
    "frf": (Case("chain", 3, 400), Case("response", 4, 400, 3, 2)),
}


# --- data ------------------------------------------------------------------------------------------------------------


def random_plant(case: Case, rng: np.random.Generator) -> Modal:
    """Modes of equal power at the output, with residues of any phase, rank one."""
    gap = BINS * 2 * np.pi / case.size
    d = spaced_frequencies(case.n, gap, (BAND[0] * np.pi, BAND[1] * np.pi), rng)
    low, high = np.log(case.damping)
    zeta = np.exp(rng.uniform(low, high, case.n))
    poles = -zeta * d + 1j * d * np.sqrt(1 - zeta**2)
    shapes = rng.standard_normal((case.n, case.p)) + 1j * rng.standard_normal((case.n, case.p))
    forces = rng.standard_normal((case.n, case.m))
    size = np.sqrt(zeta * d) / np.linalg.norm(shapes, axis=1) / np.linalg.norm(forces, axis=1)
    return Modal(poles, size[:, None, None] * shapes[:, :, None] * forces[:, None, :])


def chain() -> Modal:
    """Receptance of three equal masses between walls, from a force at the first to the last."""
    k, c, m = CHAIN.values()
    stiffness = 2 * np.eye(3) - np.eye(3, k=1) - np.eye(3, k=-1)
    squares, shapes = np.linalg.eigh(stiffness * k / m)
    d = np.sqrt(squares)
    zeta = 0.5 * c / k * d
    poles = -zeta * d + 1j * d * np.sqrt(1 - zeta**2)
    return Modal(poles, (shapes[2] * shapes[0] / m / (2j * poles.imag))[:, None, None])


def data_of(case: Case, seed: int) -> tuple[Record | Responses, Modal, Array]:
    """Noisy data number `seed`, the truth, and standard deviations of the noise of each output or entry."""
    rng = np.random.default_rng([case.n, case.size, case.p, case.m, seed])
    truth = chain() if case.kind == "chain" else random_plant(case, rng)
    if case.kind == "record":
        u = rng.standard_normal((case.m, case.size))
        clean = truth.simulate(u, 1.0)
        sigma = 10 ** (-case.snr / 20) * clean.std(axis=1)
        return Record(u, clean + sigma[:, None] * rng.standard_normal(clean.shape)), truth, sigma
    omega = np.linspace(0, 500, 512)[50:450]
    if case.kind != "chain":
        omega = 3.0 / case.size * np.arange(0.06 * case.size, 1.06 * case.size)
    clean = truth.response(omega)
    deviation = np.full(clean.shape[:2], CHAIN_NOISE)
    if case.kind != "chain":
        deviation = FRF_NOISE * np.sqrt(np.mean(np.abs(clean) ** 2, axis=-1) / 2)
    noise = rng.standard_normal((2, *clean.shape)) * deviation[..., None]
    quantity = "displacement" if case.kind == "chain" else "free"
    return Responses(omega, clean + noise[0] + 1j * noise[1], quantity), truth, deviation.ravel()


def bound(data: Record | Responses, truth: Modal, sigma: Array) -> tuple[Array, Array]:
    """Cramer-Rao bounds: relative standard errors of frequencies and damping ratios, of a model with free residues."""
    columns, own = derivatives(data, truth)
    basis = np.linalg.qr(own.T)[0]
    information = np.zeros((2 * len(truth.poles),) * 2)
    for deviation, shared in zip(sigma, columns, strict=True):
        rest = shared.T - basis @ (basis.T @ shared.T)
        information += rest.T @ rest / deviation**2
    covariance = np.linalg.inv(information)
    return _relative(truth.poles, covariance)


def derivatives(data: Record | Responses, truth: Modal) -> tuple[list[Array], Array]:
    """Derivatives of each output, or entry, by (Im p, Re p), and those by what enters linearly, shared by all."""
    n = len(truth.poles)
    if isinstance(data, Responses):
        terms = 1 / (1j * data.omega - truth.poles[:, None]), 1 / (1j * data.omega - truth.poles.conj()[:, None])
        slopes = np.square(terms)
        entries = truth.residues.reshape(n, -1).T
        columns = []
        for residue in entries:
            of, conjugate = residue[:, None] * slopes[0], residue.conj()[:, None] * slopes[1]
            columns.append(_parts(np.concatenate([1j * (of - conjugate), of + conjugate])))
        own = _parts(np.concatenate([terms[0] + terms[1], 1j * (terms[0] - terms[1])]))
        return columns, own
    h, count = data.h, data.u.shape[1]
    x = np.array([states(p, data.u, h) for p in truth.poles])
    w = np.array([_slope(p, data.u, x[l], h) for l, p in enumerate(truth.poles)])
    columns = []
    for residue in truth.residues.transpose(1, 0, 2):
        of = 2 * np.einsum("lm,lmt->lt", residue, w)
        columns.append(np.concatenate([(1j * of).real, of.real]))
    flat = 2 * x.reshape(-1, count)
    decays = np.exp(np.outer(truth.poles, h * np.arange(count)))
    own = np.concatenate([flat.real, flat.imag, decays.real, decays.imag])
    return columns, own


def _parts(values: Any) -> Array:
    return np.concatenate([values.real, values.imag], axis=1)


def _slope(p: complex, u: Array, x: Any, h: float) -> Any:
    """Derivative of modal states by the pole."""
    z = np.exp(p * h)
    gain = (h * z * p - (z - 1)) / p**2
    return lfilter([0.0, 1.0], [1.0, -z], h * z * x + gain * u)


def _relative(poles: Any, covariance: Array) -> tuple[Array, Array]:
    d = np.abs(poles)
    zeta = -poles.real / d
    found = []
    for by_imag, by_real in ((poles.imag / d**2, poles.real / d**2),
                             (-poles.imag / d**2, -1 / d / zeta - poles.real / d**2)):  # fmt: skip
        J = np.concatenate([np.diag(by_imag), np.diag(by_real)], axis=1)
        found.append(np.sqrt(np.diag(J @ covariance @ J.T)))
    return found[0], found[1]


# --- judgement -------------------------------------------------------------------------------------------------------


def errors(estimate: Estimate, truth: Modal) -> tuple[Array, Array, bool]:
    """Relative errors of frequencies and damping ratios of the poles next to the truth, and whether all are found."""
    d, n = np.abs(truth.poles), len(truth.poles)
    zeta = -truth.poles.real / d
    poles = np.asarray(estimate.poles)
    poles = poles[np.isfinite(poles)]
    if len(poles) < n:
        poles = np.concatenate([poles, np.full(n - len(poles), 1e3 * d.max() * 1j)])
    rows, columns = linear_sum_assignment(np.abs(np.subtract.outer(truth.poles.imag, poles.imag)))
    near = poles[columns[np.argsort(rows)]]
    off = np.abs(near) / d - 1
    damping = -near.real / np.abs(near) / zeta
    gaps = np.abs(np.subtract.outer(d, d)) + np.diag(np.full(n, np.inf))
    allowed = NEAR * np.minimum(gaps.min(axis=1), 0.1 * d) / d
    found = (np.abs(off) <= allowed) & (damping <= FACTOR) & (damping >= 1 / FACTOR)
    return off, damping - 1, bool(found.all())


def attempt(method: Method, setting: Any, data: Record | Responses, truth: Modal, seed: int) -> dict[str, Any]:
    """One identification, timed, and held against the truth."""
    estimate, failure = Estimate(np.zeros(0, complex)), ""
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # failures show in the numbers
        start = perf_counter()
        try:
            estimate = method.identify(data, len(truth.poles), setting)
        except (Exception, SystemExit) as reason:
            failure = f"{type(reason).__name__}: {str(reason)[:100]}"
        seconds = perf_counter() - start
        off, damping, found = errors(estimate, truth)
        ahead = _ahead(estimate, data, truth, seed)
    rank = (bool(failure), not found, rms(damping) if found else rms(np.minimum(np.abs(off), 1.0)))
    return {
        "seed": seed, "setting": setting, "failure": failure, "seconds": seconds, "found": found, "rank": rank,
        "frequency": off.tolist(), "damping": damping.tolist(), "ahead": ahead,
    }  # fmt: skip


def _ahead(estimate: Estimate, data: Record | Responses, truth: Modal, seed: int) -> float:
    """Relative error on what was not fitted: a new input, or frequencies between the lines; NaN without a model."""
    if estimate.model is None:
        return np.nan
    if isinstance(data, Record):
        u = np.random.default_rng([seed, 7]).standard_normal((len(data.u), AHEAD))
        answer, said = truth.simulate(u, data.h), estimate.model.simulate(u, data.h)
        axes: tuple[int, ...] = (1,)
    else:
        if isinstance(estimate.model, Discrete):
            return np.nan
        between = 0.5 * (data.omega[1:] + data.omega[:-1])
        answer, said, axes = truth.response(between), estimate.model.response(between), (2,)
    relative = np.linalg.norm(said - answer, axis=axes[0]) / np.linalg.norm(answer, axis=axes[0])
    found = float(np.sqrt(np.mean(relative**2)))
    return found if np.isfinite(found) else np.inf


def trials(method: Method, case: Case, seeds: int, truths: dict[str, Array]) -> list[dict[str, Any]]:
    """Each seed with the best setting for it."""
    found = []
    for seed in range(seeds):
        data, truth, _ = data_of(case, seed)
        truths["near"] = np.abs(truth.poles)
        if not seed:
            attempt(method, method.settings[0], data, truth, seed)  # imports are not what is timed
        tried = [attempt(method, setting, data, truth, seed) for setting in method.settings]
        found.append(min(tried, key=lambda trial: trial["rank"]))
    return found


def table(case: Case, rows: dict[str, list[dict[str, Any]] | str], limits: tuple[float, float]) -> Iterator[str]:
    """Lines of a case: counts, rms errors of the trials that found all modes, medians of prediction and time."""
    yield f"\n{case!s:62s} all found   rms d [%]   rms zeta [%]   x bound   new data [%]   time [s]"
    yield f"  {'Cramer-Rao bound':60s} {'':9s}   {100 * limits[0]:9.2g}   {100 * limits[1]:12.3g}   {1:7.2f}"
    for name, done in rows.items():
        if isinstance(done, str):
            yield f"  {name:60s} {done}"
            continue
        good = [one for one in done if one["found"]]
        d, zeta = (rms([one[key] for one in good]) for key in ("frequency", "damping"))
        ahead, seconds = (float(np.median([one[key] for one in done])) for key in ("ahead", "seconds"))
        known = f"{100 * ahead:12.3g}" if np.isfinite(ahead) else f"{'-':>12s}"
        yield (
            f"  {name:60s} {len(good):4d}/{len(done):<4d}   {100 * d:9.2g}   {100 * zeta:12.3g}   "
            f"{zeta / limits[1]:7.2f}   {known}   {seconds:8.3f}"
        )
        if case.kind == "chain" and good:
            modes = np.sqrt(np.mean(np.square([one["damping"] for one in good]), axis=0))
            yield f"      zeta of each mode: {', '.join(f'{100 * one:.2f} %' for one in modes)}"
        for reason in sorted({one["failure"] for one in done if one["failure"]}):
            yield f"      failed: {reason}"


def rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else np.nan


def study(case: Case, seeds: int, wanted: Sequence[str] | None) -> tuple[list[str], dict[str, Any]]:
    """Run all methods on a case."""
    truths: dict[str, Array] = {}
    kind = Record if case.kind == "record" else Responses
    rows: dict[str, list[dict[str, Any]] | str] = {}
    for method in methods(lambda: truths["near"]):
        if kind not in method.of or not chosen(method, wanted):
            continue
        rows[method.name] = method.missing or trials(method, case, seeds, truths)
    limits = [bound(*data_of(case, seed)) for seed in range(seeds)]
    limit = tuple(float(np.sqrt(np.mean(np.square([one[k] for one in limits])))) for k in (0, 1))
    return list(table(case, rows, (limit[0], limit[1]))), {"case": str(case), "bound": limit, "trials": rows}


def chosen(method: Method, wanted: Sequence[str] | None) -> bool:
    return wanted is None or method.package == "ph_control" or any(text in method.name for text in wanted)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the studies and print a table of each."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.modal_peers", description=__doc__.splitlines()[0])
    parser.add_argument("studies", nargs="*", metavar="STUDY", help="time, frf (default: both)")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--method", nargs="+", metavar="TEXT", help="only the methods with one of these in their names")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    names = options.studies or list(CASES)
    unknown = [one for one in names if one not in CASES]
    if unknown:
        parser.error(f"{unknown[0]} is no study; they are time and frf")
    print(f"modal_peers: {environment(1)}", flush=True)
    document = []
    for name in names:
        for case in CASES[name]:
            lines, found = study(case, options.seeds, options.method)
            print("\n".join(lines), flush=True)
            document.append(found)
    if options.json:
        options.json.write_text(json.dumps(document, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
