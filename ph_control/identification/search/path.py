"""From nothing to a minimum of the loss: modes added in turn, doubtful ones seated anew, other paths tried."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

from ..._frozen import Frozen
from ..._types import Array
from ..._workers import mapped
from ..regression.tuning import TUNING
from .steps import Report, Search, Step


@dataclass(frozen=True)
class Start(Frozen):
    """One of the ways in which a minimum was looked for.

    Attributes
    ----------
    kind : str
        'guess', 'forward', 're-seated', 'pruned' or 'random'.
    loss : float
        Mean squared residual it ended with.
    d : ndarray
        Natural frequencies, ascending, rad per unit time.
    """

    kind: str
    loss: float
    d: Array


def grow(
    search: Search,
    step: Step,
    largest: int,
    *,
    rtol: float,
    floor: float,
    together: bool = False,
    stop: Callable[[list[Step]], bool] | None = None,
    pick: Callable[[Step], int] | None = None,
    report: Callable[[int], Report | None] = lambda order: None,
) -> list[Step]:
    """Add modes until there are `largest`, the loss is at its floor, or `stop` says so; all steps from the first on."""
    path = [step]
    while len(step.d) < largest and step.loss > floor and len(step.candidates):
        if pick is not None:
            fresh = step.candidates[[pick(step)]]
        else:
            fresh = _batch(search, step, largest - len(step.d)) if together else step.candidates[:1]
        step = search.step(np.concatenate([step.d, fresh]), rtol, report(len(step.d) + len(fresh)))
        path.append(step)
        if stop is not None and stop(path):
            break
    return path


def _batch(search: Search, step: Step, most: int) -> Array:
    """Candidates that may join at once: nearly as strong as the strongest, and far from one another."""
    chosen: list[float] = []
    for d, gain in zip(step.candidates.tolist(), step.gains.tolist(), strict=True):
        if len(chosen) == most or gain < TUNING.nearly_as_strong * step.gains[0]:
            break
        if all(abs(d - other) >= TUNING.together_apart * search.problem.bin for other in chosen):
            chosen.append(d)
    return np.array(chosen)


def stop_of(criterion: Callable[[Step], float]) -> Callable[[list[Step]], bool]:
    """End of a path whose criterion has not improved for some orders, where it can judge them."""
    criterion = cache(criterion)

    def stop(path: list[Step]) -> bool:
        values = [criterion(step) for step in path]
        return not path[-1].coloured and len(path) - 1 - int(np.argmin(values)) >= TUNING.patience

    return stop


def reseat(
    search: Search,
    step: Step,
    rtol: float,
    floor: float,
    report: Callable[[int], Report | None] = lambda order: None,
) -> Step:
    """Move modes one by one to where they explain more, if there is such a place.

    A mode taken early, when others were still missing, may have ended in a wrong basin.
    """
    tried: set[float] = set()
    if 2 * step.held.sum() >= max(len(step.d), 2 * TUNING.hopeless):
        return step
    while step.loss > floor and (step.held.any() or search.unconvinced(step)):
        places = [k for k in np.argsort(step.weights, kind="stable") if float(step.d[k]) not in tried]
        if not places:
            break
        tried.add(float(step.d[places[0]]))
        trial = _moved(search, step, places[0], rtol, report)
        if trial is None:
            break
        if trial.loss < (1 - TUNING.better) * step.loss:
            step, tried = replace(trial, iterations=step.iterations + trial.iterations), set()
    return step


def _moved(search: Search, step: Step, place: int, rtol: float, report: Callable[[int], Report | None]) -> Step | None:
    """The step with one mode where it explains most beside the others; None if there is no such place."""
    others = search.step(np.delete(step.d, place), rtol, report(len(step.d) - 1))
    if not len(others.candidates):
        return None
    return search.step(np.append(others.d, others.candidates[0]), rtol, report(len(step.d)))


def prune(search: Search, step: Step, most: int, *, rtol: float, floor: float) -> Step:
    """As many modes as now, by way of a few more, of which those that contribute least are dropped again.

    Modes in the wrong places leave the right ones to be found; once these have joined, the others are of no use.
    """
    order = len(step.d)
    end = grow(search, step, min(order + TUNING.beyond, most), rtol=rtol, floor=floor)[-1]
    while len(end.d) > order:
        end = search.step(np.delete(end.d, np.argmin(end.weights)), rtol)
    return end


def restart(
    search: Search, empty: Step, order: int, *, rtol: float, floor: float, rng: Any, workers: Any
) -> list[Step]:
    """Ends of a few paths that choose at random among the best candidates, each with a seed of its own."""
    seeds = np.random.SeedSequence(0 if rng is None else _entropy(rng)).spawn(TUNING.restarts)
    run = partial(_random_path, search, empty, order, rtol, floor)
    return list(mapped(run, seeds, workers, Step))


def _entropy(rng: Any) -> int:
    return int(np.random.default_rng(rng).integers(2**63))


def _random_path(
    search: Search, empty: Step, order: int, rtol: float, floor: float, seed: np.random.SeedSequence
) -> Step:
    rng = np.random.default_rng(seed)

    def pick(step: Step) -> int:
        gains = np.maximum(step.gains[: TUNING.divergent], 0.0)
        return int(rng.choice(len(gains), p=gains / gains.sum())) if gains.any() else 0

    return grow(search, empty, order, rtol=rtol, floor=floor, pick=pick)[-1]
