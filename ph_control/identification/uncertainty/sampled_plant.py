"""A plant in continuous time at the samples of a record: held or linear inputs, and outputs that come later."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..._types import Array, Indices
from ...exceptions import StructureError
from ...modal.discretization import Hold
from ..regression.time_rows import WHOLE


@dataclass(frozen=True)
class SampledPlant:
    """`x[k+1] = A x[k] + B u[k]`, `y[k] = C x[k] + D u[k]`: the plant, then registers of inputs of earlier samples.

    Outputs of different delays have a plant of their own each, one after the other: `plants` of `order` states.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    order: int
    plants: int


def sampled_plant(A: Array, B: Array, C: Array, D: Array, hold: Hold, delay: Array) -> SampledPlant:
    """Sample `x' = A x + B u`, `y(t) = (C x + D u)(t - delay)` with a delay (p,) of each output, exactly.

    An input that is held, or linear between samples, and late by `(k + f) h` is two or three of its samples.
    """
    (n, m), p = B.shape, len(C)
    late = np.unique(delay)
    taps = [_Taps.of(A, B, hold, float(each), bool(D[delay == each].any())) for each in late]
    longest = max(max(each.last for each in taps), 0)
    count = len(late) * n
    whole_A = np.zeros((count + longest * m,) * 2)
    whole_B, whole_C, through = np.zeros((len(whole_A), m)), np.zeros((p, len(whole_A))), np.zeros((p, m))
    for g, (each, part) in enumerate(zip(late, taps, strict=True)):
        rows, own = np.flatnonzero(delay == each), slice(g * n, (g + 1) * n)
        step = part.step
        # what an input does to the state at its own sample is no part of the state
        at_once = part.driven.get(-1, np.zeros((n, m)))
        whole_A[own, own], whole_C[rows, own] = step, C[rows]
        whole_B[own] = step @ at_once + part.driven.get(0, np.zeros((n, m)))
        through[rows] = C[rows] @ at_once + part.direct.get(0, 0.0) * D[rows]
        for k in range(1, longest + 1):
            register = slice(count + (k - 1) * m, count + k * m)
            whole_A[own, register] = part.driven.get(k, 0.0)
            whole_C[rows, register] = part.direct.get(k, 0.0) * D[rows]
    if longest:
        whole_B[count : count + m] = np.eye(m)
        earlier = count + np.arange((longest - 1) * m)
        whole_A[earlier + m, earlier] = 1.0
    return SampledPlant(whole_A, whole_B, whole_C, through, n, len(late))


@dataclass(frozen=True)
class _Taps:
    """What the inputs k samples before do in a step: to the states (n, m), `driven[k]`, and to outputs, `direct[k]`."""

    step: Array
    driven: dict[int, Array]
    direct: dict[int, float]

    @property
    def last(self) -> int:
        """The earliest sample that counts, as a number of samples before."""
        return max([*self.driven, *self.direct], default=0)

    @classmethod
    def of(cls, A: Array, B: Array, hold: Hold, delay: float, fed: bool) -> _Taps:
        samples = delay / hold.h
        whole = int(np.ceil(samples - WHOLE))
        # of the step after the sample `whole` before
        part = whole - samples if whole - samples > WHOLE else 0.0
        if part and hold.method != "exact":
            raise StructureError(
                f"a delay of {delay:.6g} is no whole number of steps of {hold.h:.6g}, and method={hold.method!r} says "
                "nothing of what is between samples"
            )
        linear = hold.intersample == "foh"
        full = hold.step_of_matrices(A, B)
        step = full.F + full.rest
        if not part:
            driven = {whole: full.held - full.risen, whole - 1: full.risen}
        else:
            before, after = (replace(hold, h=share * hold.h).step_of_matrices(A, B) for share in (1 - part, part))
            carried = after.F + after.rest
            first, last = carried @ (before.held - before.risen), carried @ before.risen
            second, ahead = after.held - after.risen, after.risen
            # from the input at the beginning to that at the sample, and from there to that at the end
            driven = {
                whole: (1 - part * linear) * first,
                whole - 1: part * linear * first + last + second + (1 - part) * linear * ahead,
                whole - 2: part * linear * ahead,
            }
        direct = {whole: 1 - part * linear, whole - 1: part * linear} if fed else {}
        used = {k: matrix for k, matrix in driven.items() if matrix.any()}
        taps = cls(step, used, {k: share for k, share in direct.items() if share})
        if min(taps.driven, default=0) < -1 or min(taps.direct, default=0) < 0:
            raise StructureError(
                f"an output comes {-delay:.6g} before the response to the inputs, which at a step of {hold.h:.6g} and "
                f"intersample={hold.intersample!r} depends on inputs that are not known yet: shift the inputs of the "
                "record"
            )
        return taps


def connected(A: Array) -> Indices:
    """Number of the part (n,) that each state belongs to, where parts do not act on one another."""
    from scipy.sparse.csgraph import connected_components

    return np.asarray(connected_components(A != 0, directed=False)[1])
