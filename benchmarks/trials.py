"""One seed of each Monte-Carlo study: what is recorded, fitted, and held against the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import perf_counter, process_time
from typing import Any

import numpy as np

import ph_control as phc

from .bound import fit_from_truth, standard_errors
from .recordings import Configuration, Recording, random_recording

ALLOWED = 4.0  # standard errors of every frequency
INTERVAL = 1.96  # standard errors either side: 95 %
SAME_LOSS = 1e-6  # relative difference of two losses that counts as none

CONVERGENCE = tuple(
    Configuration(*numbers)
    for numbers in (
        (2, 1000, 20, 3), (5, 1000, 20, 3), (5, 2000, 10, 3), (10, 4000, 20, 3), (5, 1000, 20, 1.5),
        (20, 10_000, 20, 3), (50, 100_000, 20, 3),
    )
)  # fmt: skip
EFFICIENCY = CONVERGENCE[:3]
ORDER = tuple(Configuration(*numbers) for numbers in ((2, 1000, 20, 3), (5, 1000, 20, 3), (10, 4000, 20, 3)))
NOISE = Configuration(0, 1000, -np.inf, 3)  # nothing but noise

PLAIN = Configuration(3, 2000, 20, 3)


@dataclass(frozen=True)
class Disturbed:
    """Recordings that show something beside a lossless plant and white noise."""

    kind: str
    plain: Configuration = PLAIN

    @property
    def n(self) -> int:
        """Number of modes of the plant."""
        return self.plain.n

    @property
    def samples(self) -> int:
        """Samples of a recording."""
        return self.plain.samples

    def __str__(self) -> str:
        return f"{self.kind}: {self.plain}"


DISTURBED = (
    *map(Disturbed, ("none", "constant", "drift", "linear input", "delay", "coloured noise", "input noise")),
    Disturbed("none", Configuration(2, 20_000, 40, 0.2)),
    Disturbed("none", Configuration(3, 1000, 5, 3)),
)

FOUND, BAD_LUCK, FALSE_MINIMUM, ERROR = "found", "bad luck", "false minimum", "error"


def recording_of(config: Configuration, seed: int) -> Recording:
    """Recording number `seed` of a configuration."""
    return random_recording(config, np.random.default_rng([config.n, config.samples, int(10 * config.bins), seed]))


def timed_fit(recording: Recording, order: int | str) -> tuple[Any, float, str]:
    """Result, seconds, and the error that came in place of a result."""
    start = perf_counter()
    try:
        return (
            phc.pem((recording.u, recording.y), order=order, dt=recording.h, structure="lossless"),
            perf_counter() - start,
            "",
        )
    except (phc.PHControlError, ArithmeticError, np.linalg.LinAlgError) as error:
        return None, perf_counter() - start, f"{type(error).__name__}: {error}"


def convergence(task: tuple[Configuration, int]) -> dict[str, Any]:
    """Fit with the order known: whether every frequency lies within 4 standard errors, and if not, why."""
    config, seed = task
    recording = recording_of(config, seed)
    result, seconds, error = timed_fit(recording, config.n)
    if result is None:
        return {"seed": seed, "outcome": ERROR, "error": error, "seconds": seconds}
    return {"seed": seed, "seconds": seconds} | judged(recording, result)


def judged(recording: Recording, result: Any) -> dict[str, Any]:
    """How far a result of the right order is from the truth, and if too far, whether a better one is near the truth.

    'bad luck' is the best fit there is, and yet far from the truth; at a 'false minimum' a better one was missed.
    """
    n = len(recording.d)
    worst = float(np.max(np.abs(result.d - recording.d) / standard_errors(recording)[:n]))
    noise = float(np.mean((recording.y - recording.clean) ** 2))
    outcome, best = FOUND, None
    if not worst <= ALLOWED:
        best = fit_from_truth(recording).loss
        outcome = BAD_LUCK if result.loss <= best * (1 + SAME_LOSS) else FALSE_MINIMUM
    return {
        "outcome": outcome, "worst": worst, "loss": result.loss, "loss_of_truth": noise, "loss_near_truth": best,
        "message": result.verdict,
    }  # fmt: skip


def efficiency(task: tuple[Configuration, int]) -> dict[str, Any]:
    """Fit the one recording of a configuration with new noise: errors, and whether the intervals hold the truth."""
    config, seed = task
    first = recording_of(config, 0)
    recording = first.again(np.random.default_rng([config.n, config.samples, seed, 1]))
    result, seconds, error = timed_fit(recording, config.n)
    if result is None:
        return {"seed": seed, "error": error, "seconds": seconds}
    off = np.concatenate([result.d, result.r, result.initial_state]) - recording.theta
    said = np.concatenate([result.stderr[name] for name in ("d", "r", "initial_state")])
    return {
        "seed": seed, "seconds": seconds, "scaled_error": (off / standard_errors(recording)).tolist(),
        "covered": (np.abs(off) <= INTERVAL * said).tolist(),
    }  # fmt: skip


def order(task: tuple[Configuration, int]) -> dict[str, Any]:
    """Fit with the order unknown; no modes at all stands for pure noise."""
    config, seed = task
    if config.n:
        recording = recording_of(config, seed)
    else:
        u, y = np.random.default_rng([config.samples, seed]).standard_normal((2, config.samples))
        nothing = np.zeros(0)
        recording = Recording(nothing, nothing, nothing, u, 0 * y, 1.0, y)
    result, seconds, error = timed_fit(recording, "auto")
    if result is None:
        return {"seed": seed, "order": None, "error": error, "seconds": seconds}
    return {"seed": seed, "order": result.order, "message": result.verdict, "seconds": seconds}


def disturbance(task: tuple[Disturbed, int]) -> dict[str, Any]:
    """Fit a disturbed recording with the order unknown: the order found, the modes found, and what is said."""
    config, seed = task
    recording = disturbed(recording_of(config.plain, seed), config.kind, np.random.default_rng([seed, config.n, 2]))
    start = process_time()
    result, _, error = timed_fit(recording, "auto")
    seconds = process_time() - start
    if result is None:
        return {"seed": seed, "order": None, "error": error, "seconds": seconds}
    bin_width = 2 * np.pi / config.samples
    near = [bool(result.order) and bool(np.min(np.abs(result.d - d)) < 0.5 * bin_width) for d in recording.d]
    causes = sorted({one.cause.value for one in getattr(result, "findings", ())})
    return {
        "seed": seed, "order": result.order, "message": result.verdict, "seconds": seconds, "modes_found": sum(near),
        "causes": causes,
    }  # fmt: skip


def disturbed(recording: Recording, kind: str, rng: np.random.Generator) -> Recording:
    """The recording with a disturbance of a kind."""
    u, y, size, samples = recording.u, recording.y, float(np.std(recording.clean)), len(recording.u)
    if kind == "constant":
        y = y + 2 * size
    elif kind == "drift":
        y = y + 2 * size * np.arange(samples) / samples
    elif kind == "linear input":
        clean = phc.forced_response(
            recording.plant, np.arange(float(samples)), u, recording.state, return_states=False, intersample="foh"
        ).outputs
        y = np.asarray(clean) + (y - recording.clean)
    elif kind == "delay":
        u, y = u[1:], y[:-1]
    elif kind == "coloured noise":
        noise = np.zeros(samples + 200)
        for k, white in enumerate(rng.standard_normal(samples + 199), start=1):
            noise[k] = 0.9 * noise[k - 1] + white
        y = recording.clean + recording.deviation * noise[200:] / np.std(noise[200:])
    elif kind == "input noise":
        u = u + 0.1 * rng.standard_normal(samples)
    elif kind != "none":
        raise ValueError(f"no disturbance is called {kind!r}")
    return replace(recording, u=u, y=y)
