"""Samples of one incidence as a group whose errors of the model have to do with each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem.protocol import Problem
from gonio.fitting.residual_tests.groups import classes

MOST = 12  # groups: more and smaller ones would part what belongs together
FEWEST = 3  # groups that say how they scatter
NORMAL_DEG = 0.5  # theta_i below which phi_i means nothing


def incidence_groups(problem: Problem) -> NDArray[np.int64]:
    """Number of the incidence of each sample, (N,), from 0 on.

    One group for each theta_i to 1 degree, and for an anisotropic model for each phi_i as well
    where these are few. Equally filled groups where incidences are many. Parts of a joint fit that
    were measured at one incidence are in one group: they err alike.
    """
    d, n = problem.samples.directions, problem.n
    theta, phi = (np.degrees(np.broadcast_to(a, (n,))) for a in (d.theta_i, d.phi_i))
    phi = np.where(theta < NORMAL_DEG, 0.0, np.round(phi) % 360)
    pairs = np.unique(360 * np.round(theta) + phi, return_inverse=True)[1].astype(np.int64)
    by_theta = classes(theta, MOST)
    few = int(pairs.max()) < MOST
    if few and (not problem.model.claims.isotropic or int(by_theta.max()) + 1 < FEWEST):
        return pairs
    return by_theta
