"""Reduced and nearest passive models beside those of other packages, one run.

    python -m benchmarks.reduction chain [--orders R ...] [--picture FILE]      pyMOR beside, if it is installed
    python -m benchmarks.reduction building FILE [--orders R ...]               the same
    python -m benchmarks.reduction bounds [--count N]
    python -m benchmarks.reduction passive [--count N]                          scikit-rf beside
    python -m benchmarks.reduction network FILE [--poles N]                     the same
    python -m benchmarks.reduction loops [--count N]                            python-control beside

`chain` is the mass-spring-damper chain of 50 masses with two ports, `building` a building of 48 states (`build.mat` of
the SLICOT collection): the H2 norm of the difference, whether the model is passive, CPU seconds.  `bounds` holds
`error_bound` of random systems against responses by dense matrices.  `passive` makes fits to noisy scattering data
passive by the covariance, by the H2 norm, and by scikit-rf, and compares what the data pay; `network` does so for
measured data, a Touchstone file, from the poles and residues of scikit-rf's vector fitting.  `loops` closes random
loops through gains, random systems and LQG: the energy without input, and the poles of `control.feedback` of the same
matrices.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from dataclasses import replace
from time import process_time
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

import ph_control as phc

Array = NDArray[Any]

METHODS = ("modal", "balanced", "h2")


def main(argv: Sequence[str] | None = None) -> None:
    """Run one of the comparisons."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("which", choices=("chain", "building", "bounds", "passive", "network", "loops"))
    parser.add_argument("file", nargs="?")
    parser.add_argument("--orders", type=int, nargs="+", default=list(range(2, 21)))
    parser.add_argument("--picture")
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--poles", type=int, default=28, help="for vector fitting: two real, the others complex")
    options = parser.parse_args(argv)
    if options.which in ("building", "network") and not options.file:
        parser.error(f"{options.which} needs its file")
    {
        "chain": lambda: beside_pymor(phc.msd_chain(), options.orders, options.picture),
        "building": lambda: beside_pymor(building(options.file), options.orders, options.picture),
        "bounds": lambda: bounds(options.count), "passive": lambda: passive(options.count),
        "network": lambda: network(options.file, options.poles), "loops": lambda: loops(options.count),
    }[options.which]()  # fmt: skip


# --- beside pyMOR -------------------------------------------------------------------------------------------------


def building(path: str) -> Any:
    """The model of a building, as a port-Hamiltonian system."""
    from scipy.io import loadmat
    from scipy.sparse import csc_matrix

    A, B, C = (np.asarray(csc_matrix(loadmat(path)[name]).todense(), float) for name in "ABC")
    return phc.ph(ct.ss(A, B, C, 0))


def beside_pymor(plant: Any, orders: Sequence[int], picture: str | None) -> None:
    """H2 error, passivity and CPU time of all methods over orders."""
    full = ct.ss(plant.A, plant.B, plant.C, plant.D)
    reducers: dict[str, Callable[[int], Any]] = {
        f"ph_control {one}": lambda r, one=one: phc.reduce(plant, r, method=one) for one in METHODS
    }
    reducers |= dict(pymor_reducers(plant))
    found: dict[str, list[tuple[int, float, bool]]] = {}
    print(f"H2 norm {ct.norm(full, 2):.5f}\nmethod                 order  H2 error    passive  CPU s")
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
            found.setdefault(name, []).append((order, error, report.is_passive))
            print(f"{name:22} {order:5}  {error:.4e}  {report.is_passive!s:7}  {seconds:.2f}", flush=True)
    if picture:
        draw(found, picture)


def draw(found: dict[str, list[tuple[int, float, bool]]], path: str) -> None:
    """The errors over the orders, passive models filled."""
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(layout="constrained", figsize=(7, 5.2))
    for (name, rows), marker in zip(found.items(), "osD^v<>PX*", strict=False):
        orders, errors, passive_ones = (np.array(column) for column in zip(*rows, strict=True))
        own = name.startswith("ph_control")
        (line,) = axis.semilogy(
            orders, errors, "-" if own else ":", marker=marker, ms=5, lw=2 if name.endswith("h2") else 1, label=name
        )
        opened = orders[~passive_ones], errors[~passive_ones]
        axis.semilogy(*opened, marker, ms=5, color=line.get_color(), mfc="white", zorder=3)
    axis.set(xlabel="States", ylabel="H2 norm of the error", xticks=np.arange(orders.min(), orders.max() + 1, 2))
    axis.set_title("Filled marks: passive models; open marks: models that are not", fontsize="medium")
    axis.grid(alpha=0.4)
    figure.legend(fontsize="small", ncols=3, loc="outside lower center", frameon=False)
    figure.savefig(path, dpi=110)


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


# --- a measured network -------------------------------------------------------------------------------------------


def network(path: str, poles: int) -> None:
    """What measured scattering parameters pay for passivity, with the same noise on all of them."""
    import skrf
    from skrf.vectorFitting import VectorFitting

    warnings.simplefilter("ignore")
    data = skrf.Network(path)
    omega = 2 * np.pi * data.f
    fitting = VectorFitting(data)
    fitting.vector_fit(n_poles_real=2, n_poles_cmplx=poles - 2)

    def system(model: Any) -> Any:
        return ct.StateSpace(*model._get_ABCDE()[:4], remove_useless_states=False)

    fit = system(fitting)
    squared = np.abs(data.s - response(fit, omega)) ** 2

    def report(name: str, model: Any, seconds: float) -> None:
        lost = 2 * (np.sum(np.abs(data.s - response(model, omega)) ** 2) - squared.sum()) / squared.mean()
        judged = phc.passivity(model, kind="scattering")
        bands = ", ".join(f"{low:.4g} to {high:.4g} MHz" for low, high in np.array(judged.bands) / (2e6 * np.pi))
        print(
            f"{name:28} cost {lost:8.2f}  {seconds:6.1f} s  {'active at ' + bands if bands else 'passive'}", flush=True
        )

    residual = np.sqrt(squared.mean())
    print(f"{data.nports} ports, {len(omega)} frequencies, {fit.nstates} states, residual {residual:.4f}")
    report("vector fitting", fit, 0.0)
    weights: tuple[tuple[str, Any], ...] = (("data", (omega, np.ones(len(omega)))), ("h2", "h2"))
    for name, weight in weights:
        start = process_time()
        report(f"nearest_passive, weight {name}", phc.nearest_passive(fit, weight=weight, kind="scattering"),
               process_time() - start)  # fmt: skip
    for count in (200, 1000):
        moved = deepcopy(fitting)
        start = process_time()
        moved.passivity_enforce(n_samples=count)
        report(f"scikit-rf, {count} samples", system(moved), process_time() - start)


# --- closed loops -------------------------------------------------------------------------------------------------


def loops(count: int) -> None:
    """Loops of random plants and controllers: rise of the energy without input, and poles by python-control."""
    rises, differences, passive_loops, ports = [], [], 0, 2
    for seed in range(count):
        rng = np.random.default_rng(seed)
        plant = random_loop_part(rng, ports)
        root = rng.normal(size=(ports, ports))
        controller = (
            random_loop_part(rng, ports), root @ root.T + root - root.T, phc.lqg(plant, 10 ** rng.uniform(-2, 1))
        )[seed % 3]  # fmt: skip
        loop = phc.damping_injection(plant, controller)
        judged = phc.passivity(ct.ss(loop.A, loop.B, loop.C, loop.D)).is_passive
        passive_loops += judged and isinstance(loop, phc.PortHamiltonian)
        t = np.linspace(0, 4, 100)
        states = phc.forced_response(loop, t, np.zeros((ports, len(t))), rng.normal(size=loop.nstates)).states
        energy = 0.5 * np.einsum("it,ij,jt->t", states, loop.Q, states)
        rises.append(np.diff(energy).max() / energy[0])
        other = ct.ss(controller) if isinstance(controller, ct.StateSpace) else ct.ss([], [], [], controller)
        expected = ct.feedback(ct.ss(plant.A, plant.B, plant.C, plant.D), other).poles()
        distance = np.abs(expected[:, None] - loop.poles())
        differences.append(distance[linear_sum_assignment(distance)].max() / np.abs(expected).max())
    print(f"{count} loops, port-Hamiltonian and passive {passive_loops}")
    print(f"largest rise of the energy: {max(rises):.1e} of that at the start")
    print(f"poles beside those of control.feedback: largest difference {max(differences):.1e} of the largest pole")


def random_loop_part(rng: np.random.Generator, ports: int) -> Any:
    """Passive system of 1 to 8 states."""
    n = int(rng.integers(1, 9))
    J, root, loss = rng.normal(size=(n, n)), rng.normal(size=(n, n)), rng.normal(size=(n, int(rng.integers(1, n + 1))))
    return phc.ph(root @ root.T + 0.1 * np.eye(n), rng.normal(size=(n, ports)), J=J - J.T, R=loss @ loss.T)


if __name__ == "__main__":
    main()
