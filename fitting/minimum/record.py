"""A minimum with its problem, its goodness of fit and what to know about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from gonio.fitting.minimum.optimum import Optimum
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.result import PartFit, Sharing

MISFIT = 1.5  # chi2/dof above which the model, not the noise, decides the residuals
CHI2_95 = 3.841459  # 95 % quantile of chi-squared with one degree of freedom


@dataclass(frozen=True)
class Minimum:
    """Where the least squares of a model lie, and how well it fits there.

    Uncertainties, intervals, posterior, diagnostics and comparison take it as their one argument.

    Parameters
    ----------
    problem : Problem
        With the weights that the minimum was found with.
    optimum : Optimum
    noise_scale : float
        Factor on the independent uncertainties; 0 where the model leaves no residuals.
    chi2, dof : float, int
        As `FitResult` has them.
    warnings : list of str
        A rival minimum, or a lobe that was taken out.
    faults : list of str
        Parameters whose derivative is not that of the model.
    parts : tuple of PartFit
        Of a joint fit.
    sharing : Sharing or None
        Of a joint fit.
    """

    problem: Problem
    optimum: Optimum
    noise_scale: float
    chi2: float
    dof: int
    warnings: list[str] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)
    parts: tuple[PartFit, ...] = ()
    sharing: Sharing | None = None

    @classmethod
    def of(
        cls,
        problem: Problem,
        optimum: Optimum,
        noise_scale: float | None = None,
        *,
        warnings: Sequence[str] = (),
        faults: Sequence[str] = (),
    ) -> Minimum:
        """The minimum with its goodness; the noise scale is found where it is not given."""
        chi2, dof, estimated = goodness(problem, optimum)
        scale = estimated if noise_scale is None else noise_scale
        return cls(problem, optimum, scale, chi2, dof, list(warnings), list(faults))

    def at(self, problem: Problem, optimum: Optimum) -> Minimum:
        """The same noise about a minimum of another problem over these samples, or some of them."""
        return replace(self, problem=problem, optimum=optimum)

    def as_least_squares(self) -> Minimum:
        """The minimum of weighted least squares whose residuals are those that the loss sees.

        The same where the loss is chi-squared.
        """
        if self.problem.quadratic:
            return self
        problem = self.problem.as_least_squares(self.optimum.p)
        chi2, gradient, curvature = problem.normal_equations(self.optimum.p)
        optimum = replace(self.optimum, chi2=chi2, gradient=gradient, curvature=curvature)
        return Minimum.of(problem, optimum, warnings=self.warnings, faults=self.faults)

    @property
    def status(self) -> Literal["converged", "not_converged"]:
        """Whether the optimum passed its checks."""
        return "converged" if self.optimum.verified and not self.faults else "not_converged"


def goodness(problem: Problem, optimum: Optimum) -> tuple[float, int, float]:
    """chi2, degrees of freedom, and the factor on the independent uncertainties.

    Where the samples state their uncertainty the factor is 1, or sqrt(chi2/dof) where the
    residuals are larger than it explains (Birge's ratio); otherwise the scatter of the weighted
    residuals is the only measure of the noise.
    """
    dof = problem.n - int(np.count_nonzero(optimum.free))
    if not problem.quadratic:
        is_likelihood = problem.law.likelihood
        return optimum.chi2, dof, 1.0 if is_likelihood else float(np.sqrt(optimum.chi2 / dof))
    if problem.weights == "sd":
        f = problem.values(optimum.p)
        residual = problem.samples.value - f
        chi2 = float(np.sum(residual**2 / problem.variance(f)))
        return chi2, dof, float(np.sqrt(max(1.0, chi2 / dof)))
    return optimum.chi2, dof, float(np.sqrt(optimum.chi2 / dof))
