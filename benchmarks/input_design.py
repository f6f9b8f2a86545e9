"""Inputs by `design_input`: the optimum of a general solver, and the errors of fits to them over those predicted.

python -m benchmarks.input_design optimum|errors [--seeds N]
"""

from __future__ import annotations

import argparse
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ph_control as phc

Array = NDArray[np.float64]

STEP, SAMPLES, NOISE = 0.05, 4000, 0.05
LIGHT = phc.modes([3.0, 7.0, 13.0], [0.3, 0.1, 0.08], damping=[0.01, 0.008, 0.012])


def response(theta: Array, omega: Array, h: float) -> NDArray[np.complex128]:
    """Response of held inputs of modes `theta` = (d, zeta, real and imaginary parts of residues)."""
    z, total = np.exp(1j * omega * h), np.zeros(len(omega), complex)
    for d, zeta, real, imaginary in np.reshape(theta, (4, -1)).T:
        p, rho = d * (-zeta + 1j * np.sqrt(1 - zeta**2)), real + 1j * imaginary
        for pole, residue in ((p, rho), (p.conj(), rho.conj())):
            total += residue * np.expm1(pole * h) / pole / (z - np.exp(pole * h))
    return total


def sensitivities(theta: Array, omega: Array, h: float) -> NDArray[np.complex128]:
    """Derivatives of the response by central differences."""
    columns = []
    for k, value in enumerate(theta):
        step = np.zeros(len(theta))
        step[k] = 1e-5 * max(abs(value), 1e-2)
        columns.append((response(theta + step, omega, h) - response(theta - step, omega, h)) / (2 * step[k]))
    return np.array(columns).T


def parameters(plant: Any) -> Array:
    """Parameters of a modal form of one input and output."""
    p, residues = plant.poles, plant.residues[:, 0, 0]
    kept = np.flatnonzero(p.imag > 0)
    kept = kept[np.argsort(np.abs(p[kept]))]
    d = np.abs(p[kept])
    return np.concatenate([d, -p[kept].real / d, residues[kept].real, residues[kept].imag])


def least_by_cvxpy(D: NDArray[np.complex128], wanted: Array) -> float:
    """Least `trace(W F^-1 W^T)` over powers that sum up to 1, `F = sum P Re(D^H D)`, by an interior-point solver."""
    import cvxpy as cp

    size = D.shape[1]
    scale = np.sqrt(np.mean(np.abs(D) ** 2, axis=0))
    D, wanted = D / scale, wanted / scale
    parts = np.einsum("ki,kj->kij", D.conj(), D).real.reshape(len(D), -1)
    power = cp.Variable(len(D), nonneg=True)
    F = cp.reshape(parts.T @ power, (size, size), order="C")
    total = sum(cp.matrix_frac(row, 0.5 * (F + F.T)) for row in wanted)
    return float(cp.Problem(cp.Minimize(total), [cp.sum(power) == 1]).solve(solver="CLARABEL"))


def optimum(seeds: int) -> None:
    """Criterion of the designed spectrum over that of cvxpy, for random plants of three modes."""
    T, h = 1000, 0.2
    ratios, times = [], []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        d, zeta = np.sort(rng.uniform(1.0, 12.0, 3)), rng.uniform(0.004, 0.02, 3)
        plant = phc.modes(d, rng.uniform(0.05, 0.3, 3), damping=zeta)
        theta, omega = parameters(plant), 2 * np.pi * np.arange(1, T // 2) / (T * h)
        D = sensitivities(theta, omega, h)
        for first, purpose in ((0, "natural_frequencies"), (3, "damping_ratios")):
            start = time.process_time()
            design = phc.design_input(plant, T, h, rms=1.0, for_=purpose, noise_std=1.0)
            times.append(time.process_time() - start)
            wanted = np.eye(12)[first : first + 3] / theta[first : first + 3, None]
            power = np.zeros(len(omega))
            power[np.rint(design.frequencies * T * h / (2 * np.pi)).astype(int) - 1] = design.spectrum[0]
            F = T * np.einsum("k,ki,kj->ij", power, D.conj(), D).real
            reached = np.trace(wanted @ np.linalg.solve(F, wanted.T))
            ratios.append(reached * T / least_by_cvxpy(D, wanted))
    print(
        f"{len(ratios)} designs: criterion over that of cvxpy {min(ratios):.5f} to {max(ratios):.5f}; CPU time "
        f"{np.median(times):.2f} s"
    )


def errors(seeds: int) -> None:
    """Root mean square errors of fits over the predicted ones, and over those of white noise of the same peak."""
    design = phc.design_input(LIGHT, SAMPLES, STEP, peak=1.0, noise_std=NOISE)
    white = np.random.default_rng(1).standard_normal(SAMPLES)
    white /= np.abs(white).max()
    other = phc.excitation((white, None), LIGHT, dt=STEP, noise_std=NOISE).stderr
    plant, true = phc.ph(LIGHT), {"natural_frequencies": LIGHT.natural_frequencies}
    true["damping_ratios"] = LIGHT.damping_ratios
    print(f"{design}; white noise of the same peak: rms {white.std():.3f}, designed {design.rms[0]:.3f}")
    for name, u in (("designed", design.signal[0]), ("white", white)):
        clean = phc.forced_response(plant, design.time, u, intersample="zoh").outputs
        deviations: dict[str, list[Array]] = {key: [] for key in true}
        orders = 0
        for seed in range(seeds):
            y = clean + NOISE * np.random.default_rng(100 + seed).standard_normal(SAMPLES)
            orders += phc.pem((u, y), dt=STEP).order == 3 if seed < 20 else 0
            fit = phc.pem((u, y), 3, dt=STEP, structure="free", delay=0)
            for key, value in true.items():
                deviations[key].append(getattr(fit, key) - value)
        predicted = design.stderr if name == "designed" else other
        for key in true:
            rms = np.sqrt(np.mean(np.square(deviations[key]), axis=0))
            print(
                f"{name}, {key}: rms error {rms}, over the predicted one {(rms / predicted[key]).round(3)}, predicted "
                f"for white noise over this {(other[key] / rms).round(2)}"
            )
        print(f"{name}: by the default call {orders} of {min(seeds, 20)} with three modes", flush=True)


def main() -> None:
    """Run a study."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.input_design", description=__doc__.splitlines()[0])
    parser.add_argument("study", choices=("optimum", "errors"))
    parser.add_argument("--seeds", type=int)
    options = parser.parse_args()
    if options.study == "optimum":
        optimum(options.seeds or 20)
    else:
        errors(options.seeds or 200)


if __name__ == "__main__":
    main()
