"""The methods that `modal_peers` holds beside each other, each behind the same call.

A method is given data, the number of modes and one of its own settings (horizon, segment, polynomial order), and
returns poles and, where it has one, a whole model.  Packages that are not installed are listed by name, never an error.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd, lfilter

import ph_control as phc

Array = NDArray[np.float64]

HORIZONS = (10, 20, 40, 80)  # block rows of the subspace methods
SEGMENTS = (256, 512, 1024, 2048)  # samples of a Fourier transform
POLYNOMIALS = (20, 40, 60, 100)  # orders of the common denominator
TOP = 5000.0  # Hz that the highest frequency is scaled to, since windows of sdypy-EMA are in Hz


@dataclass(frozen=True)
class Record:
    """Inputs (m, T), outputs (p, T), step, and the quantity measured."""

    u: Array
    y: Array
    h: float = 1.0
    quantity: str = "free"


@dataclass(frozen=True)
class Responses:
    """Frequencies (K,) in rad/s, response (p, m, K), and the quantity measured."""

    omega: Array
    H: Any
    quantity: str = "free"


@dataclass(frozen=True)
class Modal:
    """Poles of positive imaginary part (n,), residues (n, p, m), feedthrough (p, m) or none."""

    poles: Any
    residues: Any
    feedthrough: Any = 0.0

    def simulate(self, u: Array, h: float) -> Array:
        """Outputs from rest under a held input."""
        y = np.zeros((self.residues.shape[1], u.shape[1])) + self.feedthrough @ u if np.ndim(self.feedthrough) else 0.0
        for pole, residue in zip(self.poles, self.residues, strict=True):
            y = y + 2 * np.real(residue @ states(pole, u, h))
        return np.asarray(y)

    def response(self, omega: Array) -> Any:
        """Frequency response (p, m, K)."""
        s = 1j * omega
        terms = 1 / (s - self.poles[:, None]), 1 / (s - self.poles.conj()[:, None])
        parts = [
            np.einsum("lom,lk->omk", r, x) for r, x in zip((self.residues, self.residues.conj()), terms, strict=True)
        ]
        return parts[0] + parts[1] + (np.asarray(self.feedthrough)[..., None] if np.ndim(self.feedthrough) else 0.0)


@dataclass(frozen=True)
class Discrete:
    """State space in discrete time."""

    A: Any
    B: Any
    C: Any
    D: Any

    def simulate(self, u: Array, h: float) -> Array:
        """Outputs from rest."""
        x, y = np.zeros(len(self.A)), np.empty((len(self.C), u.shape[1]))
        with np.errstate(over="ignore", invalid="ignore"):
            for k, now in enumerate(u.T):
                y[:, k] = self.C @ x + self.D @ now
                x = self.A @ x + self.B @ now
        return y


@dataclass(frozen=True)
class Estimate:
    """Poles of positive imaginary part, as many as the method found, and the model, if it makes one."""

    poles: Any
    model: Modal | Discrete | None = None


@dataclass(frozen=True)
class Method:
    """A named method for records or responses, its package, and its settings: all are tried, the best one counts."""

    name: str
    identify: Callable[[Any, int, Any], Estimate]
    settings: tuple[Any, ...] = (None,)
    package: str = "ph_control"
    of: tuple[type, ...] = field(default=(Record,))

    @property
    def missing(self) -> str:
        """Why it cannot run here; empty if it can."""
        return "" if importlib.util.find_spec(self.package.split(".")[0]) else "not installed"


def states(pole: complex, u: Array, h: float) -> Any:
    """Modal states (m, T) from rest under a held input."""
    z = np.exp(pole * h)
    return lfilter([0.0, (z - 1) / pole], [1.0, -z], u)


# --- ours ------------------------------------------------------------------------------------------------------------


def _pem(structure: str) -> Callable[[Any, int, None], Estimate]:
    def identify(data: Any, n: int, setting: None) -> Estimate:
        keywords: dict[str, Any] = {"structure": structure, "quantity": data.quantity}
        if isinstance(data, Record):
            u, y = (x[0] if len(x) == 1 else x for x in (data.u, data.y))
            result: Any = phc.pem((u, y), n, dt=data.h, intersample="zoh", **keywords)
        else:
            result = phc.pem(ct.frd(data.H, data.omega), n, **keywords)
        poles = np.asarray(result.poles)
        upper = poles.imag > 0
        return Estimate(poles[upper], Modal(poles[upper], np.asarray(result.residues)[upper], result.feedthrough))

    return identify


# --- state-space methods ---------------------------------------------------------------------------------------------


def _discrete(A: Any, B: Any, C: Any, D: Any, h: float) -> Estimate:
    A, B, C, D = (np.atleast_2d(np.asarray(part, float)) for part in (A, B, C, D))
    z = np.linalg.eigvals(A)
    return Estimate(np.log(z[z.imag > 0]) / h, Discrete(A, B, C, D))


def _era(data: Record, n: int, length: int) -> Estimate:
    """Markov parameters by least squares, then the eigensystem realisation of all of them."""
    markov = np.asarray(ct.markov(data.y, data.u, length))
    size = (length - 1) // 2
    system, _ = ct.eigensys_realization(markov.reshape(len(data.y), len(data.u), -1), 2 * n, m=size, n=size)
    return _discrete(system.A, system.B, system.C, system.D, data.h)


def _nfoursid(data: Record, n: int, rows: int) -> Estimate:
    import pandas as pd
    from nfoursid.nfoursid import NFourSID

    names = [f"u{k}" for k in range(len(data.u))], [f"y{k}" for k in range(len(data.y))]
    frame = pd.DataFrame(dict(zip(names[0] + names[1], [*data.u, *data.y], strict=True)))
    search = NFourSID(frame, output_columns=names[1], input_columns=names[0], num_block_rows=rows)
    search.subspace_identification()
    system, _ = search.system_identification(rank=2 * n)
    return _discrete(system.a, system.b, system.c, system.d, data.h)


def _sippy(name: str) -> Callable[[Record, int, int], Estimate]:
    def identify(data: Record, n: int, horizon: int) -> Estimate:
        from sippy_unipi import system_identification

        with contextlib.redirect_stdout(io.StringIO()):
            found = system_identification(data.y, data.u, name, SS_fixed_order=2 * n, SS_f=horizon, SS_p=horizon)
        return _discrete(found.A, found.B, found.C, found.D, data.h)

    return identify


# --- operational modal analysis --------------------------------------------------------------------------------------


def _pyoma(kind: str) -> Callable[[Record, int, Any], Estimate]:
    def identify(data: Record, n: int, setting: Any) -> Estimate:
        from pyoma2.algorithms import SSI, pLSCF
        from pyoma2.setup import SingleSetup

        logging.disable(logging.CRITICAL)
        loose = {"xi_max": 0.5, "mpc_lim": None, "mpd_lim": None, "CoV_max": None}
        try:
            with contextlib.redirect_stderr(io.StringIO()):
                if kind == "pLSCF":
                    segment, order = setting
                    algorithm = pLSCF(name="one", ordmax=order, nxseg=segment, hc=loose)
                    column = order - 1
                else:
                    given = {"U": data.u.T} if kind == "IOcov" else {}
                    options = {"method": kind, "br": setting, "ordmax": 2 * n, "step": 2 * n, "hc": loose}
                    algorithm = SSI(name="one", **options, **given)
                    column = 1
                setup = SingleSetup(data.y.T.copy(), fs=1 / data.h)
                setup.add_algorithms(algorithm)
                setup.run_all()
        finally:
            logging.disable(logging.NOTSET)
        d, zeta = (np.asarray(part)[:, column] for part in (algorithm.result.Fn_poles, algorithm.result.Xi_poles))
        d, zeta = 2 * np.pi * d[np.isfinite(d)], zeta[np.isfinite(d)]
        return Estimate(-zeta * d + 1j * d * np.sqrt(1 - zeta**2))

    return identify


# --- methods for frequency responses ---------------------------------------------------------------------------------


def estimated_response(data: Record, segment: int) -> Responses:
    """H1 estimate, Hann windows that overlap by half; the hold of the input is divided out."""
    options: dict[str, Any] = {"fs": 2 * np.pi / data.h, "nperseg": min(segment, data.u.shape[1])}
    omega, Suu = csd(data.u[:, None], data.u[None], **options)
    _, Suy = csd(data.u[:, None], data.y[None], **options)
    H = np.linalg.solve(Suu.transpose(2, 0, 1), Suy.transpose(2, 0, 1)).transpose(2, 1, 0)
    omega, H = omega[1:-1], H[..., 1:-1]
    return Responses(omega, H / ((1 - np.exp(-1j * omega * data.h)) / (1j * omega * data.h)))


def _of_responses(fit: Callable[[Responses, int, Any], Estimate]) -> Callable[[Any, int, Any], Estimate]:
    def identify(data: Any, n: int, setting: Any) -> Estimate:
        segment, own = setting
        return fit(estimated_response(data, segment) if isinstance(data, Record) else data, n, own)

    return identify


def sdypy_model(data: Responses, order: int) -> tuple[Any, float]:
    """Poles of all orders by LSCF, on a frequency axis that ends at `TOP`; and how much it was stretched."""
    from sdypy import EMA

    lines, flat = data.omega / 2 / np.pi, data.H.reshape(-1, len(data.omega))
    step = (lines[-1] - lines[0]) / (len(lines) - 1)
    # the package fills up to zero itself, but at times by a line too many
    lead = round(lines[0] / step)
    hertz = step * np.arange(lead + len(lines))
    flat = np.hstack([np.zeros((len(flat), lead)), flat])
    stretch = TOP / hertz[-1]
    options = {"lower": stretch * lines[0], "upper": TOP, "pol_order_high": order, "frf_form": "receptance"}
    model = EMA.Model(flat, stretch * hertz, **options)
    model.get_poles(show_progress=False)
    return model, stretch


def _sdypy(near: Callable[[], Array]) -> Callable[[Responses, int, int], Estimate]:
    """LSCF and LSFD; stable poles are picked next to the true frequencies, as a user with good eyes would."""

    def fit(data: Responses, n: int, order: int) -> Estimate:
        with contextlib.redirect_stderr(io.StringIO()):
            model, stretch = sdypy_model(data, order)
            model.select_closest_poles(list(stretch * near() / 2 / np.pi))
            _, A = model.get_constants(upper_r=False, lower_r=False)
        poles = np.array([model.all_poles[o][k] for o, k in model.pole_ind]) / stretch
        residues = (np.asarray(A).T / stretch).reshape(len(poles), *data.H.shape[:2])
        return Estimate(poles, Modal(poles, residues))

    return fit


def _skrf(data: Responses, n: int, spacing: tuple[str, int]) -> Estimate:
    """Vector fitting; a matrix that is not square is filled up with zeros."""
    import skrf
    from skrf.vectorFitting import VectorFitting

    ports = max(data.H.shape[:2])
    square = np.zeros((len(data.omega), ports, ports), complex)
    square[:, : data.H.shape[0], : data.H.shape[1]] = data.H.transpose(2, 0, 1)
    scale = np.abs(square).max()
    network = skrf.Network(frequency=skrf.Frequency.from_f(data.omega / 2 / np.pi, unit="hz"), s=square / scale)
    fitting = VectorFitting(network)
    fitting.vector_fit(n_poles_real=0, n_poles_cmplx=n + spacing[1], init_pole_spacing=spacing[0], enforce_dc=False)
    poles = np.asarray(fitting.poles)
    residues = scale * np.asarray(fitting.residues).reshape(ports, ports, -1).transpose(2, 0, 1)
    constant = scale * np.asarray(fitting.constant_coeff).reshape(ports, ports)
    p, m = data.H.shape[:2]
    upper = poles.imag > 0
    return Estimate(poles[upper], Modal(poles[upper], residues[upper, :p, :m], constant[:p, :m]))


def methods(near: Callable[[], Array]) -> list[Method]:
    """All methods; `near` gives the true frequencies, which only the picking of stable poles asks for."""
    spacings = tuple(product(("lin", "log"), (0, 2)))
    return [
        Method("ph_control pem, free", _pem("free"), of=(Record, Responses)),
        Method("python-control markov + ERA", _era, (50, 100, 200, 400), "control"),
        Method("nfoursid N4SID", _nfoursid, HORIZONS, "nfoursid"),
        *(Method(f"SIPPY {name}", _sippy(name), HORIZONS, "sippy_unipi") for name in ("N4SID", "MOESP", "CVA")),
        *(
            Method(f"pyOMA-2 SSI {label}", _pyoma(kind), HORIZONS, "pyoma2")
            for kind, label in (("cov", "covariance"), ("dat", "data"), ("IOcov", "input-output"))
        ),
        Method("pyOMA-2 pLSCF", _pyoma("pLSCF"), tuple(product(SEGMENTS[:3], (5, 10, 20, 30))), "pyoma2"),
        Method(
            "sdypy-EMA LSCF + LSFD", _of_responses(_sdypy(near)), tuple(product(SEGMENTS, POLYNOMIALS)), "sdypy",
            (Record,),
        ),
        Method(
            "sdypy-EMA LSCF + LSFD", _of_responses(_sdypy(near)), tuple(product((0,), POLYNOMIALS)), "sdypy",
            (Responses,),
        ),
        Method(
            "scikit-rf vector fitting", _of_responses(_skrf), tuple(product(SEGMENTS, spacings)), "skrf", (Record,)
        ),
        Method("scikit-rf vector fitting", _of_responses(_skrf), tuple(product((0,), spacings)), "skrf", (Responses,)),
    ]  # fmt: skip
