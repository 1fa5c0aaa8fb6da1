"""The covariance at a minimum of any kind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gonio.fitting.minimum.minimise import at_lower
from gonio.fitting.minimum.record import CHI2_95, Minimum
from gonio.fitting.residual_tests.misfit import MisfitTest
from gonio.fitting.uncertainty import covariance as uncertainty
from gonio.fitting.uncertainty.correlated_parts import with_correlated_parts
from gonio.fitting.uncertainty.informed import Informed
from gonio.fitting.uncertainty.profile_likelihood import around
from gonio.fitting.uncertainty.under_misfit import allowing


def uncertainties(minimum: Minimum) -> tuple[uncertainty.Uncertainty, list[str]]:
    """Covariance at a minimum by its noise, without parameters of a lobe that may not be there.

    The list tells of each such lobe.
    """
    errors = with_correlated_parts(minimum, uncertainty.evaluate(minimum))
    return _without_undetected(minimum, errors)


def honest_uncertainties(
    minimum: Minimum, test: MisfitTest | None, informed_by: Callable[[], Informed] | None = None
) -> tuple[uncertainty.Uncertainty, list[str]]:
    """The same with what the residuals show of the model and of the noise allowed for.

    Parameters
    ----------
    minimum : Minimum
    test : MisfitTest or None
        Of its residuals for structure.
    informed_by : callable, optional
        `Informed.once` of the minimum, where others need it as well.
    """
    errors = with_correlated_parts(minimum, uncertainty.evaluate(minimum))
    return _without_undetected(minimum, allowing(minimum, errors, test, informed_by))


def _without_undetected(
    minimum: Minimum, errors: uncertainty.Uncertainty
) -> tuple[uncertainty.Uncertainty, list[str]]:
    """Parameters of a lobe whose amplitude may be zero have no uncertainty."""
    problem, optimum = minimum.problem, minimum.optimum
    determined = errors.determined.copy()
    warnings = []
    for j, q in enumerate(problem.parameters):
        sd = np.sqrt(errors.covariance[j, j])
        if not (q.linear and errors.determined[j] and optimum.p[j] - q.lower < 4 * sd):
            continue
        small, k_small, index = around(minimum, j)
        at = small.optimum
        null = at_lower(small.problem, at, k_small)
        lost = np.zeros_like(determined)
        lost[index] = (np.diag(null.curvature) <= 0) & determined[index]
        gain = max(null.chi2 - at.chi2, 0.0) / max(errors.chi2_unit(j), 1e-300)
        if gain < CHI2_95 and lost.any():
            names = [r.name for k, r in enumerate(problem.parameters) if lost[k]]
            determined[lost] = False
            warnings.append(
                f"{q.name} may as well be {q.to_file(q.lower):.4g} (chi2 grows by {gain:.2g}): "
                f"{' and '.join(names)} would then mean nothing."
            )
    return replace(errors, determined=determined), warnings
