"""Identification of damped modes side by side: the same data, one run.

    python -m benchmarks.modal_peers [time] [frf] [measured] [--seeds N] [--method TEXT ...] [--json FILE]

`time` has records of random plants under white inputs, one input and output and two by four; `frf` the response of a
chain of three masses and of a random plant with two inputs and three outputs; `measured` real data, with the
prediction of their second half.  Every method knows the order, and is given the best of its settings by the truth, of
every data set anew; the picking of stable poles is told the true frequencies.
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

import ph_control as phc

from .modal_methods import Discrete, Estimate, Method, Modal, Record, Responses, methods, states
from .montecarlo import environment
from .recordings import BAND, spaced_frequencies

Array = NDArray[np.float64]

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "measured"
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
        if kind not in method.of or not _chosen(method, wanted):
            continue
        rows[method.name] = method.missing or trials(method, case, seeds, truths)
    limits = [bound(*data_of(case, seed)) for seed in range(seeds)]
    limit = tuple(float(np.sqrt(np.mean(np.square([one[k] for one in limits])))) for k in (0, 1))
    return list(table(case, rows, (limit[0], limit[1]))), {"case": str(case), "bound": limit, "trials": rows}


def _chosen(method: Method, wanted: Sequence[str] | None) -> bool:
    return wanted is None or method.package == "ph_control" or any(text in method.name for text in wanted)


# --- measured data ---------------------------------------------------------------------------------------------------


def predicted(model: Modal | Discrete, u: Array, y: Array, h: float) -> Array:
    """Fit percent of each output when only the initial state is fitted."""
    with np.errstate(all="ignore"):
        rest = y - model.simulate(u, h)
        motions = model.motions(u.shape[1], h)
        if not (np.isfinite(rest).all() and np.isfinite(motions).all()):
            return np.full(len(y), -np.inf)
        flat = motions.reshape(len(motions), -1)
        rest = rest - (np.linalg.lstsq(flat.T, rest.ravel(), rcond=None)[0] @ flat).reshape(rest.shape)
    return 100 * (1 - np.linalg.norm(rest, axis=1) / np.linalg.norm(y - y.mean(axis=1, keepdims=True), axis=1))


def measured_records() -> Iterator[tuple[str, Record, int, tuple[int, ...]]]:
    """Name, record, samples that are fitted, and orders."""
    arm = np.loadtxt(DATA / "robot_arm.dat")
    yield "robot_arm.dat (torque to acceleration)", _centred(arm[:, :1].T, arm[:, 1:].T, 512), 512, (2, 3)
    player = phc.read_mat(
        DATA / "CD_player_arm_dat.mat", dt=1.0, input=["CD_player_arm_dat[0]", "CD_player_arm_dat[1]"],
        output=["CD_player_arm_dat[2]", "CD_player_arm_dat[3]"],
    )  # fmt: skip
    yield "CD_player_arm_dat.mat (2 x 2)", _centred(player.inputs, player.outputs, 1024), 1024, (4, 8, 10)


def _centred(u: Any, y: Any, fitted: int) -> Record:
    """Record whose means over the part that is fitted are taken away."""
    u, y = (np.asarray(x, float) - np.mean(x[:, :fitted], axis=1, keepdims=True) for x in (u, y))
    return Record(u, y, 1.0, "free")


def measured(wanted: Sequence[str] | None) -> Iterator[str]:
    """Lines of the prediction of the second half by state-space methods, and of modes of measured responses."""
    if not DATA.is_dir():
        yield f"\nmeasured data: skipped, there is no folder {DATA}"
        return
    for name, record, count, orders in measured_records():
        first = Record(record.u[:, :count], record.y[:, :count], record.h, record.quantity)
        yield f"\n{name}: first {count} samples fitted; fit of the rest [%], best horizon by it"
        for n in orders:
            for method in methods(lambda: np.zeros(0)):
                if Record not in method.of or method.package in ("sdypy", "pyoma2") or not _chosen(method, wanted):
                    continue
                yield f"  {n:3d} modes  {method.name:40s} {_second_half(method, first, record, count, n)}"
    yield from _measured_responses(wanted)


def _second_half(method: Method, first: Record, record: Record, count: int, n: int) -> str:
    if method.missing:
        return method.missing
    best, failure, seconds, size = np.full(len(record.y), -np.inf), "no model", 0.0, 0
    for setting in method.settings:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            start = perf_counter()
            try:
                model = method.identify(first, n, setting).model
            except (Exception, SystemExit) as reason:
                failure = f"{type(reason).__name__}: {str(reason)[:80]}"
                continue
            spent = perf_counter() - start
            if model is not None:
                found = predicted(model, record.u[:, count:], record.y[:, count:], record.h)
                if found.mean() > best.mean() or not np.isfinite(best).any():
                    best, seconds, size = found, spent, len(model.motions(1, record.h))
    said = f"{' / '.join(f'{one:6.1f}' for one in best)}   {size} states, {seconds:.2f} s"
    return said if np.isfinite(best).all() else failure


def _measured_responses(wanted: Sequence[str] | None) -> Iterator[str]:
    """Damping ratios of measured responses by all methods for these."""
    beam = np.array([complex(line) for line in (DATA / "meas_point_1.txt").read_text().split()])
    hertz = np.arange(float(len(beam)))
    keep = slice(20, None)
    three = phc.read_frequency_mat(DATA / "mckiddat.mat", frequency="Freq", response="Recep", frequency_unit="Hz")
    accelerance = Responses(2 * np.pi * hertz[keep], beam[None, None, keep], "acceleration")
    cases = (
        ("meas_point_1.txt (accelerance of a beam)", accelerance, (51.5, 142.0, 278.5, 460.5, 688.0, 958.5)),
        ("mckiddat.mat", Responses(three.omega[1:], three.frdata[..., 1:], "displacement"), (0.1029, 0.1962, 0.3247)),
    )
    for name, data, near in cases:
        yield f"\n{name}: natural frequencies [Hz] and damping ratios [%]"
        guess = 2 * np.pi * np.array(near)
        for method in methods(lambda of=guess: of):
            if Responses not in method.of or not _chosen(method, wanted):
                continue
            yield f"  {method.name:30s} {method.missing or _modes_text(method, data, len(near))}"


def _modes_text(method: Method, data: Responses, n: int) -> str:
    """Modes of the setting with the smallest residual."""
    best, text, seconds = np.inf, "no model", 0.0
    for setting in method.settings:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            start = perf_counter()
            try:
                found = method.identify(data, n, setting)
            except (Exception, SystemExit) as reason:
                text = f"{type(reason).__name__}: {str(reason)[:80]}" if not np.isfinite(best) else text
                continue
            seconds = perf_counter() - start
            if not isinstance(found.model, Modal):
                continue
            loss = float(np.linalg.norm(found.model.response(data.omega) - data.H) / np.linalg.norm(data.H))
        if loss < best:
            best, order = loss, np.argsort(np.abs(found.poles))
            poles = found.poles[order]
            pairs = [f"{abs(p) / 2 / np.pi:.4g}: {-100 * p.real / abs(p):.3g}" for p in poles]
            text = f"{', '.join(pairs)}   residual {100 * loss:.1f} %, {seconds:.2f} s"
    return text


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the studies and print a table of each."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.modal_peers", description=__doc__.splitlines()[0])
    parser.add_argument("studies", nargs="*", metavar="STUDY", help="time, frf, measured (default: all)")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--method", nargs="+", metavar="TEXT", help="only the methods with one of these in their names")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    chosen = options.studies or ["time", "frf", "measured"]
    unknown = [one for one in chosen if one not in (*CASES, "measured")]
    if unknown:
        parser.error(f"{unknown[0]} is no study; they are time, frf and measured")
    print(f"modal_peers: {environment(1)}", flush=True)
    document = []
    for name in chosen:
        for case in CASES.get(name, ()):
            lines, found = study(case, options.seeds, options.method)
            print("\n".join(lines), flush=True)
            document.append(found)
        if name == "measured":
            for line in measured(options.method):
                print(line, flush=True)
    if options.json:
        options.json.write_text(json.dumps(document, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
