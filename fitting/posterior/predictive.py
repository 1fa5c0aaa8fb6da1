"""Posterior predictive draws, and the file that holds a posterior for arviz.

A predictive draw is the model at a draw of the parameters, shared terms moved as the draws are,
with noise as the noise model says: what another instrument with this noise, free of the errors
that these samples share, would read. Data that lie outside far more often than they should speak
against the model.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.files import atomic_path
from gonio.fitting.posterior.chain import Chain
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray

MAX_DRAWS = 200
MIN_DRAWS = 20
MAX_VALUES = 1_000_000  # draws times samples that are kept


def predict(
    problem: Problem, draws: FloatArray, scale: float, rng: np.random.Generator
) -> FloatArray:
    """Values of the samples for each parameter vector of `draws` (B, P), noise added, (B, N).

    Parameters
    ----------
    problem : Problem
    draws : ndarray, shape (B, P)
    scale : float
        Factor on the independent uncertainties.
    rng : numpy.random.Generator
    """
    result = np.empty((len(draws), problem.n))
    for row, p in zip(result, draws, strict=True):
        f = problem.values(p)
        noise_known = problem.weights == "sd"
        variance = problem.variance(f) if noise_known else 1 / problem.inverse_variance
        row[:] = f + scale * np.sqrt(variance) * rng.standard_normal(problem.n)
    return result


def kept(chains: int, steps: int, n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which steps of each chain and which of n samples are predicted, evenly spread.

    Examples
    --------
    >>> steps, samples = kept(8, 640, 1000)
    >>> len(steps) * 8, len(samples)
    (200, 1000)
    >>> steps, samples = kept(8, 640, 1_000_000)
    >>> len(steps) * 8, len(samples)
    (24, 41666)
    """
    wanted = min(MAX_DRAWS, max(MIN_DRAWS, MAX_VALUES // n))
    each = min(steps, -(-wanted // chains))
    samples = min(n, MAX_VALUES // (chains * each))
    return (
        np.linspace(0, steps - 1, each).round().astype(np.int64),
        np.unique(np.linspace(0, n - 1, samples).round().astype(np.int64)),
    )


def save(chain: Chain, path: Path, problem: Problem, *, scale: float, seed: int) -> None:
    """Write a posterior as netCDF that `arviz.from_netcdf` opens, whole or not at all.

    Groups: posterior, posterior_predictive, observed_data, sample_stats; everything in the unit
    of files, angles in degrees. Of the predictive draws at most `MAX_VALUES` values are kept.
    """
    groups = predictive_groups(chain, problem, scale, np.random.default_rng([seed, 1]))
    with atomic_path(path) as temporary:
        for k, (name, dataset) in enumerate(groups.items()):
            dataset.to_netcdf(
                temporary, mode="a" if k else "w", group=name, engine="h5netcdf",
                encoding={v: {"zlib": True, "complevel": 1} for v in dataset.data_vars},
            )  # fmt: skip


def predictive_groups(
    chain: Chain, problem: Problem, scale: float, rng: np.random.Generator
) -> dict[str, Any]:
    """The groups of a file of draws as datasets, angles in degrees."""
    import xarray as xr

    walkers, steps, _ = chain.draws.shape
    at = {"chain": np.arange(walkers), "draw": np.arange(steps)}
    texts = [prior.text(q) for q, prior in zip(problem.parameters, chain.priors, strict=True)]
    about = {"model": problem.name, "sampler": chain.sampler, "converged": int(chain.converged)}
    if chain.allowance:
        about["allowance"] = chain.allowance
    posterior = xr.Dataset(
        {
            q.name: (
                ("chain", "draw"),
                chain.draws[:, :, j] * q.to_file(1.0),
                {
                    "units": q.file_unit or "1", "prior": texts[j],
                    "lower": q.to_file(q.lower), "upper": q.to_file(q.upper),
                },
            )
            for j, q in enumerate(problem.parameters)
        },
        coords=at,
        attrs={
            **about,
            "priors": "; ".join(
                f"{q.name} {text}" for q, text in zip(problem.parameters, texts, strict=True)
            ),
        },
    )  # fmt: skip
    some, which = kept(walkers, steps, problem.n)
    drawn = predict(problem, chain.draws[:, some].reshape(-1, chain.draws.shape[2]), scale, rng)
    predicted = xr.Dataset(
        {
            "brdf": (
                ("chain", "draw", "sample"),
                drawn[:, which].reshape(walkers, len(some), len(which)),
                {"units": "sr^-1"},
            )
        },
        coords={"chain": at["chain"], "draw": some, **_directions(problem, which)},
        attrs=about,
    )
    samples = problem.samples
    observed = {"brdf": ("sample", samples.value[which], {"units": "sr^-1"})}
    if samples.u_independent is not None:
        observed["u_brdf"] = ("sample", samples.u_independent[which], {"units": "sr^-1"})
    statistics = xr.Dataset(
        {"lp": (("chain", "draw"), chain.log_density)},
        coords=at,
        attrs={
            **about,
            "lp": "log of the sampled density, amplitudes integrated out, up to a constant",
            "acceptance": chain.acceptance,
            "k_hat": np.nan if chain.k_hat is None else chain.k_hat,
        },
    )
    return {
        "posterior": posterior,
        "posterior_predictive": predicted,
        "observed_data": xr.Dataset(observed, coords=_directions(problem, which)),
        "sample_stats": statistics,
    }


def _directions(problem: Problem, which: NDArray[np.int64]) -> dict[str, Any]:
    """Numbers of the samples and their directions in degrees."""
    d = problem.samples.directions
    angles = {
        name: (
            "sample",
            np.degrees(np.broadcast_to(getattr(d, name), (problem.n,))[which]),
            {"units": "deg"},
        )
        for name in ("theta_i", "phi_i", "theta_r", "phi_r")
    }
    return {"sample": which, **angles}
