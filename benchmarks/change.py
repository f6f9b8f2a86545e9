"""Has the plant changed: false alarms of the score test, its power beside refitting, and the control chart.

    python -m benchmarks.change level --seeds 200     false alarms at 5 %, old and new record of one length
    python -m benchmarks.change power --seeds 200     alarms by the shift of one mode, beside a fit of the new record
    python -m benchmarks.change chart --seeds 200     alarms of the chart without a change, and delay after one

`--kind NAME ...` chooses among the kinds of records, `--parameters poles` tests these only.  The order is given, noise
and structure are those of the default call unless a kind needs another one.  `naive` is the level of the same test
without the errors of the old fit.  The line of a kind ends with the processor time of a fit and of a test.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.signal import lfilter
from scipy.special import chdtrc

import ph_control as phc

from .noise import Frame

LEVEL = 0.05
FRAME = Frame(
    np.array([0.4, 0.75]), np.array([0.01, 0.015]), np.array([[1.0, 0.8], [0.6, -1.0]]), np.array([[1.0], [0.8]]),
    np.array([[0.6, 0.7], [-1.0, 0.9]]),
)  # fmt: skip
SHIFTS = (0.0, 1.0, 2.0, 3.0, 4.0, 6.0)  # standard errors of the difference of two fits


def shifted(frame: Frame, share: float) -> Frame:
    """The frame with its first frequency moved by a share."""
    return replace(frame, w=frame.w * np.array([1 + share, *np.ones(len(frame.w) - 1)]))


def white(frame: Frame, rng: np.random.Generator, samples: int, size: float = 0.1, **noise: Any) -> Any:
    """A white input, noise of a share of each output; `correlated`, `memory` of first order, or `forces`."""
    u = rng.standard_normal((frame.driven.shape[1], samples))
    y, pushed = frame.outputs(u, rng, noise.get("forces", 0.0))
    e = rng.standard_normal(y.shape)
    shared = noise.get("correlated", 0.0)
    e = np.sqrt(1 - shared) * e + np.sqrt(shared) * rng.standard_normal(samples)
    memory = noise.get("memory", 0.0)
    e = np.sqrt(1 - memory**2) * lfilter([1.0], [1.0, -memory], e)
    constant = noise.get("offset", 0.0) * rng.standard_normal((len(y), 1))
    return u, y + pushed + size * y.std(axis=1, keepdims=True) * e + constant


def ambient(frame: Frame, rng: np.random.Generator, samples: int, **_: Any) -> Any:
    """Outputs under white forces alone, of a level that differs from record to record, with noise of 20 %."""
    _, y = frame.outputs(np.zeros((1, samples)), rng, 1.0)
    noise = 0.2 * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
    return None, np.exp(0.3 * rng.standard_normal()) * y + noise


def decay(frame: Frame, rng: np.random.Generator, samples: int, **_: Any) -> Any:
    """A motion of random amplitudes and phases that decays, with noise of 5 % of its beginning."""
    poles = frame.w * (-frame.zeta + 1j * np.sqrt(1 - frame.zeta**2))
    size = np.exp(1j * rng.uniform(0, 2 * np.pi, len(poles))) * rng.uniform(0.7, 1.3, len(poles))
    y = ((frame.shapes * size) @ np.exp(np.outer(poles, np.arange(samples)))).real
    return None, y + 0.05 * rng.standard_normal(y.shape)


def motor(frame: Frame, rng: np.random.Generator, samples: int, **_: Any) -> Any:
    """Two real poles, seen by one output from rest, noise of 10 %; the first frequency of the frame is one of them."""
    u = rng.standard_normal(samples)
    rates = np.array([0.5 * frame.w[0], 0.04])
    moved = [lfilter([0.0, 1 - np.exp(-rate)], [1.0, -np.exp(-rate)], u) for rate in rates]
    y = moved[0] + 2 * moved[1]
    return u, y + 0.1 * y.std() * rng.standard_normal(samples)


@dataclass(frozen=True)
class Kind:
    """How records are made, and how the first is fitted."""

    make: Callable[..., Any] = white
    options: dict[str, Any] = field(default_factory=lambda: {"order": 2})
    noise: dict[str, Any] = field(default_factory=dict)
    samples: int = 2000
    frame: Frame = FRAME

    def record(self, rng: np.random.Generator, share: float = 0.0, samples: int | None = None) -> Any:
        """A record of the frame, its first frequency moved by a share."""
        return self.make(shifted(self.frame, share), rng, samples or self.samples, **self.noise)


SINGLE = replace(FRAME, shapes=FRAME.shapes[:1], forced=FRAME.forced[:, :1])
TWO = replace(FRAME, driven=np.array([[1.0, 0.6], [0.8, -1.0]]))
KINDS = {
    "single": Kind(frame=SINGLE),
    "free": Kind(frame=SINGLE, options={"order": 2, "structure": "free"}),
    "noisy": Kind(frame=SINGLE, options={"order": 2, "structure": "free"}, noise={"size": 1.0}),
    "short": Kind(frame=SINGLE, options={"order": 2, "structure": "free"}, samples=400),
    "channels": Kind(frame=TWO, options={"order": 2, "structure": "free"}),
    "constant": Kind(noise={"offset": 3.0}, options={"order": 2, "offset": True}),
    "correlated": Kind(noise={"correlated": 0.7}, options={"order": 2, "noise": "correlated"}),
    "coloured": Kind(noise={"memory": 0.9, "size": 0.3}, options={"order": 2, "noise": "coloured"}),
    "forces": Kind(noise={"forces": 0.05}, options={"order": 2, "noise": "forces"}),
    "ambient": Kind(ambient, {"order": 2, "real_poles": 0, "noise": "forces"}, samples=4000),
    "decay": Kind(decay, {"order": 2, "noise": "white"}),
    "motor": Kind(motor, {"real_poles": 2, "noise": "white"}),
}


def fitted(kind: Kind, record: Any) -> Any:
    """The fit of a record."""
    return phc.pem(record, dt=1.0, delay=0, **kind.options)


def timed(function: Callable[[], Any]) -> tuple[Any, float]:
    """What a function returns, and the processor time it took."""
    start = time.process_time()
    return function(), time.process_time() - start


def naive_p(test: Any) -> float:
    """p-value of `z^T F^-1 z`, which takes the old parameters for the truth."""
    values, vectors = np.linalg.eigh(test.information)
    return float(chdtrc(test.dof, np.sum((vectors.T @ test.score)[-test.dof :] ** 2 / values[-test.dof :])))


def level(name: str, seeds: int, first: int, parameters: str) -> None:
    """False alarms of the test and of its modes."""
    kind, rows, times = KINDS[name], [], []
    for seed in range(first, first + seeds):
        rng = np.random.default_rng([seed, 32])
        result, of_fit = timed(lambda rng=rng: fitted(kind, kind.record(rng)))
        fresh = kind.record(rng)
        test, of_test = timed(lambda result=result, fresh=fresh: result.changed(fresh, parameters=parameters))
        rows.append((test.p, naive_p(test), test.mode_p.min(), *test.frequency_p, *test.damping_p, *test.real_pole_p))
        times.append((of_fit, of_test))
    p = np.array([row for row in rows if len(row) == len(rows[0])])
    rejected = 100 * np.mean(p < LEVEL, axis=0)
    fit, test_time = np.median(times, axis=0)
    print(f"{name:11} {rejected[0]:5.1f} {rejected[1]:6.1f} {rejected[2]:6.1f} {rejected[3:].mean():7.1f} {test.dof:4} "
          f"{fit:8.2f} {1000 * test_time:8.0f}", flush=True)  # fmt: skip


def power(name: str, seeds: int, first: int, parameters: str) -> None:
    """Alarms by the shift of the first frequency: the score test, its first mode, and a fit of the new record."""
    kind = KINDS[name]
    counts = np.zeros((len(SHIFTS), 5))
    for seed in range(first, first + seeds):
        rng = np.random.default_rng([seed, 33])
        result = fitted(kind, kind.record(rng))
        error = np.sqrt(2.0) * result.stderr["natural_frequencies"][0] / result.natural_frequencies[0]
        for k, share in enumerate(error * np.array(SHIFTS)):
            fresh = kind.record(rng, share)
            test = result.changed(fresh, parameters=parameters)
            comparison = result.compare(fitted(kind, fresh))
            refit = np.r_[comparison.adjusted_frequency_p, comparison.adjusted_damping_p].min(initial=1.0)
            counts[k] += [share, test.changed, 0 in test.modes, test.frequency_p[0] < LEVEL, refit < LEVEL]
    for errors, (share, *row) in zip(SHIFTS, 100 * counts / seeds, strict=True):
        print(f"{name:11} {errors:6.1f} {share:8.4f} " + " ".join(f"{value:8.1f}" for value in row), flush=True)


def chart(name: str, seeds: int, first: int, _: str) -> None:
    """Charts of 40 recordings against a fit of five: alarms without a change, and delay after one at the tenth.

    The shift is that of three errors of the frequency in one recording.
    """
    kind, rate, recordings, before = KINDS[name], 0.01, 40, 10
    alarms, early, delays = 0, 0, []
    for seed in range(first, first + seeds):
        rng = np.random.default_rng([seed, 34])
        result = fitted(kind, [kind.record(rng) for _ in range(5)])
        share = 3 * np.sqrt(5.0) * result.stderr["natural_frequencies"][0] / result.natural_frequencies[0]
        for shift in (0.0, share):
            records = [kind.record(rng, shift * (k >= before)) for k in range(recordings)]
            table = phc.fit_many(records, reference=result, dt=1.0, delay=0, **kind.options)
            seen = table.changes(false_alarms=rate).alarms
            if not shift:
                alarms += len(seen) > 0
            elif len(seen) and seen[0] < before:
                early += 1
            else:
                delays.append(seen[0] - before + 1 if len(seen) else recordings)
    expected = 100 * (1 - (1 - rate) ** recordings)
    print(
        f"{name:11} {100 * alarms / seeds:8.1f} {expected:9.1f} {np.median(delays):7.1f} {max(delays):8.0f}", flush=True
    )


def main() -> None:
    """Print the table of a task."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", choices=("level", "power", "chart"))
    parser.add_argument("--kind", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--parameters", choices=("all", "poles"), default="all")
    given = parser.parse_args()
    warnings.simplefilter("ignore")
    print({"level": "kind        % all  naive   mode  shifts  dof    fit s  test ms",
           "chart": "kind        % alarm  expected  median longest delay",
           "power": "kind        errors  shift %     test first mode  shift   refit"}[given.task])  # fmt: skip
    for name in given.kind:
        {"level": level, "power": power, "chart": chart}[given.task](name, given.seeds, given.first, given.parameters)


if __name__ == "__main__":
    main()
