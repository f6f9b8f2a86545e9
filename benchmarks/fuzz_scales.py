"""Answers in any unit of time and gain, for loose masses, and for poles that coincide: what absolute tolerances break.

Units are powers of 2, in which nothing rounds: an answer in one is that in another, scaled, to the last digits.  What
the answers are is a closed form, 60 digits, or how the plant is built.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import control as ct
import mpmath as mp
import numpy as np
import scipy.sparse
from scipy.linalg import eigh

import ph_control as phc

DIGITS = 60
ROUNDED = 1e-12  # relative, of what only rounds
TURNED = 1e-15  # relative, what poles of doubles may be off
WAYS = ("modal", "balanced")
FREE = 1e-7  # frequency of a rigid mode, of the largest one: the square root of rounding


class Wrong(Exception):
    """An answer that is not the one of the reference."""


def hold(found: Any, right: Any, what: str, allowed: float = ROUNDED) -> None:
    """Compare with the reference, relative to its largest entry."""
    found, right = np.asarray(found), np.asarray(right)
    if found.shape != right.shape:
        raise Wrong(f"{what}: shape {found.shape}, right {right.shape}")
    size = np.max(np.abs(right), initial=0.0)
    error = np.max(np.abs(found - right), initial=0.0)
    if not error <= allowed * size:
        raise Wrong(f"{what}: relative error {error / size if size else np.inf:.1e}")


def unit(rng: Any) -> float:
    """A power of 2 from 1e-12 to 1e12."""
    return float(2.0 ** rng.integers(-40, 41))


# --- poles that coincide, steps of any length ------------------------------------------------------------------------


def _sections(rng: Any, oscillating: bool = False) -> tuple[Any, Any, Any]:
    """Masses on a spring and a dashpot each, with real poles of a ratio near 1 and other ones: `m`, `c`, `k`."""
    count = int(rng.integers(1, 4))
    m, p = rng.uniform(0.5, 2.0, (2, count)) * [[1.0], [3.0]]
    ratio = 1 + 10.0 ** -rng.integers(0, 18, count) * rng.choice([1.0, 1.0, 3.0], count)
    shared = rng.random() < 0.3
    p = np.full(count, p[0]) if shared else p
    c, k = m * p * (1 + ratio), m * p * p * ratio
    return m, c * (rng.uniform(0.0, 1.0, count) if oscillating else 1.0), k


def _plant(m: Any, c: Any, k: Any, **more: Any) -> Any:
    n = len(m)
    return phc.ph(np.diag(np.r_[k, 1 / m]), np.r_[np.zeros(n), np.ones(n)], R=np.diag(np.r_[np.zeros(n), c]), **more)


def _motion(A: Any, B: Any, h: float, u: Any, z0: Any, hold_: str) -> tuple[Any, list[Any]]:
    """`e^(A h)` and all states, of the very doubles."""
    (n, m), step = B.shape, mp.mpf(h)
    with mp.workdps(3 * DIGITS):
        M = mp.zeros(n + 2 * m)
        M[:n, :n], M[:n, n : n + m] = step * mp.matrix(A.tolist()), step * mp.matrix(B.tolist())
        M[n : n + m, n + m :] = mp.eye(m)
        E = mp.expm(M)
    F, G, S, z = E[:n, :n], E[:n, n : n + m], E[:n, n + m :], [mp.matrix(np.reshape(z0, (-1, 1)).tolist())]
    for now, then in pairwise(mp.matrix(column.tolist()) for column in u.T):
        z.append(F * z[-1] + G * now + (S * (then - now) if hold_ == "foh" else 0 * G * now))
    return F, z


def _share(found: Any, right: list[Any], what: str) -> None:
    """Errors of any of these numbers, of the largest of them, where that is less than a double shows."""
    pairs = list(zip(np.ravel(found).tolist(), right, strict=True))
    size = max(abs(value) for value in right)
    error = max(abs(mp.mpf(value) - truth) for value, truth in pairs)
    if not error <= 1e-13 * size:
        raise Wrong(f"{what}: {mp.nstr(error / size if size else mp.inf, 2)} of the largest sample")


def critical_damping(rng: Any) -> None:
    """Responses and samples of real poles that nearly coincide, for steps of 1e-6 to 50 time constants."""
    scale = unit(rng)
    m, c, k = _sections(rng)
    plant = _plant(m, c * scale, k * scale * scale)
    step = 10 ** rng.uniform(-6, np.log10(50))
    samples, hold_ = int(rng.integers(2, 12)), str(rng.choice(["zoh", "foh"]))
    h, n = step / float(np.abs(plant.poles()).max()), plant.nstates
    t, rest = h * np.arange(samples), np.zeros(n)
    ones, none, u = np.ones((1, samples)), np.zeros((1, samples)), rng.standard_normal((1, samples))
    push, shift = plant.B[:, 0], np.eye(n)[int(rng.integers(n))]
    with mp.workdps(DIGITS):
        for what, response, inputs, start in (
            ("forced", phc.forced_response(plant, t, u, intersample=hold_), u, rest),
            ("step", phc.step_response(plant, t, intersample=hold_), ones, rest),
            ("impulse", phc.impulse_response(plant, t), none, push),
            ("initial", phc.initial_response(plant, t, shift), none, shift),
        ):
            F, z = _motion(plant.A, plant.B, h, inputs, start, hold_)
            C = mp.matrix(plant.C.tolist())
            right = [(C * state)[0] for state in z]
            if any(right):
                _share(response.outputs, right, f"{what}, {hold_}, step {step:.2g}")
        _share(phc.sample(plant, h, intersample=hold_).A, list(F), f"sampled, step {step:.2g}")


def long_steps(rng: Any) -> None:
    """Responses of chains in motion, lossy or not, free or grounded, for steps of 1e-3 to 50 radians of the fastest."""
    scale, n = unit(rng), int(rng.integers(1, 5))
    m, k = rng.uniform(0.5, 2.0, n), rng.uniform(0.5, 4.0, n) * 10.0 ** rng.uniform(-3, 1, n)
    if n > 1 and rng.random() < 0.3:
        k[0] = 0.0
    K = np.diag(k) + np.diag(np.r_[k[1:], 0.0]) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    C = K * 10 ** rng.uniform(-6, 0.5) + np.diag(rng.uniform(0, 1, n) * (rng.random(n) < 0.3))
    Q = np.zeros((2 * n, 2 * n))
    Q[:n, :n], Q[n:, n:] = K * scale * scale, np.diag(1 / m)
    R = np.zeros((2 * n, 2 * n))
    R[n:, n:] = C * scale
    B = np.vstack([np.zeros((n, n)), np.eye(n)])[:, rng.permutation(n)[: int(rng.integers(1, min(n, 2) + 1))]]
    plant = phc.ph(Q, B, **({} if rng.random() < 0.3 else {"R": R}))
    h = 10 ** rng.uniform(-3, np.log10(50)) / (scale * float(np.sqrt(np.abs(K).max() / m.min())))
    samples, hold_ = int(rng.integers(2, 10)), str(rng.choice(["zoh", "foh"]))
    u, start = rng.standard_normal((B.shape[1], samples)), rng.standard_normal(2 * n) * (rng.random() < 0.5)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", phc.ResolutionWarning)  # steps are meant to be long
        found = phc.forced_response(plant, h * np.arange(samples), u, start, intersample=hold_, squeeze=False)
        sampled = phc.sample(plant, h, intersample=hold_)
    with mp.workdps(DIGITS):
        F, z = _motion(plant.A, plant.B, h, u, start, hold_)
        turned = _motion(plant.A, plant.B, h * (1 + TURNED), u, start, hold_)[1]
        rows = mp.matrix(plant.C.tolist())
        right, moved = (np.array([[float(x) for x in rows * state] for state in states]).T for states in (z, turned))
        # rows and columns of the matrix have units of their own
        size = np.r_[np.full(n, scale), np.ones(n)]
        F = np.array([[float(F[i, j]) for j in range(2 * n)] for i in range(2 * n)]) * size[:, None] / size
    text = f"{n} masses, {hold_}, step {h:.2g}, unit {scale:.1e}"
    # after half turns a held force leaves hardly any speed, but what poles of doubles are off
    allowed = max(ROUNDED, float(np.max(np.abs(moved - right)) / np.max(np.abs(right))))
    hold(found.outputs, right, f"response, {text}", allowed)
    hold(sampled.A * size[:, None] / size, F, f"sampled, {text}")


def long_records(rng: Any) -> None:
    """Critical damping over up to 100 000 samples: `t exp(-p t)` for a step."""
    p, h = float(rng.uniform(0.5, 3.0)), float(10 ** rng.uniform(-5, -1))
    p = float(np.float32(p))  # of which the square is a double
    t = h * np.arange(int(min(100_000, 8 / (p * h))))
    plant = _plant(np.ones(1), np.array([2 * p]), np.array([p * p]))
    hold(phc.step_response(plant, t).outputs, t * np.exp(-p * t), "step of a long record")


# --- energy --------------------------------------------------------------------------------------------------------


def energy_of_a_push(rng: Any) -> None:
    """A held force works along the way of its mass; the rest is energy of a spring and a moving mass, and lost."""
    scale, (m, c, k) = unit(rng), (part[:1] for part in _sections(rng, oscillating=True))
    loose = rng.random() < 0.3
    c, k = c * scale, k * (0.0 if loose else scale * scale)
    plant = _plant(m, c, k)
    h = 10 ** rng.uniform(-3, 1.5) / scale
    t = h * np.arange(int(rng.integers(3, 15)))
    balance = phc.energy_balance(phc.forced_response(plant, t, 1.0, intersample="zoh"), plant)
    with mp.workdps(DIGITS):
        M, L, K = (mp.mpf(1) / mp.mpf(float(1 / m[0])), mp.mpf(float(c[0])), mp.mpf(float(k[0])))
        terms = []
        for x in map(mp.mpf, t.tolist()):
            decay, root = L / (2 * M), mp.sqrt(mp.mpc((L / (2 * M)) ** 2 - K / M))
            if loose:
                v = -mp.expm1(-L * x / M) / L if L else x / M
                way = (x - M * v) / L if L else x * x / (2 * M)
            else:
                beat = mp.sinh(root * x) / root if root else x
                v = (mp.exp(-decay * x) * beat).real / M
                way = ((1 - mp.exp(-decay * x) * (mp.cosh(root * x) + decay * beat)) / K).real
            stored = (M * v * v + K * way * way) / 2
            terms.append([float(stored), float(way), float(way - stored)])
    right = np.array(terms).T
    size = np.max(np.abs(right[1]))
    for what, found, exact in zip(
        ("stored", "supplied", "dissipated", "defect"),
        (balance.stored, balance.supplied, balance.dissipated, balance.defect), [*right, 0 * right[0]], strict=True,
    ):  # fmt: skip
        error = np.max(np.abs(found - exact)) / size
        if not error <= ROUNDED:
            raise Wrong(f"{what}: {error:.1e} of the energy supplied, unit {scale:.1e}")


# --- the same in other units -----------------------------------------------------------------------------------------


def _lossy(rng: Any) -> dict[str, Any]:
    n = 2 * int(rng.integers(1, 4))
    Q, W = rng.standard_normal((2, n, n))
    return {
        "Q": Q @ Q.T / n + np.eye(n), "B": rng.standard_normal((n, int(rng.integers(1, 3)))),
        "R": W @ W.T / n * 10.0 ** rng.uniform(-3, 0.5),
    }  # fmt: skip


def responses_in_other_units(rng: Any) -> None:
    """Time runs faster by a factor where energies are larger by it; forces and outputs stay as they are."""
    parts, scale = _lossy(rng), unit(rng)
    if rng.random() < 0.3:
        parts.pop("R")
    plain, other = phc.ph(**parts), phc.ph(**{**parts, "Q": scale * parts["Q"]})
    hold(other.natural_frequencies, scale * plain.natural_frequencies, "natural frequencies")
    hold(other.damping_ratios, plain.damping_ratios, "damping ratios")
    s = rng.uniform(0.3, 1, 3) + 1j * rng.uniform(0.1, 4, 3)
    hold(other.horner(scale * s), plain.horner(s), "frequency response")
    t = rng.uniform(0.01, 3.0) * np.arange(12)
    u = rng.standard_normal((plain.ninputs, 12))
    first, then = phc.forced_response(plain, t, u), phc.forced_response(other, t / scale, u)
    hold(then.outputs, first.outputs, "forced response")
    one, two = phc.energy_balance(first, plain), phc.energy_balance(then, other)
    size = np.max(np.abs(one.supplied)) + np.max(one.stored)
    for term in ("stored", "supplied", "dissipated"):
        if not np.max(np.abs(scale * getattr(two, term) - getattr(one, term))) <= ROUNDED * size:
            raise Wrong(f"energy {term} depends on the unit of time, {scale:.1e}")
    if not (phc.passivity(plain).is_passive and phc.passivity(other).is_passive):
        raise Wrong(f"passive by its matrices, and called active: unit of time {scale:.1e}")


def models_in_other_units(rng: Any) -> None:
    """A plain state space in other units of time, input and output: its form, verdict, and smaller models."""
    parts, scale, into, out = _lossy(rng), unit(rng), unit(rng) ** 0.5, unit(rng) ** 0.5
    base = phc.ph(**parts)
    n, m = base.B.shape
    T = np.linalg.qr(rng.standard_normal((n, n)))[0]
    A, B, C, D = T.T @ base.A @ T, T.T @ base.B, base.C @ T, np.eye(m) * float(rng.random() < 0.5)
    plain = ct.ss(A, B, C, D)
    other = ct.ss(scale * A, scale * into * B, out * C, into * out * D)
    s = rng.uniform(0.3, 1, 3) + 1j * rng.uniform(0.1, 4, 3)
    right = np.stack([C @ np.linalg.solve(x * np.eye(n) - A, B) + D for x in s], axis=-1) * into * out
    text = f"unit of time {scale:.1e}, of the input {into:.1e}, of the output {out:.1e}"
    if not phc.passivity(other).is_passive:
        raise Wrong(f"called active: {text}")
    form = phc.ph(other)
    hold(form.horner(scale * s), right, f"form, {text}", 1e-8)
    hold(np.sort_complex(np.round(form.poles() / scale, 8)), np.sort_complex(np.round(base.poles(), 8)), "poles", 1e-6)
    small = {} if n < 4 else {f"reduce, {way}": lambda sys, way=way: phc.reduce(sys, 2, method=way) for way in WAYS}
    for what, call in ({"minreal": phc.minreal} | small).items():
        first, then = call(phc.ph(plain)), call(form)
        if first.nstates != then.nstates:
            raise Wrong(f"{what}: {then.nstates} states, {first.nstates} in plain units: {text}")
        hold(then.horner(scale * s), first.horner(s) * into * out, f"{what}, {text}", 1e-6)


def _terms(rng: Any) -> tuple[Any, Any, float]:
    """Sum of passive terms with a gap below it: numerator, denominator, least real part on the axis."""
    parts, floor = [], float(rng.uniform(0.1, 1.0))
    for _ in range(int(rng.integers(1, 4))):
        d, zeta, kappa = rng.uniform(0.5, 4.0), rng.uniform(0.05, 1.5), rng.uniform(0.3, 2.0)
        parts.append(([kappa, 0.0], [1.0, 2 * zeta * d, d * d]))
    num, den = np.array([floor]), np.array([1.0])
    for top, bottom in parts:
        num, den = np.polyadd(np.polymul(num, bottom), np.polymul(top, den)), np.polymul(den, bottom)
    return num, den, floor


def transfer_functions_in_other_units(rng: Any) -> None:
    """Verdict, bands and form of a transfer function that is passive, or active, by a wide margin."""
    num, den, floor = _terms(rng)
    active = bool(rng.random() < 0.5)
    if active:
        num = np.polysub(num, 1.5 * floor * den)  # the real part is -floor/2 at 0 and beyond all modes
    scale, gain = unit(rng), unit(rng)
    powers = scale ** np.arange(len(den))
    sys = ct.tf(gain * num * powers[len(den) - len(num) :], den * powers)
    text = f"unit of time {scale:.1e}, gain {gain:.1e}"
    report = phc.passivity(sys)
    if report.is_passive == active:
        raise Wrong(f"called {'passive' if active else 'active'}: {text}")
    if active:
        try:
            phc.ph(sys)
        except phc.NotPassiveError:
            return
        raise Wrong(f"an active system is converted: {text}")
    s = rng.uniform(0.3, 1, 3) + 1j * rng.uniform(0.1, 4, 3)
    found = phc.ph(sys).horner(scale * s)[0, 0]
    hold(found, gain * np.polyval(num, s) / np.polyval(den, s), f"form, {text}", 1e-8)


# --- loose masses ----------------------------------------------------------------------------------------------------


def loose_masses(rng: Any) -> None:
    """A structure of which some masses hang on nothing: rigid modes, and responses, by all ways to make its model."""
    n, loose = int(rng.integers(2, 9)), int(rng.integers(1, 3))
    scale, weight = unit(rng), unit(rng)
    springs = rng.uniform(0.5, 3.0, n)
    K = np.zeros((n + loose, n + loose))
    K[:n, :n] = np.diag(springs) + np.diag(np.r_[springs[1:], 0.0]) - np.diag(springs[1:], 1) - np.diag(springs[1:], -1)
    floating = bool(rng.random() < 0.4)
    if floating:
        K[0, 0] -= springs[0]
    M = np.diag(rng.uniform(0.5, 2.0, n + loose))
    order = rng.permutation(n + loose)
    K, M = (part[np.ix_(order, order)] for part in (K, M))
    F = rng.standard_normal((n + loose, int(rng.integers(1, 3))))
    rigid, squares = loose + floating, eigh(K, M, eigvals_only=True)
    top = float(np.sqrt(squares[-1]))
    stiff, heavy = K * (weight * scale * scale), M * weight
    sparse = bool(rng.random() < 0.6)
    given = [scipy.sparse.csr_array(part) if sparse else part for part in (heavy, stiff)]
    ways: dict[str, dict[str, Any]] = {
        "modes": {"modes": int(rng.integers(rigid, max(rigid + 1, n + loose)))},
        "band": {"band": (0.0, 1.01 * top * scale)},
    }
    if not sparse:
        ways["dense"] = {}
    way = str(rng.choice(list(ways)))
    sys = phc.from_second_order(*given, F, **ways[way])
    text = f"{way}, {rigid} rigid of {n + loose}, sparse {sparse}, unit {scale:.1e}, masses {weight:.1e}"
    free = int(np.sum(sys.natural_frequencies <= FREE * top * scale)) if way != "dense" else int(sys.rigid_modes)
    if max(free, int(sys.rigid_modes)) != rigid:
        raise Wrong(f"{max(free, int(sys.rigid_modes))} rigid modes: {text}")
    if way == "modes":
        return
    for s in rng.uniform(0.3, 1, 2) + 1j * rng.uniform(0.1, 2, 2):
        right = s * F.T @ np.linalg.solve(s * s * M + K, F) / (scale * weight)
        hold(sys.horner(scale * s)[..., 0], right, f"response, {text}", 1e-9)


ORACLES: dict[str, Callable[[Any], None]] = {
    "critical damping": critical_damping, "long steps": long_steps, "long records": long_records,
    "energy of a push": energy_of_a_push, "other units": responses_in_other_units,
    "models in other units": models_in_other_units, "transfer functions": transfer_functions_in_other_units,
    "loose masses": loose_masses,
}  # fmt: skip
