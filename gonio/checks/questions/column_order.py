"""Do columns stand in the wrong order?"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.checks.questions.base import Finding, Question
from gonio.checks.questions.evidence import Evidence
from gonio.samples import ANGLES

LEAST = 20  # samples
FEW = 1000  # samples that are looked at first
STEADY = 0.1  # relative scatter of u_brdf/brdf where one is a fixed share of the other
GRID_DEG = 0.5


def ask(evidence: Evidence) -> Iterator[Finding]:
    """Uncertainties above all values in a fixed ratio, values that are angles on a grid."""
    value, u = evidence.value, evidence.u
    if len(value) < LEAST:
        return
    few = slice(None, None, max(1, len(value) // FEW))
    # A few samples tell that the uncertainties are not nearly all above the values.
    # One uncertainty on all lines is no column of values, but per cent.
    varied = u is not None and bool(np.any(u != u[0]))
    if u is not None and varied and np.mean(u[few] > value[few]) > 0.9 and np.all(value > 0):
        ratio = np.log(u / value)
        typical = float(np.median(ratio))
        scatter = 1.4826 * float(np.median(np.abs(ratio - typical)))
        # Noise of this size would scatter the values themselves by more than their size.
        if typical > np.log(3) and scatter < STEADY and np.mean(ratio > 0) > 0.95:
            yield Finding(
                "u_and_brdf_exchanged",
                "warning",
                f"u_brdf is {np.exp(typical):.3g} times brdf on nearly every line, to "
                f"{scatter:.1%}: noise of that size would not leave all values positive and so "
                "steady. The columns brdf and u_brdf are exchanged: exchange their names.",
            )
    column = _angle_with_values(evidence) if value.max() > 2 and _on_grid(value) else ""
    if column:
        yield Finding(
            "value_is_angle",
            "warning",
            f"brdf takes only {len(np.unique(value))} values, from {value.min():.4g} to "
            f"{value.max():.4g} on a grid of {GRID_DEG} as angles do, and {column} takes "
            "irregular ones: columns stand in the wrong order. Compare the header with them.",
        )


def _on_grid(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> bool:
    """Whether values are few and multiples of half a unit."""
    for some in (values[:LEAST], values):  # one that is not decides
        steps = some / GRID_DEG
        if not np.all(np.abs(steps - np.round(steps)) < 1e-6):
            return False
    return 3 <= len(np.unique(values)) <= len(values) / 3


def _angle_with_values(evidence: Evidence) -> str:
    """The angle that is on no grid although its values stay in a small range, or ""."""
    for name in ANGLES:
        degrees = np.degrees(getattr(evidence, name))
        if len(np.unique(np.round(degrees, 9))) > 0.5 * evidence.n and not _on_grid(degrees):
            return name
    return ""


QUESTION = Question(
    key="column_order",
    order=150,
    asks="Do columns stand in the wrong order?",
    compares="u_brdf with brdf, brdf and the angles with grids of angles",
    codes=("u_and_brdf_exchanged", "value_is_angle"),
    ask=ask,
)
