"""Uncertainties where the residuals show that the model, or equal noise, does not hold.

The variance of independent noise no longer tells how far another measurement of the same surface
would move the parameters. What does is how far the samples, and the incidences, move them against
each other: each is left out in turn, and the larger covariance counts in each direction of
parameter space.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.residual_tests.misfit import MisfitTest
from gonio.fitting.residual_tests.unequal_noise import unequal_noise
from gonio.fitting.result.verdict import ALARM
from gonio.fitting.uncertainty.allowance import Allowance
from gonio.fitting.uncertainty.clustered import by_groups
from gonio.fitting.uncertainty.correlated_parts import residual_correlation
from gonio.fitting.uncertainty.covariance import Uncertainty
from gonio.fitting.uncertainty.degrees_of_freedom import Spread
from gonio.fitting.uncertainty.direction_jackknife import by_directions, numbers_of_directions
from gonio.fitting.uncertainty.incidence_groups import FEWEST, incidence_groups
from gonio.fitting.uncertainty.informed import Informed
from gonio.fitting.uncertainty.larger_of import larger_of
from gonio.fitting.uncertainty.loss_sandwich import informed_by_loss
from gonio.fitting.uncertainty.sample_jackknife import by_samples
from gonio.fitting.uncertainty.second_derivatives import SecondDerivatives
from gonio.geometry import FloatArray

# In place of `ALARM` with at most three incidences: a false alarm widens by 3 to 5 there.
ALARM_OF_FEW = 0.001
UNEQUAL = 0.01  # chance of squared residuals that follow f below which noise does
LONE = 0.5  # share of a parameter's information from one incidence alone that is reported


def allowing(
    minimum: Minimum,
    errors: Uncertainty,
    test: MisfitTest | None,
    informed_by: Callable[[], Informed] | None = None,
) -> Uncertainty:
    """The uncertainties with what the residuals show allowed for; as they are where nothing.

    Parameters
    ----------
    minimum : Minimum
    errors : Uncertainty
        By independent noise of the stated size, or of that of the scatter.
    test : MisfitTest or None
        For structure in the residuals; None where they are rounding or too few.
    informed_by : callable, optional
        `Informed.once` of the minimum, where others need it as well.

    Notes
    -----
    Structure: samples and incidences are left out in turn; with fewer than three incidences the
    samples alone. In a joint fit they are those of the parts in which there is structure. The
    variance is never below that of the stated noise.

    The uncertainties of another loss than chi-squared leave out each sample in any case.

    Noise of unknown size that follows f, without structure: the samples alone. The scatter of all
    samples together would be that of the brightest.
    """
    problem, informed_by = minimum.problem, informed_by or Informed.once(minimum)
    if test is None or not errors.determined.any():
        return errors
    if test.structured:
        group = incidence_groups(problem)
        if test.p < alarm(int(group.max()) + 1):
            return _of_misfit(minimum, errors, test, group, informed_by)
    if problem.weights == "sd" or problem.profiled or not problem.quadratic:
        return errors
    informed = informed_by()
    level = np.sqrt(problem.inverse_variance) * problem.values(minimum.optimum.p)
    p = unequal_noise(informed.z, level)
    if p >= UNEQUAL:
        return errors
    spread = left_out(minimum, informed)
    return errors.with_spread(spread, Allowance("samples", p, 0, structure=False))


def alarm(n_incidences: int) -> float:
    """Chance of structure below which the model is taken not to hold."""
    return ALARM_OF_FEW if n_incidences <= FEWEST else ALARM


def _of_misfit(
    minimum: Minimum,
    errors: Uncertainty,
    test: MisfitTest,
    group: NDArray[np.int64],
    informed_by: Callable[[], Informed],
) -> Uncertainty:
    problem = minimum.problem
    wrong = with_structure(problem, test)
    if problem.quadratic:
        informed = informed_by()
        spread = left_out(minimum, informed, SecondDerivatives(minimum), wrong)
    else:
        assert errors.dof is not None
        informed, spread = informed_by_loss(minimum), Spread(errors.independent, errors.dof)
    spread, n_groups, share = with_incidences(spread, informed, group, wrong, errors.noise_scale)
    lone = tuple(problem.parameters[j].name for j in np.flatnonzero(share > LONE))
    if problem.weights == "sd" and problem.quadratic:
        spread = larger_of(Spread.known(informed.of_noise()), spread)
    basis: Literal["samples", "samples and incidences"] = "samples"
    if n_groups >= FEWEST:
        basis = "samples and incidences"
    n_wrong = sum(bool(wrong[where].any()) for _, where, _ in problem.pieces())
    parts = (n_wrong, len(problem.pieces()))
    allowance = Allowance(basis, test.p, n_groups, lone=lone, parts=parts)
    return errors.with_spread(spread, allowance)


def with_incidences(
    spread: Spread,
    informed: Informed,
    group: NDArray[np.int64],
    wrong: NDArray[np.bool_],
    noise_scale: float,
) -> tuple[Spread, int, FloatArray]:
    """The covariance with incidences left out as well, and the noise of samples without structure.

    Parameters
    ----------
    spread : Spread
        By leaving out the samples that have structure.
    informed : Informed
    group : ndarray of int64, shape (N,)
        Number of the incidence of each sample.
    wrong : ndarray of bool, shape (N,)
        Samples that have structure.
    noise_scale : float

    Returns
    -------
    Spread
    n_groups : int
        Incidences of these samples; fewer than `FEWEST` say nothing and are not left out.
    share : ndarray, shape (P,)
        Of each parameter's information that one incidence alone has, see `by_groups`.
    """
    n_groups, share = len(np.unique(group[wrong])), np.zeros(len(informed.back))
    if n_groups >= FEWEST:
        of_incidences, share = by_groups(informed, group, wrong)
        spread = larger_of(spread, of_incidences)
    if not wrong.all():
        spread = spread + Spread.known(informed.of_noise(~wrong) * noise_scale**2)
    return spread, n_groups, share


def left_out(
    minimum: Minimum,
    informed: Informed,
    second: SecondDerivatives | None = None,
    wrong: NDArray[np.bool_] | None = None,
) -> Spread:
    """Samples one by one; directions where the residuals of parts are correlated there."""
    problem = minimum.problem
    if residual_correlation(problem, minimum.optimum.p) is None:
        return by_samples(informed, second, wrong)
    return by_directions(informed, numbers_of_directions(problem), second or (), wrong)


def with_structure(problem: Problem, test: MisfitTest) -> NDArray[np.bool_]:
    """Samples of the parts whose residuals have structure; all where no single part shows it."""
    if len(test.parts) != len(problem.pieces()):
        return np.ones(problem.n, np.bool_)  # of a part of a joint fit alone
    wrong = np.zeros(problem.n, np.bool_)
    for (_, where, _), p in zip(problem.pieces(), test.parts, strict=True):
        wrong[where] = p < ALARM
    return wrong if wrong.any() else ~wrong
