"""Reduced and nearest passive models beside those of other packages, one run.

    python -m benchmarks.reduction chain [--orders R ...]       pyMOR beside, if it is installed
    python -m benchmarks.reduction bounds [--count N]
    python -m benchmarks.reduction passive [--count N]          scikit-rf beside

`chain` is the mass-spring-damper chain of 50 masses with two ports: the H2 norm of the difference, whether the model is
passive, CPU seconds.  `bounds` holds `error_bound` of random systems against responses by dense matrices.  `passive`
makes fits to noisy scattering data passive by the covariance, by the H2 norm, and by scikit-rf, and compares what the
data pay.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from time import process_time
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray

import ph_control as phc

Array = NDArray[Any]

METHODS = ("modal", "balanced", "h2")


def main(argv: Sequence[str] | None = None) -> None:
    """Run one of the comparisons."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("which", choices=("chain", "bounds", "passive"))
    parser.add_argument("--orders", type=int, nargs="+", default=list(range(2, 21, 2)))
    parser.add_argument("--count", type=int, default=100)
    options = parser.parse_args(argv)
    {"chain": lambda: chain(options.orders), "bounds": lambda: bounds(options.count),
     "passive": lambda: passive(options.count)}[options.which]()  # fmt: skip


# --- the chain ----------------------------------------------------------------------------------------------------


def chain(orders: Sequence[int]) -> None:
    """H2 error, passivity and CPU time of all methods over orders."""
    plant = phc.msd_chain()
    full = ct.ss(plant.A, plant.B, plant.C, plant.D)
    reducers: dict[str, Callable[[int], Any]] = {
        f"ph_control {one}": lambda r, one=one: phc.reduce(plant, r, method=one) for one in METHODS
    }
    reducers |= dict(pymor_reducers(plant))
    print(f"{'method':22} order  H2 error    passive  CPU s")
    for order in orders:
        for name, make in reducers.items():
            start = process_time()
            try:
                small = make(order)
            except Exception as error:
                print(f"{name:22} {order:5}  failed: {type(error).__name__}: {str(error)[:60]}")
                continue
            seconds = process_time() - start
            small = ct.ss(*(np.asarray(getattr(small, one), float) for one in "ABCD"))
            report = phc.passivity(small)
            error = ct.norm(full - small, 2) if not len(report.unstable) else np.inf
            print(f"{name:22} {order:5}  {error:.4e}  {report.is_passive!s:7}  {seconds:.2f}", flush=True)


def pymor_reducers(plant: Any) -> Iterator[tuple[str, Callable[[int], Any]]]:
    """Reductors of pyMOR that take this system, by name; none where pyMOR is not installed."""
    try:
        from pymor.core.logger import set_log_levels
        from pymor.models.iosys import LTIModel
        from pymor.reductors.bt import BTReductor, PRBTReductor
        from pymor.reductors.h2 import IRKAReductor, TSIAReductor
        from pymor.reductors.mt import MTReductor
        from pymor.reductors.ph.ph_irka import PHIRKAReductor
    except ImportError:
        return
    set_log_levels({"pymor": "ERROR"})
    A, B, C, D = (np.array(getattr(plant, name), float) for name in "ABCD")
    plain = LTIModel.from_matrices(A, B, C)
    # positive-real balancing needs D + D^T > 0
    fed = LTIModel.from_matrices(A, B, C, 1e-8 * np.eye(len(C)))
    energy = phc.to_pymor(plant)

    def matrices(model: Any) -> Any:
        found = phc.from_pymor(model)
        return ct.ss(found.A, found.B, found.C, D)

    for name, system, reductor in (
        ("IRKA", plain, IRKAReductor), ("TSIA", plain, TSIAReductor), ("pH-IRKA", energy, PHIRKAReductor),
        ("PRBT", fed, PRBTReductor), ("BT", plain, BTReductor), ("MT", plain, MTReductor),
    ):  # fmt: skip
        yield f"pyMOR {name}", lambda r, system=system, reductor=reductor: matrices(reductor(system).reduce(r))


# --- bounds -------------------------------------------------------------------------------------------------------


def bounds(count: int) -> None:
    """How often bounds hold, and how far they are above the largest difference found."""
    for method in METHODS:
        ratios, passive_models = [], 0
        for seed in range(count):
            plant = random_system(seed)
            small = phc.reduce(plant, max(1, plant.nstates // 2), method=method)
            passive_models += phc.passivity(ct.ss(small.A, small.B, small.C, small.D)).is_passive
            difference, gain = largest_difference(plant, small)
            if difference > 1e-10 * gain:
                ratios.append(small.error_bound / difference)
        found = np.array(ratios)
        print(
            f"{method:9} {count} systems, {len(found)} with an error: bound holds in {np.sum(found >= 1 - 1e-6)}, over "
            f"the error median {np.median(found):.6f}, largest {found.max():.4f}; passive {passive_models}", flush=True,
        )  # fmt: skip


def random_system(seed: int) -> Any:
    """Damped system of 4 to 16 states and 1 to 3 ports, with and without feedthrough."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(4, 17)), int(rng.integers(1, 4))
    J, loss = rng.normal(size=(n, n)), rng.normal(size=(n, int(rng.integers(n, 2 * n))))
    root, energy = rng.normal(size=(m, m)), rng.normal(size=(n, n))
    S = rng.integers(0, 2) * 0.1 * root @ root.T
    Q = np.eye(n) + 0.3 * energy @ energy.T / n
    size = 10 ** rng.uniform(-2, 0)
    return phc.ph(Q, rng.normal(size=(n, m)), J=J - J.T, R=size * loss @ loss.T / n, S=S)


def largest_difference(one: Any, other: Any) -> tuple[float, float]:
    """Largest difference and largest gain over a grid that is dense at all poles."""
    poles = np.concatenate([np.linalg.eigvals(one.A), np.linalg.eigvals(other.A)])
    near = (np.abs(poles.imag)[:, None] + poles.real[:, None] * np.linspace(-3, 3, 41)).ravel()
    omega = np.unique(np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 300) * np.abs(poles).max(), near[near > 0]]))
    first, second = (response(sys, omega) for sys in (one, other))
    return float(np.linalg.norm(first - second, 2, axis=(1, 2)).max()), float(np.abs(first).max())


def response(sys: Any, omega: Array) -> Array:
    """Responses (K, p, m) by dense matrices."""
    M = 1j * omega[:, None, None] * np.eye(len(sys.A)) - sys.A
    return np.asarray(
        sys.C @ np.linalg.solve(M, np.broadcast_to(sys.B, (len(omega), *sys.B.shape)).astype(complex)) + sys.D
    )


# --- passive models of fits ---------------------------------------------------------------------------------------


def passive(count: int) -> None:
    """What the data pay for passivity: twice the log-likelihood, for poles as they are."""
    ours, by_h2, by_skrf = [], [], []
    passive_models = skrf_passive = moved_poles = seed = 0
    while len(ours) + moved_poles < count:
        fit, omega = noisy_fit(seed)
        seed += 1
        report = phc.passivity(fit.observed_system, kind="scattering")
        if report.is_passive:
            continue
        model = phc.nearest_passive(fit, kind="scattering")
        passive_models += phc.passivity(model, kind="scattering").is_passive
        if len(report.unstable):
            moved_poles += 1
            continue
        ours.append(model.cost)
        by_h2.append(paid(fit, residues_of(fit, phc.nearest_passive(fit, weight="h2", kind="scattering"))))
        found, judged = by_scikit_rf(fit, omega)
        by_skrf.append(paid(fit, found) if judged else np.nan)
        skrf_passive += judged
    a, b, c = np.array(ours), np.array(by_h2), np.array(by_skrf)
    print(f"{count} fits that are not passive, {moved_poles} of them unstable; passive after: {passive_models}")
    print(f"scikit-rf: passive after {skrf_passive} of {len(ours)}")
    for name, other in (("H2", b), ("scikit-rf, where passive", c)):
        there = np.isfinite(other)
        ratio = a[there] / other[there]
        print(f"cost over that of {name}: median {np.median(ratio):.3f}, largest {ratio.max():.6f}")


def noisy_fit(seed: int, ports: int = 2, modes: int = 4) -> tuple[Any, Array]:
    """Free fit of a scattering matrix near the bound, entries of different noise."""
    rng = np.random.default_rng(seed)
    d, zeta = np.sort(rng.uniform(0.5, 3.0, modes)), rng.uniform(0.02, 0.08, modes)
    p = d * (-zeta + 1j * np.sqrt(1 - zeta**2))
    rho = rng.normal(size=(modes, ports, ports)) + 1j * rng.normal(size=(modes, ports, ports))
    rho = (rho + rho.transpose(0, 2, 1)) * (zeta * d)[:, None, None]
    omega = np.linspace(0.05, 4.0, 120)
    grid = np.unique(
        np.concatenate([omega, *(a + np.linspace(-3, 3, 61) * b * a for a, b in zip(d, zeta, strict=True))])
    )
    rho *= 0.99 / np.linalg.svd(of_modes(p, rho, grid), compute_uv=False).max()
    S = of_modes(p, rho, omega)
    noise = 0.1 * 10 ** rng.uniform(-1.5, 0.0, (ports, ports))
    S = S + noise * (rng.normal(size=S.shape) + 1j * rng.normal(size=S.shape))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fit = phc.pem(
            ct.FrequencyResponseData(np.moveaxis(S, 0, 2), omega), modes, structure="free", quantity=["free"] * ports
        )
    return fit, omega


def of_modes(p: Array, rho: Array, omega: Array) -> Array:
    """Response (K, m, m) of poles and residues."""
    s = 1j * omega[:, None]
    both = np.einsum("kl,lab->kab", 1 / (s - p), rho) + np.einsum("kl,lab->kab", 1 / (s - p.conj()), rho.conj())
    return np.asarray(both)


def residues_of(fit: Any, model: Any) -> Array:
    """Residues of a model with the poles of the fit."""
    values, vectors = np.linalg.eig(model.A)
    b, c = np.linalg.solve(vectors, model.B), model.C @ vectors
    found = np.zeros(fit.residues.shape, complex)
    for value, row, column in zip(values, b, c.T, strict=True):
        k = int(np.argmin(np.abs(fit.poles - value)))
        if value.imag > 0:
            found[k] += np.outer(column, row)
    return found


def paid(fit: Any, residues: Array) -> float:
    """Squared distance in the metric of the covariance of the residues, for given poles."""
    n, size = len(fit.poles), fit.residues.size
    known = np.nan_to_num(fit.covariance)[: 2 * (n + size), : 2 * (n + size)]
    information = np.linalg.pinv(known, rcond=1e-14, hermitian=True)[2 * n :, 2 * n :]
    moved = (residues - fit.residues).ravel()
    moved = np.concatenate([moved.real, moved.imag])
    return float(moved @ information @ moved)


def by_scikit_rf(fit: Any, omega: Array) -> tuple[Array, bool]:
    """Residues after its enforcement of passivity, and whether the exact test finds them passive."""
    import skrf
    from skrf.vectorFitting import VectorFitting

    m = fit.feedthrough.shape[0]
    frequency = skrf.Frequency.from_f(omega / (2 * np.pi), unit="hz")
    network = skrf.Network(frequency=frequency, s=of_modes(fit.poles, fit.residues, omega), z0=50)
    fitting = VectorFitting(network)
    fitting.poles, fitting.residues = fit.poles.copy(), fit.residues.reshape(len(fit.poles), -1).T.copy()
    fitting.constant_coeff, fitting.proportional_coeff = np.zeros(m * m), np.zeros(m * m)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        fitting.passivity_enforce(n_samples=1000, f_max=omega[-1] / (2 * np.pi))
    found = fitting.residues.T.reshape(fit.residues.shape)
    judged = replace(fit, residues=found, structure="free").observed_system
    return found, phc.passivity(judged, kind="scattering").is_passive


if __name__ == "__main__":
    main()
