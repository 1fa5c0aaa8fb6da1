"""Samples of one incidence as a group whose errors of the model have to do with each other."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem.protocol import Problem
from gonio.fitting.residual_tests.groups import classes, incidence_directions

MOST = 12  # groups: more and smaller ones would part what belongs together
FEWEST = 3  # groups that say how they scatter


def incidence_groups(problem: Problem) -> NDArray[np.int64]:
    """Number of the incidence of each sample, (N,), from 0 on.

    One group for each theta_i to 1 degree, and for an anisotropic model for each phi_i as well
    where these are few. Equally filled groups where incidences are many. Parts of a joint fit that
    were measured at one incidence are in one group: they err alike.
    """
    pairs = incidence_directions(problem)
    theta = np.broadcast_to(problem.samples.directions.theta_i, (problem.n,))
    by_theta = classes(np.degrees(theta), MOST)
    few = int(pairs.max()) < MOST
    if few and (not problem.model.claims.isotropic or int(by_theta.max()) + 1 < FEWEST):
        return pairs
    return by_theta
