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
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray

RIDGE = 1e-4  # a prior sd of 10^4 ranges where the data say nothing of an amplitude
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
        self._triangle = np.triu_indices(len(self.linear))
        self.exact = True  # the likelihood integrates over every cell
        # Amplitudes whose sum is limited are sampled: the Gaussian is integrated over a box.
        limited = np.flatnonzero(problem.sum_limit)
        self.limited = limited if np.isin(limited, self.sampled).all() else limited[:0]
        self.limit = problem.sum_limit[self.limited]
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
            inside_sums = self.sums(p)
            possible = (p[:, self.limited] * self.limit).sum(axis=1) <= 1
            value = self._log_integral(inside_sums)
            value += np.sum(x[inside][:, self.log], axis=1)  # dp = p dx
            for j in self.sampled:
                value += self.priors[j].log_density(p[:, j])
            density[inside] = np.where(np.isfinite(value) & possible, value, -np.inf)
            sums[inside] = inside_sums
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
        rows, columns = self._triangle
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
