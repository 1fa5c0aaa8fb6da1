"""Samples over the hemisphere, with noise and errors of a known size."""

from __future__ import annotations

import numpy as np

from gonio import models
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

ISOTROPIC = {"rho_d": 0.3, "rho_s": 0.1, "alpha": 0.2}


def grid(incidences=(5, 25, 45, 65), viewing=15, azimuths=(0, 30, 90, 150, 180)):
    theta_i, theta_r, phi_r = np.meshgrid(
        np.radians(incidences), np.linspace(0, 1.3, viewing), np.radians(azimuths), indexing="ij"
    )
    return Directions(theta_i.ravel(), 0.0, theta_r.ravel(), phi_r.ravel())


GRID = grid()
INCIDENCE = np.unique(GRID.theta_i, return_inverse=True)[1]


def noisy(rng, name="lambert", truth=None, *, sd=0.01, stated=True, error=0.0, where=GRID):
    """Samples whose noise is `sd` of f, stated or not, with an error of the model."""
    f = models.get(name)(where, **(truth or {"rho": 0.5})) * np.ones(len(where.theta_r))
    value = f * (1 + error + sd * rng.standard_normal(len(f)))
    return BRDFSamples(where, value, sd * f if stated else None)
