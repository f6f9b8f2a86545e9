"""Mode shapes of a fit with their standard errors: of residues, or of a free motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..._types import Array, ComplexArray
from ..regression.free_prediction import FittedChannels, natural_jacobian
from .fitted_structure import FittedStructure
from .scaled_shapes import ModeShapes, shape_errors


def fitted_shapes(
    structure: FittedStructure, covariance: Array, experiments: Sequence[FittedChannels]
) -> tuple[ModeShapes, ComplexArray]:
    """Shapes with their standard errors: of residues, or of a free motion."""
    request, poles, residues = structure.request, structure.poles, structure.residues
    n, (_, p, m) = int(np.sum(poles.imag != 0)), residues.shape
    count, size = len(poles), residues.size
    poles, residues = poles[:n], residues[:n]
    # a port that was not named holds only where the structure does
    ports = () if request.assumed and structure.fit.structure == "free" else request.ports
    if m:
        shapes = ModeShapes.of(poles, residues, request.quantities, ports)
        entries = np.arange(n * p * m).reshape(n, p * m)
        places = [[l, count + l, *(2 * count + entries[l]), *(2 * count + size + entries[l])] for l in range(n)]
        blocks = [np.nan_to_num(covariance[np.ix_(indices, indices)]) for indices in places]
        return shapes, shape_errors(poles, residues, request.quantities, ports, blocks)
    motions = np.stack([experiment.free_amplitudes[:n] for experiment in experiments], axis=2)
    shapes = ModeShapes.of(poles, motions, request.quantities, ())
    shapes = ModeShapes(shapes.shapes, np.zeros((n, 0), complex), shapes.scaled)
    return shapes, shape_errors(poles, motions, request.quantities, (), _motion_covariances(structure)[:n])


def _motion_covariances(structure: FittedStructure) -> list[Array]:
    """Covariance of `(d, zeta, Re, Im of the free motions)` of each mode, outputs by experiments, of a free motion."""
    projection, fit, free = structure.measured, structure.fit, structure.free
    n, count, runs = len(fit.p), len(free.scales), len(free.channels)
    J, inner = natural_jacobian(fit.p), fit.covariance[: 2 * n, : 2 * n]
    measured = np.cumsum([int(data.observed.any(axis=-1).sum()) for data in free.channels])
    size, done = count * runs, 0
    covariances = [np.zeros((2 + 2 * size, 2 + 2 * size)) for _ in range(n)]
    for l, total in enumerate(covariances):
        total[:2, :2] = J[[l, n + l]] @ inner @ J[[l, n + l]].T
    for k, rows in enumerate(projection.experiments):
        place = int(np.searchsorted(measured, done, side="right"))
        done += len(rows.outputs)
        for output, (spread, with_poles) in zip(rows.outputs.tolist(), structure.own_spreads(k), strict=True):
            scale = 2 * free.scales[output] * getattr(rows, "unit", 1.0)
            for l, total in enumerate(covariances):
                both = [2 + output * runs + place, 2 + size + output * runs + place]
                total[np.ix_(both, both)] = scale**2 * spread[np.ix_([l, n + l], [l, n + l])]
                total[np.ix_(both, [0, 1])] = scale * with_poles[[l, n + l], : 2 * n] @ J[[l, n + l]].T
                total[np.ix_([0, 1], both)] = total[np.ix_(both, [0, 1])].T
    return [covariances[l] for l in structure.rank.tolist()]
