"""Set-ups of different sensors under forces that nobody measured, with some sensors that stay where they are.

    y_s = C_s x_s + e_s,    x_s' = A x_s + K_s e_s        for each set-up s, with its rows C_s of what all sensors see

Poles and shapes are common; forces and noise of a set-up are its own, and so are its gain and its innovations.  The
sensors that stay tie the sizes and the signs of the shapes together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..._types import Array, ComplexArray, Indices
from .minimum import InnovationsModel, LikelihoodEvaluation, Problem
from .noise_sections import NoiseSections


@dataclass(frozen=True, eq=False)
class SetUp:
    """Experiments `members` that show the same `outputs`, with the problem that they make by themselves.

    `gains` are the columns of their innovations among those of all set-ups.
    """

    outputs: Indices
    members: Indices
    gains: Indices
    problem: Problem


class SetUpsProblem(Problem):
    """Prediction errors of set-ups, of poles and shapes that are common, and a gain and a covariance of each.

    A model has `C` (p, N) of all outputs, and `K` (N, P) with the columns of one set-up after the other.
    """

    def __init__(self, problem: Problem, shown: Sequence[Indices]) -> None:
        """Experiments of a problem, each with some of its outputs: `shown` of each."""
        super().__init__(
            problem.experiments, problem.active, problem.coloured, problem.fed, real_shapes=problem.real_shapes
        )
        self.shown = tuple(shown)
        members = dict[tuple[int, ...], list[int]]()
        for place, outputs in enumerate(shown):
            members.setdefault(tuple(outputs.tolist()), []).append(place)
        ends = np.cumsum([0, *map(len, members)]).tolist()
        self.set_ups = [
            SetUp(np.array(outputs), np.array(places), np.arange(first, first + len(outputs)), Problem(
                [problem.experiments[place] for place in places], np.zeros((0, len(outputs)), bool),
                real_shapes=problem.real_shapes,
            ))
            for (outputs, places), first in zip(members.items(), ends, strict=False)
        ]  # fmt: skip

    @property
    def innovations(self) -> int:
        """Number P of innovations of all set-ups."""
        return sum(len(each.outputs) for each in self.set_ups)

    def with_real_shapes(self) -> SetUpsProblem:
        """The same data for outputs that see the first state of each mode alone."""
        return SetUpsProblem(super().with_real_shapes(), self.shown)

    def thinned(self, most: int) -> SetUpsProblem:
        """The same with so many bins of each experiment at most, about."""
        return SetUpsProblem(super().thinned(most), self.shown)

    def models(self, point: InnovationsModel) -> list[InnovationsModel]:
        """The model of each set-up."""
        noise = point.noise
        return [
            replace(
                point, noise=noise.moved(noise.sections, noise.C[each.outputs], noise.K[:, each.gains]),
                states=tuple(point.states[place] for place in each.members), shared=point.shared[:, each.outputs],
            )
            for each in self.set_ups
        ]  # fmt: skip

    def evaluated(self, point: InnovationsModel) -> SetUpsEvaluation:
        """The prediction errors of a model."""
        return SetUpsEvaluation(self, point)

    def that_forgets(self, point: InnovationsModel, like: LikelihoodEvaluation) -> InnovationsModel:
        """The model of the same spectra whose predictors forget, with the covariances of an evaluation."""
        K = point.noise.K.copy()
        for (each, model), (_, _, known) in zip(
            zip(self.set_ups, self.models(point), strict=True), like.by_set_up, strict=True
        ):
            K[:, each.gains] = model.noise.that_forgets(known.covariance).K
        return replace(point, noise=point.noise.moved(point.noise.sections, point.noise.C, K))

    def numbers_of(self, point: InnovationsModel) -> list[Indices]:
        """Places of the numbers of each set-up among all."""
        noise = point.noise
        (p, N), P, first = noise.C.shape, self.innovations, len(noise.x)
        states = np.arange(N)
        return [
            np.concatenate([
                np.arange(first), first + (each.outputs[:, None] * N + states).ravel(),
                first + p * N + (states[:, None] * P + each.gains).ravel(),
                first + (p + P) * N + (each.members[:, None] * N + states).ravel(),
            ])
            for each in self.set_ups
        ]  # fmt: skip

    def extended(self, noise: NoiseSections, references: Indices) -> InnovationsModel:
        """A model to begin with, of one of the outputs that all set-ups show: what others see of its states.

        Their own innovations move no state yet.
        """
        N, p = noise.states, len(self.active.T)
        C, K = np.zeros((p, N)), np.zeros((N, self.innovations))
        grams, products = np.zeros((p, N, N)), np.zeros((p, N))
        for each in self.set_ups:
            known = np.searchsorted(each.outputs, references)
            K[:, each.gains[known]] = noise.K
            for experiment in each.problem.experiments:
                errors = noise.errors(experiment.z, experiment.Y[known])
                states: ComplexArray = noise.resolve(experiment.z, np.asarray(noise.K @ errors, complex))
                counted = (states * experiment.counts).conj()
                grams[each.outputs] += (states @ counted.T).real
                products[each.outputs] += (experiment.Y @ counted.T).real
        for output in range(p):
            C[output] = np.linalg.lstsq(grams[output], products[output], rcond=None)[0]
        C[references] = noise.C
        starts = tuple(np.zeros(N) for _ in self.experiments)
        return InnovationsModel(noise.moved(noise.sections, C, K), np.zeros((0, p)), (), starts)


class SetUpsEvaluation(LikelihoodEvaluation):
    """The prediction errors of set-ups, and how they depend on the numbers of a model."""

    problem: SetUpsProblem

    @cached_property
    def by_set_up(self) -> list[tuple[Indices, Indices, LikelihoodEvaluation]]:
        """Outputs, experiments and evaluation of each set-up."""
        models = zip(self.problem.set_ups, self.problem.models(self.point), strict=True)
        return [(each.outputs, each.members, each.problem.evaluated(model)) for each, model in models]

    @cached_property
    def errors(self) -> list[ComplexArray]:
        """Prediction errors of each experiment, of the outputs that it shows."""
        errors = dict[int, ComplexArray]()
        for _, members, evaluation in self.by_set_up:
            errors |= dict(zip(members.tolist(), evaluation.errors, strict=True))
        return [errors[place] for place in range(len(errors))]

    @property
    def values(self) -> int:
        """Number of samples of all outputs that were measured."""
        return sum(evaluation.values for _, _, evaluation in self.by_set_up)

    @property
    def unknowns(self) -> int:
        """Numbers that move, less those of bases, and of the covariances."""
        own = sum(len(outputs) * (len(outputs) + 1) // 2 for outputs, _, _ in self.by_set_up)
        return len(self.problem.vector(self.point)) - self.bases.shape[1] + own

    @cached_property
    def cost(self) -> float:
        """Twice the negative logarithm of the likelihood; infinite where there is none."""
        return sum(evaluation.cost for _, _, evaluation in self.by_set_up)

    @cached_property
    def normal(self) -> tuple[Array, Array]:
        """Gram matrix of the Jacobian of errors of covariance 1, and half the gradient."""
        size = len(self.problem.vector(self.point))
        gram, gradient = np.zeros((size, size)), np.zeros(size)
        for numbers, (_, _, evaluation) in zip(self.problem.numbers_of(self.point), self.by_set_up, strict=True):
            gram[np.ix_(numbers, numbers)] += evaluation.normal[0]
            gradient[numbers] += evaluation.normal[1]
        gradient[self._held], gram[self._held], gram[:, self._held] = 0.0, 0.0, 0.0
        return gram, gradient
