"""Proposals that know the posterior: a mixture of Student-t's fitted to weighted draws.

A last part of the mixture is the whole range between the bounds, and one before it is as wide as
three times all that the fit has seen: what the fitted parts miss these find, and the importance
weights then tell. Where draws crowd at a bound the Student-t's are mirrored at it, so that nothing
of them is lost beyond.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from gonio.fitting.posterior.density import Target
from gonio.geometry import FloatArray

DEGREES = 5.0  # of the Student-t's: heavier tails than the posterior's
WIDER = 3.0
SHARES = (0.94, 0.04, 0.02)  # of the fitted parts, the wide one and the range
FITTED_SHARES = (0.82, 0.08, 0.1)  # the same where one Student-t did not do
WIDE_SHARES = (0.5, 0.25, 0.25)  # of a first look
PILOT = 768
PILOT_ROUNDS = 4
ENOUGH = 150.0  # effective draws that tell a covariance
LEAST = 50.0  # effective draws that a covariance is taken from
PARTS = 8
DRAWS_A_PART = 40.0
ITERATIONS = 30
NEAR = 0.25  # whole standard deviations that count as near a bound
CROWDED = 0.03  # share of the weight near a bound that has the parts mirrored
FLOOR = 1e-3  # of the whole covariance, so that no part shrinks to a draw


@dataclass(frozen=True)
class Weighted:
    """Draws of a proposal.

    Parameters
    ----------
    x : ndarray, shape (n, S)
    density, log_weight : ndarray, shape (n,)
        Log of the target, and that over the proposal's.
    sums : ndarray, shape (n, sums)
        As `Target.evaluate` gives them.
    """

    x: FloatArray
    density: FloatArray
    log_weight: FloatArray
    sums: FloatArray

    @property
    def weight(self) -> FloatArray:
        """Weights that add up to 1; all 0 where no draw has any."""
        top = self.log_weight.max()
        if not np.isfinite(top):
            return np.zeros(len(self.x))
        share = np.exp(self.log_weight - top)
        return np.asarray(share / share.sum())

    @property
    def effective(self) -> float:
        """Effective number of draws, 1/sum w^2."""
        return _effective(self.weight)

    def tempered(self, least: float) -> FloatArray:
        """Weights to the largest power up to 1 at which `least` draws count; they add up to 1.

        Where the proposal has missed most of the target this leads it there step by step.
        """
        weight = self.weight
        if _effective(weight) >= least or not np.isfinite(self.log_weight.max()):
            return weight
        low, high = -20.0, 0.0  # log2 of the power
        for _ in range(12):
            power = 2 ** ((low + high) / 2)
            some = np.exp(power * (self.log_weight - self.log_weight.max()))
            some /= some.sum()
            if _effective(some) >= least:
                low, weight = float(np.log2(power)), some
            else:
                high = float(np.log2(power))
        return weight

    def joined(self, other: Weighted) -> Weighted:
        """These draws, and more of the same proposal."""
        return Weighted(
            np.concatenate([self.x, other.x]),
            np.concatenate([self.density, other.density]),
            np.concatenate([self.log_weight, other.log_weight]),
            np.concatenate([self.sums, other.sums]),
        )


@dataclass(frozen=True)
class Proposal:
    """A mixture of Student-t's, with a wide one and the range between the bounds.

    Parameters
    ----------
    centres : ndarray, shape (K, S)
    roots : ndarray, shape (K, S, S)
        Lower triangles whose squares are the scales. The last part is the wide one.
    shares : ndarray, shape (K + 1,)
        Of the parts, then of the range.
    lower, upper : ndarray, shape (S,)
    mirrored : ndarray of bool, shape (2, S)
        Lower and upper bounds at which draws of the parts are mirrored.
    """

    centres: FloatArray
    roots: FloatArray
    shares: FloatArray
    lower: FloatArray
    upper: FloatArray
    mirrored: NDArray[np.bool_]

    @classmethod
    def about(
        cls,
        target: Target,
        centres: FloatArray,
        covariances: FloatArray,
        parts: FloatArray,
        whole: tuple[FloatArray, FloatArray],
        shares: tuple[float, float, float],
        mirrored: NDArray[np.bool_] | None = None,
    ) -> Proposal:
        """Parts with these shares among them, and what is about all of them: (mean, covariance)."""
        width = target.x_upper - target.x_lower
        roots = [cholesky(c, width) for c in covariances]
        roots.append(WIDER * cholesky(whole[1], width))
        return cls(
            np.concatenate([centres, whole[0][None, :]]),
            np.stack(roots),
            np.concatenate([shares[0] * parts, shares[1:]]),
            target.x_lower,
            target.x_upper,
            np.zeros((2, len(width)), bool) if mirrored is None else mirrored,
        )

    @cached_property
    def _inverse(self) -> FloatArray:
        return np.asarray(np.linalg.inv(self.roots), float)

    @cached_property
    def _constants(self) -> FloatArray:
        """Log of share times density at the centre, by part; of the range last."""
        d = self.centres.shape[1]
        t = gammaln((DEGREES + d) / 2) - gammaln(DEGREES / 2) - d / 2 * np.log(DEGREES * np.pi)
        peak = t - np.sum(np.log(np.diagonal(self.roots, axis1=1, axis2=2)), axis=1)
        flat = -np.sum(np.log(self.upper - self.lower))
        return np.asarray(np.log(self.shares) + np.append(peak, flat))

    def draw(self, n: int, rng: np.random.Generator | np.random.RandomState) -> FloatArray:
        """n points, in mixed order."""
        k, d = self.centres.shape
        steps = np.cumsum(self.shares)
        part = np.minimum(np.searchsorted(steps, steps[-1] * rng.random(n), side="right"), k)
        z = rng.standard_normal((n, d))
        z /= np.sqrt(rng.chisquare(DEGREES, (n, 1)) / DEGREES)
        anywhere = self.lower + (self.upper - self.lower) * rng.random((n, d))
        at = np.minimum(part, k - 1)
        near = self.centres[at] + np.einsum("nij,nj->ni", self.roots[at], z)
        near = np.where(self.mirrored[0] & (near < self.lower), 2 * self.lower - near, near)
        near = np.where(self.mirrored[1] & (near > self.upper), 2 * self.upper - near, near)
        return np.where((part == k)[:, None], anywhere, near)

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log of the density inside the bounds."""
        d = self.centres.shape[1]
        parts = [np.full((1, len(x)), self._constants[-1])]
        for image in self._images(x):
            z = np.einsum("kij,knj->kni", self._inverse, image - self.centres[:, None, :])
            fall = -(DEGREES + d) / 2 * np.log1p(np.sum(z * z, axis=2) / DEGREES)
            parts.append(fall + self._constants[:-1, None])
        every = np.concatenate(parts)
        top = every.max(axis=0)
        return np.asarray(top + np.log(np.sum(np.exp(every - top), axis=0)))

    def _images(self, x: FloatArray) -> Iterator[FloatArray]:
        """Points that are the points x once they are mirrored, x itself first."""
        choices = [[0, *(1 + np.flatnonzero(sides))] for sides in self.mirrored.T]
        for choice in itertools.product(*choices):
            image = x.copy()
            for j, side in enumerate(choice):
                if side:
                    bound = self.lower[j] if side == 1 else self.upper[j]
                    image[:, j] = 2 * bound - x[:, j]
            yield image

    def weighted(self, target: Target, n: int, rng: np.random.Generator) -> Weighted:
        """n draws with their weights."""
        x = self.draw(n, rng)
        density, sums = target.evaluate(x)
        return Weighted(x, density, density - self.log_density(x), sums)


def pilot(
    target: Target, covariance: FloatArray, rng: np.random.Generator
) -> tuple[Proposal, FloatArray]:
    """A proposal fitted to draws of a wide one, and the log-weights of the last of these.

    Parameters
    ----------
    target : Target
    covariance : ndarray, shape (S, S)
        Of the sampled coordinates about the mode: a first guess.
    rng : numpy.random.Generator
    """
    centre = target.coordinates(target.mode)
    weights = np.empty(0)
    one = np.ones(1)
    for _ in range(PILOT_ROUNDS):
        whole = centre, covariance
        wide = Proposal.about(target, centre[None, :], covariance[None, :], one, whole, WIDE_SHARES)
        proposed = wide.weighted(target, PILOT, rng)
        weights = proposed.log_weight
        if np.isfinite(weights).sum() > LEAST:
            centre, covariance = _moments(proposed.x, proposed.tempered(LEAST))
        if proposed.effective >= ENOUGH:
            break
    whole = centre, covariance
    return Proposal.about(target, centre[None, :], covariance[None, :], one, whole, SHARES), weights


def fitted(target: Target, proposed: Weighted, rng: np.random.Generator) -> Proposal | None:
    """A mixture fitted to weighted draws by expectation maximisation; None where too few count."""
    if np.isfinite(proposed.log_weight).sum() < LEAST:
        return None
    weight = proposed.tempered(4 * DRAWS_A_PART)
    n_parts = max(1, int(min(PARTS, _effective(weight) / DRAWS_A_PART)))
    kept = weight > 1e-12
    x, weight = proposed.x[kept], weight[kept]
    whole = _moments(x, weight)
    root = cholesky(whole[1], target.x_upper - target.x_lower)
    z = np.asarray(np.linalg.solve(root, (x - whole[0]).T).T, float)
    parts, centres, covariances = _mixture(z, weight, n_parts, rng)
    return Proposal.about(
        target,
        whole[0] + centres @ root.T,
        np.einsum("ij,kjl,ml->kim", root, covariances, root),
        parts,
        whole,
        FITTED_SHARES,
        _crowded(target, x, weight),
    )


def _crowded(target: Target, x: FloatArray, weight: FloatArray) -> NDArray[np.bool_]:
    """Bounds near which much of the weight lies, (2, S)."""
    near = NEAR * np.sqrt(np.diag(_moments(x, weight)[1]))
    sides = (x < target.x_lower + near, x > target.x_upper - near)
    return np.array([weight @ side > CROWDED for side in sides])


def cholesky(covariance: FloatArray, width: FloatArray) -> FloatArray:
    """Root of a covariance, no standard deviation wider than the range."""
    sd = np.maximum(np.sqrt(np.diag(covariance)), 1e-9 * width)
    correlation = covariance / np.outer(sd, sd) + 1e-9 * np.eye(len(sd))
    return np.asarray(np.minimum(sd, width)[:, None] * np.linalg.cholesky(correlation))


def _effective(weight: FloatArray) -> float:
    square = float(np.sum(weight**2))
    return 1 / square if square > 0 else 0.0


def _moments(x: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    mean = weight @ x
    away = x - mean
    return mean, (weight[:, None] * away).T @ away


def _mixture(
    z: FloatArray, weight: FloatArray, n_parts: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Shares, means and covariances of Gaussians fitted to weighted points of unit covariance."""
    d = z.shape[1]
    centres = z[_far_apart(z, weight, n_parts, rng)]
    covariances = np.tile(np.eye(d) / n_parts ** (2 / d), (n_parts, 1, 1))
    shares = np.full(n_parts, 1 / n_parts)
    for _ in range(ITERATIONS):
        log_part = np.empty((n_parts, len(z)))
        for k in range(n_parts):
            root = np.linalg.cholesky(covariances[k])
            u = np.linalg.inv(root) @ (z - centres[k]).T
            log_part[k] = np.log(shares[k]) - np.sum(np.log(np.diag(root))) - np.sum(u * u, 0) / 2
        belongs = np.exp(log_part - logsumexp(log_part, axis=0)) * weight
        shares = np.maximum(belongs.sum(axis=1), 1e-6)
        centres = belongs @ z / shares[:, None]
        for k in range(n_parts):
            away = z - centres[k]
            covariances[k] = (belongs[k][:, None] * away).T @ away / shares[k] + FLOOR * np.eye(d)
        shares = shares / shares.sum()
    return shares, centres, covariances


def _far_apart(z: FloatArray, weight: FloatArray, n: int, rng: np.random.Generator) -> list[int]:
    """Points chosen by weight and by the square of the distance from those chosen before."""
    chosen = [int(rng.choice(len(z), p=weight / weight.sum()))]
    for _ in range(n - 1):
        square = np.min([np.sum((z - z[k]) ** 2, axis=1) for k in chosen], axis=0)
        share = weight * square
        chosen.append(int(rng.choice(len(z), p=share / share.sum())))
    return chosen
