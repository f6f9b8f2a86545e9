"""Outputs alone, under white forces that nobody measured: order, errors beside the bound, intervals, other packages.

    python -m benchmarks.ambient floors four --samples 3000 30000 --noise 0.05 0.6 --seeds 200
    python -m benchmarks.ambient close --widths 2 1 0.5     two modes some half-power widths apart
    python -m benchmarks.ambient roving                     three set-ups, two sensors stay and two move, in one fit
    python -m benchmarks.ambient floors --peers             pyOMA2 on the same records, where it is installed
    python -m benchmarks.ambient large                      10 modes, 10 sensors, a million samples: time and memory

One BLAS thread.  `z2` is the mean squared error over the stated one, `cover` the share of 95 % intervals that hold, of
frequencies, damping ratios and shapes; `rms/bound` the rms errors over the Cramer-Rao bound of the plant's own
parameters, from numerical derivatives of the spectrum of the record, `rms/Au` over Au's law for one mode alone in
little noise, whose coefficients of variation are `sqrt(zeta / (2 pi N))` and `1 / sqrt(2 pi zeta N)` in N periods.
"""

from __future__ import annotations

import argparse
import resource
import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import control as ct
import numpy as np
from scipy.linalg import eigh, expm, solve_discrete_lyapunov
from scipy.signal import lfilter

import ph_control as phc

HELD = 1e-9  # standard error of what is held
RULE = 1e-10  # of the largest eigenvalue of an information matrix: what the scales of shapes leave undetermined
ROVING = [0, 1, 2, 3], [0, 1, 4, 5], [0, 1, 6, 7]  # sensors of set-ups,
LOUDNESS = 1.0, 3.0, 0.5  # and what the forces of each are multiplied by


@dataclass(frozen=True)
class Structure:
    """Modes with real shapes (p, n) in velocities, moved by white modal forces of covariance `forces` (n, n)."""

    hertz: np.ndarray
    zeta: np.ndarray
    shapes: np.ndarray
    forces: np.ndarray
    step: float

    @property
    def sampled(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`A`, `C` and the covariance of what forces add in a step."""
        n, w = len(self.hertz), 2 * np.pi * self.hertz
        A, B, C = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, n)), np.zeros((len(self.shapes), 2 * n))
        i = np.arange(n)
        # second state: velocity over the frequency, as the first is a displacement
        A[2 * i, 2 * i + 1], A[2 * i + 1, 2 * i], A[2 * i + 1, 2 * i + 1] = w, -w, -2 * self.zeta * w
        B[2 * i + 1, i], C[:, 1::2] = 1 / w, self.shapes * w
        both = expm(self.step * np.block([[-A, B @ self.forces @ B.T], [np.zeros(A.shape), A.T]]))
        Ad = both[2 * n :, 2 * n :].T
        Q = Ad @ both[: 2 * n, 2 * n :]
        return Ad, C, 0.5 * (Q + Q.T)

    @property
    def variances(self) -> np.ndarray:
        """Of the outputs without noise."""
        A, C, Q = self.sampled
        return np.diag(C @ solve_discrete_lyapunov(A, Q) @ C.T)

    def record(self, samples: int, noise: float, rng: np.random.Generator) -> np.ndarray:
        """Outputs (p, T) in steady motion, with white noise of a share of the standard deviation of each."""
        A, C, Q = self.sampled
        values, V = np.linalg.eig(A)
        P = solve_discrete_lyapunov(A, Q)
        first = np.linalg.solve(V, _root(P) @ rng.standard_normal(len(A)))
        added = np.linalg.solve(V, _root(Q) @ rng.standard_normal((len(A), samples)))
        states = np.empty(added.shape, complex)
        for k, value in enumerate(values):
            states[k] = lfilter([1.0], [1, -value], np.append(first[k], added[k, :-1]))
        y = (C @ (V @ states)).real
        return y + noise * np.sqrt(np.diag(C @ P @ C.T))[:, None] * rng.standard_normal(y.shape)

    def spectrum(self, z: np.ndarray, sensors: np.ndarray) -> np.ndarray:
        """Spectrum (bins, p, p) of the record, of noise with these standard deviations."""
        A, C, Q = self.sampled
        values, V = np.linalg.eig(A)
        seen = (C @ V)[None] / (z[:, None, None] - values)
        inner = np.linalg.solve(V, np.linalg.solve(V, Q).conj().T).conj().T
        return seen @ inner @ seen.conj().transpose(0, 2, 1) + np.diag(sensors**2)

    def bound(
        self, samples: int, noise: float, set_ups: Sequence[Sequence[int]] | None = None, bins: int = 4000
    ) -> np.ndarray:
        """Cramer-Rao bound of frequencies and damping ratios (2n,); shapes, forces and noise are unknown as well.

        Of a record of all outputs, or of one of each of some set-ups, whose forces and noise are their own.
        """
        n, p = len(self.hertz), len(self.shapes)
        sensors = [list(range(p))] if set_ups is None else [list(rows) for rows in set_ups]
        k = np.linspace(1, samples // 2 - 1, min(bins, samples // 2 - 1))
        z, each = np.exp(2j * np.pi * k / samples), (samples // 2 - 1) / len(k)
        lower = np.tril_indices(n)

        def model(theta: np.ndarray) -> list[np.ndarray]:
            hertz, zeta, shapes, rest = np.split(theta, np.cumsum([n, n, p * n]))
            now, spectra = replace(self, hertz=hertz, zeta=zeta), []
            for rows in sensors:
                root, own, rest = np.split(rest, np.cumsum([len(lower[0]), len(rows)]))
                L = np.zeros((n, n))
                L[lower] = root
                part = replace(now, shapes=shapes.reshape(p, n)[rows], forces=L @ L.T)
                spectra.append(part.spectrum(z, own))
            return spectra

        root, size = np.linalg.cholesky(self.forces)[lower], noise * np.sqrt(self.variances)
        own = [part for rows in sensors for part in (root, size[rows])]
        theta = np.concatenate([self.hertz, self.zeta, self.shapes.ravel(), *own])
        whitening = [np.linalg.inv(np.linalg.cholesky(spectrum)) for spectrum in model(theta)]
        columns = []
        for j, value in enumerate(theta):
            change = np.zeros(len(theta))
            change[j] = 1e-5 * max(abs(value), 1e-3)
            column = []
            for W, more, less in zip(whitening, model(theta + change), model(theta - change), strict=True):
                slope = (more - less) / (2 * change[j])
                whitened = (W @ slope @ W.conj().transpose(0, 2, 1)).ravel() * np.sqrt(each)
                column += [whitened.real, whitened.imag]
            columns.append(np.concatenate(column))
        J = np.array(columns)
        lengths = np.linalg.norm(J, axis=1)
        J /= lengths[:, None]
        inverse = np.linalg.pinv(J @ J.T, rcond=RULE, hermitian=True)
        return np.sqrt(np.diag(inverse))[: 2 * n] / lengths[: 2 * n]

    def law(self, samples: int) -> np.ndarray:
        """Au's law: errors of frequencies and damping ratios (2n,) of separate modes in little noise."""
        periods = self.hertz * samples * self.step
        return np.concatenate([
            self.hertz * np.sqrt(self.zeta / (2 * np.pi * periods)), np.sqrt(self.zeta / (2 * np.pi * periods)),
        ])  # fmt: skip


def _root(S: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(S)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def floors() -> Structure:
    """Three floors, white forces of one density at each: displacements' modes by mass and stiffness."""
    M = np.diag([300.0, 250.0, 180.0])
    k = 4.2e5
    K = k * np.array([[2.4, -1, 0], [-1, 2, -1], [0, -1, 1]])
    squares, shapes = eigh(K, M)
    return Structure(np.sqrt(squares) / (2 * np.pi), np.array([0.01, 0.012, 0.015]), shapes, shapes.T @ shapes, 0.02)


def four() -> Structure:
    """Four modes and five sensors; the second and third are 0.4 Hz apart, and forces on all are correlated."""
    rng = np.random.default_rng(11)
    shapes, mixed = rng.standard_normal((5, 4)), rng.standard_normal((4, 4))
    hertz = np.array([2.0, 5.2, 5.6, 9.0])
    size = 2 * np.pi * hertz
    forces = mixed @ mixed.T + np.diag(size / size[0])
    return Structure(hertz, np.array([0.01, 0.008, 0.01, 0.015]), shapes, forces, 0.02)


def eight() -> Structure:
    """The same modes and forces with eight sensors."""
    return replace(four(), shapes=np.random.default_rng(5).standard_normal((8, 4)))


def close(widths: float) -> Structure:
    """Bending of a tower in two directions, some half-power widths apart, and its twist; four sensors."""
    zeta, first = 0.01, 3.0
    shapes = np.array([[1.0, 0.3, 0.6], [0.2, 1.0, -0.5], [0.9, -0.2, -0.6], [-0.3, 0.8, 0.7]])
    hertz = np.array([first, first * (1 + 2 * zeta * widths), 7.1])
    forces = np.array([[1.0, 0.3, 0.1], [0.3, 1.2, -0.2], [0.1, -0.2, 1.5]])
    return Structure(hertz, np.full(3, zeta), shapes, forces, 0.04)


class Table:
    """What many estimates of a kind have shown."""

    def __init__(
        self, name: str, structure: Structure, samples: int, noise: float,
        set_ups: Sequence[Sequence[int]] | None = None,
    ) -> None:  # fmt: skip
        self.name, self.structure = name, structure
        self.least, self.law = structure.bound(samples, noise, set_ups), structure.law(samples * len(set_ups or [0]))
        self.orders: Counter[tuple[int, int]] = Counter()
        self.errors: list[np.ndarray] = []
        self.z: list[np.ndarray] = []
        self.shape_z: list[np.ndarray] = []
        self.times: list[float] = []

    def add(self, order: tuple[int, int], values: np.ndarray, stated: np.ndarray, seconds: float) -> None:
        """Frequencies and damping ratios (2n,), and their stated errors, of one record; NaN where there are none."""
        self.orders[order] += 1
        self.times.append(seconds)
        truth = np.concatenate([self.structure.hertz, self.structure.zeta])
        if values.shape == truth.shape:
            self.errors.append(values - truth)
            self.z.append((values - truth) / stated)

    def add_shapes(self, shapes: np.ndarray, stated: np.ndarray) -> None:
        """Shapes (n, p) with the largest entry 1."""
        z = []
        for shape, error, true in zip(shapes, stated, self.structure.shapes.T, strict=True):
            largest = int(np.argmax(np.abs(shape)))
            off = shape - true / true[largest]
            for part, spread in ((off.real, error.real), (off.imag, error.imag)):
                known = (spread > HELD) & (np.arange(len(true)) != largest)
                z.append(part[known] / spread[known])
        self.shape_z.append(np.concatenate(z))

    def show(self) -> None:
        """Print a line."""
        n = len(self.structure.hertz)
        line = f"{self.name:40s} order {self.orders[n, 0]:3d} of {sum(self.orders.values())}"
        if self.errors:
            z, errors = np.array(self.z), np.array(self.errors)
            parts = [z[:, :n].ravel(), z[:, n:].ravel(), *([np.concatenate(self.shape_z)] if self.shape_z else [])]
            parts = [part[np.isfinite(part)] for part in parts]
            line += "  cover " + "/".join(f"{100 * np.mean(np.abs(part) < 1.96):.1f}" for part in parts if len(part))
            line += "  z2 " + "/".join(f"{np.mean(part**2):.2f}" for part in parts if len(part))
            for word, size in (("bound", self.least), ("Au", self.law)):
                rms = np.sqrt(np.mean((errors / size) ** 2, axis=0))
                line += f"  rms/{word} " + "/".join(
                    f"{np.sqrt(np.mean(part**2)):.2f}({part.max():.2f})" for part in (rms[:n], rms[n:])
                )
        print(f"{line}  {np.median(self.times):.2f} s", flush=True)
        others = {key: count for key, count in self.orders.items() if key != (n, 0)}
        if others:
            print("      modes, real poles:", others, flush=True)


Peer = Callable[[Structure, np.ndarray], tuple[np.ndarray, np.ndarray]]


def peers() -> dict[str, Peer]:
    """Methods of pyOMA2 by name, told the true frequencies to pick poles by: values and stated errors (2n,)."""
    from pyoma2.algorithms import SSI, pLSCF
    from pyoma2.setup.single import SingleSetup

    def told(
        algorithm: object, structure: Structure, y: np.ndarray, order: object, name: str = "order_in"
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        setup = SingleSetup(y.T.copy(), fs=1 / structure.step)
        setup.add_algorithms(algorithm)
        setup.run_all()
        setup.mpe("peer", sel_freq=structure.hertz.tolist(), **{name: order})
        result = setup["peer"].result
        values = np.concatenate([np.ravel(result.Fn), np.ravel(result.Xi)])
        stated = np.full(values.shape, np.nan)
        if getattr(result, "Fn_std", None) is not None:
            stated = np.concatenate([np.ravel(result.Fn_std), np.ravel(result.Xi_std)])
        return values, stated

    def ssi(rows: int, order: Callable[[int], object]) -> Peer:
        def of(structure: Structure, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            n = len(structure.hertz)
            wanted = order(n)
            largest = wanted if isinstance(wanted, int) else 4 * n
            algorithm = SSI(name="peer", br=rows, method="cov", ordmax=largest, calc_unc=True, nb=50)
            return told(algorithm, structure, y, wanted)

        return of

    def plscf(structure: Structure, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        algorithm = pLSCF(name="peer", ordmax=16, nxseg=512)
        return told(algorithm, structure, y, 14, "order")

    return {
        "pyOMA2 SSI-cov, 15 rows, true order": ssi(15, lambda n: 2 * n),
        "pyOMA2 SSI-cov, 30 rows, true order": ssi(30, lambda n: 2 * n),
        "pyOMA2 SSI-cov, 30 rows, order 4 more": ssi(30, lambda n: 2 * n + 4),
        "pyOMA2 SSI-cov, 30 rows, stable poles": ssi(30, lambda n: "find_min"),
        "pyOMA2 pLSCF, 512 points, order 14": plscf,
    }


def study(
    name: str, structure: Structure, samples: int, noise: float, seeds: Sequence[int], others: bool,
    set_ups: Sequence[Sequence[int]] | None = None,
) -> None:  # fmt: skip
    """Fit the records of some seeds, and print a table."""
    title = f"{name}, T = {samples}, noise {100 * noise:.0f} %"
    table = Table(title, structure, samples, noise, set_ups)
    rivals = {rival: (method, Table("  " + rival, structure, samples, noise)) for rival, method in
              (peers() if others else {}).items()}  # fmt: skip
    n = len(structure.hertz)
    for seed in seeds:
        rng = np.random.default_rng([seed, samples, round(100 * noise)])
        data: object = (None, y := structure.record(samples, noise, rng)) if set_ups is None else [
            ct.TimeResponseData(
                structure.step * np.arange(samples), size * structure.record(samples, noise, rng)[rows], issiso=False,
                output_labels=[f"sensor {row}" for row in rows],
            )
            for rows, size in zip(set_ups, LOUDNESS, strict=True)
        ]  # fmt: skip
        start = time.process_time()
        result = phc.pem(data, dt=structure.step if set_ups is None else None, quantity="velocity")
        seconds = time.process_time() - start
        values = np.concatenate([result.natural_frequencies / (2 * np.pi), result.damping_ratios])
        stated = np.concatenate([result.stderr["natural_frequencies"] / (2 * np.pi), result.stderr["damping_ratios"]])
        right = result.order == n and not len(result.real_poles)
        table.add((result.order, len(result.real_poles)), values if right else values[:0], stated, seconds)
        if right:
            table.add_shapes(result.shapes, result.stderr["shapes"])
        for method, of_rival in rivals.values():
            start = time.process_time()
            try:
                values, stated = method(structure, y)
            except Exception as error:  # whatever another package makes of a record
                values = stated = np.zeros(0)
                print("     ", of_rival.name.strip(), type(error).__name__, error)
            good = values.shape == (2 * n,) and np.isfinite(values).all()
            seconds = time.process_time() - start
            of_rival.add((n, 0) if good else (0, 0), values if good else values[:0], stated, seconds)
    table.show()
    for _, of_rival in rivals.values():
        of_rival.show()


def large() -> None:
    """Ten modes, ten sensors, a million samples: time, memory, errors."""
    rng = np.random.default_rng(2)
    hertz, zeta = np.linspace(0.6, 9.0, 10), rng.uniform(0.005, 0.02, 10)
    structure = Structure(hertz, zeta, rng.standard_normal((10, 10)), np.diag(1 + np.arange(10.0)), 0.04)
    y = structure.record(1_000_000, 0.3, rng)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start = time.process_time()
    result = phc.pem((None, y), dt=structure.step, quantity="velocity")
    seconds = time.process_time() - start
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(f"{seconds:.1f} s of processor; {most / 1e6:.2f} GB in all, {before / 1e6:.2f} GB before the fit")
    print(result)
    if result.order == 10:
        z = np.concatenate([
            (result.natural_frequencies / (2 * np.pi) - hertz) / (result.stderr["natural_frequencies"] / (2 * np.pi)),
            (result.damping_ratios - zeta) / result.stderr["damping_ratios"],
        ])  # fmt: skip
        print("z2", np.mean(z**2).round(2), "largest", np.abs(z).max().round(2))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="+", choices=["floors", "four", "close", "roving", "large"])
    parser.add_argument("--samples", type=int, nargs="+", default=[3000, 30_000])
    parser.add_argument("--noise", type=float, nargs="+", default=[0.05, 0.6])
    parser.add_argument("--widths", type=float, nargs="+", default=[2.0, 1.0, 0.5])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--peers", action="store_true")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    seeds = range(arguments.first, arguments.first + arguments.seeds)
    for what in arguments.what:
        if what == "large":
            large()
            continue
        structures = {
            "floors": ("three floors", floors), "four": ("four modes", four), "roving": ("three set-ups", eight),
        }  # fmt: skip
        wanted = [(f"{widths} widths apart", close(widths)) for widths in arguments.widths] if what == "close" else []
        wanted += [(structures[what][0], structures[what][1]())] if what in structures else []
        for name, structure in wanted:
            for samples in arguments.samples:
                for noise in arguments.noise:
                    set_ups = ROVING if what == "roving" else None
                    study(name, structure, samples, noise, seeds, arguments.peers and not set_ups, set_ups)


if __name__ == "__main__":
    main()
