"""What every fit is told about itself: identifiability, residuals, and copies among its samples."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from gonio.errors import DataError
from gonio.fitting.diagnostics.identifiability import identify
from gonio.fitting.diagnostics.residual_report import ResidualReport, examine
from gonio.fitting.minimum.gauss_newton import Optimum
from gonio.fitting.problem.problem import Problem
from gonio.kernels.copies import suspects
from gonio.samples import BRDFSamples

SMALLEST, LARGEST = 1e-100, 1e100  # sr^-1, of which squares are numbers
_COPIES = "copies of other samples count once"


def diagnose(
    problem: Problem, optimum: Optimum, noise_scale: float
) -> tuple[dict[str, Any], list[str]]:
    """Diagnostics of a fit as plain data, and what a reader must be warned of.

    Parameters
    ----------
    problem : Problem
        Over one BRDF or several; of several the residuals of each are examined.
    optimum : Optimum
    noise_scale : float
        Factor on the independent uncertainties.
    """
    identified = identify(problem, optimum, noise_scale)
    reports = [_of_piece(piece, optimum, place) for piece, _, place in problem.pieces()]
    warnings = copies_told(problem.samples) + identified.warnings
    if len(reports) == 1:
        told: Any = reports[0].to_dict()
        warnings += reports[0].warnings
    else:
        told = {"parts": [report.to_dict() for report in reports]}
        bad = [k + 1 for k, report in enumerate(reports) if report.warnings]
        if bad:
            first = reports[bad[0] - 1].warnings[0]
            warnings.append(
                f"the residuals of {len(bad)} of {len(reports)} parts are not noise, of part "
                f"{bad[0]} first: {first}"
            )
    return {"identifiability": identified.to_dict(), "residuals": told}, warnings


def _of_piece(piece: Problem, optimum: Optimum, place: Any) -> ResidualReport:
    own = replace(
        optimum,
        p=optimum.p[place],
        gradient=optimum.gradient[place],
        curvature=optimum.curvature[np.ix_(place, place)],
        free=optimum.free[place],
    )
    return examine(piece, own)


def usable(samples: BRDFSamples) -> BRDFSamples:
    """The samples without copies, if their numbers can be squared and summed.

    Raises
    ------
    DataError
        If a value or uncertainty is too large or too small to compute with.
    """
    columns = {"a BRDF value": np.max(np.abs(samples.value), initial=0.0)}
    if samples.u_independent is not None and len(samples):
        columns |= {"the smallest u_brdf": np.min(samples.u_independent),
                    "the largest u_brdf": np.max(samples.u_independent)}  # fmt: skip
    for what, size in columns.items():
        if size > 0 and not SMALLEST <= size <= LARGEST:
            raise DataError(
                f"{what} is {size:.3g} sr^-1; a fit can compute with {SMALLEST:g} to {LARGEST:g}. "
                "Check the unit and the scale of the data.",
                value=float(size),
            )
    return without_copies(samples)


def without_copies(samples: BRDFSamples) -> BRDFSamples:
    """The samples without exact copies: the same directions, value and uncertainty twice.

    Noise makes no value twice, so that a copy is a row that was written twice and tells nothing
    new; counted again it would make every uncertainty too small.
    """
    suspect = samples.value[suspects(np.ascontiguousarray(samples.value))]
    if len(np.unique(suspect)) == len(suspect):
        return samples
    d = samples.directions
    columns = [np.broadcast_to(a, (len(samples),)) for a in
               (d.theta_i, d.phi_i, d.theta_r, d.phi_r, samples.value)]  # fmt: skip
    columns += [c for c in (samples.u_independent, samples.wavelength_nm) if c is not None]
    first = np.unique(np.column_stack(columns), axis=0, return_index=True)[1]
    if len(first) == len(samples):
        return samples
    return samples.select(np.sort(first), _COPIES)


def copies_told(samples: BRDFSamples) -> list[str]:
    """A warning where `without_copies` took some away."""
    found = [line for line in samples.history if line.startswith(_COPIES)]
    if not found:
        return []
    kept, total = (int(word) for word in found[0].split(": ")[1].split() if word.isdigit())
    return [
        f"{total - kept} of {total} samples are exact copies of others (same directions and "
        "value); they tell nothing new and were counted once."
    ]
