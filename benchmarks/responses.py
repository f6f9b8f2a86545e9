"""Monte Carlo of fits to responses: order, coverage, narrow minima, outliers, damping, windows, dead time.

python -m benchmarks.responses order|coverage|trap|outlier|damping|window|late [--seeds N]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.signal import get_window

import ph_control as phc

Array = NDArray[np.float64]

ORDERS = (3, 6, 12)
NOISES = {"gain": (0.02, 0.0), "constant": (0.0, 0.02), "both": (0.02, 0.02), "high floor": (0.02, 0.3)}
DISTANCES = (0.1, 1e-2, 1e-4, 1e-6)
RATIOS = (0.0, 1e-5, 1e-4, 1e-3)


def plant(n: int, seed: int, points: int = 25) -> tuple[Array, Array, Array]:
    """Frequencies at least 4 points apart, residues within a factor of 5, and the points."""
    rng = np.random.default_rng([n, seed])
    omega = np.linspace(0.05, 3.2, points * n)
    place = np.sort(rng.uniform(2, len(omega) - 3, (1000, n)), axis=1)
    place = place[np.min(np.diff(place, axis=1), axis=1, initial=np.inf) >= 4][0]
    return np.interp(place, np.arange(len(omega)), omega), rng.uniform(0.2, 1.0, n), omega


def response(d: Array, r: Array, omega: Array, ratio: float = 0.0) -> NDArray[np.complex128]:
    """Velocity of damped modes."""
    gap = d[:, None] ** 2 - omega**2 + 2j * ratio * d[:, None] * omega
    return np.asarray((r * d) @ (1j * omega / gap))


def noise(size: Array, seed: int) -> NDArray[np.complex128]:
    """Complex noise whose parts have this standard deviation."""
    rng = np.random.default_rng(seed)
    return np.asarray(size * (rng.standard_normal(len(size)) + 1j * rng.standard_normal(len(size))))


def measured(exact: NDArray[np.complex128], omega: Array, size: Array, seed: int) -> Any:
    """The response with noise."""
    return ct.frd(exact + noise(size, seed), omega, smooth=False)


def of_cause(result: Any, cause: str) -> list[tuple[float, ...]]:
    """Values of the findings of some cause."""
    return [finding.values for finding in result.findings if finding.cause.name == cause]


def order(seeds: int) -> None:
    """How often the order is found where noise and weights go with the gain."""
    for n in ORDERS:
        right, consistent = 0, 0
        for seed in range(seeds):
            d, r, omega = plant(n, seed)
            exact = response(d, r, omega)
            size = 0.01 * np.abs(exact)
            result = phc.pem(measured(exact, omega, size, seed), weights=1 / size**2, structure="lossless")
            right += result.order == n
            consistent += result.verdict.startswith("consistent")
        print(
            f"n = {n}: order right {100 * right / seeds:.1f} %, 'consistent' {100 * consistent / seeds:.1f} %",
            flush=True,
        )


def coverage(seeds: int) -> None:
    """How often 95 % intervals hold the true values, without weights."""
    for name, (relative, floor) in NOISES.items():
        for n in (1, 3, 6):
            inside: dict[str, list[Array]] = {"d": [], "r": []}
            consistent, grows = 0, 0
            for seed in range(seeds):
                d, r, omega = plant(n, seed)
                exact = response(d, r, omega)
                size = np.hypot(relative * np.abs(exact), floor * np.median(np.abs(exact)))
                result = phc.pem(measured(exact, omega, size, seed), n, structure="lossless")
                consistent += result.verdict.startswith("consistent")
                grows += of_cause(result, "GAIN_NOISE") != []
                intervals = result.confidence_interval()
                for key, true in (("d", d), ("r", r)):
                    low, high = intervals[key].T
                    inside[key].append((low <= true) & (true <= high))
            shares = ", ".join(f"{key} {100 * np.mean(one):.1f} %" for key, one in inside.items())
            print(
                f"{name} n = {n}: {shares} inside; 'consistent' {100 * consistent / seeds:.1f} %, "
                f"noise grows with the gain {100 * grows / seeds:.1f} %",
                flush=True,
            )


def trap(seeds: int) -> None:
    """How often a resonance close to a point is missed, and the least standard error."""
    for distance in DISTANCES:
        stuck, least = 0, np.inf
        for seed in range(seeds):
            d, r, omega = plant(6, seed)
            l = seed % 6
            d[l] = omega[np.argmin(np.abs(omega - d[l]))] - distance * (omega[1] - omega[0])
            exact = response(d, r, omega)
            size = 0.001 * np.abs(exact)
            data, weights = measured(exact, omega, size, seed), 1 / size**2
            result = phc.pem(data, 6, weights=weights, structure="lossless")
            best = phc.pem(data, 6, weights=weights, initial_guess=(d, r), structure="lossless")
            stuck += result.loss > 1.001 * best.loss
            least = min(least, float(np.min(result.stderr["d"] / result.d)))
        print(f"{distance:g} points away: stuck {stuck} of {seeds}, least standard error of d {least:.1e}", flush=True)


def outlier(seeds: int) -> None:
    """How often one error of 200 standard deviations is named, and nothing else."""

    def of_response(seed: int, by: float) -> Any:
        d, r, omega = plant(3, seed)
        exact = response(d, r, omega)
        size = 0.01 * np.abs(exact)
        values = exact + noise(size, seed)
        values[seed % len(omega)] += by * size[seed % len(omega)]
        return phc.pem(ct.frd(values, omega, smooth=False), 3, weights=1 / size**2, structure="lossless"), seed % len(
            omega
        )

    def of_record(seed: int, by: float) -> Any:
        rng = np.random.default_rng(seed)
        u, truth = rng.standard_normal(400), phc.ph(phc.modes([0.5, 2.0], [1.0, 0.25]))
        y = np.array(phc.forced_response(truth, np.arange(400.0), u, intersample="zoh").outputs)
        y += 0.1 * rng.standard_normal(400)
        y[seed] += 0.1 * by
        return phc.pem((u, y), 2, dt=1.0, structure="lossless"), seed

    kinds: dict[str, Callable[[int, float], Any]] = {"response": of_response, "record": of_record}
    for name, fit in kinds.items():
        named, alarms = 0, 0
        for seed in range(seeds):
            result, place = fit(seed, 200.0)
            named += of_cause(result, "OUTLIERS") == [(place,)] and not result.verdict.startswith("consistent")
            alarms += of_cause(fit(seed, 0.0)[0], "OUTLIERS") != []
        print(f"{name}: named {named} of {seeds}, false alarms {alarms}", flush=True)


def damping(seeds: int) -> None:
    """How often a lossless model is refused."""
    for ratio in RATIOS:
        for kind in ("weights", "constant", "gain"):
            p, consistent, scores = [], 0, []
            for seed in range(seeds):
                d, r, omega = plant(3, seed)
                exact = response(d, r, omega, ratio)
                size = 0.02 * (np.full(len(omega), np.median(np.abs(exact))) if kind == "constant" else np.abs(exact))
                result = phc.pem(
                    measured(exact, omega, size, seed), 3, weights=1 / size**2 if kind == "weights" else None
                )
                p += [test.p for test in result.tests]
                consistent += result.verdict.startswith("consistent")
                if result.structure != "lossless" and result.order == 3:
                    scores.append((result.damping_ratios - ratio) / result.stderr["damping_ratios"])
            shares = ", ".join(
                f"p < {level:g}: {100 * np.mean(np.array(p) < level):.1f} %" for level in (0.05, 0.01, 1e-3)
            )
            rms = f"{np.sqrt(np.mean(np.square(scores))):.2f}" if scores else "-"
            print(
                f"{kind}, zeta {ratio:g}: {len(p)} tests, {shares}; 'consistent' {100 * consistent / seeds:.1f} %; "
                f"damped in {len(scores)}, rms z-score {rms}",
                flush=True,
            )


# --- estimates with a window -----------------------------------------------------------------------------------------

# quantity, outputs, inputs, samples in a block, blocks, ends of the damping ratios, noise over the output
WINDOWED = (
    ("velocity", 1, 1, 512, 20, (0.004, 0.02), 0.1), ("velocity", 1, 1, 512, 20, (0.002, 0.006), 0.1),
    ("displacement", 1, 1, 512, 20, (0.004, 0.02), 0.1), ("acceleration", 1, 1, 512, 20, (0.004, 0.02), 0.1),
    ("velocity", 1, 1, 256, 40, (0.004, 0.02), 0.1), ("velocity", 1, 1, 512, 20, (0.004, 0.02), 0.3),
    ("velocity", 2, 1, 512, 20, (0.004, 0.02), 0.1), ("velocity", 2, 2, 512, 20, (0.004, 0.02), 0.1),
)  # fmt: skip
STEP = 0.5


def structure(
    outputs: int, inputs: int, quantity: str, ends: tuple[float, float], seed: int
) -> tuple[Array, Array, Any]:
    """Frequencies, damping ratios and matrices of three modes with classical damping; output k is at input k."""
    rng = np.random.default_rng([seed, 99])
    w = np.sort(rng.uniform(0.4, 2.6, (1000, 3)), axis=1)
    w = w[np.min(np.diff(w, axis=1), axis=1) >= 0.33][0]
    zeta = np.exp(rng.uniform(*np.log(ends), 3))
    count = max(outputs, inputs)
    phi = rng.uniform(0.5, 1, (3, count)) * rng.choice([-1, 1], (3, count))
    A = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.diag(w**2), -np.diag(2 * zeta * w)]])
    B = np.concatenate([np.zeros((3, inputs)), phi[:, :inputs]])
    C = {
        "displacement": np.eye(6)[:3], "velocity": np.eye(6)[3:], "acceleration": A[3:],
    }[quantity]  # fmt: skip
    D = phi[:, :outputs].T @ phi[:, :inputs] * (quantity == "acceleration")
    return w, zeta, (A, B, phi[:, :outputs].T @ C, D)


def averaged(system: Any, length: int, blocks: int, size: float, seed: int) -> Any:
    """H1 estimate over the response of the hold, of a plant in motion under a held random force."""
    A, B, C, D = system
    rng = np.random.default_rng([seed, 5])
    T, m = length * blocks, B.shape[1]
    u = rng.standard_normal((m, T + 4000))
    plant = ct.c2d(ct.ss(A, B, C, D), STEP)
    y = np.atleast_2d(ct.forced_response(plant, inputs=u, squeeze=False).outputs)[:, 4000:]
    u = u[:, 4000:]
    y = y + size * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    window, starts = get_window("hann", length), range(0, T - length + 1, length // 2)
    U, Y = (np.array([np.fft.rfft(window * x[:, k : k + length]) for k in starts]) for x in (u, y))
    cross, power = (np.einsum("bok,bik->koi", x, U.conj()) for x in (Y, U))
    lines = np.arange(2, length // 2)
    H = np.moveaxis(np.linalg.solve(np.swapaxes(power, 1, 2), np.swapaxes(cross, 1, 2)).swapaxes(1, 2), 0, -1)
    omega = 2 * np.pi * lines / (length * STEP)
    hold = np.sinc(omega * STEP / (2 * np.pi)) * np.exp(-0.5j * omega * STEP)
    return ct.frd(H[..., lines] / hold, omega, smooth=False)


def percent(shares: list[Array]) -> Array:
    """Means over seeds, in per cent."""
    return np.round(100 * np.mean(shares, axis=0), 1)


def window(seeds: int) -> None:
    """Order, bias and coverage of fits to estimates with a Hann window, and how often a true structure is refused."""
    for quantity, outputs, inputs, length, blocks, ends, size in WINDOWED:
        w, zeta, system = structure(outputs, inputs, quantity, ends, 1)
        right, refused = 0, 0
        scores: dict[str, list[Array]] = {"natural_frequencies": [], "damping_ratios": []}
        errors, spread = [], []
        for seed in range(seeds):
            data = averaged(system, length, blocks, size, seed)
            result = phc.pem(data, window=("hann", length), intersample="zoh", quantity=quantity)
            if result.states != 6 or result.order != 3:
                continue
            right += 1
            refused += next((test.p < 0.05 for test in result.tests if test.hypothesis == "classical"), False)
            for key, true in (("natural_frequencies", w), ("damping_ratios", zeta)):
                scores[key].append((getattr(result, key) - true) / result.stderr[key])
            errors.append(result.damping_ratios / zeta - 1)
            spread.append(result.stderr["damping_ratios"] / zeta)
        inside = ", ".join(f"{key} {100 * np.mean(np.abs(z) < 1.96):.1f} %" for key, z in scores.items())
        in_band = np.round(zeta * w * length * STEP / np.pi, 1)
        print(
            f"{quantity} {outputs} x {inputs}, {blocks} blocks of {length}, noise {size:g}, {in_band} lines at -3 dB: "
            f"order right {right} of {seeds}, inside {inside}; bias of damping {percent(errors)} % "
            f"beside standard errors of {percent(spread)} %; classical refused {100 * refused / max(1, right):.1f} %",
            flush=True,
        )


def late_plant(seed: int) -> tuple[Any, float]:
    """Response of a random plant with dead time: lags and modes of any gains, some outputs; and the delay.

    At the last point the delay turns the phase by a third of a radian to five turns.
    """
    rng = np.random.default_rng([seed, 17])
    outputs, modes = int(rng.choice([1, 1, 2, 3])), int(rng.integers(0, 4))
    omega = np.linspace(0.2, 16.0, 240) if rng.random() < 0.5 else np.geomspace(0.1, 24.0, 160)
    rates = np.sort(np.exp(rng.uniform(np.log(0.2), np.log(5.0), 3)))[: int(rng.integers(modes == 0, 3))]
    delay = float(np.exp(rng.uniform(np.log(0.3), np.log(30.0)))) / omega[-1]
    s = 1j * omega
    exact = np.zeros((outputs, len(omega)), complex)
    for rate in rates:
        exact += rng.standard_normal(outputs)[:, None] * rate / (s + rate)
    for frequency in np.exp(rng.uniform(np.log(0.6), np.log(12.0), modes)):
        width = np.exp(rng.uniform(np.log(0.003), np.log(0.05))) * frequency
        exact += 0.3 * rng.standard_normal(outputs)[:, None] * frequency * s / (s * s + 2 * width * s + frequency**2)
    exact *= np.exp(-s * delay)
    errors = rng.standard_normal(exact.shape) + 1j * rng.standard_normal(exact.shape)
    size = np.exp(rng.uniform(np.log(0.002), np.log(0.03)))
    seen = exact + size * np.sqrt(np.mean(np.abs(exact) ** 2, axis=1, keepdims=True)) * errors
    return ct.frd(seen[:, None], omega, smooth=False), delay


def late(seeds: int) -> None:
    """How often modes and lags are as many as with the delay given, and whether the errors of delays hold."""
    same, on_time, z, seconds = 0, 0, [], 0.0
    for seed in range(seeds):
        data, delay = late_plant(seed)
        start = time.process_time()
        fit = phc.pem(data)
        seconds += time.process_time() - start
        known, without = phc.pem(data, delay=delay), phc.pem(data, delay=0.0)
        numbers = [(each.order, len(each.real_poles)) for each in (known, fit, without)]
        same, on_time = same + (numbers[0] == numbers[1]), on_time + (numbers[0] == numbers[2])
        if np.all(np.isfinite(fit.stderr["delay"])) and np.ptp(fit.delay) == 0 < fit.delay[0]:
            z.append(float((fit.delay[0] - delay) / fit.stderr["delay"][0]))
    inside = 100 * np.mean(np.abs(z) < 1.96)
    print(
        f"modes and lags as with the delay given in {same} of {seeds}, without one in {on_time}; delay found with its "
        f"error in {len(z)}: z2 {np.mean(np.square(z)):.2f}, inside 95 % {inside:.0f} %; {seconds / seeds:.2f} s each",
        flush=True,
    )


STUDIES = {
    "order": order, "coverage": coverage, "trap": trap, "outlier": outlier, "damping": damping, "window": window,
    "late": late,
}  # fmt: skip


def main() -> None:
    """Run a study."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.responses", description=__doc__.splitlines()[0])
    parser.add_argument("study", choices=STUDIES)
    parser.add_argument("--seeds", type=int, default=100)
    options = parser.parse_args()
    STUDIES[options.study](options.seeds)


if __name__ == "__main__":
    main()
