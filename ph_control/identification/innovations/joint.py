"""The data about the minimum beside noise of any kind: what poles and residues cost there, all else moving along."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..._types import Array, ComplexArray
from ..regression.free import FreeProjection, FreeRows, GivenResidues, Sensitivity
from ..regression.sections import Sections
from .estimated_noise import with_estimated_noise
from .minimum import Minimum


@dataclass(frozen=True, eq=False)
class Quadratic:
    """The likelihood about its maximum as a square `|R (theta - centre)|^2` of poles and shared unknowns.

    `centre` are imaginary and real parts of the poles, then shared unknowns by outputs; `covariance` is their
    covariance. Unknowns of each part of rows follow: `inner` is their covariance for known `theta`, `along` how they
    move with it.
    """

    centre: Array
    root: Array
    covariance: Array
    own: tuple[Array, ...]
    inner: tuple[Array, ...]
    along: tuple[Array, ...]

    @classmethod
    def of(cls, minimum: Minimum) -> Quadratic:
        """The square about a minimum."""
        evaluation = minimum.evaluation
        problem, point = evaluation.problem, evaluation.point
        sections, active = point.noise.sections, problem.active
        size, every = len(sections.x), with_estimated_noise(evaluation, evaluation.information_inverse())
        first, count = problem.numbers_before_shared(point.noise), int(active.sum())
        kept = np.append(np.arange(size), first + np.arange(count))
        poles, shared = sections.pole_slopes, point.shared
        T = np.zeros((len(poles) + shared.size, size + count))
        T[: len(poles), :size] = poles
        numbers = np.arange(shared.size).reshape(shared.shape[::-1]).T[active]
        T[len(poles) + numbers, size + np.arange(count)] = 1.0
        inner = every[np.ix_(kept, kept)]
        information = np.linalg.pinv(inner, rcond=1e-13, hermitian=True)
        values, vectors = np.linalg.eigh(0.5 * (information + information.T))
        root = (vectors * np.sqrt(np.maximum(values, 0.0))).T @ np.linalg.pinv(T)
        own, spreads, along, first = list[Array](), list[Array](), list[Array](), first + count
        for part in point.own:
            mine = np.arange(first, first + part.size)
            moved = every[np.ix_(mine, kept)] @ information
            own.append(part)
            spreads.append(every[np.ix_(mine, mine)] - moved @ every[np.ix_(kept, mine)])
            along.append(moved @ np.linalg.pinv(T))
            first += part.size
        centre = np.concatenate([sections.p.imag, sections.p.real, shared.T.ravel()])
        return cls(centre, root, T @ inner @ T.T, tuple(own), tuple(spreads), tuple(along))


class JointProjection(GivenResidues):
    """Data at some poles and shared unknowns, at the loss that these have beside noise of any kind.

    Rows have variance 1 at the minimum.  With more or fewer poles, or real ones in place of complex ones, no square
    tells the loss: then it is that of white noise, in units of the `variance` that this has at the minimum.
    """

    def __init__(
        self, projection: FreeProjection, shared: Array, quadratic: Quadratic, unknowns: int, variance: float
    ) -> None:
        super().__init__(projection, shared)
        self.quadratic, self._unknowns, self._variance = quadratic, unknowns, variance

    @classmethod
    def of(cls, projection: FreeProjection, shared: Array, quadratic: Quadratic, unknowns: int) -> JointProjection:
        """The data at the minimum."""
        variance = GivenResidues(projection, shared).loss / projection.rows
        return cls(projection, shared, quadratic, unknowns, variance)

    @property
    def unknowns(self) -> int:
        """Number of real unknowns, those of the noise among them."""
        return self._unknowns

    def given(
        self, p: ComplexArray, shared: Array, sections: Sections | None = None,
        experiments: Sequence[FreeRows] | None = None,
    ) -> GivenResidues:  # fmt: skip
        """The same data at other poles and shared unknowns."""
        free = FreeProjection(self.experiments if experiments is None else experiments, p, self.fed, sections)
        return JointProjection(free, shared, self.quadratic, self._unknowns, self._variance)

    @cached_property
    def _moved(self) -> Array | None:
        """How far poles and shared unknowns are from the minimum; None where the poles are of other kinds."""
        moved = np.concatenate([self.p.imag, self.p.real, self.shared.T.ravel()])
        n, known = len(self.p), len(self.quadratic.centre) - self.shared.size
        alike = 2 * n == known and np.array_equal(self.quadratic.centre[:n] != 0, self.p.imag != 0)
        return moved - self.quadratic.centre if alike else None

    @cached_property
    def loss(self) -> float:
        """What is left at the minimum, of variance 1, and what the distance from it costs."""
        if self._moved is None:
            return super().loss / self._variance
        return float(self.rows + np.sum((self.quadratic.root @ self._moved) ** 2))

    def sensitivities(self) -> Iterator[Sensitivity]:
        """All outputs, what the distance leaves, and its derivatives by poles and shared unknowns."""
        if self._moved is None:
            unit = np.sqrt(self._variance)
            for outputs, residual, by_poles, by_shared in super().sensitivities():
                yield outputs, residual / unit, by_poles / unit, by_shared / unit
            return
        root, n = self.quadratic.root, len(self.p)
        yield list(range(self.shared.shape[1])), root @ self._moved, root[:, : 2 * n], root[:, 2 * n :]

    def covariance(self, variance: float) -> Array:
        """Covariance of imaginary and real parts of the poles, then `shared` by outputs."""
        return variance * self.quadratic.covariance

    @cached_property
    def own(self) -> list[Array]:
        """What belongs to each experiment, shape (unknowns, its outputs)."""
        if self._moved is None:
            return super().own
        pairs = zip(self.quadratic.own, self.quadratic.along, strict=True)
        moved = self._moved
        return [mine + (along @ moved).reshape(mine.shape) for mine, along in pairs]

    def own_covariances(self, experiment: int, covariance: Array, variance: float) -> list[tuple[Array, Array]]:
        """Covariances of what belongs to an experiment, for each output, and with the poles and what `shared` has."""
        mine, rows = self.quadratic.own[experiment], self.experiments[experiment]
        n, width, pairs = len(self.p), len(self.shared), []
        for k, output in enumerate(rows.outputs.tolist()):
            these = np.arange(len(mine)) * mine.shape[1] + k
            along = self.quadratic.along[experiment][these]
            places = np.append(np.arange(2 * n), 2 * n + output * width + np.arange(width)).astype(int)
            crossed = along @ covariance
            spread = variance * self.quadratic.inner[experiment][np.ix_(these, these)] + crossed @ along.T
            pairs.append((spread, crossed[:, places]))
        return pairs
