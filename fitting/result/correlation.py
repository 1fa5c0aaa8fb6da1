"""Correlation of the fitted parameters, by all errors where the covariance is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gonio.fitting.result.record import FitRecord

TOTAL = "Correlation of all errors"
INDEPENDENT = "Correlation of the independent errors"


@dataclass(frozen=True)
class Correlation:
    """Correlation coefficients by name.

    Parameters
    ----------
    names : tuple of str
    rows : sequence of sequences of float or None
        None where a parameter is not determined.
    of : str
        Which errors they are of, as a heading.
    """

    names: tuple[str, ...]
    rows: Sequence[Sequence[float | None]]
    of: str


def correlation(record: FitRecord) -> Correlation | None:
    """The total correlation, or that of the independent errors where no covariance is known.

    A shared error, such as that of the standard, moves several parameters together: by the total
    covariance they may be correlated where their independent errors are not.
    """
    if record.covariance is not None:
        free = [k for k, e in enumerate(record.parameters.values()) if not e.fixed]
        names = tuple(list(record.parameters)[k] for k in free)
        c = np.asarray(record.covariance)[np.ix_(free, free)]
        sd = np.sqrt(np.diag(c))
        with np.errstate(divide="ignore", invalid="ignore"):
            r = np.clip(c / np.outer(sd, sd), -1, 1)
        rows = [[float(v) if np.isfinite(v) else None for v in row] for row in r]
        return Correlation(names, rows, TOTAL)
    identified = record.diagnostics.get("identifiability")
    if not identified:
        return None
    return Correlation(tuple(identified["parameters"]), identified["correlation"], INDEPENDENT)
