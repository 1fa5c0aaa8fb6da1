"""Goodness of fit with the noise model: where the residuals are more than noise.

Residuals are divided by their standard uncertainties (z) and whatever the parameters or the shared
errors could do is projected out of them. Groups of samples (cells of the viewing hemisphere about
the lobe, rings about the mirror direction, angles) are then compared with the scatter inside them:
for normal independent errors

F = (S / K) / ((Q - S) / (n - K))

follows Fisher's distribution with K and n - K degrees of freedom, Q being the sum of squares that
is left, n its degrees of freedom, and S = t^T C^+ t the part of it that lies in the sums t over the
groups, with covariance C of rank K. The size of the noise drops out. Rao 1973, Linear Statistical
Inference, sec. 4b.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.shared_columns import shared_columns, thinned
from gonio.fitting.residual_tests.chi_squared import chi_squared_test
from gonio.fitting.residual_tests.groups import (
    MAPPED,
    Grouping,
    groupings_of,
)
from gonio.fitting.residual_tests.structure import (
    NEIGHBOURING,
    Test,
    group_test,
    neighbour_test,
)
from gonio.fitting.residual_tests.whitened import (
    Base,
    Whitened,
)
from gonio.fitting.result import plain

ALARM = 0.01  # share of right models in which structure is reported
MOST = 20_000  # samples that are examined: enough for any structure that matters
DOMINATES = 0.5  # share of the residual variance above which the model makes the residuals
MOST_GROUPS = 3  # that are reported


@dataclass(frozen=True)
class GroupResidual:
    """Mean residual of a group of samples.

    Parameters
    ----------
    where : str
        In words.
    theta_i_deg : float or None
        Angle of incidence; None where all are taken together.
    n : int
    z : float
        Sum of the residuals over its standard deviation under noise alone.
    relative : float or None
        Weighted mean of measured less fitted over that of the fitted values; None where the fitted
        mean is not positive.
    """

    where: str
    theta_i_deg: float | None
    n: int
    z: float
    relative: float | None


@dataclass(frozen=True)
class ResidualReport:
    """What the residuals say of model and noise.

    Parameters
    ----------
    known_noise : bool
        Whether the samples state their uncertainty; otherwise chi2, dof and p_chi2 are None.
    n : int
        Samples that were examined, at most 20 000, evenly chosen.
    chi2, dof : float, float
        Of the residuals with the shared errors taken off; dof counts noise of the standard that
        images share once.
    p_chi2 : float
        Probability that noise gives a chi-squared at least so far on this side of its middle.
    verdict : {"fits", "too large", "too small"} or None
        Of chi-squared: too large or too small is said beyond 0.5 % on both sides together and
        a factor of 1.25.
    tests : tuple of Test
    p_structure : float
        Smallest p-value times the number of tests, at most 1.
    model_share : float
        Share of the residual variance that is error of the model: what the tests see, and where
        they see something also what chi-squared has beyond the stated noise.
    model_error : float or None
        Standard deviation of the model's error as a fraction of the mean fitted value.
    noise_ratio : float
        Standard deviation of sums over groups in units of what noise alone would give; by so much
        uncertainties that count on noise may be too small. 1 where no structure was found.
    covered : bool
        Whether that error is smaller than the stated errors that samples share.
    largest : tuple of GroupResidual
        The groups that stand out, clearest first.
    maps : mapping of str to list of GroupResidual
        All groups about the mirror direction and all cells of the hemisphere.
    """

    known_noise: bool
    n: int
    chi2: float | None
    dof: float | None
    p_chi2: float | None
    verdict: str | None
    tests: tuple[Test, ...]
    p_structure: float
    model_share: float
    model_error: float | None
    noise_ratio: float
    covered: bool
    largest: tuple[GroupResidual, ...]
    maps: Mapping[str, list[GroupResidual]]

    @property
    def structured(self) -> bool:
        """Whether the residuals have structure that noise has in fewer than 1 % of all fits."""
        return self.p_structure < ALARM

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a JSON document."""
        # Files call the largest residuals "places" since version 0.1.
        fields = {"places" if k == "largest" else k: v for k, v in plain(self).items()}
        return {**fields, "structured": self.structured, "line": self.line}

    @property
    def line(self) -> str:
        """The finding in one line."""
        if not self.tests:
            return "residuals: none beyond rounding, or too few samples to look for structure"
        if not self.structured:
            return f"residuals: no structure beyond noise ({_p(self.p_structure)})"
        covered = ", smaller than the stated shared errors" if self.covered else ""
        return (
            f"residuals: structure beyond noise ({_p(self.p_structure)}), "
            f"{100 * self.model_share:.0f} % of their variance{covered}"
        )

    @property
    def warnings(self) -> list[str]:
        """What a reader must know; nothing where noise explains the residuals."""
        sentences = []
        if self.structured and not self.covered:
            where = "; ".join(_in_words(group) for group in self.largest)
            cause = "the model, not the noise, dominates: its error makes up"
            if self.model_share < DOMINATES:
                cause = "the model does not hold everywhere: its error makes up"
            sentences.append(
                f"{cause} {100 * self.model_share:.0f} % of the residual variance (structure of "
                f"the residuals, {_p(self.p_structure)})"
                + (f"; it is {where}" if where else "")
                + ". The stated uncertainties hold only for the best-fitting surface of this "
                "family of models."
            )
        if self.verdict == "too small":
            assert self.chi2 is not None
            assert self.dof
            sentences.append(
                f"chi2/dof is {self.chi2 / self.dof:.3g}, too small for the stated noise "
                f"({_p(self.p_chi2 or 0.0)}): u_brdf is too large, or the samples were "
                "smoothed or are not independent."
            )
        elif self.verdict == "too large" and not self.structured:
            assert self.chi2 is not None
            assert self.dof
            sentences.append(
                f"chi2/dof is {self.chi2 / self.dof:.3g}, too large for the stated noise "
                f"({_p(self.p_chi2 or 0.0)}), and the residuals have no structure: u_brdf is "
                "probably too small."
            )
        return sentences


def examine(minimum: Minimum) -> ResidualReport:
    """Examine the residuals of a fit.

    Parameters
    ----------
    minimum : Minimum

    Examples
    --------
    >>> from gonio.fitting.minimum.minimise import minimise
    >>> from gonio.fitting.problem.single import SingleProblem
    >>> from gonio.geometry import Directions
    >>> from gonio.models import get
    >>> from gonio.samples import BRDFSamples
    >>> theta = np.linspace(0, 1.2, 200)
    >>> noise = 0.01 * np.random.default_rng(1).standard_normal(200)
    >>> samples = BRDFSamples(Directions(0.3, 0.0, theta, np.pi), 0.1 + noise)
    >>> problem = SingleProblem.from_samples(samples, get("lambert"))
    >>> examine(Minimum.of(problem, minimise(problem, np.array([0.5])))).structured
    False
    """
    problem, optimum = thinned(minimum.problem, MOST), minimum.optimum
    f, jacobian = problem.jacobian(optimum.p)
    informed = optimum.free & (np.diag(optimum.curvature) > 0)
    base = Base(problem, f, jacobian[:, informed], shared_columns(problem, optimum.p, f))
    left = Whitened.of(base)
    chi2 = dof = p_chi2 = verdict = None
    known_noise = problem.weights == "sd"
    if known_noise:
        chi2, dof, p_chi2, verdict = chi_squared_test(base)
    tests: list[Test] = []
    groupings = groupings_of(problem) if left is not None else {}
    for name, grouping in groupings.items():
        assert left is not None
        compared = group_test(left, name, grouping)
        if compared is not None:
            tests.append(compared)
    if left is not None:
        neighbours = neighbour_test(problem, left)
        if neighbours is not None:
            tests.append(neighbours)
    p = min(1.0, max(len(tests), 1) * min((test.p_value for test in tests), default=1.0))
    share, ratio, largest = 0.0, 1.0, []
    if left is not None and p < ALARM:
        significant = [test for test in tests if test.p_value * len(tests) < ALARM]
        share = max(test.share for test in significant)
        if chi2 is not None and dof is not None and chi2 > dof:
            share = max(share, 1 - dof / chi2)
        significant = [test for test in significant if test.name != NEIGHBOURING]
        ratio = max((float(np.sqrt(test.statistic)) for test in significant), default=1.0)
        largest = _largest(left, groupings, significant)
    maps = {
        name: _group_residuals(left, groupings[name])
        for name in MAPPED
        if left is not None and name in groupings
    }
    error = None
    if left is not None and share > 0 and left.mean > 0:
        error = float(np.sqrt(share * left.variance) / left.mean)
    covered = left is not None and share * float(np.mean(left.z**2)) < left.stated
    return ResidualReport(
        known_noise, problem.n, chi2, dof, p_chi2, verdict, tuple(tests), p, share, error,
        max(ratio, 1.0), covered, tuple(largest), maps,
    )  # fmt: skip


def _group_residuals(left: Whitened, grouping: Grouping) -> list[GroupResidual]:
    """Every group with its mean residual, in the order of the grouping."""
    inside = grouping.group >= 0
    k = len(grouping.words)
    number = grouping.group[inside]
    weight = left.root[inside] ** 2
    noise = np.sqrt(max(float(left.z @ left.z) / left.dof, 1e-300))
    counts = np.bincount(number, minlength=k)
    z = np.bincount(number, weights=left.z[inside], minlength=k)
    above = np.bincount(number, weights=weight * left.residual[inside], minlength=k)
    below = np.bincount(number, weights=weight * left.f[inside], minlength=k)
    return [
        GroupResidual(
            grouping.words[g],
            grouping.theta_i_deg[g],
            int(counts[g]),
            round(float(z[g] / (noise * np.sqrt(counts[g]))), 3),
            # Of a model that is almost 0 no residual is a share.
            float(f"{above[g] / below[g]:.3g}") if below[g] > 1e-12 * abs(above[g]) else None,
        )
        for g in range(k)
    ]


def _largest(
    left: Whitened, groupings: Mapping[str, Grouping], significant: list[Test]
) -> list[GroupResidual]:
    """The groups that stand out most in the test that sees most of the structure."""
    if not significant:
        return []
    best = max(significant, key=lambda test: test.share)
    groups = _group_residuals(left, groupings[best.name])
    groups.sort(key=lambda group: -abs(group.z))
    return [group for group in groups[:MOST_GROUPS] if abs(group.z) > 3]


def _in_words(group: GroupResidual) -> str:
    """A group as part of a sentence."""
    side = "low" if group.z > 0 else "high"
    by = ""
    if group.relative is not None:
        by = f" by {100 * abs(group.relative):.2g} %"
    at = "" if group.theta_i_deg is None else f"at theta_i = {group.theta_i_deg:.0f} deg"
    where = " ".join(part for part in (group.where, at) if part)
    return f"too {side}{by} {where}"


def _p(p: float) -> str:
    return f"p = {p:.2g}" if p >= 1e-6 else "p < 1e-6"
