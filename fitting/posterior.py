"""The posterior by emcee, with a batched likelihood and proposals that know the mode.

The likelihood holds the independent errors. Errors that the samples share are not learnt from the
data: each draw is moved by a random draw of every shared term, as GUM supplement 1 propagates
them. Priors are flat between the bounds of the parameters.
"""

from __future__ import annotations

import warnings as python_warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import emcee
import numpy as np

from gonio.files import atomic_path
from gonio.fitting.optimise import Optimum
from gonio.fitting.problem import Problem
from gonio.fitting.result import PosteriorSummary
from gonio.fitting.uncertainty import Uncertainty
from gonio.geometry import FloatArray
from gonio.kernels import map_blocks
from gonio.models import Model

WALKERS = 32
BURN_IN = 50
BLOCK_STEPS = 100
MAX_STEPS = 5000
CHAIN_LENGTHS = 50  # autocorrelation times that a chain must be long
MAX_R_HAT = 1.01
DEGREES = 5.0  # of the Student-t proposal: heavier tails than the posterior's
EXACT_MEMBERS = 50_000  # with so few cell members every likelihood integrates over the cells
CHECKED_DRAWS = 8
TOLERANCE = 0.05  # largest error of a log-likelihood that the cell factors may make

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Chain:
    """Draws of the posterior.

    Parameters
    ----------
    draws : ndarray, shape (walkers, steps, parameters)
        Python units, burn-in removed, shared terms added.
    tau : float
        Longest integrated autocorrelation time, steps; infinite where it cannot be told.
    r_hat, ess : float
        Largest split R-hat and smallest effective number of draws, of the sampled chain.
    acceptance : float
    warnings : list of str
    """

    draws: FloatArray
    tau: float
    r_hat: float
    ess: float
    acceptance: float
    warnings: list[str]

    @property
    def n_steps(self) -> int:
        """Steps a walker after the burn-in."""
        return int(self.draws.shape[1])

    @property
    def converged(self) -> bool:
        """Long against tau, and R-hat near 1."""
        return self.n_steps >= CHAIN_LENGTHS * self.tau and self.r_hat < MAX_R_HAT

    def summary(self, path: str | None) -> PosteriorSummary:
        """The part of the chain that stands in a fit's JSON document."""
        tau = self.tau if np.isfinite(self.tau) else float(self.n_steps)
        return PosteriorSummary(self.ess, self.r_hat, tau, self.acceptance, self.converged, path)

    def save(self, path: Path, model: Model) -> None:
        """Write the draws as netCDF with a group `posterior`, angles in degrees.

        `arviz.from_netcdf` opens it.
        """
        import xarray as xr

        variables = {
            q.name: (
                ("chain", "draw"),
                self.draws[:, :, j] * q.to_file(1.0),
                {"units": q.file_unit or "1"},
            )
            for j, q in enumerate(model.parameters)
        }
        walkers, steps, _ = self.draws.shape
        dataset = xr.Dataset(
            variables,
            coords={"chain": np.arange(walkers), "draw": np.arange(steps)},
            attrs={"model": model.name, "sampler": f"emcee {emcee.__version__}"},
        )
        with atomic_path(path) as temporary:
            dataset.to_netcdf(temporary, group="posterior", engine="h5netcdf")


def sample(
    problem: Problem,
    optimum: Optimum,
    errors: Uncertainty,
    *,
    seed: int,
    max_steps: int = MAX_STEPS,
    progress: Progress | None = None,
) -> Chain:
    """Sample the posterior until it has converged or `max_steps` are done.

    Parameters
    ----------
    problem : Problem
        With the weights of the least-squares minimum.
    optimum : Optimum
    errors : Uncertainty
        Its noise scale widens the likelihood, its shared terms move the draws.
    seed : int
        One seed, one chain, whatever the number of threads.
    progress : callable, optional
        Called with (steps done, most steps).
    """
    rng = np.random.default_rng(seed)
    likelihood = _Likelihood(problem, optimum.p, errors.noise_scale)
    walkers, state, acceptance = _run(
        problem, optimum, errors, likelihood, rng, max_steps, progress
    )
    notes = []
    if not likelihood.exact:
        worst = likelihood.worst_error(walkers, rng)
        if worst > TOLERANCE:
            likelihood = likelihood.made_exact()
            walkers, state, acceptance = _run(
                problem, optimum, errors, likelihood, rng, max_steps, progress
            )
            notes.append(
                "the lobe changes over the cells within the posterior: the likelihood was "
                "integrated over every cell, which is slower."
            )
    tau, r_hat, ess = state
    draws = _with_shared(problem, walkers, errors, rng)
    return Chain(draws, tau, r_hat, ess, acceptance, notes)


class _Likelihood:
    """Log-likelihood of a batch of parameter vectors.

    The model is taken at one direction a sample times a factor that integrates it over the cell;
    the factor is expanded to first order in the parameters about the mode. `worst_error` tells
    what this costs over the posterior; with few samples the cells are integrated over every time.
    """

    def __init__(self, problem: Problem, mode: FloatArray, scale: float) -> None:
        self.problem = problem
        self.scale = scale
        self.exact = len(problem.cells.weight) <= EXACT_MEMBERS
        _, w_r = problem.samples.directions.vectors()
        self.w_r = np.ascontiguousarray(w_r)
        self.mode = mode
        self.factor = self._factors()
        self.lower = np.array([q.lower for q in problem.parameters])
        self.upper = np.array([q.upper for q in problem.parameters])

    def _factors(self) -> FloatArray:
        """Integral over the cell by value at its centre, and its derivatives, (N, 1 + P)."""
        problem = self.problem
        centre, centre_slope = problem.model.gradient(
            problem.w_i, self.w_r, self.mode, threads=problem.threads
        )
        cell, cell_slope = problem.jacobian(self.mode)
        safe = np.where(centre != 0, centre, 1.0)
        ratio = np.where(centre != 0, cell / safe, 1.0)
        slope = (cell_slope - ratio[:, None] * centre_slope) / safe[:, None]
        slope[centre == 0] = 0.0
        return np.concatenate([ratio[:, None], slope], axis=1)

    def __call__(self, batch: FloatArray) -> FloatArray:
        """Log-posterior of each row of `batch`; -inf outside the bounds."""
        inside = np.all((batch >= self.lower) & (batch <= self.upper), axis=1)
        result = np.full(len(batch), -np.inf)
        if inside.any():
            chi2 = self._chi2(np.ascontiguousarray(batch[inside]))
            result[inside] = -0.5 * chi2 / self.scale**2
        return result

    def _chi2(self, batch: FloatArray) -> FloatArray:
        problem = self.problem
        if self.exact:
            return np.array([problem.chi2(p) for p in batch])
        block = 16384
        parts = np.empty((-(-problem.n // block), len(batch)))
        work = problem.model.loops.batch_chi2
        value = problem.samples.value

        def run(a: int, b: int) -> None:
            work(
                problem.w_i[a:b], self.w_r[a:b], self.factor[a:b], self.mode, value[a:b],
                problem.inverse_variance[a:b], batch, parts[a // block],
            )  # fmt: skip

        map_blocks(run, problem.n, threads=problem.threads, block=block)
        return np.asarray(parts.sum(axis=0))

    def worst_error(self, walkers: FloatArray, rng: np.random.Generator) -> float:
        """Largest error of the log-likelihood ratio between posterior draws."""
        flat = walkers.reshape(-1, walkers.shape[-1])
        some = flat[rng.integers(0, len(flat), CHECKED_DRAWS)]
        fast = self._chi2(np.ascontiguousarray(some))
        slow = np.array([self.problem.chi2(p) for p in some])
        difference = (fast - slow) / (2 * self.scale**2)
        return float(np.ptp(difference))

    def made_exact(self) -> _Likelihood:
        """The same likelihood, integrated over the cells every time."""
        self.exact = True
        return self


class _IndependenceMove(emcee.moves.RedBlueMove):  # type: ignore[misc]
    """Propose from a Student-t at the mode, whatever the walkers' places."""

    def __init__(self, mode: FloatArray, root: FloatArray) -> None:
        self.mode = mode
        self.root = root
        self.inverse = np.linalg.inv(root)
        super().__init__()

    def get_proposal(
        self, sample: FloatArray, complement: Any, random: np.random.RandomState
    ) -> tuple[FloatArray, FloatArray]:
        """New places and the log of the ratio of proposal densities, old over new."""
        n, d = sample.shape
        z = random.standard_normal((n, d))
        z /= np.sqrt(random.chisquare(DEGREES, (n, 1)) / DEGREES)
        proposed = self.mode + z @ self.root.T
        return proposed, self._log_density(sample) - self._log_density(proposed)

    def _log_density(self, p: FloatArray) -> FloatArray:
        z = (p - self.mode) @ self.inverse.T
        d = p.shape[1]
        return np.asarray(-(DEGREES + d) / 2 * np.log1p(np.sum(z * z, axis=1) / DEGREES))


class _SnookerMove(emcee.moves.RedBlueMove):  # type: ignore[misc]
    """Differential evolution along the line through another walker (ter Braak & Vrugt 2008).

    emcee's own move neither normalises the direction of the line nor takes the whole ratio of
    the distances, and so does not leave the posterior as it is.
    """

    def __init__(self) -> None:
        super().__init__(nsplits=4)

    def get_proposal(
        self, sample: FloatArray, complement: Any, random: np.random.RandomState
    ) -> tuple[FloatArray, FloatArray]:
        """New places q and (d - 1) log(|q - z| / |x - z|)."""
        n, d = sample.shape
        z, z1, z2 = (c[random.randint(len(c), size=n)] for c in complement)
        line = sample - z
        length = np.linalg.norm(line, axis=1)
        unit = line / length[:, None]
        proposed = sample + 1.7 * np.sum(unit * (z1 - z2), axis=1)[:, None] * unit
        return proposed, (d - 1) * np.log(np.linalg.norm(proposed - z, axis=1) / length)


def _run(
    problem: Problem,
    optimum: Optimum,
    errors: Uncertainty,
    likelihood: _Likelihood,
    rng: np.random.Generator,
    max_steps: int,
    progress: Progress | None,
) -> tuple[FloatArray, tuple[float, float, float], float]:
    """Walkers (walkers, steps, P) with (tau, R-hat, ESS) and the acceptance."""
    root = _proposal_root(problem, optimum, errors)
    moves = [
        (_IndependenceMove(optimum.p, root), 0.6),
        (emcee.moves.DEMove(), 0.3),
        (_SnookerMove(), 0.1),
    ]
    n_p = len(optimum.p)
    sampler = emcee.EnsembleSampler(WALKERS, n_p, likelihood, moves=moves, vectorize=True)
    # emcee keeps a legacy generator; its `random_state` setter ignores a Generator silently, so
    # the state of a seeded RandomState is handed over with the start.
    legacy = np.random.RandomState(np.random.MT19937(int(rng.integers(0, 2**63))))
    start = _start(likelihood, optimum.p, root, rng)
    state = emcee.State(start, random_state=legacy.get_state())
    state = sampler.run_mcmc(state, BURN_IN)
    sampler.reset()
    done = 0
    measures = (np.inf, np.inf, 0.0)
    while done < max_steps:
        state = sampler.run_mcmc(state, BLOCK_STEPS)
        done += BLOCK_STEPS
        if progress is not None:
            progress(done, max_steps)
        measures = _measures(sampler.get_chain())
        if done >= CHAIN_LENGTHS * measures[0] and measures[1] < MAX_R_HAT:
            break
    chain = np.swapaxes(sampler.get_chain(), 0, 1)
    return chain, measures, float(np.mean(sampler.acceptance_fraction))


def _measures(chain: FloatArray) -> tuple[float, float, float]:
    """Longest autocorrelation time, largest split R-hat, smallest ESS of a (steps, walkers, P)."""
    with python_warnings.catch_warnings():
        python_warnings.simplefilter("ignore")  # arviz announces its next major version
        import arviz

        tau = emcee.autocorr.integrated_time(chain, tol=0, quiet=True)
        columns = [np.ascontiguousarray(chain[:, :, j].T) for j in range(chain.shape[2])]
        r_hat = [float(arviz.rhat(c, method="split")) for c in columns]
        ess = [float(arviz.ess(c, method="bulk")) for c in columns]
    if not (np.all(np.isfinite(tau)) and np.all(np.isfinite(r_hat))):
        return np.inf, np.inf, 0.0
    return float(np.max(tau)), max(r_hat), min(ess)


def _proposal_root(problem: Problem, optimum: Optimum, errors: Uncertainty) -> FloatArray:
    """Matrix whose square is the proposal's covariance.

    From the curvature where the data determine a parameter; one at a bound or undetermined is
    given the width that its own curvature allows, at most a third of its range.
    """
    n_p = len(optimum.p)
    covariance = errors.independent.copy()
    for j, q in enumerate(problem.parameters):
        if not errors.determined[j]:
            widest = (q.upper - q.lower) / 3
            information = optimum.curvature[j, j] / errors.noise_scale**2
            width = widest if information <= 0 else min(1 / np.sqrt(information), widest)
            covariance[j, :] = covariance[:, j] = 0.0
            covariance[j, j] = width**2
    scale = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(scale, scale) + 1e-12 * np.eye(n_p)
    return np.asarray(scale[:, None] * np.linalg.cholesky(correlation))


def _start(
    likelihood: _Likelihood, mode: FloatArray, root: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Walkers scattered about the mode, mirrored at the bounds."""
    places = mode + rng.standard_normal((WALKERS, len(mode))) @ root.T
    lower, upper = likelihood.lower, likelihood.upper
    places = np.where(places < lower, 2 * lower - places, places)
    places = np.where(places > upper, 2 * upper - places, places)
    # A place mirrored beyond the other bound is drawn anywhere between them.
    anywhere = lower + (upper - lower) * rng.random(places.shape)
    return np.where((places < lower) | (places > upper), anywhere, places)


def _with_shared(
    problem: Problem, walkers: FloatArray, errors: Uncertainty, rng: np.random.Generator
) -> FloatArray:
    """Each draw moved by a random draw of every shared term, held inside the bounds."""
    draws = walkers.copy()
    for moves in errors.shared.values():
        draws += rng.standard_normal((*walkers.shape[:2], len(moves))) @ moves
    lower = [q.lower for q in problem.parameters]
    upper = [q.upper for q in problem.parameters]
    return np.clip(draws, lower, upper)
