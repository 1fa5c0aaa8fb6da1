"""The search for a plan: greedy choice of images with exchange (V. V. Fedorov, 1972)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from gonio.planning.criteria import Criterion
from gonio.planning.information import Candidates, Design, Expected

MAX_REPEATS = 4  # takes of each background and standard that are considered
_EXCHANGE = 1e-3  # by which the criterion must fall for an exchange
_LEAST_GAIN = 0.02  # smallest gain worth an image, as a share of the gain by averaging alone


def choose(
    candidates: Candidates,
    criterion: Criterion,
    *,
    budget: int | None = None,
    reached: Callable[[Expected], bool] | None = None,
) -> Design:
    """Few images with a small criterion: greedy choice with exchange.

    The search starts at the best single image. Each step adds an incidence, a rotation at every
    incidence, or another take of every background and standard: the one that lowers the criterion
    most for each image that it costs. After each step angles are exchanged for others while that
    lowers the criterion. The search ends where `reached` is true, at the budget, or where no step
    helps. Then it drops the images that are not needed.

    Parameters
    ----------
    candidates : Candidates
    criterion : callable
        From `c_optimality` or `d_optimality`.
    budget : int, optional
        Images of sample, standard and background together, at least 3.
    reached : callable, optional
        Whether the expected uncertainties are small enough; never, where not given.
    """
    limit = np.inf if budget is None else budget

    def value(design: Design) -> float:
        return criterion(candidates.expected(design))

    def good(design: Design) -> bool:
        return reached is not None and reached(candidates.expected(design))

    whole = candidates.everything
    singles = [Design((i,), (r,)) for i in whole.incidences for r in whole.rotations]
    design = min(singles, key=value)
    while not good(design):
        now = value(design)
        bigger = [d for d in _additions(design, whole) if d.n_images <= limit]
        gains = [(now - value(d)) / (d.n_images - design.n_images) for d in bigger]
        if not gains or max(gains) < _LEAST_GAIN / max(design.n_images, 1):
            break
        design = _exchanged(bigger[int(np.argmax(gains))], whole, value)
    while good(design):
        smaller = [d for d in _removals(design) if good(d)]
        if not smaller:
            break
        design = min(smaller, key=lambda d: (d.n_images, value(d)))
    return design


def _additions(design: Design, whole: Design) -> Iterator[Design]:
    """The design with one incidence, rotation or take more."""
    for i in sorted(set(whole.incidences) - set(design.incidences)):
        yield replace(design, incidences=tuple(sorted({*design.incidences, i})))
    for r in sorted(set(whole.rotations) - set(design.rotations)):
        yield replace(design, rotations=tuple(sorted({*design.rotations, r})))
    if design.repeats < MAX_REPEATS:
        yield replace(design, repeats=design.repeats + 1)


def _removals(design: Design) -> Iterator[Design]:
    """The design with one incidence, rotation or take less."""
    for i in design.incidences if len(design.incidences) > 1 else ():
        yield replace(design, incidences=tuple(k for k in design.incidences if k != i))
    for r in design.rotations if len(design.rotations) > 1 else ():
        yield replace(design, rotations=tuple(k for k in design.rotations if k != r))
    if design.repeats > 1:
        yield replace(design, repeats=design.repeats - 1)


def _exchanged(design: Design, whole: Design, value: Callable[[Design], float]) -> Design:
    """The design with each of its angles in turn replaced by the best one."""
    for i in design.incidences:
        swapped = _swapped(design.incidences, i, whole.incidences)
        design = _better([replace(design, incidences=angles) for angles in swapped], design, value)
    for r in design.rotations:
        swapped = _swapped(design.rotations, r, whole.rotations)
        design = _better([replace(design, rotations=angles) for angles in swapped], design, value)
    return design


def _swapped(chosen: tuple[int, ...], old: int, whole: tuple[int, ...]) -> list[tuple[int, ...]]:
    """The numbers with another one in place of `old`.

    Examples
    --------
    >>> _swapped((0, 2), 2, (0, 1, 2, 3))
    [(0, 1), (0, 3)]
    """
    others = set(chosen) - {old}
    return [tuple(sorted({*others, new})) for new in whole if new not in chosen]


def _better(others: list[Design], design: Design, value: Callable[[Design], float]) -> Design:
    """The best of the others if it is better than the design."""
    if not others:
        return design
    best = min(others, key=value)
    return best if value(best) < value(design) - _EXCHANGE else design
