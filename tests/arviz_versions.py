"""The functions of arviz that tests compare with, the same below version 1 and from it on."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # versions before 1 announce it
    import arviz

BEFORE_1 = int(arviz.__version__.split(".")[0]) < 1
from_netcdf = arviz.from_netcdf


# Arrays of (chains, steps) are what versions before 1 expect; later ones want to be told.
_AXES = {} if BEFORE_1 else {"chain_axis": 0, "draw_axis": 1}


def rhat(chains: np.ndarray) -> float:
    """Rank-normalised R-hat of chains (chains, steps) of one variable."""
    return float(arviz.rhat(chains, method="rank", **_AXES))


def ess(chains: np.ndarray, method: str) -> float:
    """Effective number of draws of chains (chains, steps) of one variable, "bulk" or "tail"."""
    quantiles = {} if BEFORE_1 or method == "bulk" else {"prob": (0.05, 0.95)}
    return float(arviz.ess(chains, method=method, **_AXES, **quantiles))


def psislw(log_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pareto-smoothed log weights and k-hat of each row."""
    if BEFORE_1:
        smoothed, k_hat = arviz.psislw(log_weights.copy())
    else:
        from arviz_stats.base import array_stats

        # It is made for leave-one-out and takes the log-likelihood, the negative of the weights.
        smoothed, k_hat = array_stats.psislw(-log_weights)
    return np.asarray(smoothed), np.atleast_1d(k_hat)


def group_names(data: Any) -> set[str]:
    """Names of the groups of what `from_netcdf` returns."""
    groups = data.groups() if callable(data.groups) else data.groups
    return {name.strip("/") for name in groups} - {""}
