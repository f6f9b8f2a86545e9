"""The search for damped modes with residues of any phase.

The same path as for lossless modes, one joining at a time where it explains most of what is left.  Around the bins of
what is left of a transform, `z E = lambda E + beta U + gamma z` is a linear problem in the pole `lambda` as well; as
peaks may be much wider than a bin, it is solved over windows of several widths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..._types import Array, ComplexArray, Indices
from ...modal.discretization import Hold
from ..regression.free import FreeProjection, PoleRegion
from ..regression.frequency_rows import FreeResponse, FrequencyRows
from ..regression.modal_regressors import SampledModes
from ..regression.spectral_rows import FreeWindow, Spectrum
from ..regression.time_rows import FreeRecord, FreeRows, RecordRows
from ..regression.tuning import TUNING
from ..regression.variable_projection import Problem
from .response_candidates import ranked_candidates
from .screening import highest_peaks

_ROUNDS = 3  # of the local problem, weighted with the pole found
_EVERYWHERE = 1 << 12  # bins up to which all are centres of windows; above, those where most is left
_PEAKS = 200
_COMPARED = 16


class _DampedData:
    """Experiments of a problem, and where damped modes are looked for in them."""

    windowed = False  # whether `rows` are a part of all

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.region = PoleRegion(problem.bin, problem.ceiling)


class Records(_DampedData):
    """Records in time."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self.experiments = experiments = [one for one in problem.experiments if isinstance(one, RecordRows)]
        self.spectra = [Spectrum.of(one) for one in experiments]
        self.windowed = max(len(one.u) for one in experiments) > TUNING.in_time and all(
            one.complete and not one.from_rest and one.offset < 2 for one in experiments
        )
        self._in_time = [FreeRecord.of(one) for one in experiments]

    def rows(self, p: ComplexArray) -> Sequence[FreeRows]:
        """The bins about the modes of long records."""
        return [FreeWindow.thinned(one, p) for one in self.spectra] if self.windowed else self._in_time

    def all_rows(self, through: bool) -> Sequence[FreeRows]:
        """All observed samples."""
        return [FreeRecord.of(one, through) for one in self.experiments]

    def left(self, at: FreeProjection) -> list[ComplexArray]:
        """Transforms of what a model leaves; 0 where an output is missing, or an offset explains it."""
        residues = at.residues[:, 0] if at.inputs else np.zeros((len(at.p), 1), complex)
        if not len(at.p):
            left = [one.Y.copy() for one in self.spectra]
        elif isinstance(at.experiments[0], FreeWindow):
            left = [
                one.left(
                    SampledModes.of(one.experiment.hold, at.p), residues[:, 0], own[:, 0],
                    float(at.feedthrough[0, 0]) if at.has_feedthrough else 0.0,
                )
                for one, own in zip(self.spectra, at.own, strict=True)
            ]  # fmt: skip
        else:
            pairs = zip(self.experiments, at.predicted(), strict=True)
            left = [np.fft.rfft(np.where(one.observed, one.y - predicted, 0.0)) for one, predicted in pairs]
        return [spectrum.beside_offset(each) for spectrum, each in zip(self.spectra, left, strict=True)]

    def loss(self, left: Sequence[ComplexArray]) -> float:
        """Sum of squares over the observed samples."""
        return float(sum(spectrum.energy(one) for one, spectrum in zip(left, self.spectra, strict=True)))

    def candidates(self, left: Sequence[ComplexArray]) -> tuple[ComplexArray, Array]:
        """Of windows of all widths, the poles that explain most."""
        found = [Channels.of(spectrum).modes(one[None]) for spectrum, one in zip(self.spectra, left, strict=True)]
        p, gain = (np.concatenate(parts) for parts in zip(*found, strict=True))
        width = min(one.bin for one in self.experiments)
        chosen: list[int] = []
        for k in np.argsort(-gain, kind="stable"):
            apart = width + np.abs(p[k].real)
            if all(abs(p[k].imag - p[other].imag) > apart + abs(p[other].real) for other in chosen):
                chosen.append(int(k))
            if len(chosen) == _COMPARED:
                break
        return p[chosen], gain[chosen]


@dataclass(frozen=True)
class Channels:
    """Transforms of the inputs (m, K) of a record of some length, and where modes are looked for in its outputs."""

    U: ComplexArray
    length: int
    hold: Hold
    ceiling: float

    @classmethod
    def of(cls, spectrum: Spectrum) -> Channels:
        """Those of a record of one input."""
        one = spectrum.experiment
        return cls(spectrum.U[None][: int(one.driven)], spectrum.length, one.hold, one.ceiling)

    def modes(self, left: ComplexArray) -> tuple[ComplexArray, Array]:
        """Poles of modes that explain something of what is left of outputs (q, K), and how much; O(q T).

        Each within a window, in windows of several widths everywhere.
        """
        found = [(np.zeros(0, complex), np.zeros(0))]
        for half in TUNING.widths_of_peaks:
            if 4 * half > self._last and half > TUNING.widths_of_peaks[0]:
                break
            half = min(half, (self._last - 1) // 2)
            if half < 3:
                break
            centres = np.arange(half + 1, self._last - half + 1, max(1, half // 6))
            if self._last > _EVERYWHERE:
                centres = _peaking(left, half, centres)
            size = max(1, TUNING.piece // (len(left) * (2 * half + 1)))
            found += [self._local(left, half, centres[k : k + size]) for k in range(0, len(centres), size)]
        p, gain = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return p, gain

    def peak(self, left: ComplexArray, place: float) -> tuple[float, float]:
        """Half-width of one mode within the narrowest window about a place (in bins), and its share of the power."""
        half = min(TUNING.widths_of_peaks[0], (self._last - 1) // 2)
        if half < 3:
            return 0.0, 0.0
        centre = int(np.clip(np.rint(place), half + 1, self._last - half))
        p, gain = self._local(left, half, np.array([centre]))
        power = 2.0 / self.length * float(np.sum(np.abs(left[:, centre - half : centre + half + 1]) ** 2))
        return (float(-p[0].real), float(gain[0]) / power) if len(p) and power else (0.0, 0.0)

    @property
    def _last(self) -> int:
        """Last bin below the Nyquist frequency."""
        return (self.length - 1) // 2

    def _local(self, left: ComplexArray, half: int, centres: Indices) -> tuple[ComplexArray, Array]:
        """One mode in each window, frequencies in bins from its centre: `(s - pole) E = sum beta U + gamma z`.

        The pole is that of all outputs: what inputs and ends explain of `E` and of `s E` is taken out of both.
        """
        T = self.length
        turn = np.expm1(2j * np.pi / T * np.arange(-half, half + 1))
        s = turn * (T / (2 * np.pi))
        place = centres[:, None] + np.arange(-half, half + 1)
        E, U = (np.ascontiguousarray(np.moveaxis(rows[:, place], 0, 1)) for rows in (left, self.U))
        # a smooth input is told from the ends by what it is beside a constant
        size = np.linalg.norm(U, axis=2, keepdims=True)
        ends = np.broadcast_to(1.0 + turn, (len(place), 1, len(s)))
        inputs = np.concatenate([ends, U / np.where(size > 0, size, 1.0)], axis=1)
        weight = np.ones((len(place), 1, len(s)), complex)
        for _ in range(_ROUNDS):
            shown = E * weight
            power = np.sum(np.abs(shown) ** 2, axis=1)
            energy, cross = power.sum(axis=1), power @ s
            products, solved = _least_squares(inputs * weight, np.concatenate([shown, s * shown], axis=1))
            taken = products[:, :, : len(left)].conj()
            energy = energy - np.sum(taken * solved[:, :, : len(left)], axis=(1, 2)).real
            cross = cross - np.sum(taken * solved[:, :, len(left) :], axis=(1, 2))
            pole = cross / np.where(energy > 0, energy, 1.0)
            width = np.clip(np.abs(pole.real), TUNING.narrowest, 2.0 * half)
            pole = -width + 1j * np.clip(pole.imag, -half, half)
            weight = 1.0 / (s - pole[:, None, None])
        products, solved = _least_squares(inputs * weight, E)
        gain = np.sum(products.conj() * solved, axis=(1, 2)).real
        p = self.hold.pole(np.exp(2j * np.pi / T * centres) * (1.0 + pole * (2 * np.pi / T)))
        kept = (np.abs(pole.imag) < half) & (p.imag > 0) & (p.imag < self.ceiling)
        return p[kept], gain[kept] * (2.0 / T)


def _peaking(left: ComplexArray, half: int, centres: Indices) -> Indices:
    """Centres about which most is left."""
    width = max(1, half // 3)
    total = np.concatenate([[0.0], np.cumsum(np.sum(np.abs(left) ** 2, axis=0))])
    power = total[centres + width] - total[centres - width]
    about = highest_peaks(power, _PEAKS)[:, None] + np.arange(-1, 2)
    return centres[np.unique(np.clip(about, 0, len(centres) - 1))]


def _least_squares(columns: ComplexArray, targets: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Products of columns (windows, k, rows) with targets (windows, q, rows), and coefficients, (windows, k, q)."""
    conjugate = columns.conj()
    gram = conjugate @ columns.transpose(0, 2, 1)
    ridge = TUNING.ridge * np.trace(gram, axis1=1, axis2=2).real
    gram += np.where(ridge > 0, ridge, 1.0)[:, None, None] * np.eye(columns.shape[1])
    products = conjugate @ targets.transpose(0, 2, 1)
    return products, np.linalg.solve(gram, products)


class Responses(_DampedData):
    """Frequency responses."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self.experiments = [one for one in problem.experiments if isinstance(one, FrequencyRows)]
        self._responses = [FreeResponse(one) for one in self.experiments]

    def rows(self, p: ComplexArray) -> Sequence[FreeRows]:
        """All points."""
        return self._responses

    def all_rows(self, through: bool) -> Sequence[FreeResponse]:
        """All points."""
        return self._responses

    def left(self, at: FreeProjection) -> list[ComplexArray]:
        """What a model leaves, in the scale of the weights."""
        return [
            rows.target - np.concatenate([own, at.shared])[:, 0] @ rows.columns(at.p)
            for rows, own in zip(self._responses, at.own, strict=True)
        ]

    def loss(self, left: Sequence[ComplexArray]) -> float:
        """Weighted sum of squares."""
        return float(sum(np.sum(np.abs(one) ** 2) for one in left))

    def candidates(self, left: Sequence[ComplexArray]) -> tuple[ComplexArray, Array]:
        """Candidates between the points."""
        d, gain = ranked_candidates(self.experiments, left)
        return np.asarray(np.nan + 1j * d, complex), gain


FreeSearch = Records | Responses


def free_search(problem: Problem) -> FreeSearch:
    """Where damped modes are looked for in the data of a problem."""
    in_time = any(isinstance(one, RecordRows) for one in problem.experiments)
    return Records(problem) if in_time else Responses(problem)
