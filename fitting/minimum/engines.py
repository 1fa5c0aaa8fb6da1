"""Engines: what searches for the neighbourhood of a minimum, selected by name.

Gauss-Newton steps and the same checks end every fit (`minimise.minimise`): engines differ in time
and in which minimum they reach, not in how exactly. All are nlopt's and search the nonlinear
parameters inside their bounds; at each point the linear ones are solved for.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from gonio.errors import unknown_name
from gonio.fitting.minimum.minimise import Engine
from gonio.fitting.minimum.search_objective import Objective
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray

DEFAULT = "lbfgs"
NO_SEARCH = "gauss_newton"
ENGINES = {
    "lbfgs": "nlopt LD_LBFGS, quasi-Newton",
    "slsqp": "nlopt LD_SLSQP, sequential quadratic programming",
    "mma": "nlopt LD_MMA, moving asymptotes",
    "bobyqa": "nlopt LN_BOBYQA, quadratic models without gradient",
    "sbplx": "nlopt LN_SBPLX, simplices without gradient",
    "mlsl": "nlopt G_MLSL_LDS, many starts, L-BFGS from each",
    "gauss_newton": "no search: Gauss-Newton steps alone",
}
_LOCAL = {
    "lbfgs": "LD_LBFGS",
    "slsqp": "LD_SLSQP",
    "mma": "LD_MMA",
    "bobyqa": "LN_BOBYQA",
    "sbplx": "LN_SBPLX",
}
OBJECTIVE_TOLERANCE = 1e-3  # relative; the Gauss-Newton steps do the rest
VARIABLE_TOLERANCE = 1e-7  # relative
EVALUATIONS = 400
GLOBAL_EVALUATIONS = 300  # a nonlinear parameter
LOCAL_EVALUATIONS = 40


def get(name: str, seed: int = 0) -> Engine | None:
    """The engine with this name; None for Gauss-Newton steps alone.

    Parameters
    ----------
    name : str
        One of `ENGINES`.
    seed : int
        Of the starts of "mlsl".

    Raises
    ------
    ConfigurationError
        If there is none, with the nearest name.
    """
    if name not in ENGINES:
        raise unknown_name("engine", name, ENGINES)
    if name == NO_SEARCH:
        return None
    if name in _LOCAL:
        return partial(_local, _LOCAL[name])
    return partial(_multistart, seed)


def _local(name: str, problem: Problem, start: FloatArray) -> tuple[FloatArray, int]:
    objective = Objective(problem, start)
    return _run(lambda: _optimiser(name, objective, EVALUATIONS), objective)


def _multistart(seed: int, problem: Problem, start: FloatArray) -> tuple[FloatArray, int]:
    import nlopt

    objective = Objective(problem, start)

    def make() -> Any:
        nlopt.srand(seed)
        n = len(objective.start)
        optimiser = _optimiser("G_MLSL_LDS", objective, GLOBAL_EVALUATIONS * n)
        local = nlopt.opt(nlopt.LD_LBFGS, n)
        local.set_ftol_rel(1e-5)
        local.set_maxeval(LOCAL_EVALUATIONS)
        optimiser.set_local_optimizer(local)
        return optimiser

    return _run(make, objective)


def _optimiser(name: str, objective: Objective, evaluations: int) -> Any:
    import nlopt

    n = len(objective.start)
    optimiser = nlopt.opt(getattr(nlopt, name), n)
    optimiser.set_lower_bounds(np.zeros(n))
    optimiser.set_upper_bounds(np.ones(n))
    optimiser.set_min_objective(objective)
    optimiser.set_ftol_rel(OBJECTIVE_TOLERANCE)
    optimiser.set_xtol_rel(VARIABLE_TOLERANCE)
    optimiser.set_maxeval(evaluations)
    return optimiser


def _run(make: Callable[[], Any], objective: Objective) -> tuple[FloatArray, int]:
    """The best point seen; the polish and its checks decide what it is worth."""
    import nlopt

    # nlopt has a runtime_error of its own, which is no RuntimeError.
    with contextlib.suppress(nlopt.RoundoffLimited, nlopt.runtime_error, RuntimeError, ValueError):
        if len(objective.start):
            make().optimize(objective.start)
    return objective.best, objective.passes


SEARCH = get(DEFAULT)
