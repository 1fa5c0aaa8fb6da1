"""The verdict on a fit: its error beyond the noise, with its interval, against a tolerance.

Where the noise is stated, chi-squared gives the size of the model's error and its interval, and
with the tests of structure the chance that the model is exactly true. Where it is not, residuals
without structure may be all noise or all error: only the tests of structure decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gonio.fitting.minimum.record import Minimum
from gonio.fitting.residual_tests.excess import Excess, excess_of
from gonio.fitting.residual_tests.misfit import MisfitTest, misfit_test_of
from gonio.fitting.residual_tests.quadratic_forms import combined
from gonio.fitting.residual_tests.report import ResidualReport, examine_parts
from gonio.fitting.residual_tests.standardised import LEAST, standardise
from gonio.fitting.residual_tests.unstructured import (
    missing_floor,
    negative_readings,
    samples_of_half,
    sees_smooth_errors,
)
from gonio.fitting.residual_tests.usefulness import explained_share, worse_than_constant
from gonio.fitting.residual_tests.whitened import Base
from gonio.fitting.result.verdict import ALARM, HIDDEN, TOLERANCE, Class, Verdict, of_f, per_cent
from gonio.wording import counted

UNDERSTATED = 3.0  # factor by which noise may be stated too small where samples are sparse
BLACK = "the fitted f is 0 at every sample, so that no error has a size in per cent of f"
UNUSUAL = 0.3  # of f: noise that no instrument has where it measures
IMPOSSIBLE = 2.0  # of f: noise that readings above zero cannot have; speckle, the worst, has 1
SMALLER = 3.0  # standard deviations of chi-squared by which residuals are smaller than their noise
STANDS_OUT = 4.0  # standard deviations by which a group does that the verdict names


@dataclass(frozen=True)
class _Finding:
    """A class with its numbers, and the reason for it."""

    kind: Class
    p: float | None
    size: float | None
    interval: tuple[float, float] | None
    reason: str


def judge(
    minimum: Minimum,
    base: Base,
    reports: Sequence[ResidualReport],
    tolerance: float = TOLERANCE,
) -> Verdict:
    """The verdict on a fit.

    Parameters
    ----------
    minimum : Minimum
        Of any problem.
    base : Base
        Its values and derivatives.
    reports : sequence of ResidualReport
        On the residuals of each part; one of a fit to one BRDF.
    tolerance : float
        Error of the model, as a fraction of f, up to which it fits.

    Examples
    --------
    >>> from gonio.fitting.minimum.find import find_minimum
    >>> from gonio.geometry import Directions
    >>> from gonio.models import get
    >>> from gonio.samples import BRDFSamples
    >>> theta = np.linspace(0, 1.2, 200)
    >>> noise = 0.01 * np.random.default_rng(1).standard_normal(200)
    >>> samples = BRDFSamples(Directions(0.3, 0.0, theta, np.pi), 0.1 * (1 + noise), 0.001)
    >>> minimum = find_minimum(samples, get("lambert"))
    >>> verdict_of(minimum).line
    'verdict: fits: no error of the model beyond 0.49 % of f'
    """
    known = minimum.problem.samples.u_independent is not None
    if known:
        found = _by_noise(base, reports, tolerance, shared=False)
        if found.kind != "fits" and base.shared.shape[1]:
            found = _within_shared(_by_noise(base, reports, tolerance, shared=True))
    else:
        found = _by_structure(base, reports, tolerance)
    if found.kind != "fits" and not np.any(base.f):
        found = replace(found, size=None, interval=None, reason=BLACK)
    return _with_use(_verdict(found, reports, tolerance), minimum, reports, known=known)


def verdict_of(minimum: Minimum) -> Verdict:
    """The verdict on a fit whose residuals nobody has examined yet."""
    base = Base.of(minimum)
    return judge(minimum, base, examine_parts(minimum, base))


def misfit_beyond_shared(minimum: Minimum, base: Base | None = None) -> MisfitTest | None:
    """The test for structure, None where shared errors leave an error within the tolerance.

    With 10^5 samples of a session the floor of image formation is structure; its uncertainties are
    those of the shared errors. `base` is that of the minimum, where it is at hand.
    """
    base = Base.of(minimum) if base is None else base
    test = misfit_test_of(base)
    if test is None or not test.structured or not base.shared.shape[1]:
        return test
    if base.problem.samples.u_independent is None:
        return test
    return None if excess_of(base).interval[1] <= TOLERANCE else test


def _within_shared(found: _Finding) -> _Finding:
    return replace(found, kind="fits_within_shared") if found.kind == "fits" else found


def _verdict(found: _Finding, reports: Sequence[ResidualReport], tolerance: float) -> Verdict:
    verdict = Verdict(found.kind, found.p, found.size, found.interval, tolerance, found.reason)
    if found.kind != "does_not_fit":
        return verdict
    groups = [
        g for report in reports for places in report.maps.values() for g in places
        if abs(g.z) > STANDS_OUT and g.relative is not None
    ]  # fmt: skip
    if not groups:
        return verdict
    worst = max(groups, key=lambda g: abs(g.relative or 0.0))
    assert worst.relative is not None
    if found.size is not None and abs(worst.relative) <= found.size:
        # The error changes its sign within all groups: the mean of none is its size.
        clearest = max(groups, key=lambda g: abs(g.z))
        reason = f"{found.reason}, seen most clearly {clearest.text}"
        return replace(verdict, reason=reason, where=clearest.text, most=clearest.relative)
    side = "low" if worst.relative > 0 else "high"
    by = per_cent(abs(worst.relative))
    reason = f"{found.reason}, most (too {side} by {by}) {worst.text}"
    return replace(verdict, reason=reason, where=worst.text, most=worst.relative)


def _with_use(
    verdict: Verdict, minimum: Minimum, reports: Sequence[ResidualReport], *, known: bool
) -> Verdict:
    """Whether a model that does not fit explains half of f, and predicts better than a constant."""
    if verdict.fits:
        return verdict
    problem, f = minimum.problem, minimum.problem.values(minimum.optimum.p)
    residual = problem.samples.value - f
    if known:
        variance = problem.variance(f)
        noise = float(np.sum(problem.inverse_variance * variance))
    elif verdict.kind == "undecided":
        if verdict.interval is None or verdict.interval[1] < UNUSUAL:
            return verdict  # all that is left may be noise
        noise = float(np.sum(problem.inverse_variance * residual**2))
    else:
        noise = (1 - _share(reports)) * float(np.sum(problem.inverse_variance * residual**2))
        if verdict.p is not None and verdict.p >= ALARM:
            # Readings that are not negative have noise of the size of f at most.
            noise = min(noise, float(np.sum(problem.inverse_variance * f**2)))
    explained = explained_share(minimum, noise)
    if explained is None:
        return verdict
    worse = worse_than_constant(minimum)
    may_be_noise = not known and verdict.kind == "undecided"
    verdict = replace(
        verdict, explained=None if may_be_noise else explained, worse_than_lambert=worse
    )
    words = []
    if explained < 0.5:
        words.append(f"it explains {per_cent(max(explained, 0.0))} of the variance of f")
    if worse:
        words.append("a constant predicts unseen incidences better")
    return replace(verdict, reason="; ".join([verdict.reason, *words]))


# ---------------------------------------------------------------- stated noise


def _by_noise(
    base: Base, reports: Sequence[ResidualReport], tolerance: float, *, shared: bool
) -> _Finding:
    """The class where the noise is stated."""
    excess = excess_of(base, shared=shared)
    if len(reports) == 1:
        p_structure = reports[0].p_structure if shared else reports[0].p_independent
    else:
        misfit = misfit_test_of(base, shared=shared)
        p_structure = 1.0 if misfit is None else misfit.p
    p = combined([excess.p, p_structure])
    kind, reason = _class_by_noise(excess, p, tolerance)
    if kind == "does_not_fit":
        kind, reason = _of_large_residuals(base, excess, p_structure)
    return _Finding(kind, p, excess.size, excess.interval, reason)


def _class_by_noise(excess: Excess, p: float, tolerance: float) -> tuple[Class, str]:
    size, upper = of_f(excess.size), of_f(excess.interval[1])
    if p >= ALARM:
        if excess.dof < LEAST:
            few = counted(int(excess.dof), "degree") + " of freedom"
            return "undecided", f"{few} cannot tell a right model from a wrong one"
        if excess.interval[1] > max(HIDDEN, tolerance):
            return "undecided", f"the noise may hide an error of the model of {upper}"
        return "fits", f"no error of the model beyond {upper}"
    limit = per_cent(tolerance)
    if excess.interval[1] <= tolerance and excess.interval[0] == 0:
        return "fits", f"no error of the model beyond {upper}, within the tolerance of {limit}"
    if excess.interval[1] <= tolerance:
        return "fits", f"typically off by {size}, within the tolerance of {limit}"
    if excess.size <= 0:
        return "undecided", _small_but_structured(excess)
    if excess.size <= tolerance:
        return "undecided", (
            f"an error of the model is seen, of {size} or so, and it is not clear whether it "
            f"is above the tolerance of {limit}"
        )
    if excess.p >= ALARM:
        return "undecided", (
            "the residuals follow each other but are no larger than the stated noise: correlated "
            f"errors, or an error of the model of {size} or so"
        )
    return "does_not_fit", f"typically off by {size}"


def _small_but_structured(excess: Excess) -> str:
    """What is said of structure in residuals that are smaller than the stated noise."""
    ratio = float(np.sqrt(excess.chi2 / max(excess.dof, 1.0)))
    hidden = of_f(excess.interval[1])
    if excess.chi2 > excess.dof - SMALLER * np.sqrt(2 * excess.dof):
        return (
            "the residuals follow each other but are no larger than the stated noise: correlated "
            f"errors, or an error of the model of up to {hidden}"
        )
    return (
        f"the residuals are only {ratio:.2g} times the stated noise and yet have structure: u_brdf "
        f"is too large, and may hide an error of the model of up to {hidden}"
    )


def _of_large_residuals(base: Base, excess: Excess, p_structure: float) -> tuple[Class, str]:
    """The class where residuals are larger than the stated noise: an error of it, or the model's.

    An error of the model is smooth. Where the tests would have seen one and see none, the stated
    noise is too small, by whatever factor. Where samples are too sparse for that, the word of
    whoever stated the noise counts, but for a factor that is common.
    """
    size = of_f(excess.size)
    ratio = float(np.sqrt(excess.chi2 / max(excess.dof, 1.0)))
    times = f"{ratio:.2g} times the stated noise"
    floor = missing_floor(base, excess) if excess.dof >= LEAST else None
    if floor is not None:
        return "undecided", (
            f"the residuals are {times}, and what they have beyond it is all in dark readings "
            f"(f below {floor.below:.2g} sr^-1): u_brdf lacks a floor of about "
            f"{floor.size:.1g} sr^-1"
        )
    if p_structure < ALARM or excess.dof < LEAST:
        return "does_not_fit", f"typically off by {size}"
    few = samples_of_half(excess)
    if few is None and excess.size < UNUSUAL and sees_smooth_errors(base, excess):
        return "undecided", (
            f"the residuals are {times} but have no structure, and an error of the model of {size} "
            "would have: u_brdf is too small, or directions are uncertain"
        )
    if ratio <= UNDERSTATED:
        return "undecided", (
            f"the residuals are {times} but have no structure: u_brdf is too small, directions are "
            f"uncertain, or the model is off by {size}"
        )
    where = "samples are too sparse to show structure"
    if few is not None:
        where = f"{few} of {excess.z.size} samples make half of chi2"
    return "does_not_fit", f"typically off by {size} if u_brdf is right; {where}"


# ---------------------------------------------------------------- unknown noise


def _by_structure(base: Base, reports: Sequence[ResidualReport], tolerance: float) -> _Finding:
    """The class where nobody stated the noise."""
    left = standardise(base)
    if left is None:
        dof = base.problem.n - base.jacobian.shape[1]
        if dof >= LEAST:
            reason = "the model leaves no residuals beyond rounding"
            return _Finding("fits", 1.0, 0.0, (0.0, 0.0), reason)
        few = f"the noise is not stated and {counted(dof, 'degree')} of freedom cannot tell it"
        return _Finding("undecided", None, None, None, few)
    level = float(np.mean(left.level**2))
    everything = float(np.sqrt(float(left.z @ left.z) / left.dof / max(level, 1e-300)))
    misfit = misfit_test_of(base) if len(reports) != 1 else None
    p = reports[0].p_structure if misfit is None else misfit.p
    whole, limit = of_f(everything), per_cent(tolerance)
    if everything <= tolerance:
        reason = f"all residuals together are {whole}, within the tolerance of {limit}"
        return _Finding("fits", p, everything, (0.0, everything), reason)
    negative = negative_readings(left) if everything >= IMPOSSIBLE else None
    if p >= ALARM and negative is not None:
        expected, count = negative
        are = f"{count or 'none'} {'is' if count < 2 else 'are'}"
        reason = (
            f"typically off by {whole}: noise of that size would make about {expected:.0f} of "
            f"{left.problem.n} readings negative, and {are}"
        )
        return _Finding("does_not_fit", p, everything, None, reason)
    if p >= ALARM:
        reason = (
            f"the noise is not stated: residuals of {whole} without structure may be noise "
            "or error of the model"
        )
        if everything >= UNUSUAL:
            reason += ", and noise of that size would be unusual"
        return _Finding("undecided", p, None, (0.0, everything), reason)
    size = float(np.sqrt(_share(reports))) * everything
    if size <= tolerance:
        reason = f"residuals of {whole} hold an error of the model of {per_cent(size)} or so"
        return _Finding("undecided", p, size, (0.0, everything), reason)
    return _Finding("does_not_fit", p, size, (0.0, everything), f"typically off by {of_f(size)}")


def _share(reports: Sequence[ResidualReport]) -> float:
    """Share of the residual variance that is error of the model, over all parts."""
    total = sum(report.n for report in reports)
    return sum(report.n * report.model_share for report in reports) / max(total, 1)
