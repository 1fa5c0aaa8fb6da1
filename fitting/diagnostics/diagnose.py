"""Diagnostics of every fit: identifiability, residuals, and copies among its samples."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.diagnostics.identifiability import identify
from gonio.fitting.diagnostics.residual_report import ResidualReport, examine
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.copies import (
    copies_warning,
)
from gonio.fitting.problem.protocol import Problem


def diagnose(minimum: Minimum) -> tuple[dict[str, Any], list[str]]:
    """Diagnostics of a fit as plain data, and what a reader must be warned of.

    Parameters
    ----------
    minimum : Minimum
        Over one BRDF or several; of several the residuals of each are examined.
    """
    problem = minimum.problem
    identified = identify(minimum)
    reports = [_of_piece(minimum, piece, index) for piece, _, index in problem.pieces()]
    warnings = copies_warning(problem.samples) + identified.warnings
    if len(reports) == 1:
        residuals: Any = reports[0].to_dict()
        warnings += reports[0].warnings
    else:
        residuals = {"parts": [report.to_dict() for report in reports]}
        bad = [k + 1 for k, report in enumerate(reports) if report.warnings]
        if bad:
            first = reports[bad[0] - 1].warnings[0]
            warnings.append(
                f"the residuals of {len(bad)} of {len(reports)} parts are not noise; part "
                f"{bad[0]}: {first}"
            )
    return {"identifiability": identified.to_dict(), "residuals": residuals}, warnings


def _of_piece(minimum: Minimum, piece: Problem, index: NDArray[np.int64]) -> ResidualReport:
    optimum = minimum.optimum
    own = replace(
        optimum,
        p=optimum.p[index],
        gradient=optimum.gradient[index],
        curvature=optimum.curvature[np.ix_(index, index)],
        free=optimum.free[index],
    )
    return examine(minimum.at(piece, own))
