"""Records under circumstances beside white noise: order, what is named, errors beside the Cramer-Rao bound, intervals.

    python -m benchmarks.circumstances experiments --seeds 200    two experiments with noise of 2 and 50 %
    python -m benchmarks.circumstances louder --seeds 200         noise ten times larger in a third of a record
    python -m benchmarks.circumstances hum --seeds 200            tones of 1, 5 and 30 % that no input drives
    python -m benchmarks.circumstances shaker --seeds 200         a shaker with a tenth of the ambient forces
    python -m benchmarks.circumstances hits --seeds 200           noise of a hammer's force of a thousandth of its peak
    python -m benchmarks.circumstances window --seeds 200         H1, Hann window, some lines in the width of modes

One BLAS thread.  Columns are those of `benchmarks.noise`; `bias` is the mean error of damping ratios in per cent of
them, and in its own standard errors.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import control as ct
import numpy as np

import ph_control as phc
from benchmarks.noise import STEP, Frame, Table, run

SAMPLES = 3000
SHAPE = (3, 3, 1)
QUIET, LOUD = 0.02, 0.5
HUMS = (0.01, 0.05, 0.3)
BLOCK = 256
LINES = (0.5, 1.0, 3.0)
FORCE_NOISE = 0.001  # of a peak of 0.5 to 1.5
HITS = ((1, 1, 0.01), (3, 1, 0.003), (3, 3, 0.003))  # with outputs, and noise of these over what they show


@dataclass(frozen=True)
class Record:
    """Inputs (m, T), the seed of what came before, and the standard deviation (T,) of the noise."""

    u: np.ndarray
    seed: Sequence[int]
    level: np.ndarray

    def clean(self, frame: Frame) -> np.ndarray:
        """Outputs (p, T) without noise."""
        return frame.outputs(self.u, np.random.default_rng(self.seed), 0.0)[0]


def bound(frame: Frame, records: Sequence[Record]) -> np.ndarray:
    """Cramer-Rao bound of frequencies and damping ratios (2n,), of outputs in white noise of any size.

    The motion in which each record begins is unknown as well.
    """
    n, p = len(frame.w), len(frame.shapes)
    theta = np.concatenate([frame.w, frame.zeta, frame.shapes.ravel(), frame.driven.ravel()])

    def outputs(values: np.ndarray) -> np.ndarray:
        parts = np.split(values, np.cumsum([n, n, p * n]))
        now = replace(frame, w=parts[0], zeta=parts[1], shapes=parts[2].reshape(p, n),
                      driven=parts[3].reshape(frame.driven.shape))  # fmt: skip
        return np.concatenate([(record.clean(now) / record.level).ravel() for record in records])

    columns = []
    for j, value in enumerate(theta):
        change = np.zeros(len(theta))
        change[j] = 1e-5 * abs(value)
        columns.append((outputs(theta + change) - outputs(theta - change)) / (2 * change[j]))
    A, _, C, _ = frame.sampled
    values, V = np.linalg.eig(A)
    for place in range(len(records)):
        for state in np.linalg.inv(V).T:
            motions = [
                ((C @ V * state) @ values[:, None] ** np.arange(len(record.level)) / record.level).real
                * (place == number)
                for number, record in enumerate(records)
            ]
            columns.append(np.concatenate([motion.ravel() for motion in motions]))
    J = np.array(columns)
    lengths = np.linalg.norm(J, axis=1)
    # the scales of shapes and forces leave n directions undetermined
    inverse = np.linalg.pinv((J @ J.T) / np.outer(lengths, lengths), rcond=1e-10, hermitian=True)
    return np.sqrt(np.diag(inverse))[: 2 * n] / lengths[: 2 * n]


def white_run(name: str, levels: Sequence[np.ndarray], seeds: int, cause: str) -> None:
    """Fit records of random frames in white noise of some sizes, over the rms of the outputs, at each sample."""
    n, p, m = SHAPE
    table = Table(name, n)
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 78])
        frame = Frame.random(rng, n, p, m, 0)
        records, data = [], []
        for k, shares in enumerate(levels):
            u, before = rng.standard_normal((m, len(shares))), [seed, 79, k]
            y = Record(u, before, shares).clean(frame)
            record = Record(u, before, shares * np.sqrt(np.mean(y.var(axis=1))))
            records.append(record)
            data.append((u, y + record.level * rng.standard_normal(y.shape)))
        start = time.process_time()
        result = phc.pem(data if len(data) > 1 else data[0], dt=STEP, quantity="velocity")
        table.add(result, frame, bound(frame, records), time.process_time() - start)
    table.show()
    print(f"     {cause} named {table.findings[cause]} of {seeds}", flush=True)


def hums(share: float, seeds: int) -> None:
    """Fit records with a tone of some share of the outputs, and count modes and names."""
    n, p, m = SHAPE
    orders, named, right, seconds = Counter(), 0, 0, []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 80])
        frame = Frame.random(rng, n, p, m, 0)
        u = rng.standard_normal((m, SAMPLES))
        y = Record(u, [seed, 81], np.ones(SAMPLES)).clean(frame)
        size = np.sqrt(np.mean(y.var(axis=1)))
        while True:
            frequency = rng.uniform(0.1, 2.8)
            if np.min(np.abs(frequency - frame.w)) > 0.05:
                break
        gains = rng.uniform(0.5, 1.5, (p, 1))
        tone = np.sqrt(2) * share * gains * np.cos(frequency * np.arange(SAMPLES) + rng.uniform(0, 6))
        start = time.process_time()
        y = y + size * (tone + QUIET * rng.standard_normal(y.shape))
        result = phc.pem((u, y), dt=STEP, quantity="velocity")
        seconds.append(time.process_time() - start)
        orders[result.order, len(result.real_poles)] += 1
        heard = [finding.values[0] for finding in result.findings if finding.cause.name == "HUM"]
        named += bool(heard)
        right += bool(heard) and min(abs(np.array(heard) - frequency)) < 2 * np.pi / SAMPLES
    print(
        f"hum of {100 * share:2.0f} %: order {orders[n, 0]} of {seeds}, named {named}, within a bin {right}, "
        f"{np.median(seconds):.2f} s  {dict(orders)}",
        flush=True,
    )


def windowed(lines: float, seeds: int) -> None:
    """Fit H1 with a Hann window of blocks that have so many lines within the half-power width of a mode."""
    w = np.array([0.7, 1.5])
    zeta = lines * np.pi / (BLOCK * w)
    frame = Frame(w, zeta, np.array([[1.0, 0.8]]), np.array([[1.0], [0.8]]), np.zeros((2, 0)))
    z, errors, orders, structures = [], [], Counter(), Counter()
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 82])
        u = rng.standard_normal((1, 40 * BLOCK))
        y = frame.outputs(u, rng, 0.0)[0]
        y = y + 0.1 * np.std(y) * rng.standard_normal(y.shape)
        data = ct.TimeResponseData(np.arange(u.shape[1]) * STEP, y, inputs=u)
        result = phc.pem(phc.spectral_estimate(data, segments=79), quantity="velocity")
        orders[result.order] += 1
        structures[result.structure] += 1
        if result.order == 2 and not len(result.real_poles):
            stated = result.stderr
            errors.append(result.damping_ratios / zeta - 1)
            z.append(np.concatenate([(result.natural_frequencies - w) / stated["natural_frequencies"],
                                     (result.damping_ratios - zeta) / stated["damping_ratios"]]))  # fmt: skip
    z, errors = np.array(z), np.array(errors)
    bias = errors.mean(axis=0)
    print(
        f"H1, {lines:g} lines in the width: order {orders[2]} of {seeds}  {dict(structures)}  cover "
        f"{100 * np.mean(np.abs(z[:, :2]) < 1.96):.1f}/{100 * np.mean(np.abs(z[:, 2:]) < 1.96):.1f}  z2 "
        f"{np.mean(z[:, :2] ** 2):.2f}/{np.mean(z[:, 2:] ** 2):.2f}  bias {np.round(100 * bias, 2)} %, of errors of "
        f"one fit {np.round(bias / errors.std(axis=0), 2)}",
        flush=True,
    )


def hit(count: int, outputs: int, loud: float, seeds: int) -> None:
    """Fit so many hits at rest, with sensors whose noise is a share of what they show."""
    t = np.arange(2048.0)
    z, orders, structures, named, seconds = [], Counter(), Counter(), 0, []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 83])
        w, zeta = np.sort(np.exp(rng.uniform(np.log(0.1), np.log(1.2), 2))), rng.uniform(0.004, 0.02, 2)
        w[1] = max(w[1], 1.2 * w[0])
        poles = -zeta * w + 1j * w * np.sqrt(1 - zeta**2)
        shapes = rng.standard_normal((2, outputs))
        plant = phc.modes(poles, shapes, shapes[:, :1] * (poles / (2j * poles.imag))[:, None]).state_space()
        data = []
        for _ in range(count):
            force, width, first = np.zeros(len(t)), int(rng.integers(6, 12)), int(rng.integers(20, 100))
            force[first : first + width] = (
                rng.uniform(0.5, 1.5) * np.sin(np.pi * np.arange(1, width + 1) / (width + 1)) ** 2
            )
            y = np.atleast_2d(ct.forced_response(plant, t, force).outputs)
            y = y + loud * y.std(axis=1, keepdims=True) * rng.standard_normal(y.shape)
            data.append((force + FORCE_NOISE * rng.standard_normal(len(t)), y))
        start = time.process_time()
        result = phc.pem(data, dt=1.0, intersample="foh", initial_state="zero", ports=[(0, 0)])
        seconds.append(time.process_time() - start)
        orders[result.order, len(result.real_poles)] += 1
        structures[result.structure] += 1
        named += any(finding.cause.name == "CONTACT_NOISE" for finding in result.findings)
        if (result.order, len(result.real_poles)) == (2, 0):
            stated = result.stderr
            port, port_error = np.abs(result.shapes[:, 0]), stated["shapes"][:, 0].real
            z.append(np.concatenate([(result.natural_frequencies - w) / stated["natural_frequencies"],
                                     (result.damping_ratios - zeta) / stated["damping_ratios"],
                                     port * np.log(port / np.abs(shapes[:, 0])) / port_error]))  # fmt: skip
    parts = np.split(np.array(z), 3, axis=1)
    print(
        f"{count} hits, {outputs} outputs, sensors {100 * loud:g} %: order {orders[2, 0]} of {seeds}, named {named}  "
        f"{dict(structures)}  cover {'/'.join(f'{100 * np.mean(np.abs(each) < 1.96):.1f}' for each in parts)}  z2 "
        f"{'/'.join(f'{np.mean(each**2):.2f}' for each in parts)}  {np.median(seconds):.1f} s",
        flush=True,
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["experiments", "louder", "hum", "shaker", "hits", "window"])
    parser.add_argument("--seeds", type=int, default=20)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    even = np.ones(SAMPLES)
    if arguments.what == "experiments":
        levels = [QUIET * even, LOUD * even]
        white_run("experiments with noise of 2 and 50 %", levels, arguments.seeds, "UNEQUAL_NOISE")
    elif arguments.what == "louder":
        third = np.where((np.arange(SAMPLES) // (SAMPLES // 3)) == 1, 10.0, 1.0)
        white_run("noise ten times larger in a third", [QUIET * third], arguments.seeds, "CHANGING_NOISE")
    elif arguments.what == "hum":
        for share in HUMS:
            hums(share, arguments.seeds)
    elif arguments.what == "shaker":
        run("a shaker with a tenth of the ambient forces", SHAPE, arguments.seeds, 6000, forces=10.0)
    elif arguments.what == "hits":
        for count, outputs, loud in HITS:
            hit(count, outputs, loud, arguments.seeds)
    else:
        for lines in LINES:
            windowed(lines, arguments.seeds)


if __name__ == "__main__":
    main()
