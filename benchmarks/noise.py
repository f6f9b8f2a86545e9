"""Records in noise of every kind: order, errors beside the Cramer-Rao bound, and whether stated intervals hold.

    python -m benchmarks.noise forces --seeds 200        unmeasured forces of 3 and 30 %; 1 x 1, 3 x 1, 4 x 2
    python -m benchmarks.noise inputs --seeds 200        noise of 5 % on the recorded inputs
    python -m benchmarks.noise sensors --seeds 200       sensors whose noise is correlated by 0.5 and 0.9
    python -m benchmarks.noise colour --seeds 200        AR(0.9) and AR(0.99) noise of each output, open and closed loop
    python -m benchmarks.noise white --seeds 200         none of these

`--shape` and `--case` choose among the rows.

One BLAS thread.  `z2` is the mean squared error over the stated one, `cover` the share of 95 % intervals that hold, of
frequencies, damping ratios and residues.  The bound is that of the plant's own parameters, from numerical derivatives
of the spectrum of the record.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

import ph_control as phc

STEP = 1.0


@dataclass(frozen=True)
class Frame:
    """Modes with real shapes, seen as velocities: outputs (p, n), measured and unmeasured forces (n, m), (n, f)."""

    w: np.ndarray
    zeta: np.ndarray
    shapes: np.ndarray
    driven: np.ndarray
    forced: np.ndarray

    @classmethod
    def random(cls, rng: np.random.Generator, n: int, p: int, m: int, forces: int) -> Frame:
        """A frame with separate modes, the first input at the first output."""
        while True:
            w = np.sort(rng.uniform(0.2, 2.2, n))
            if n == 1 or np.min(np.diff(w)) > 0.15:
                break
        zeta = 10 ** rng.uniform(-2.2, -1.6, n)
        shapes = rng.standard_normal((max(p, m, forces), n))
        shapes[np.abs(shapes) < 0.4] = 0.4
        return cls(w, zeta, shapes[:p], shapes[:m].T, shapes[:forces].T)

    @property
    def matrices(self) -> tuple[np.ndarray, ...]:
        """`A`, `B` of measured forces, `C`, `B` of unmeasured forces, continuous."""
        n = len(self.w)
        A, C = np.zeros((2 * n, 2 * n)), np.zeros((len(self.shapes), 2 * n))
        i = np.arange(n)
        A[2 * i, 2 * i + 1], A[2 * i + 1, 2 * i], A[2 * i + 1, 2 * i + 1] = 1, -(self.w**2), -2 * self.zeta * self.w
        C[:, 1::2] = self.shapes
        B, F = np.zeros((2 * n, self.driven.shape[1])), np.zeros((2 * n, self.forced.shape[1]))
        B[1::2], F[1::2] = self.driven, self.forced
        return A, B, C, F

    @property
    def sampled(self) -> tuple[np.ndarray, ...]:
        """One step: `A`, `B` of held inputs, `C`, and the covariance of what white unmeasured forces add."""
        A, B, C, F = self.matrices
        n, m = B.shape
        step = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * STEP)
        both = expm(np.block([[-A, F @ F.T], [np.zeros((n, n)), A.T]]) * STEP)
        Ad = step[:n, :n]
        Q = Ad @ both[:n, n:]
        return Ad, step[:n, n:], C, 0.5 * (Q + Q.T)

    def in_closed_loop(self, r: np.ndarray, gain: float, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Inputs `u = r - gain y` of the first sensors, and outputs with noise, from rest 2000 samples before."""
        A, B, C, _ = self.sampled
        early, m = 2000, len(r)
        r = np.concatenate([r[:, :early], r], axis=1)
        noise = np.concatenate([noise[:, :early], noise], axis=1)
        state, u, y = np.zeros(len(A)), np.empty(r.shape), np.empty(noise.shape)
        for k in range(r.shape[1]):
            y[:, k] = C @ state + noise[:, k]
            u[:, k] = r[:, k] - gain * y[:m, k]
            state = A @ state + B @ u[:, k]
        return u[:, early:], y[:, early:]

    def outputs(self, u: np.ndarray, rng: np.random.Generator, size: float) -> tuple[np.ndarray, np.ndarray]:
        """Responses to held inputs (m, T), and to unmeasured forces of a density; both in steady motion."""
        A, B, C, Q = self.sampled
        values, V = np.linalg.eig(A)
        early, T = 2000, u.shape[1]
        sizes, vectors = np.linalg.eigh(Q)
        root = vectors * np.sqrt(np.maximum(sizes, 0.0))
        noise = np.sqrt(size) * root @ rng.standard_normal((len(Q), T + early))
        held = B @ np.concatenate([rng.standard_normal((len(u), early)), u], axis=1)
        responses = []
        for force in (held, noise):
            modal = np.linalg.solve(V, force)
            states = np.array([lfilter([0, 1], [1, -value], row) for value, row in zip(values, modal, strict=True)])
            responses.append((C @ (V @ states).real)[:, early:])
        return responses[0], responses[1]

    def free_motion(self, z: np.ndarray, samples: int) -> np.ndarray:
        """What states at the first sample add to the outputs, (bins, p, 2n), as those at `z` show it."""
        A, _, C, _ = self.sampled
        values, V = np.linalg.eig(A)
        return (C @ V)[None] * (z[:, None, None] / (z[:, None, None] - values)) @ np.linalg.inv(V) / np.sqrt(samples)

    def residues(self) -> np.ndarray:
        """Residues (n, p, m) at the poles of positive imaginary part."""
        pole = self.w * (-self.zeta + 1j * np.sqrt(1 - self.zeta**2))
        factor = pole / (2j * pole.imag)
        return np.einsum("l,ol,li->loi", factor, self.shapes, self.driven)


def spectra(
    frame: Frame, z: np.ndarray, size: float, sensors: np.ndarray, inputs: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Transfer (bins, p, m) of held inputs, spectrum (bins, p, p) of the noise; `inputs` is the variance of theirs."""
    A, B, C, Q = frame.sampled
    values, V = np.linalg.eig(A)
    states = (C @ V)[None] / (z[:, None, None] - values)
    inner = np.linalg.solve(V, B)
    Qv = np.linalg.solve(V, np.linalg.solve(V, Q).conj().T).conj().T
    Qv = size * Qv + inputs * inner @ inner.conj().T
    return states @ inner, states @ Qv @ states.conj().transpose(0, 2, 1) + sensors


def bound(
    frame: Frame, u: np.ndarray, y: np.ndarray, size: float, sensors: np.ndarray, colour: float = 0.0,
    inputs: float = 0.0,
) -> np.ndarray:  # fmt: skip
    """Cramer-Rao bound of frequencies and damping ratios (2n,) of a record: inputs, outputs without noise.

    Shapes, forces, variances and the motion in which the record begins are unknown as well.  Noise of the sensors is
    autoregressive with the coefficient `colour`, that of held inputs has the variance `inputs`.
    """
    n, p, T = len(frame.w), len(frame.shapes), u.shape[1]
    k = np.arange(1, (T - 1) // 2)
    z, U = np.exp(2j * np.pi * k / T), (np.fft.rfft(u)[:, k] / np.sqrt(T)).T if len(u) else np.zeros((len(k), 0))
    lower = np.tril_indices(p)
    driven = np.einsum("kpm,km->kp", spectra(frame, z, size, sensors)[0], U)
    rest = ((np.fft.rfft(y)[:, k] / np.sqrt(T)).T - driven).ravel()
    motion = frame.free_motion(z, T).reshape(len(rest), 2 * n)
    begun = np.linalg.lstsq(np.concatenate([motion.real, motion.imag]), np.concatenate([rest.real, rest.imag]))[0]

    def model(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        sizes = [n, n, p * n, frame.driven.size, frame.forced.size, 2 * n]
        parts = np.split(theta, np.cumsum(sizes))
        now = Frame(parts[0], parts[1], parts[2].reshape(p, n), parts[3].reshape(frame.driven.shape),
                    parts[4].reshape(frame.forced.shape))  # fmt: skip
        L = np.zeros((p, p))
        L[lower] = parts[6][:-2]
        coloured = (np.abs(1 - parts[6][-2] / z) ** -2.0)[:, None, None] * (L @ L.T)
        G, S = spectra(now, z, size, coloured, parts[6][-1])
        return np.einsum("kpm,km->kp", G, U) + now.free_motion(z, T) @ parts[5], S

    root = np.linalg.cholesky(sensors)[lower]
    theta = np.concatenate([frame.w, frame.zeta, frame.shapes.ravel(), frame.driven.ravel(), frame.forced.ravel(),
                            begun, root, [colour, inputs]])  # fmt: skip
    _, S = model(theta)
    W = np.linalg.inv(np.linalg.cholesky(S))
    columns = []
    first = len(theta) - 2 - len(root) - 2 * n
    for j, value in enumerate(theta):
        e = np.zeros(len(theta))
        e[j] = 1e-5 * abs(value) if value else 1e-8
        if first <= j < first + 2 * n:  # the spectrum is linear in these
            e[j] = np.max(np.abs(begun))
        if not value and j >= len(theta) - 2:
            continue
        (up, Su), (down, Sd) = model(theta + e), model(theta - e)
        mean = np.einsum("kab,kb->ka", W, (up - down) / (2 * e[j])).ravel() * np.sqrt(2)
        spread = (W @ ((Su - Sd) / (2 * e[j])) @ W.conj().transpose(0, 2, 1)).ravel()
        columns.append(np.concatenate([mean.real, mean.imag, spread.real, spread.imag]))
    J = np.array(columns)
    information = J @ J.T
    lengths = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(lengths, lengths), rcond=1e-10, hermitian=True)
    return np.sqrt(np.diag(inverse))[: 2 * n] / lengths[: 2 * n]


@dataclass
class Table:
    """What many fits of a kind have shown."""

    name: str
    modes: int

    def __post_init__(self) -> None:
        self.orders, self.structures, self.findings = Counter(), Counter(), Counter()
        self.z, self.ratio, self.times = [], [], []

    def add(
        self, result: phc.PEMResult, frame: Frame, least: np.ndarray, seconds: float, residues: bool = True
    ) -> None:
        """Add a fit."""
        self.orders[result.order, len(result.real_poles)] += 1
        self.structures[result.structure] += 1
        self.findings.update({finding.cause.name for finding in result.findings})
        self.times.append(seconds)
        if result.order != self.modes or len(result.real_poles):
            return
        errors = np.concatenate([result.natural_frequencies - frame.w, result.damping_ratios - frame.zeta])
        stated = np.concatenate([result.stderr["natural_frequencies"], result.stderr["damping_ratios"]])
        n, z = self.modes, errors / stated
        parts = [z[:n], z[n:]]
        if residues:
            wrong, of = result.residues - frame.residues(), result.stderr["residues"]
            parts.append(np.concatenate([(wrong.real / of.real).ravel(), (wrong.imag / of.imag).ravel()]))
        self.z.append(parts)
        self.ratio.append(errors / least)

    def show(self) -> None:
        """Print a line."""
        right = self.orders[self.modes, 0]
        line = f"{self.name:44s} order {right:3d} of {sum(self.orders.values())}"
        if self.z:
            parts = [np.concatenate([np.ravel(z[k]) for z in self.z]) for k in range(len(self.z[0]))]
            line += "  cover " + "/".join(f"{100 * np.mean(np.abs(part) < 1.96):.1f}" for part in parts)
            line += "  z2 " + "/".join(f"{np.mean(part**2):.2f}" for part in parts)
            ratio = np.array(self.ratio)
            line += "  rms/bound " + "/".join(
                f"{np.sqrt(np.mean(part**2)):.2f}" for part in (ratio[:, : self.modes], ratio[:, self.modes :])
            )
        line += f"  {np.median(self.times):.2f} s"
        print(line, "\n    ", dict(self.structures), dict(self.findings), dict(self.orders), flush=True)


def run(name: str, shape: tuple[int, int, int], seeds: int, T: int = 3000, *, forces: float = 0.0, inputs: float = 0.0,
        sensors: float = 0.02, correlation: float = 0.0, colour: float = 0.0, loop: float = 0.0, first: int = 0,
        **options: object) -> Table:  # fmt: skip
    """Fit records of random frames: `forces` and `inputs` are sizes (rms) over those of the outputs and inputs.

    `colour` is the coefficient of autoregressive noise of the sensors, `loop` a gain that takes outputs to inputs: half
    of what makes a loop of one input and output unstable, or less.
    """
    n, p, m = shape
    table = Table(name, n)
    for seed in range(first, first + seeds):
        rng = np.random.default_rng([seed, 77])
        frame = Frame.random(rng, n, p, m, p if forces else 0)
        u = rng.standard_normal((m, T))
        y, moved = frame.outputs(u, rng, 1.0)
        size = 0.0
        if forces:
            size = forces**2 * float(np.mean(y.var(axis=1)) / np.mean(moved.var(axis=1)))
            moved = np.sqrt(size) * moved
        level = sensors * np.sqrt(np.mean((y + moved).var(axis=1)))
        noise = level**2 * ((1 - correlation) * np.eye(p) + correlation)
        e = np.linalg.cholesky(noise * (1 - colour**2)) @ rng.standard_normal((p, T + 1000))
        e = lfilter([1.0], [1.0, -colour], e)[:, 1000:]
        if loop:
            u, y = frame.in_closed_loop(u, loop * np.sqrt(np.mean(u.var(axis=1)) / np.mean(y.var(axis=1))), e)
            clean = y - e
        else:
            clean, y = y, y + moved + e
        seen = u + inputs * rng.standard_normal(u.shape)
        least = bound(frame, u, clean, size, noise * (1 - colour**2), colour, inputs**2)
        # second moments do not tell white noise of a white input from a force beside it: what can be known of residues
        # is what a recorded input foretells
        seen_frame = replace(frame, driven=frame.driven / (1 + inputs**2))
        start = time.process_time()
        result = phc.pem((seen, y), dt=STEP, quantity="velocity", **options)
        table.add(result, seen_frame, least, time.process_time() - start)
    table.show()
    return table


SHAPES = {"1 x 1": (2, 1, 1), "3 x 1": (3, 3, 1), "4 x 2": (4, 4, 2)}
OF_INPUTS = {"1 x 1": (2, 1, 1), "3 x 1": (3, 3, 1), "3 x 2": (3, 3, 2)}  # whose recorded inputs have noise


def cases(what: str) -> dict[str, dict[str, float]]:
    """Rows of a table: what they are called, and the options of `run`."""
    if what == "forces":
        return {f"unmeasured forces of {100 * share:.0f} %": {"forces": share} for share in (0.03, 0.3)}
    if what == "inputs":
        return {"noise of the inputs of 5 %": {"inputs": 0.05}}
    if what == "sensors":
        return {f"sensors correlated by {each}": {"sensors": 0.3, "correlation": each} for each in (0.5, 0.9)}
    if what == "colour":
        noise = {f"AR({each}) noise of 30 %": {"sensors": 0.3, "colour": each} for each in (0.9, 0.99)}
        return noise | {f"{name}, closed loop": {**how, "loop": 0.05} for name, how in noise.items()}
    return {"white noise of 2 %": {}}


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["forces", "inputs", "sensors", "colour", "white"])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--shape", choices=SHAPES | OF_INPUTS, action="append")
    parser.add_argument("--case", type=int)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    shapes = OF_INPUTS if arguments.what == "inputs" else SHAPES
    for name, shape in shapes.items():
        if name not in (arguments.shape or shapes) or (arguments.what == "sensors" and shape[1] == 1):
            continue
        for place, (case, how) in enumerate(cases(arguments.what).items()):
            if arguments.case in (None, place):
                run(f"{name}, {case}", shape, arguments.seeds, first=arguments.first, **how)


if __name__ == "__main__":
    main()
