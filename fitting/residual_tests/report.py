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
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gonio.fitting.minimum.record import Minimum
from gonio.fitting.residual_tests.chi_squared import chi_squared_test
from gonio.fitting.residual_tests.group_residuals import (
    GroupResidual,
    group_residuals,
    largest_groups,
)
from gonio.fitting.residual_tests.groups import MAPPED, groupings_of
from gonio.fitting.residual_tests.misfit import misfit_test_of
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
from gonio.fitting.result.verdict import ALARM
from gonio.geometry import FloatArray
from gonio.wording import counted

DOMINATES = 0.5  # share of the residual variance above which the model makes the residuals
MAD_TO_SD = 1.4826  # of normal noise, from the median of its absolute values
OUTLYING = 10.0  # typical residuals that single readings have by error, and hardly by noise


@dataclass(frozen=True)
class ResidualReport:
    """What the residuals say of model and noise.

    Parameters
    ----------
    known_noise : bool
        Whether the samples state their uncertainty; otherwise noise_factor, p_chi2 and noise are
        None.
    n : int
        Samples that were examined, at most 20 000, evenly chosen.
    noise_factor : float
        Size of the residuals in units of the stated noise, shared errors taken off.
    p_chi2 : float
        Probability that noise gives a chi-squared at least so far on this side of its middle.
    noise : {"as stated", "larger", "smaller"} or None
        What chi-squared says of the stated noise: larger or smaller is said beyond 0.5 % on both
        sides together and a factor of 1.25 in chi-squared.
    outliers : int
        Samples whose residuals are more than 10 typical ones.
    tests : tuple of Test
        Groups of samples against the scatter inside them: where the structure is.
    components : mapping of str to float
        p-value of each kind of error of the model (`gonio.fitting.residual_tests.misfit`).
    p_structure : float
        Their combination: the chance of such structure under a true model, errors that samples
        share as large as stated; 1 where nothing can be tested.
    p_independent : float
        The same where all errors are independent noise.
    model_share : float
        Share of the residual variance that is error of the model: what the tests see, and where
        they see something also what chi-squared has beyond the stated noise.
    model_error : float or None
        Standard deviation of the model's error as a fraction of the mean fitted value.
    noise_ratio : float
        Standard deviation of sums over groups in units of what noise alone would give; by so much
        uncertainties that count on noise may be too small. 1 where no structure was found.
    covered : bool
        Whether there is structure that the stated errors that samples share explain.
    largest : tuple of GroupResidual
        The groups that stand out, clearest first.
    maps : mapping of str to list of GroupResidual
        All groups about the mirror direction and all cells of the hemisphere.
    """

    known_noise: bool
    n: int
    noise_factor: float | None
    p_chi2: float | None
    noise: str | None
    outliers: int
    tests: tuple[Test, ...]
    components: Mapping[str, float]
    p_structure: float
    p_independent: float
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
        if not self.components:
            return "residuals: none beyond rounding, or too few samples to look for structure"
        if self.covered:
            return "residuals: structure beyond noise, which the stated shared errors explain"
        if self.structured:
            return (
                f"residuals: structure beyond noise ({_p(self.p_structure)}), "
                f"{100 * self.model_share:.0f} % of their variance"
            )
        if self.outliers:
            return (
                f"residuals: {counted(self.outliers, 'sample')} off by more than "
                f"{OUTLYING:.0f} times the typical residual, no structure in the others"
            )
        if self.noise == "larger":
            return (
                f"residuals: {self.noise_factor:.2g} times as large as the stated noise, without "
                "structure that the tests find"
            )
        return f"residuals: no structure beyond noise ({_p(self.p_structure)})"

    @property
    def warnings(self) -> list[str]:
        """What a reader must know; nothing where noise explains the residuals."""
        return self.warnings_of_model + self.warnings_of_noise

    @property
    def warnings_of_model(self) -> list[str]:
        """Where the error of the model is, if there is structure."""
        sentences = []
        if self.structured:
            where = "; ".join(group.sentence for group in self.largest)
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
        return sentences

    @property
    def warnings_of_noise(self) -> list[str]:
        """Whether the stated noise is that of the residuals."""
        sentences = []
        if self.noise == "smaller":
            sentences.append(
                f"the residuals are only {self.noise_factor:.2g} times as large as the stated "
                f"noise ({_p(self.p_chi2 or 0.0)}): u_brdf is too large, or the samples were "
                "smoothed or are not independent."
            )
        elif self.noise == "larger" and not (self.structured or self.covered):
            sentences.append(
                f"the residuals are {self.noise_factor:.2g} times as large as the stated noise "
                f"({_p(self.p_chi2 or 0.0)}) and have no structure: u_brdf is probably too small, "
                "or single readings are wrong."
            )
        return sentences


def examine(minimum: Minimum, base: Base | None = None) -> ResidualReport:
    """Examine the residuals of a fit.

    Parameters
    ----------
    minimum : Minimum
    base : Base, optional
        Its values and derivatives, where they are at hand.

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
    base = Base.of(minimum) if base is None else base
    problem = base.problem
    left = Whitened.of(base)
    factor = p_chi2 = noise = None
    known_noise = problem.weights == "sd"
    if known_noise:
        chi2, dof, p_chi2, noise = chi_squared_test(base)
        factor = float(np.sqrt(chi2 / max(dof, 1.0)))
    misfit = misfit_test_of(base)
    tests: list[Test] = []
    groupings = groupings_of(problem, base.vectors) if left is not None else {}
    for name, grouping in groupings.items():
        assert left is not None
        compared = group_test(left, name, grouping)
        if compared is not None:
            tests.append(compared)
    if left is not None:
        neighbours = neighbour_test(base, left)
        if neighbours is not None:
            tests.append(neighbours)
    structured = misfit is not None and misfit.structured
    alone = misfit_test_of(base, shared=False) if base.shared.shape[1] else misfit
    covered = not structured and alone is not None and alone.structured
    share, ratio, largest = 0.0, 1.0, []
    if left is not None and structured:
        significant = [test for test in tests if test.p_value * len(tests) < ALARM]
        share = max((test.share for test in significant or tests), default=0.0)
        if factor is not None and factor > 1:
            share = max(share, 1 - 1 / factor**2)
        significant = [test for test in significant if test.name != NEIGHBOURING]
        ratio = max((float(np.sqrt(test.statistic)) for test in significant), default=1.0)
        largest = largest_groups(left, groupings, significant)
    maps = {
        name: group_residuals(left, groupings[name])
        for name in MAPPED
        if left is not None and name in groupings
    }
    error = None
    if left is not None and share > 0 and left.mean > 0:
        error = float(np.sqrt(share * left.variance) / left.mean)
    return ResidualReport(
        known_noise, problem.n, factor, p_chi2, noise, 0 if left is None else outlying(left.z),
        tuple(tests), {} if misfit is None else misfit.components,
        1.0 if misfit is None else misfit.p, 1.0 if alone is None else alone.p, share, error,
        max(ratio, 1.0), covered, tuple(largest), maps,
    )  # fmt: skip


def examine_parts(minimum: Minimum, base: Base) -> list[ResidualReport]:
    """Examine the residuals of each part of a joint fit; of a fit to one BRDF the whole.

    `base` is that of the whole.
    """
    if len(minimum.problem.pieces()) == 1:
        return [examine(minimum, base)]
    optimum = minimum.optimum
    reports = []
    for piece, _, index in minimum.problem.pieces():
        own = replace(
            optimum,
            p=optimum.p[index],
            gradient=optimum.gradient[index],
            curvature=optimum.curvature[np.ix_(index, index)],
            free=optimum.free[index],
        )
        reports.append(examine(minimum.at(piece, own)))
    return reports


def outlying(z: FloatArray) -> int:
    """How many residuals are more than ten typical ones."""
    typical = MAD_TO_SD * float(np.median(np.abs(z)))
    return int(np.count_nonzero(np.abs(z) > OUTLYING * typical)) if typical > 0 else 0


def _p(p: float) -> str:
    return f"p = {p:.2g}" if p >= 1e-6 else "p < 1e-6"
