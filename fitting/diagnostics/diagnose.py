"""Diagnostics of every fit: identifiability, residuals, and copies among its samples."""

from __future__ import annotations

from typing import Any

from gonio.fitting.diagnostics.identifiability import identify
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.copies import (
    copies_warning,
)
from gonio.fitting.residual_tests.report import examine_parts
from gonio.fitting.residual_tests.verdict import judge
from gonio.fitting.residual_tests.whitened import Base
from gonio.fitting.result.verdict import Verdict


def diagnose(
    minimum: Minimum, base: Base | None = None
) -> tuple[Verdict, dict[str, Any], list[str]]:
    """The verdict on a fit, its diagnostics as plain data, and what a reader must be warned of.

    Parameters
    ----------
    minimum : Minimum
        Over one BRDF or several; of several the residuals of each are examined.
    base : Base, optional
        Its values and derivatives, where they are at hand.
    """
    problem = minimum.problem
    identified = identify(minimum)
    base = Base.of(minimum) if base is None else base
    reports = examine_parts(minimum, base)
    verdict = judge(minimum, base, reports)
    # An error of the model within the tolerance, or that shared errors explain, is no warning.
    sentences = [
        report.warnings_of_noise if verdict.fits else report.warnings for report in reports
    ]
    warnings = copies_warning(problem.samples) + identified.warnings
    if len(reports) == 1:
        residuals: Any = reports[0].to_dict()
        warnings += sentences[0]
    else:
        residuals = {"parts": [report.to_dict() for report in reports]}
        bad = [k + 1 for k, own in enumerate(sentences) if own]
        if bad:
            warnings.append(
                f"the residuals of {len(bad)} of {len(reports)} parts are not noise; part "
                f"{bad[0]}: {sentences[bad[0] - 1][0]}"
            )
    return verdict, {"identifiability": identified.to_dict(), "residuals": residuals}, warnings
