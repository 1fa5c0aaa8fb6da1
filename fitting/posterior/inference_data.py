"""A posterior in memory as arviz takes it, with the log-likelihood of every sample on request."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigurationError
from gonio.fitting.posterior.chain import Chain
from gonio.fitting.posterior.predictive import predictive_groups
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray

MAX_BYTES = 200_000_000  # of the log-likelihood
MAX_DRAWS = 4000  # draws to which a long chain is thinned where the log-likelihood would be larger


def inference_data(
    chain: Chain, problem: Problem, *, scale: float, seed: int, log_likelihood: bool = False
) -> Any:
    """Groups posterior, posterior_predictive, observed_data and sample_stats; angles in radians.

    Parameters
    ----------
    chain : Chain
    problem : Problem
    scale : float
        Factor on the independent uncertainties.
    seed : int
        Of the noise in the predictive draws.
    log_likelihood : bool
        Add the group that `arviz.loo` needs, thinned to `MAX_BYTES`.

    Raises
    ------
    ConfigurationError
        If a log-likelihood is asked for where samples are not independent given the parameters.
    """
    groups = predictive_groups(chain, problem, scale, np.random.default_rng([seed, 1]))
    for j, q in enumerate(problem.parameters):
        attributes = {"units": q.unit or "1", "lower": q.lower, "upper": q.upper}
        groups["posterior"][q.name] = (("chain", "draw"), chain.draws[:, :, j], attributes)
    if log_likelihood:
        _check(problem)
        draws, which = _thinned(chain, problem.n)
        for name in ("posterior", "sample_stats"):
            groups[name] = groups[name].isel(draw=draws)
        groups["log_likelihood"] = _log_likelihood(chain, problem, scale, draws, which)
    return _packed(groups)


def _check(problem: Problem) -> None:
    why = ""
    if not problem.quadratic:
        why = f"loss {problem.law.name!r} is not chi2"
    elif problem.profiled:
        why = "shared errors are unknowns of this fit and make its samples depend on each other"
    if why:
        raise ConfigurationError(
            f"log_likelihood: {why}; fit with loss='chi2' and nuisance='none' for it."
        )


def _thinned(chain: Chain, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Steps of each chain and samples that are kept, evenly spread, within `MAX_BYTES`."""
    walkers, steps, _ = chain.draws.shape
    most = MAX_BYTES // 8
    if walkers * steps * n <= most:
        return np.arange(steps), np.arange(n)
    each = min(steps, max(1, MAX_DRAWS // walkers))
    samples = max(1, min(n, most // (walkers * each)))
    warnings.warn(
        f"the log-likelihood is thinned to {walkers * each} of {walkers * steps} draws and "
        f"{samples} of {n} samples, {MAX_BYTES // 1_000_000} MB; its scores are of these samples.",
        stacklevel=4,
    )
    return (
        np.linspace(0, steps - 1, each).round().astype(np.int64),
        np.linspace(0, n - 1, samples).round().astype(np.int64),
    )


def _log_likelihood(
    chain: Chain,
    problem: Problem,
    scale: float,
    draws: NDArray[np.int64],
    which: NDArray[np.int64],
) -> Any:
    """Log densities (chain, draw, sample) of the independent errors.

    Draws hold moves by the shared errors; given those errors the data move along, so that the
    densities are those of the draws before they were moved.
    """
    import xarray as xr

    own = chain.draws if chain.unmoved is None else chain.unmoved
    own = own[:, draws]
    some, at = (problem, which) if len(problem.pieces()) > 1 else (problem.at(which), slice(None))
    weight = some.inverse_variance[at] / scale**2
    constant = 0.5 * np.log(weight / (2 * np.pi))
    y = some.samples.value[at]
    out: FloatArray = np.empty((*own.shape[:2], len(which)))
    for row, p in zip(out.reshape(-1, len(which)), own.reshape(-1, own.shape[-1]), strict=True):
        row[:] = constant - 0.5 * weight * (y - some.values(p)[at]) ** 2
    return xr.Dataset(
        {"brdf": (("chain", "draw", "sample"), out)},
        coords={"chain": np.arange(len(out)), "draw": draws, "sample": which},
        attrs={
            "model": problem.name,
            "of": "independent errors; shared errors held at their stated values",
            "samples": f"{len(which)} of {problem.n}",
            "draws": f"{len(draws)} of {chain.n_steps} a chain",
        },
    )


def _packed(groups: dict[str, Any]) -> Any:
    """The groups as arviz takes them: its own type below version 1, a DataTree from there on.

    Without arviz, which is an extra of the package, the DataTree too: it needs xarray alone.
    """
    import xarray as xr

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # arviz announces its next major version
        try:
            from arviz import InferenceData
        except ImportError:
            pass
        else:
            return InferenceData(**groups)

    return xr.DataTree.from_dict({f"/{name}": dataset for name, dataset in groups.items()})
