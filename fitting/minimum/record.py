"""A minimum with its problem, its goodness of fit and what to know about it."""

from __future__ import annotations

from dataclasses import dataclass
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

    Parameters
    ----------
    problem : Problem
        With the weights that the minimum was found with.
    optimum : Optimum
    doubts : list of str
        A rival minimum, or a lobe that was taken out.
    faults : list of str
        Parameters whose derivative is not that of the model.
    chi2, dof, noise_scale : float, int, float
        As `FitResult` has them.
    parts : tuple of PartFit
        Of a joint fit.
    sharing : Sharing or None
        Of a joint fit.
    """

    problem: Problem
    optimum: Optimum
    doubts: list[str]
    faults: list[str]
    chi2: float
    dof: int
    noise_scale: float
    parts: tuple[PartFit, ...] = ()
    sharing: Sharing | None = None

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
        known = problem.law.likelihood
        return optimum.chi2, dof, 1.0 if known else float(np.sqrt(optimum.chi2 / dof))
    if problem.weights == "sd":
        f = problem.values(optimum.p)
        residual = problem.samples.value - f
        chi2 = float(np.sum(residual**2 / problem.variance(f)))
        return chi2, dof, float(np.sqrt(max(1.0, chi2 / dof)))
    return optimum.chi2, dof, float(np.sqrt(optimum.chi2 / dof))
