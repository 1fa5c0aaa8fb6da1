"""Whether separate fits of the parts of a joint fit agree, by the uncertainties of their estimates.

Where the model does not hold, the growth of chi-squared from separate fits to the joint one has no
known distribution. What can be compared are the estimates of the parts themselves: with the
uncertainties that fits under misfit state, and with the errors that parts have in common.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.joint import JointProblem
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.residual_tests.misfit import MisfitTest
from gonio.fitting.residual_tests.quadratic_forms import combined
from gonio.fitting.uncertainty.allowance import Allowance
from gonio.fitting.uncertainty.covariance import Uncertainty
from gonio.fitting.uncertainty.degrees_of_freedom import Spread
from gonio.fitting.uncertainty.established import carriers, established
from gonio.fitting.uncertainty.incidence_groups import incidence_groups
from gonio.fitting.uncertainty.informed import Informed
from gonio.fitting.uncertainty.larger_of import larger_of
from gonio.fitting.uncertainty.second_derivatives import SecondDerivatives
from gonio.fitting.uncertainty.under_misfit import left_out, with_incidences, with_structure
from gonio.geometry import FloatArray

ROUNDING = 1e-12  # of the variances of the parts: a difference is not known better


@dataclass(frozen=True)
class Comparison:
    """How far estimates of parts are from those of the others.

    Parameters
    ----------
    p : float
        Chance of estimates that are as far apart; of several comparisons by Cauchy's rule.
    distance : float
        The clearest difference between a part and the others, in standard uncertainties.
    dof : float or None
        Degrees of freedom of its variance; None where that is known.
    """

    p: float
    distance: float
    dof: float | None


def compared_estimates(
    separate: Minimum,
    names: Sequence[str],
    errors: Uncertainty,
    test: MisfitTest | None,
    informed_by: Callable[[], Informed],
) -> Comparison | None:
    """Compare what the parts say of each shared parameter alone.

    None where fewer than two parts establish any: a few samples do not tell how uncertain they are.

    Parameters
    ----------
    separate : Minimum
        Of a `JointProblem` that shares nothing.
    names : sequence of str
        Of the shared parameters, as the model names them.
    errors : Uncertainty
        Of the separate estimates, with what the residuals show allowed for.
    test : MisfitTest or None
        The test of structure by which `errors` allows for misfit.
    informed_by : callable
        `Informed.once` of the separate fits.

    Notes
    -----
    Each part is compared with the weighted mean of the others. The variance of that difference is
    made as that of a parameter: samples and incidences are left out in turn, from all parts at
    once. An error that two parts have in common (at one direction, at one incidence) moves both
    and leaves their difference alone. Student's t with its degrees of freedom gives the chance.
    """
    carried = established(*carriers(informed_by()))
    combinations = _contrasts(separate.problem, names, errors, carried)
    if len(combinations) == 0:
        return None
    spread = _spread(separate, combinations, errors, test, informed_by)
    for moves in errors.shared.values():
        of_differences = moves @ combinations.T
        spread = spread + Spread.known(of_differences.T @ of_differences)
    # Where parts err alike to the last digit, what is left of the variance is rounding.
    least = ROUNDING * (combinations**2 @ np.diag(errors.covariance))
    size = np.sqrt(np.maximum(np.diag(spread.covariance), least))
    difference = combinations @ separate.optimum.p
    distance = np.divide(np.abs(difference), size, out=np.zeros(len(size)), where=size > 0)
    dof = np.where(np.isfinite(spread.dof), np.maximum(spread.dof, 1.0), np.inf)
    chances = 2 * stats.t.sf(distance, dof)
    clearest = int(np.argmin(chances))
    freedom = float(dof[clearest]) if np.isfinite(dof[clearest]) else None
    p = combined(chances.tolist()) if len(chances) > 1 else float(chances[0])
    return Comparison(p, float(distance[clearest]), freedom)


def _contrasts(
    problem: Problem, names: Sequence[str], errors: Uncertainty, carried: NDArray[np.bool_]
) -> FloatArray:
    """Each part's value of each parameter less the mean of the others', as rows over unknowns."""
    assert isinstance(problem, JointProblem)
    variance = np.where(errors.determined, np.diag(errors.covariance), 0.0)
    rows = []
    for name in names:
        compared = [
            int(index[j])
            for part, index in zip(problem.parts, problem.indices, strict=True)
            for j, q in enumerate(part.parameters)
            if q.name == name and carried[index[j]] and variance[index[j]] > 0
            and variance[index[j]] < (q.upper - q.lower) ** 2
        ]  # fmt: skip
        if len(compared) < 2:
            continue
        for k in compared[1:] if len(compared) == 2 else compared:
            others = [j for j in compared if j != k]
            row = np.zeros(len(variance))
            row[k] = 1.0
            row[others] = -(1 / variance[others]) / np.sum(1 / variance[others])
            rows.append(row)
    return np.array(rows).reshape(len(rows), len(variance))


def _spread(
    separate: Minimum,
    combinations: FloatArray,
    errors: Uncertainty,
    test: MisfitTest | None,
    informed_by: Callable[[], Informed],
) -> Spread:
    """Covariance of the combinations by what is independent."""
    allowance = errors.allowance
    if allowance is None:
        covariance = combinations @ errors.independent @ combinations.T
        spread = Spread.known(covariance)
        if errors.dof is None:
            return spread
        return Spread(covariance, np.full(len(covariance), float(np.nanmin(errors.dof))))
    # The larger covariance counts in each direction of the space of all parameters.
    every = np.vstack([np.eye(combinations.shape[1]), combinations])
    informed = informed_by().of_combinations(every)
    spread = _of_all(separate, informed, allowance, test)
    last = slice(combinations.shape[1], None)
    return Spread(spread.covariance[last, last], spread.dof[last])


def _of_all(
    separate: Minimum, informed: Informed, allowance: Allowance, test: MisfitTest | None
) -> Spread:
    if not allowance.structure or test is None:
        return left_out(separate, informed)
    problem = separate.problem
    wrong = with_structure(problem, test)
    spread = left_out(separate, informed, SecondDerivatives(separate), wrong)
    group = incidence_groups(problem)
    spread, _, _ = with_incidences(spread, informed, group, wrong, separate.noise_scale)
    if problem.weights == "sd":
        assert isinstance(problem, JointProblem)
        # Weights hold the scatter of each part; what is known is the stated noise.
        stated = informed.gain.copy()
        for where, scale in zip(problem.slices, problem.scales, strict=True):
            stated[where] /= scale
        spread = larger_of(Spread.known(stated.T @ stated), spread)
    return spread
