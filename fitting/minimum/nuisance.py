"""The minimum with shared errors profiled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gonio.fitting.minimum.minimise import minimise
from gonio.fitting.minimum.optimum import Optimum
from gonio.fitting.problem.nuisance import NuisanceProblem
from gonio.fitting.problem.protocol import Problem

ROUNDS = 12  # of new weights, draws and parameters
SETTLED = 1e-3  # of the uncertainties: a last round that moves less ends them


def profiled_minimum(
    problem: Problem, optimum: Optimum, names: Sequence[str]
) -> tuple[NuisanceProblem, Optimum, list[str]]:
    """The minimum with shared errors learnt, from that without; and what to know about it.

    Weights, U and z0 follow parameters and draws, which follow them, until both stand still.
    """
    learning = NuisanceProblem.of(problem, names)
    evaluations = optimum.evaluations
    for _ in range(ROUNDS):
        before = optimum.p
        learning = learning.reweighted(before)
        optimum = minimise(learning, before, near=True)
        evaluations += optimum.evaluations
        step = optimum.p - before
        still = float(step @ optimum.curvature @ step) <= (SETTLED * learning.noise) ** 2
        if still and np.all(np.abs(learning.draws(optimum.p) - learning.z0) <= SETTLED):
            return learning, replace(optimum, evaluations=evaluations), []
    told = (
        f"the shared errors that were learnt have not settled in {ROUNDS} rounds: they are too "
        "large for this model, or it is the wrong one."
    )
    return learning, replace(optimum, evaluations=evaluations), [told]
