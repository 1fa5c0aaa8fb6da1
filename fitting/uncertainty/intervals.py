"""Parameters with uncertainties and intervals, inside their bounds, on them, and where unknown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import numpy as np

from gonio.fitting.minimum.record import CHI2_95, Minimum
from gonio.fitting.residual_tests.misfit import MisfitTest
from gonio.fitting.result import Estimate
from gonio.fitting.uncertainty import covariance as uncertainty
from gonio.fitting.uncertainty.degrees_of_freedom import quantile
from gonio.fitting.uncertainty.profile_curvature import curved_profile
from gonio.fitting.uncertainty.profile_limits import excluded
from gonio.fitting.uncertainty.profile_limits import limit as bound_limit
from gonio.geometry import FloatArray
from gonio.models import Parameter

LEVELS = (0.6826895, 0.95)  # of the intervals
ROUNDING = 1e-13  # of the root mean square of the data: residuals that are rounding
NEAR_BOUND = 2  # half-widths of an interval within which a bound is asked for by itself


def estimated(
    minimum: Minimum, errors: uncertainty.Uncertainty, test: MisfitTest | None = None
) -> tuple[dict[str, Estimate], list[str]]:
    """Every unknown with its standard uncertainty and intervals; angles in radians.

    Parameters
    ----------
    minimum : Minimum
    errors : Uncertainty
    test : MisfitTest or None
        For structure in the residuals, for which `errors` allow.
    """
    problem, optimum = minimum.problem, minimum.optimum
    allowed = test if errors.allowance else None
    estimates, warnings = {}, []
    bare = noiseless(minimum)
    if bare:
        warnings.append(
            "the model leaves no residuals beyond rounding and the samples state no uncertainty: "
            "the parameters have no uncertainties; give u_brdf."
        )
    for j, q in enumerate(problem.parameters):
        value = float(optimum.p[j])
        if value in (q.lower, q.upper):
            estimates[q.name], text = _at_bound(minimum, j, allowed)
            warnings.append(text)
            continue
        if j in optimum.limited:
            estimates[q.name] = _along_sum(minimum, j, allowed)
            continue
        known = bool(errors.determined[j])
        estimate = Estimate(value, None, q.unit, None, None, None, established=known)
        if errors.determined[j] and bare:
            estimates[q.name] = estimate
            continue
        if errors.determined[j]:
            estimate = _inside(minimum, errors, j, allowed)
        if estimate.interval_95 is None:
            warnings.append(
                f"{q.name} is not determined by these data: its value is arbitrary and it has no "
                "uncertainty; measure other directions or use a simpler model."
            )
        estimates[q.name] = estimate
    return estimates, warnings


def noiseless(minimum: Minimum) -> bool:
    """Whether rounding is all that the residuals hold and nobody stated the noise."""
    problem = minimum.problem
    if problem.weights == "sd" or problem.samples.shared:
        return False
    size = np.sqrt(np.mean(problem.samples.value**2 * problem.inverse_variance))
    return bool(minimum.noise_scale <= ROUNDING * size)


def _inside(
    minimum: Minimum,
    errors: uncertainty.Uncertainty,
    j: int,
    test: MisfitTest | None,
) -> Estimate:
    """A parameter between its bounds.

    Where an end of an interval leaves the bounds, or chi-squared is far from a parabola there, the
    curvature is no guide any more: that end is looked for on the profile of chi-squared.
    """
    q = minimum.problem.parameters[j]
    value = float(minimum.optimum.p[j])
    stderr = float(np.sqrt(errors.covariance[j, j]))
    dof = errors.dof_of(j)
    # Under misfit the growth of chi-squared says nothing of the uncertainty.
    curved = errors.allowance is None and curved_profile(minimum, j, quantile(0.975, dof))
    intervals = []
    for level in LEVELS:
        t = quantile((1 + level) / 2, dof)
        # What is allowed for beyond noise, the profile of chi-squared counts by itself.
        z = t if test is None else quantile((1 + level) / 2, None)
        ends = []
        for side, bound in ((-1, q.lower), (1, q.upper)):
            end: float | None = value + side * t * stderr
            # All errors, where chi-squared counts those of the likelihood alone.
            own = errors.of_likelihood[j, j]
            unit = (errors.noise_scale * stderr) ** 2 / own if own > 0 else 0.0
            if side * (value + NEAR_BOUND * side * t * stderr - bound) >= 0 and not excluded(
                minimum, j, bound, unit * (t / z) ** 2, level
            ):
                end = bound
            elif curved or side * (value + side * t * stderr - bound) >= 0:
                end = bound_limit(minimum, j, z**2, side=side, test=test)
            ends.append(bound if end is None else end)
        intervals.append((ends[0], ends[1]))
    if intervals[1] == (q.lower, q.upper):
        return Estimate(value, None, q.unit, None, None, None, established=False)
    components = errors.components(j)
    is_known = stderr < q.upper - q.lower
    return Estimate(
        value,
        stderr if is_known else None,
        q.unit,
        None,
        intervals[0],
        intervals[1],
        components if is_known else {},
        dof=dof if is_known else None,
    )


def _along_sum(minimum: Minimum, j: int, test: MisfitTest | None) -> Estimate:
    """A reflectance whose sum with others is held at 1: it grows as far as those give way."""
    q = minimum.problem.parameters[j]
    intervals = []
    for increase in (1.0, CHI2_95):
        ends = [bound_limit(minimum, j, increase, side=side, test=test) for side in (-1, 1)]
        low, high = (
            bound if end is None else end
            for end, bound in zip(ends, (q.lower, q.upper), strict=True)
        )
        intervals.append((low, high))
    value = float(minimum.optimum.p[j])
    return Estimate(value, None, q.unit, "upper", intervals[0], intervals[1])


def _at_bound(minimum: Minimum, j: int, test: MisfitTest | None) -> tuple[Estimate, str]:
    """A parameter at its bound: one-sided limits from the profile of chi-squared, no stderr."""
    q = minimum.problem.parameters[j]
    value = float(minimum.optimum.p[j])
    at_bound: Literal["lower", "upper"] = "lower" if value == q.lower else "upper"
    side = 1 if at_bound == "lower" else -1
    limits = [
        bound_limit(minimum, j, increase, side=side, test=test) for increase in (1.0, CHI2_95)
    ]
    far = q.upper if side > 0 else q.lower
    intervals = []
    for limit in limits:
        low, high = sorted((value, far if limit is None else limit))
        intervals.append((low, high))
    unit = f" {q.file_unit}" if q.file_unit else ""
    text = f"{q.name} is at its {at_bound} bound ({q.to_file(value):.4g}{unit}): "
    if limits[1] is None:
        text += "the data do not limit it."
    else:
        text += (
            f"the data do not support a value {'above' if side > 0 else 'below'} "
            f"{q.to_file(limits[1]):.3g}{unit} (95 %) and do not determine it otherwise."
        )
    return Estimate(value, None, q.unit, at_bound, intervals[0], intervals[1]), text


def with_quantiles(
    parameters: tuple[Parameter, ...],
    estimates: Mapping[str, Estimate],
    draws: FloatArray,
) -> dict[str, Estimate]:
    """Intervals from the posterior's quantiles: central, or one-sided where a bound is near.

    A central interval would exclude a bound that the data do not exclude.
    """
    result = {}
    flat = draws.reshape(-1, draws.shape[-1])
    for j, q in enumerate(parameters):
        estimate = estimates[q.name]
        ends = estimate.interval_95 or (np.nan, np.nan)
        near = [ends[0] <= q.lower, ends[1] >= q.upper]
        if estimate.value in (q.lower, q.upper):
            near = [estimate.at_bound == "lower", estimate.at_bound == "upper"]
        intervals = []
        for level in LEVELS:
            if near == [True, False]:
                pair = (q.lower, float(np.quantile(flat[:, j], level)))
            elif near == [False, True]:
                pair = (float(np.quantile(flat[:, j], 1 - level)), q.upper)
            else:
                tail = (1 - level) / 2
                low, high = np.quantile(flat[:, j], [tail, 1 - tail])
                pair = (float(low), float(high))
            intervals.append(pair)
        result[q.name] = replace(estimate, interval_68=intervals[0], interval_95=intervals[1])
    return result


def covariance(errors: uncertainty.Uncertainty) -> list[list[float]] | None:
    """The covariance of all errors; None where a parameter is not determined."""
    if not errors.determined.all():
        return None
    return [[float(v) for v in row] for row in errors.covariance]
