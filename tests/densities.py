"""Known densities for the tests of samplers."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from gonio.fitting.posterior.density import Target
from gonio.fitting.posterior.priors import Prior
from gonio.models import Parameter


class Density(Target):
    """A known log-density in a box."""

    def __init__(self, log_density, lower, upper, mode):
        bounds = zip(lower, upper, strict=True)
        parameters = tuple(
            Parameter(f"p{k}", "p", "", 0.0, a, b) for k, (a, b) in enumerate(bounds)
        )
        problem = SimpleNamespace(parameters=parameters, sum_limit=np.zeros(len(parameters)))
        super().__init__(problem, mode, 1.0, [Prior()] * len(parameters))
        self.log_density = log_density

    def sums(self, p):
        return -2 * self.log_density(p)[:, None]
