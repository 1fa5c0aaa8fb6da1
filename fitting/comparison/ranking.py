"""Models ranked by their scores, and which the data cannot tell apart."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from gonio.fitting.comparison.records import Entry, Score
from gonio.fitting.comparison.scores import (
    Judged,
)
from gonio.geometry import FloatArray
from gonio.wording import listed

TOLD_APART = 2.0  # standard errors of a difference
SMALL = 4.0  # a difference of log scores below which its standard error is not to be trusted
CLEAR = 8.0  # a difference D that is two of its standard errors by known noise, sqrt(2 D)


def ranked(judged: list[Judged], n: int, known_noise: bool) -> tuple[Entry, ...]:
    """Entries with their scores against the first, the best first."""

    def key(item: Judged) -> tuple[float, float, float]:
        terms = (item.by_group, item.by_sample)
        scores = [-np.inf if t is None else float(np.sum(t)) for t in terms]
        return -scores[0], -scores[1], item.entry.chi2 / item.entry.dof

    ordered = sorted(judged, key=key)
    first = ordered[0]
    return tuple(
        replace(
            item.entry,
            held_out=_score(item.by_group, first.by_group, None, known_noise),
            loo=_score(item.by_sample, first.by_sample, n, known_noise),
        )
        for item in ordered
    )


def _score(
    terms: FloatArray | None, first: FloatArray | None, n: int | None, known_noise: bool
) -> Score | None:
    """Sum over n terms, of which some may stand for all, against the first model's."""
    if terms is None or first is None:
        return None
    total = len(terms) if n is None else n

    def summed(t: FloatArray) -> tuple[float, float]:
        return float(total * t.mean()), float(total * t.std(ddof=1) / np.sqrt(len(t)))

    difference, stderr = summed(terms - first)
    size = abs(difference)
    clear = size >= TOLD_APART * stderr or (known_noise and size >= CLEAR)
    return Score(
        *summed(terms),
        difference,
        stderr,
        terms=len(terms),
        worse=int(np.count_nonzero(terms < first)),
        told_apart=bool(size > SMALL and clear),
    )


def verdicts_in_words(entries: tuple[Entry, ...]) -> str:
    """Which models fit: a sentence, to stand before the conclusion from the scores."""
    by_class: dict[str, list[str]] = {}
    for entry in entries:
        if entry.verdict is not None:
            by_class.setdefault(entry.verdict.kind, []).append(entry.model)
    fitting = by_class.get("fits", []) + by_class.get("fits_within_shared", [])
    if fitting:
        return f"Of these models {_with_verb(fitting, 'fits', 'fit')}. "
    undecided = by_class.get("undecided", [])
    if undecided:
        return f"Whether {_with_verb(undecided, 'fits', 'fit')} is undecided; no other model does. "
    return "None of these models fits. " if by_class else ""


def _with_verb(names: list[str], singular: str, plural: str) -> str:
    return f"{listed(names)} {singular if len(names) == 1 else plural}"


def conclusion_of(entries: tuple[Entry, ...]) -> str:
    """Which models fit, and which the data cannot distinguish from the best."""
    best, verdicts = entries[0], verdicts_in_words(entries)
    kind: Literal["held_out", "loo"] = "loo" if best.held_out is None else "held_out"
    words = "held-out" if kind == "held_out" else "leave-one-out"
    scores = {e.model: getattr(e, kind) for e in entries[1:]}
    if getattr(best, kind) is None:
        return verdicts + (
            "No predictive score could be computed; the data and these models do not allow it."
        )
    same = [name for name, s in scores.items() if s is not None and not s.told_apart]
    unknown = [name for name, s in scores.items() if s is None]
    if same:
        text = (
            f"By the {words} score the data cannot distinguish {best.model} from {listed(same)}: "
            f"the difference is below {TOLD_APART:g} standard errors or below {SMALL:g}"
        )
        near = [name for name in same if abs(scores[name].difference) > SMALL]
        if near and kind == "held_out":
            counts = [f"{name} at {scores[name].worse} of {scores[name].terms}" for name in near]
            text += f", though it predicts better than {listed(counts)} incidences"
    else:
        text = f"By the {words} score {best.model} predicts better than every other model scored"
    return verdicts + text + (f"; {listed(unknown)} could not be scored." if unknown else ".")
