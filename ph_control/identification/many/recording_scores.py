"""Scores of many recordings against one reference: tests of its poles, or differences of fitted ones."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..._types import Array, Indices
from ..._units import hertz_size
from ...exceptions import StructureError
from ..change.score import Score, known_parameters, root_of_covariance
from ..change.score_test import ChangeTest
from .control_chart import ControlChart, chart_of
from .recordings import Modes


def chart_of_recordings(fits: Any, false_alarms: float, shift: float) -> ControlChart:
    """Control chart of the recordings of a table."""
    recordings: tuple[Modes, ...] = fits.recordings
    names = [modes.name for modes in recordings]
    tests = [modes.score for modes in recordings if isinstance(modes.score, ChangeTest)]
    scores: list[Score | str]
    if tests:
        hertz = np.array(tests[0].hertz)
        scores = [_of_test(modes.score) if isinstance(modes.score, ChangeTest) else modes.score for modes in recordings]
    else:
        hertz, scores = _of_fits(fits, recordings)
    if not any(isinstance(score, Score) for score in scores):
        reasons = "; ".join(dict.fromkeys(map(str, scores))) or "there are none"
        raise StructureError(f"no recording can be held against a reference: {reasons}")
    return chart_of(scores, names, hertz, fits.frequency_unit, false_alarms, shift)


def _of_test(test: ChangeTest) -> Score:
    n, count = len(test.natural_frequencies), len(test.pole_directions) // 2
    places = np.concatenate([np.arange(n), count + np.arange(n)])
    directions = test.pole_directions[places].copy()
    directions[:n] /= hertz_size(test.time_unit)
    return Score(test.score, test.information, directions)


def _of_fits(fits: Any, recordings: tuple[Modes, ...]) -> tuple[Array, list[Score | str]]:
    """Frequencies of the first recording with modes, and differences of fitted poles from its own."""
    fitted = [place for place, modes in enumerate(recordings) if modes.order > 0]
    if not fitted:
        return np.zeros(0), [modes.message for modes in recordings]
    first = recordings[fitted[0]]
    root, known = _root(first.covariance)
    ids, table = fits.track(shortest=1).ids, fits.table
    rows = [ids[table["recording"] == number] for number in np.unique(table["recording"])]
    scores: list[Score | str] = []
    for place, modes in enumerate(recordings):
        if place == fitted[0]:
            scores.append("it is the reference")
        elif modes.order <= 0:
            scores.append(modes.message)
        else:
            scores.append(_difference(first, modes, _partners(rows[fitted[0]], rows[place]), root, known))
    return first.numbers[:, 0], scores


def _partners(reference: Indices, recording: Indices) -> list[tuple[int, int]]:
    """Modes of the reference and of a recording that are the same."""
    return [(k, int(np.flatnonzero(recording == mode)[0])) for k, mode in enumerate(reference) if mode in recording]


def _difference(
    reference: Modes, modes: Modes, partners: list[tuple[int, int]], root: Array, known: Indices
) -> Score | str:  # fmt: skip
    """Score of the poles of a fit at those of the reference, in units of the errors of these."""
    n, other = reference.order, modes.order
    places = np.array([(k + part * n, l + part * other) for part in (0, 1) for k, l in partners], int).reshape(-1, 2)
    usable = np.isin(places[:, 0], known) & (np.diag(modes.covariance)[places[:, 1]] > 0)
    places = places[usable]
    if not len(places):
        return "it has no mode of the reference"
    change = modes.numbers[:, ::2].T.ravel()[places[:, 1]] - reference.numbers[:, ::2].T.ravel()[places[:, 0]]
    covariance = modes.covariance[np.ix_(places[:, 1], places[:, 1])]
    sizes = np.sqrt(np.diag(covariance))
    inverse = np.linalg.pinv(covariance / np.outer(sizes, sizes), hermitian=True) / np.outer(sizes, sizes)
    own = root[places[:, 0]]
    return Score(own.T @ (inverse @ change), own.T @ inverse @ own, root)


def _root(covariance: Array) -> tuple[Array, Indices]:
    """Square root (2n, q) of the covariance of the reference, 0 where nothing is known, and what is known."""
    known = known_parameters(covariance)
    if not len(known):
        raise StructureError("the first recording has no errors of its modes, and cannot be a reference: pass one")
    inner = root_of_covariance(covariance, known)
    root = np.zeros((len(covariance), inner.shape[1]))
    root[known] = inner
    return root, known
