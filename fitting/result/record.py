"""The fields of a fit's result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from gonio.fitting.result.estimates import (
    Estimate,
    NuisanceEstimate,
    PartFit,
    PosteriorSummary,
    Sharing,
)
from gonio.fitting.result.verdict import Verdict


@dataclass(frozen=True)
class FitRecord:
    """What a fit found, without what it can do; `FitResult` is this record with its methods.

    Parameters
    ----------
    model : str
    status : {"converged", "not_converged"}
        "converged" only when the optimum passed its checks: the next step is far below the
        uncertainties, chi-squared grows along every axis of the uncertainty ellipsoid, and the
        model's derivatives agree with difference quotients. It is the deepest of the minima
        that were found from several starts.
    parameters : mapping of str to Estimate
    covariance : list of lists, or None
        In the order of `parameters`, angles in radians, shared terms included; None where a
        parameter has no standard uncertainty.
    chi2, dof : float, int
        Weighted sum of squares of the residuals, and samples less free parameters.
    noise_scale : float
        Factor on the independent uncertainties: sqrt(chi2/dof) where that exceeds 1 or where no
        uncertainty was given.
    n_samples, n_negative : int
    weights : str
    cuts : mapping
        Selections and angle limits that were applied.
    seed : int
    posterior : PosteriorSummary or None
    warnings : tuple of str
    diagnostics, versions, source : mapping
        Plain data as the document holds them: angles in degrees.
    parts : tuple of PartFit
        The channels, wavelengths or materials of a joint fit, else empty.
    sharing : Sharing or None
        The test of a joint fit's shared parameters.
    nuisance : tuple of NuisanceEstimate
        Shared errors that the fit profiled, else empty.
    engine : str
        What searched for the minimum (`gonio.fitting.minimum.engines`); "gauss_newton" where
        nothing searched before the polish.
    polish : str
        What ended the search and checked the minimum.
    loss : str
        What was made small (`gonio.fitting.problem.losses`); for another one than chi2 its value
        stands as `chi2`, and uncertainties come from the scatter of the residuals.
    verdict : Verdict or None
        Whether the model describes the samples; None in files of version 0.1.
    model_source : mapping or None
        File and sha256 of a model from outside the package (`gonio.models.source_of`).
    """

    model: str
    status: Literal["converged", "not_converged"]
    parameters: Mapping[str, Estimate]
    covariance: list[list[float]] | None
    chi2: float
    dof: int
    noise_scale: float
    n_samples: int
    n_negative: int
    weights: str
    seed: int
    cuts: Mapping[str, Any] = field(default_factory=dict)
    posterior: PosteriorSummary | None = None
    warnings: tuple[str, ...] = ()
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    source: Mapping[str, Any] = field(default_factory=dict)
    parts: tuple[PartFit, ...] = ()
    sharing: Sharing | None = None
    nuisance: tuple[NuisanceEstimate, ...] = ()
    engine: str = "gauss_newton"
    polish: str = "gauss_newton"
    loss: str = "chi2"
    model_source: Mapping[str, Any] | None = None
    verdict: Verdict | None = None

    @property
    def ok(self) -> bool:
        """True when the fit passed its own checks.

        The optimum and the posterior, where there is one, have converged, and the model is of use:
        it explains half of the variance of f beyond the noise, and predicts incidences that it has
        not seen better than a constant does.
        """
        return self.converged and (self.verdict is None or self.verdict.useful)

    @property
    def converged(self) -> bool:
        """True when the optimum, and the posterior where there is one, have converged."""
        return self.status == "converged" and (self.posterior is None or self.posterior.converged)

    def values(self) -> dict[str, float]:
        """Parameter values by name, angles in radians, as models and `start` take them."""
        return {name: estimate.value for name, estimate in self.parameters.items()}
