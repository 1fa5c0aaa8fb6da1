"""Posteriors: effective draws a second, against emcee with a numpy model."""

from __future__ import annotations

import time
from collections.abc import Callable

import emcee
import numpy as np

from benchmarks.timing import Row
from gonio import models
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.posterior import sample as posterior
from gonio.fitting.posterior.convergence import autocorrelation_time
from gonio.fitting.uncertainty.at_minimum import uncertainties
from gonio.geometry import Directions, FloatArray
from gonio.samples import BRDFSamples

N = 5000
TRUTH = {"rho_d": 0.15, "rho_s": 0.19, "alpha_x": 0.088, "alpha_y": 0.13}
STEPS = 1000  # of plain emcee; it would take some 2000 to converge
ROUNDS = 3


def measured(n: int = N, seed: int = 0) -> BRDFSamples:
    """Ward's model at random directions with 1 % noise and 0.001 sr^-1."""
    rng = np.random.default_rng(seed)
    theta = np.radians(rng.uniform(0, 70, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    where = Directions(theta[0], phi[0], theta[1], phi[1])
    f = models.get("ward")(where, **TRUTH)
    sd = 0.01 * f + 1e-3
    return BRDFSamples(where, f + sd * rng.standard_normal(n), u_independent=sd)


def numpy_log_posterior(samples: BRDFSamples) -> Callable[[FloatArray], float]:
    """Flat priors and Gaussian noise in numpy, for one walker."""
    (x_i, y_i, z_i), (x_r, y_r, z_r) = (np.array(w.T) for w in samples.directions.vectors())
    bounds = [(q.lower, q.upper) for q in models.get("ward").parameters]
    lower, upper = np.array(bounds).T

    def log_posterior(p: FloatArray) -> float:
        if np.any(p < lower) or np.any(p > upper):
            return -np.inf
        rho_d, rho_s, alpha_x, alpha_y = p
        h_x, h_y, h_z = x_i + x_r, y_i + y_r, z_i + z_r
        exponent = ((h_x / alpha_x) ** 2 + (h_y / alpha_y) ** 2) / h_z**2
        lobe = np.exp(-exponent) / (4 * np.pi * alpha_x * alpha_y * np.sqrt(z_i * z_r))
        f = rho_d / np.pi + rho_s * lobe
        return float(-0.5 * np.sum(((samples.value - f) / samples.u_independent) ** 2))

    return log_posterior


def emcee_chains(samples: BRDFSamples, minimum: Minimum, sd: FloatArray) -> FloatArray:
    """emcee's stretch move from a ball about the minimum, (walkers, steps, parameters)."""
    sampler = emcee.EnsembleSampler(32, len(sd), numpy_log_posterior(samples))
    start = minimum.optimum.p + sd * np.random.default_rng(1).standard_normal((32, len(sd)))
    state = sampler.run_mcmc(start, 200)
    sampler.reset()
    sampler.run_mcmc(state, STEPS)
    return np.swapaxes(sampler.get_chain(), 0, 1)


def effective(chains: FloatArray) -> float:
    """Draws over the longest autocorrelation time, as emcee counts them."""
    return chains.shape[0] * chains.shape[1] / float(np.max(autocorrelation_time(chains)))


def run() -> list[Row]:
    """Effective draws a second on one thread, burn-in and searches included."""
    samples = measured()
    minimum = find_minimum(samples, models.get("ward"), threads=1)
    errors, _ = uncertainties(minimum)
    sd = np.sqrt(np.diag(errors.covariance))

    def ours(sampler: posterior.Sampler) -> FloatArray:
        problem, optimum = minimum.problem, minimum.optimum
        return posterior.sample(
            Minimum.of(problem, optimum, 1.0), errors, seed=1, sampler=sampler
        ).draws

    works: dict[str, Callable[[], FloatArray]] = {
        "plain": lambda: emcee_chains(samples, minimum, sd),
        "emcee": lambda: ours("emcee"),
        "marginal": lambda: ours("marginal"),
    }
    ours("marginal")  # compiles
    rates = dict.fromkeys(works, 0.0)
    drawn = {}
    for _ in range(ROUNDS):
        for name, work in works.items():
            start = time.perf_counter()
            drawn[name] = work()
            rate = effective(drawn[name]) / (time.perf_counter() - start)
            rates[name] = max(rates[name], rate)
    base = drawn["plain"].std(axis=(0, 1))
    rows = [
        Row(
            f"effective draws, plain emcee, {N} samples", rates["plain"], "", None,
            "stretch move, a numpy likelihood for each walker",
        )
    ]  # fmt: skip
    for name, text in (("emcee", "emcee's walkers, our moves"), ("marginal", "marginal sampler")):
        off = np.max(np.abs(drawn[name].std(axis=(0, 1)) / base - 1))
        rows.append(
            Row(
                f"effective draws, {text}", rates[name], "plain emcee",
                rates[name] / rates["plain"],
                f"standard deviations within {100 * off:.1f} % of plain emcee's",
            )
        )  # fmt: skip
    return rows
