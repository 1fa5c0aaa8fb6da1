"""Every parameter that a result states: estimates of the unknowns, and those fixed or tied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from gonio.fitting.problem.unknowns import Reported
from gonio.fitting.result import Estimate


def all_estimates(
    reported: Sequence[Reported], estimates: Mapping[str, Estimate]
) -> dict[str, Estimate]:
    """Estimates of all parameters, from those of the unknowns.

    A fixed parameter has its value and no uncertainty; tied ones have the estimate that they share.
    """
    unknowns = list(estimates.values())
    stated = {}
    for r in reported:
        q = r.parameter
        if r.unknown is None:
            stated[q.name] = Estimate(
                r.of(np.zeros(0)), None, q.unit, None, None, None, fixed=True, tied_to=r.tied_to
            )
        else:
            stated[q.name] = replace(unknowns[r.unknown], tied_to=r.tied_to)
    return stated


def all_covariances(
    reported: Sequence[Reported], covariance: list[list[float]] | None
) -> list[list[float]] | None:
    """Covariance of all parameters; 0 in the rows of those that are fixed.

    Examples
    --------
    >>> from gonio.models import get
    >>> q = get("lambert").parameters[0]
    >>> all_covariances([Reported(q, None, 0.5), Reported(q, 0), Reported(q, 0)], [[0.25]])
    [[0.0, 0.0, 0.0], [0.0, 0.25, 0.25], [0.0, 0.25, 0.25]]
    """
    if covariance is None:
        return None
    gain = np.zeros((len(reported), len(covariance)))
    for row, r in zip(gain, reported, strict=True):
        if r.unknown is not None:
            row[r.unknown] = 1.0
    matrix = gain @ np.asarray(covariance) @ gain.T
    return [[float(v) for v in row] for row in matrix]
