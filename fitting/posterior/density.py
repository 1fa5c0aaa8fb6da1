"""What a sampler samples: the posterior with up to two amplitudes integrated out in closed form.

With f linear in the amplitudes a, chi2 is c - 2 g.d + d.H d in d = a - a_ref. Where their priors
are flat or Gaussian inside bounds, a given the other parameters theta is a Gaussian cut at the
bounds, and its integral leaves

    ln p(theta | y) = -(c - g.H^-1 g)/2 - ln det(H)/2 + ln P(box) + ln prior(theta)

with H, g, c divided by the square of the noise scale and the priors' precision added, and P(box)
the share of that Gaussian between the bounds. a is drawn from it afterwards. The other parameters
are sampled by their logarithm where they are so declared.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from gonio.fitting.posterior import truncated_normal
from gonio.fitting.posterior.priors import Prior
from gonio.fitting.problem.problem import Problem
from gonio.geometry import FloatArray
from gonio.kernels import map_blocks, moment_loops_for

AMPLITUDES = 2  # integrated out at most
EXACT_MEMBERS = 50_000  # with so few cell members every likelihood integrates over the cells
SAMPLES = 4096  # of one piece of work: their directions fit the second cache
VECTORS = 64  # parameter vectors of one piece of work
RIDGE = 1e-4  # a prior sd of 10^4 ranges where the data say nothing of an amplitude
EXPANSION = 4.0  # standard deviations over which the cell factors are expanded
LARGEST_FACTOR = 100.0
CHECKED_DRAWS = 8
TOLERANCE = 0.05  # largest error of a log-likelihood that the cell factors may make


class Target(ABC):
    """A density over coordinates x, and how to come from there to all parameters.

    Parameters
    ----------
    problem : Problem
    mode : ndarray, shape (P,)
    scale : float
        Factor on the independent uncertainties.
    priors : sequence of Prior, one a parameter
    linear : sequence of int
        Numbers of the parameters that are integrated out.
    """

    def __init__(
        self,
        problem: Problem,
        mode: FloatArray,
        scale: float,
        priors: Sequence[Prior],
        linear: Sequence[int] = (),
    ) -> None:
        self.problem = problem
        self.mode = np.array(mode, float)
        self.scale = scale
        self.priors = tuple(priors)
        parameters = problem.parameters
        self.linear = np.array(linear, np.int64)
        self.sampled = np.array([j for j in range(len(parameters)) if j not in linear], np.int64)
        self.lower = np.array([q.lower for q in parameters])
        self.upper = np.array([q.upper for q in parameters])
        self.exact = True  # the likelihood integrates over every cell
        # Amplitudes whose sum is limited are sampled: the Gaussian is integrated over a box.
        limited = np.array(problem.sum_at_most_one, np.int64)
        self.limited = limited if np.isin(limited, self.sampled).all() else limited[:0]
        self.log = np.array([parameters[j].scale == "log" for j in self.sampled], bool)
        self.x_lower = self.coordinates(self.lower)
        self.x_upper = self.coordinates(self.upper)

    @property
    def n_sums(self) -> int:
        """Numbers that `evaluate` keeps of each point."""
        n = len(self.linear)
        return 1 + n + n * (n + 1) // 2

    def coordinates(self, p: FloatArray) -> FloatArray:
        """x of parameter vectors (..., P)."""
        theta = np.array(p[..., self.sampled], float)
        theta[..., self.log] = np.log(theta[..., self.log])
        return theta

    def parameters(self, x: FloatArray) -> FloatArray:
        """Parameter vectors (B, P) of x (B, S), with the amplitudes of the mode."""
        theta = np.array(x, float)
        theta[:, self.log] = np.exp(theta[:, self.log])
        p = np.tile(self.mode, (len(x), 1))
        p[:, self.sampled] = np.clip(theta, self.lower[self.sampled], self.upper[self.sampled])
        return p

    def evaluate(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log-density (B,), -inf outside the bounds, and the sums (B, n_sums) of each point."""
        inside = np.all((x >= self.x_lower) & (x <= self.x_upper), axis=1)
        density = np.full(len(x), -np.inf)
        sums = np.zeros((len(x), self.n_sums))
        if inside.any():
            p = self.parameters(x[inside])
            found = self.sums(p)
            possible = p[:, self.limited].sum(axis=1) <= 1
            value = self._log_integral(found)
            value += np.sum(x[inside][:, self.log], axis=1)  # dp = p dx
            for j in self.sampled:
                value += self.priors[j].log_density(p[:, j])
            density[inside] = np.where(np.isfinite(value) & possible, value, -np.inf)
            sums[inside] = found
        return density, sums

    @abstractmethod
    def sums(self, p: FloatArray) -> FloatArray:
        """c, g and the upper triangle of H of parameter vectors (B, P)."""

    def draw(self, x: FloatArray, sums: FloatArray, rng: np.random.Generator) -> FloatArray:
        """All parameters (B, P) of points x, the amplitudes drawn from their Gaussian."""
        p = self.parameters(x)
        if len(self.linear):
            mean, covariance, _ = self._conditional(sums)
            box = self.lower[self.linear], self.upper[self.linear]
            p[:, self.linear] = truncated_normal.draw(mean, covariance, *box, rng)
        return p

    def log_likelihood(self, p: FloatArray) -> FloatArray:
        """-chi2/(2 scale^2) of whole parameter vectors, by way of the sums."""
        sums = self.sums(np.where(np.isin(np.arange(p.shape[1]), self.linear), self.mode, p))
        c, g, h = self._unpacked(sums)
        d = p[:, self.linear] - self.mode[self.linear]
        chi2 = c - 2 * np.sum(g * d, axis=1) + np.einsum("bi,bij,bj->b", d, h, d)
        return np.asarray(-chi2 / (2 * self.scale**2))

    def worst_error(self, draws: FloatArray, rng: np.random.Generator) -> float:
        """Largest error of the log-likelihood ratio between posterior draws (B, P)."""
        some = draws[rng.integers(0, len(draws), CHECKED_DRAWS)]
        exact = np.array([-self.problem.chi2(p) for p in some]) / (2 * self.scale**2)
        return float(np.ptp(self.log_likelihood(some) - exact))

    def _unpacked(self, sums: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        n = len(self.linear)
        h = np.empty((len(sums), n, n))
        rows, columns = np.triu_indices(n)
        h[:, rows, columns] = h[:, columns, rows] = sums[:, 1 + n :]
        return sums[:, 0], sums[:, 1 : 1 + n], h

    def _conditional(self, sums: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Mean (B, L) and covariance (B, L, L) of the amplitudes, and ln p at the mean."""
        c, g, h = self._unpacked(sums / self.scale**2)
        fall = c.copy()
        g, h = g.copy(), h.copy()
        for k, j in enumerate(self.linear):
            gaussian = self.priors[j].gaussian
            assert gaussian is not None
            mean, precision = gaussian
            away = mean - self.mode[j]
            g[:, k] += precision * away
            fall += precision * away**2
            h[:, k, k] += precision + (RIDGE / (self.upper[j] - self.lower[j])) ** 2
        covariance, log_det = _inverse(h)
        step = np.sum(covariance * g[:, None, :], axis=2)
        peak = -0.5 * np.maximum(fall - np.sum(g * step, axis=1), 0.0) - 0.5 * log_det
        return self.mode[self.linear] + step, covariance, peak

    def _log_integral(self, sums: FloatArray) -> FloatArray:
        """The likelihood integrated over the amplitudes between their bounds, up to a constant."""
        if len(self.linear) == 0:
            return np.asarray(-0.5 * sums[:, 0] / self.scale**2)
        finite = np.all(np.isfinite(sums), axis=1)
        result = np.full(len(sums), -np.inf)
        if finite.any():
            mean, covariance, peak = self._conditional(sums[finite])
            box = self.lower[self.linear], self.upper[self.linear]
            result[finite] = peak + truncated_normal.log_probability(mean, covariance, *box)
        return result


class WholeTarget(Target):
    """The posterior of any problem, over all its parameters, by its own chi-squared."""

    def sums(self, p: FloatArray) -> FloatArray:
        """chi2 alone."""
        return self.problem.batch_chi2(np.ascontiguousarray(p))[:, None]


class MarginalTarget(Target):
    """The posterior of one model with independent noise, by compiled sums.

    Where samples have many cell members each part of f is taken at one of them a sample times a
    factor that integrates it over the cell; the factor is expanded to first order in the
    parameters about the mode, from differences a standard deviation wide. `worst_error` tells
    what this costs over the posterior; with few members the cells are integrated over every time.
    """

    def __init__(
        self,
        problem: Problem,
        mode: FloatArray,
        scale: float,
        priors: Sequence[Prior],
        spread: FloatArray,
        *,
        amplitudes: int = AMPLITUDES,
    ) -> None:
        flagged = [
            j for j, q in enumerate(problem.parameters)
            if q.linear and priors[j].gaussian is not None
        ]  # fmt: skip
        super().__init__(problem, mode, scale, priors, flagged[:amplitudes])
        model = problem.model
        self.loops = moment_loops_for(model.kernel, len(mode), tuple(map(int, self.linear)))
        self.plain = problem.samples.cells is None
        self.exact = self.plain or len(problem.cells.weight) <= EXACT_MEMBERS
        self.w_r = self._directions()
        components = np.concatenate([problem.w_i.T, self.w_r.T])
        self.blocks = [(a, min(a + SAMPLES, problem.n)) for a in range(0, problem.n, SAMPLES)]
        self.components = [np.ascontiguousarray(components[:, a:b]) for a, b in self.blocks]
        self.factors: list[FloatArray] = []
        # Beyond a few standard deviations a straight line is no guide: the factors stay.
        self.reach = EXPANSION * spread[self.sampled]
        if not self.exact:
            factors = self._factors(spread)
            self.factors = [np.ascontiguousarray(factors[:, :, a:b]) for a, b in self.blocks]

    def _directions(self) -> FloatArray:
        """One viewing direction a sample, (N, 3): of a cell the member that is brightest.

        At the foot of a lobe the middle of a cell may see a millionth of what the cell does.
        """
        problem = self.problem
        if self.exact:
            return np.ascontiguousarray(problem.samples.directions.vectors()[1])
        cells = problem.cells
        counts = np.diff(cells.offsets)
        f = problem.model.evaluate(
            np.repeat(problem.w_i, counts, axis=0), cells.w_r, self.mode, threads=problem.threads
        )
        largest = np.repeat(np.maximum.reduceat(f, cells.offsets[:-1]), counts)
        owner = np.repeat(np.arange(problem.n), counts)
        brightest = np.flatnonzero(f == largest)
        _, first = np.unique(owner[brightest], return_index=True)
        return np.ascontiguousarray(cells.w_r[brightest[first]])

    def sums(self, p: FloatArray) -> FloatArray:
        """c, g and H: samples and vectors in pieces that do not depend on the threads."""
        problem = self.problem
        pieces = [(k, v) for k in range(len(self.blocks)) for v in range(0, len(p), VECTORS)]
        parts = np.empty((len(self.blocks), len(p), self.n_sums))
        batch = np.ascontiguousarray(p)

        def run(first: int, last: int) -> None:
            for k, v in pieces[first:last]:
                self._piece(k, batch[v : v + VECTORS], parts[k, v : v + VECTORS])

        # Starting threads takes longer than a few walkers on a few samples.
        small = problem.n * len(p) < 200_000
        map_blocks(run, len(pieces), threads=1 if small else problem.threads, block=1)
        return np.asarray(parts.sum(axis=0))

    def _piece(self, k: int, batch: FloatArray, out: FloatArray) -> None:
        problem = self.problem
        a, b = self.blocks[k]
        value, weight = problem.samples.value[a:b], problem.inverse_variance[a:b]
        if self.plain:
            self.loops.moments(self.components[k], value, weight, batch, out)
        elif self.exact:
            c = problem.cells
            self.loops.cell_moments(
                problem.w_i, c.w_r, c.weight, c.offsets, a, value, weight, batch, out
            )
        else:
            steps = batch[:, self.sampled] - self.mode[self.sampled]
            self.loops.factored_moments(
                self.components[k], self.factors[k], np.clip(steps, -self.reach, self.reach),
                self.linear, value, weight, batch, out,
            )  # fmt: skip

    def _factors(self, spread: FloatArray) -> FloatArray:
        """Integral over the cell by value at its centre of every part, and its slopes."""
        ratio = self._ratio(self.mode)
        slopes = []
        for j in self.sampled:
            ends = [self.mode.copy(), self.mode.copy()]
            for p, side in zip(ends, (-1, 1), strict=True):
                p[j] = np.clip(p[j] + side * spread[j], self.lower[j], self.upper[j])
            width = ends[1][j] - ends[0][j]
            change = self._ratio(ends[1]) - self._ratio(ends[0])
            slopes.append(change / width if width > 0 else np.zeros_like(ratio))
        return np.stack([ratio, *slopes], axis=1)

    def _ratio(self, p: FloatArray) -> FloatArray:
        """Cell over centre of what stays without the amplitudes, and by amplitude, (1 + L, N)."""
        problem = self.problem
        at_centre = problem.model.gradient(problem.w_i, self.w_r, p, threads=problem.threads)
        parts = []
        for f, jac in (at_centre, problem.jacobian(p)):
            amplitudes = jac[:, self.linear].T
            rest = f - p[self.linear] @ amplitudes
            # What is left by rounding is nothing.
            rest[np.abs(rest) < 1e-12 * np.abs(f)] = 0.0
            parts.append(np.concatenate([rest[None, :], amplitudes]))
        centre, cell = parts
        ratio = np.ones_like(centre)
        ratio = np.divide(cell, centre, out=ratio, where=centre != 0)
        # Where the centre of a cell sees nothing of a lobe the ratio is no guide to other lobes.
        return np.asarray(np.clip(ratio, -LARGEST_FACTOR, LARGEST_FACTOR))


def _inverse(h: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Inverses and log-determinants of positive definite matrices (B, 1, 1) or (B, 2, 2)."""
    if h.shape[1] == 1:
        return 1 / h, np.log(h[:, 0, 0])
    size = np.sqrt(np.diagonal(h, axis1=1, axis2=2))
    # The same direction twice: keep the matrix from being singular by rounding.
    off = np.clip(h[:, 0, 1] / (size[:, 0] * size[:, 1]), -1 + 1e-13, 1 - 1e-13)
    rest = (1 - off) * (1 + off)
    inverse = np.empty_like(h)
    inverse[:, 0, 0] = 1 / (size[:, 0] ** 2 * rest)
    inverse[:, 1, 1] = 1 / (size[:, 1] ** 2 * rest)
    inverse[:, 0, 1] = inverse[:, 1, 0] = -off / (size[:, 0] * size[:, 1] * rest)
    return inverse, np.log(rest) + 2 * np.sum(np.log(size), axis=1)
