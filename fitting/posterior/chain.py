"""Draws of a posterior with their measures of convergence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from gonio.fitting.posterior.convergence import Convergence
from gonio.fitting.posterior.priors import Prior
from gonio.fitting.result import PosteriorSummary
from gonio.geometry import FloatArray
from gonio.models import Parameter

Sampler = Literal["emcee", "marginal", "auto"]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Chain:
    """Draws of the posterior.

    Parameters
    ----------
    draws : ndarray, shape (chains, steps, parameters)
        Python units, burn-in removed, shared terms added.
    measures : Convergence
        Of the sampled chains, before the shared terms.
    acceptance : float
    sampler : {"marginal", "emcee"}
    k_hat : float or None
        Of the importance weights of the marginal sampler, also where its guard refused it; None
        where it had nothing to weigh or did not run.
    note : str
        Why the marginal sampler was not used where it was asked for; else empty.
    log_density : ndarray, shape (chains, steps)
        Log of the density that was sampled, amplitudes integrated out, up to a constant.
    priors : tuple of Prior
    warnings : list of str
    unmoved : ndarray, optional
        The draws before they were spread and the shared terms were added.
    allowance : str
        What the spread of the draws allows for beyond the likelihood; empty for nothing.
    """

    draws: FloatArray
    measures: Convergence
    acceptance: float
    sampler: Literal["marginal", "emcee"]
    k_hat: float | None
    note: str
    log_density: FloatArray
    priors: tuple[Prior, ...]
    warnings: list[str] = field(default_factory=list)
    unmoved: FloatArray | None = None
    allowance: str = ""

    @property
    def n_steps(self) -> int:
        """Steps a chain after the burn-in."""
        return int(self.draws.shape[1])

    @property
    def converged(self) -> bool:
        """Long against tau, R-hat near 1, enough effective draws in the middle and the tails."""
        return self.measures.converged

    def summary(self, parameters: Sequence[Parameter], path: str | None) -> PosteriorSummary:
        """The part of the chain that stands in a fit's JSON document."""
        m = self.measures
        return PosteriorSummary(
            ess=m.ess_bulk,
            r_hat=m.r_hat if np.isfinite(m.r_hat) else float(len(self.draws)),
            tau=m.tau if np.isfinite(m.tau) else float(self.n_steps),
            acceptance=self.acceptance,
            converged=self.converged,
            draws=path,
            ess_bulk=m.ess_bulk,
            ess_tail=m.ess_tail,
            sampler=self.sampler,
            k_hat=self.k_hat if self.k_hat is not None and np.isfinite(self.k_hat) else None,
            note=self.note,
            allowance=self.allowance,
            priors={q.name: p.text(q) for q, p in zip(parameters, self.priors, strict=True)},
        )
