"""Goodness of fit with the noise model: is what is left over noise, and if not, where it lives.

Residuals are divided by their standard uncertainties (z) and whatever the parameters or the shared
errors could do is projected out of them. Groups of samples (cells of the viewing hemisphere about
the lobe, rings about the mirror direction, angles) are then compared with the scatter inside them:
for normal independent errors

F = (S / K) / ((Q - S) / (n - K))

follows Fisher's distribution with K and n - K degrees of freedom, Q being the sum of squares that
is left, n its degrees of freedom, and S = t^T C^+ t the part of it that lies in the sums t over the
groups, with covariance C of rank K. The size of the noise drops out. Rao 1973, Linear Statistical
Inference, sec. 4b.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.gauss_newton import Optimum
from gonio.fitting.problem.problem import Problem
from gonio.fitting.result import plain
from gonio.fitting.uncertainty.information import shared_columns, thinned, weighted_square
from gonio.geometry import FloatArray, unit_vectors

ALARM = 0.01  # share of right models in which structure is told
OUTSIDE = 0.0025  # one-sided probability of chi-squared beyond which its size is told,
MATERIAL = 1.25  # and factor by which chi2/dof must miss 1: smaller misses change no decision
ROUNDING = 1e-10  # of the largest value: smaller residuals are no residuals
LEAST = 8  # samples in a group
MOST_INCIDENCES = 12
RINGS_DEG = (1, 2, 3, 4.5, 6, 8, 11, 15, 20, 30, 45, 60, 90)  # edges about the mirror direction
CELLS = ((0.0, 1), (25.0, 6), (50.0, 10))  # lower theta_r (deg) and sectors of every ring of cells
MOST = 20_000  # samples that are examined: enough for any structure that matters
NEIGHBOURS = 4000  # samples that are compared with their neighbour
DOMINATES = 0.5  # share of the residual variance above which the model makes the residuals
PLACES = 3  # that are told


@dataclass(frozen=True)
class Test:
    """A test for structure that white noise would not have.

    Parameters
    ----------
    name : str
        Against what the residuals were compared.
    statistic : float
        Fisher's F, or for neighbours the self-normalised sum of products (standard normal).
    groups : int
        Degrees of freedom of the numerator; pairs for neighbours.
    p_value : float
    share : float
        Share of the residual variance that the structure makes, noise taken off; for neighbours
        their correlation.
    """

    __test__ = False

    name: str
    statistic: float
    groups: int
    p_value: float
    share: float


@dataclass(frozen=True)
class Place:
    """Mean residual of a group of samples.

    Parameters
    ----------
    where : str
        In words.
    theta_i_deg : float or None
        Angle of incidence; None where all are taken together.
    n : int
    z : float
        Sum of the residuals over its standard deviation under noise alone.
    relative : float or None
        Weighted mean of measured less fitted over that of the fitted values; None where the fitted
        mean is not positive.
    """

    where: str
    theta_i_deg: float | None
    n: int
    z: float
    relative: float | None


@dataclass(frozen=True)
class ResidualReport:
    """What the residuals say of model and noise.

    Parameters
    ----------
    known_noise : bool
        Whether the samples state their uncertainty; otherwise chi2, dof and p_chi2 are None.
    n : int
        Samples that were examined, at most 20 000, evenly chosen.
    chi2, dof : float, float
        Of the residuals with the shared errors taken off; dof counts noise of the standard that
        images share once.
    p_chi2 : float
        Probability that noise gives a chi-squared at least so far on this side of its middle.
    verdict : {"fits", "too large", "too small"} or None
        Of chi-squared: too large or too small is said beyond 0.5 % on both sides together and
        a factor of 1.25.
    tests : tuple of Test
    p_structure : float
        Smallest p-value times the number of tests, at most 1.
    model_share : float
        Share of the residual variance that is error of the model: what the tests see, and where
        they see something also what chi-squared has beyond the stated noise.
    model_error : float or None
        Standard deviation of the model's error as a fraction of the mean fitted value.
    noise_ratio : float
        Standard deviation of sums over groups in units of what noise alone would give; by so much
        uncertainties that count on noise may be too small. 1 where no structure was found.
    covered : bool
        Whether that error is smaller than the stated errors that samples share.
    places : tuple of Place
        The groups that stand out, clearest first.
    maps : mapping of str to list of Place
        All groups about the mirror direction and all cells of the hemisphere.
    """

    known_noise: bool
    n: int
    chi2: float | None
    dof: float | None
    p_chi2: float | None
    verdict: str | None
    tests: tuple[Test, ...]
    p_structure: float
    model_share: float
    model_error: float | None
    noise_ratio: float
    covered: bool
    places: tuple[Place, ...]
    maps: Mapping[str, list[Place]]

    @property
    def structured(self) -> bool:
        """Whether the residuals have structure that noise has in fewer than 1 % of all fits."""
        return self.p_structure < ALARM

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a JSON document."""
        return {**plain(self), "structured": self.structured, "line": self.line}

    @property
    def line(self) -> str:
        """The finding in one line."""
        if not self.tests:
            return "residuals: none beyond rounding, or too few samples to look for structure"
        if not self.structured:
            return f"residuals: no structure beyond noise ({_p(self.p_structure)})"
        covered = ", smaller than the stated shared errors" if self.covered else ""
        return (
            f"residuals: structure beyond noise ({_p(self.p_structure)}), "
            f"{100 * self.model_share:.0f} % of their variance{covered}"
        )

    @property
    def warnings(self) -> list[str]:
        """What a reader must know; nothing where noise explains the residuals."""
        told = []
        if self.structured and not self.covered:
            where = "; ".join(_said(place) for place in self.places)
            cause = "the model, not the noise, dominates: its error makes"
            if self.model_share < DOMINATES:
                cause = "the model does not hold everywhere: its error makes"
            told.append(
                f"{cause} {100 * self.model_share:.0f} % of the residual variance (structure of "
                f"the residuals, {_p(self.p_structure)})"
                + (f"; it is {where}" if where else "")
                + ". The stated uncertainties hold only for the best-fitting surface of this "
                "family of models."
            )
        if self.verdict == "too small":
            assert self.chi2 is not None
            assert self.dof
            told.append(
                f"chi2/dof is {self.chi2 / self.dof:.3g}, too small for the stated noise "
                f"({_p(self.p_chi2 or 0.0)}): u_brdf is too large, or the samples were "
                "smoothed or are not independent."
            )
        elif self.verdict == "too large" and not self.structured:
            assert self.chi2 is not None
            assert self.dof
            told.append(
                f"chi2/dof is {self.chi2 / self.dof:.3g}, too large for the stated noise "
                f"({_p(self.p_chi2 or 0.0)}), and the residuals have no structure: u_brdf is "
                "probably too small."
            )
        return told


def examine(problem: Problem, optimum: Optimum) -> ResidualReport:
    """Examine the residuals of a fit.

    Parameters
    ----------
    problem : Problem
        With the weights that the minimum was found with.
    optimum : Optimum

    Examples
    --------
    >>> from gonio.fitting.minimum.gauss_newton import minimise
    >>> from gonio.geometry import Directions
    >>> from gonio.models import get
    >>> from gonio.samples import BRDFSamples
    >>> theta = np.linspace(0, 1.2, 200)
    >>> noise = 0.01 * np.random.default_rng(1).standard_normal(200)
    >>> samples = BRDFSamples(Directions(0.3, 0.0, theta, np.pi), 0.1 + noise)
    >>> problem = Problem.from_samples(samples, get("lambert"))
    >>> examine(problem, minimise(problem, np.array([0.5]))).structured
    False
    """
    problem = thinned(problem, MOST)
    f, jacobian = problem.jacobian(optimum.p)
    seen = optimum.free & (np.diag(optimum.curvature) > 0)
    base = _Base(problem, f, jacobian[:, seen], shared_columns(problem, optimum.p, f))
    left = _Left.of(base)
    chi2 = dof = p_chi2 = verdict = None
    known = problem.weights == "sd"
    if known:
        chi2, dof, p_chi2, verdict = _chi_squared(base)
    tests: list[Test] = []
    groupings = _groupings(problem) if left is not None else {}
    for name, grouping in groupings.items():
        assert left is not None
        found = _compared(left, name, grouping)
        if found is not None:
            tests.append(found)
    if left is not None:
        neighbours = _neighbours(problem, left)
        if neighbours is not None:
            tests.append(neighbours)
    p = min(1.0, max(len(tests), 1) * min((test.p_value for test in tests), default=1.0))
    share, ratio, places = 0.0, 1.0, []
    if left is not None and p < ALARM:
        telling = [test for test in tests if test.p_value * len(tests) < ALARM]
        share = max(test.share for test in telling)
        if chi2 is not None and dof is not None and chi2 > dof:
            share = max(share, 1 - dof / chi2)
        telling = [test for test in telling if test.name != NEIGHBOURING]
        ratio = max((float(np.sqrt(test.statistic)) for test in telling), default=1.0)
        places = _places(left, groupings, telling)
    maps = {
        name: _all_places(left, groupings[name])
        for name in _MAPPED
        if left is not None and name in groupings
    }
    error = None
    if left is not None and share > 0 and left.mean > 0:
        error = float(np.sqrt(share * left.variance) / left.mean)
    covered = left is not None and share * float(np.mean(left.z**2)) < left.stated
    return ResidualReport(
        known, problem.n, chi2, dof, p_chi2, verdict, tuple(tests), p, share, error,
        max(ratio, 1.0),        covered, tuple(places), maps,
    )  # fmt: skip


# ---------------------------------------------------------------- what is left


@dataclass(frozen=True)
class _Base:
    """A problem at its minimum: values, derivatives by what is free, shared errors."""

    problem: Problem
    f: FloatArray
    jacobian: FloatArray
    shared: Any  # sparse (N, draws)

    @property
    def residual(self) -> FloatArray:
        return np.asarray(self.problem.samples.value - self.f)


@dataclass(frozen=True)
class _Left:
    """Whitened residuals with what parameters and shared errors could do projected out."""

    z: FloatArray  # (N,)
    columns: Any  # whitened, sparse (N, C)
    inverse: FloatArray  # pseudo-inverse of columns^T columns
    dof: int
    root: FloatArray  # square root of the weights (N,)
    f: FloatArray
    residual: FloatArray
    stated: float  # mean square of z that the shared errors may make

    @classmethod
    def of(cls, base: _Base) -> _Left | None:
        """None where too few samples are left to say anything."""
        from scipy.sparse import csr_array, diags_array, hstack

        problem = base.problem
        # In units of the largest value: squares of what is left neither overflow nor vanish.
        unit = float(np.max(np.abs(problem.samples.value))) or 1.0
        f, residual = base.f / unit, base.residual / unit
        if not np.max(np.abs(residual)) > ROUNDING:
            return None
        root = np.sqrt(problem.inverse_variance) * unit
        if problem.weights != "sd":
            root = _unstated(f, residual)
        parts = hstack([csr_array(base.jacobian), base.shared]) / unit
        columns = csr_array(diags_array(root) @ csr_array(parts))
        own = columns[:, base.jacobian.shape[1] :]
        stated = float(own.multiply(own).sum()) / problem.n
        size = np.sqrt(np.maximum(np.asarray(columns.multiply(columns).sum(axis=0)), 1e-300))
        columns = csr_array(columns @ diags_array(1 / size.ravel()))
        square = np.asarray((columns.T @ columns).toarray())
        inverse, rank = _pseudo_inverse(square)
        z = root * residual
        z = z - columns @ (inverse @ (columns.T @ z))
        dof = problem.n - rank
        if dof < 3 * LEAST or not np.max(np.abs(z)) > ROUNDING * np.max(root):
            return None
        return cls(z, columns, inverse, dof, root, f, residual, stated)

    @property
    def mean(self) -> float:
        """Mean fitted value."""
        return float(np.mean(self.f))

    @property
    def variance(self) -> float:
        """Mean square of the residuals in the unit of f."""
        return float(np.mean(self.residual**2))


def _unstated(f: FloatArray, residual: FloatArray) -> FloatArray:
    """One over the noise where nobody stated it: sd^2 = a + b f^2 from the scatter itself.

    Neighbours in f share their noise; a and b are the best non-negative ones for the mean squares
    of groups.
    """
    from scipy.optimize import nnls

    order = np.array_split(np.argsort(f), int(np.clip(len(f) // 20, 1, 40)))
    squares = np.array([np.mean(residual[k] ** 2) for k in order])
    levels = np.array([np.mean(f[k] ** 2) for k in order])
    if not np.all(squares > 0):
        return np.full(len(f), 1 / max(float(np.sqrt(np.mean(residual**2))), 1e-300))
    design = np.column_stack([np.ones(len(order)), levels]) / squares[:, None]
    (a, b), _ = nnls(design, np.ones(len(order)))
    variance = a + b * f**2
    return np.asarray(1 / np.sqrt(np.maximum(variance, 1e-3 * np.mean(variance) + 1e-300)))


def _pseudo_inverse(square: FloatArray) -> tuple[FloatArray, int]:
    if len(square) == 0:
        return square, 0
    values, vectors = np.linalg.eigh(square)
    good = values > 1e-10 * max(float(values[-1]), 1e-300)
    return (vectors[:, good] / values[good]) @ vectors[:, good].T, int(np.count_nonzero(good))


def _chi_squared(base: _Base) -> tuple[float, float, float, str]:
    """chi2, dof, one-sided probability and verdict, shared errors marginalised.

    Noise of a standard's frame that R images use is one draw, not R: with the share q of it in
    the variance, chi-squared varies as one with n / (1 + (R - 1) q^2) degrees of freedom.
    """
    from scipy import stats

    problem, u, jac = base.problem, base.shared, base.jacobian
    variance = problem.variance(base.f)
    weight = 1 / variance
    inner = np.linalg.inv(np.eye(u.shape[1]) + weighted_square(u, weight))

    def product(a: FloatArray, b: FloatArray) -> FloatArray:
        """a^T C^-1 b."""
        plain = a.T @ (weight[:, None] * b)
        return np.asarray(
            plain - (u.T @ (weight[:, None] * a)).T @ inner @ (u.T @ (weight[:, None] * b))
        )

    r = base.residual[:, None]
    size = np.sqrt(np.maximum(np.sum(jac**2, axis=0), 1e-300))
    jac = jac / size
    cross = product(jac, r)
    inverse, rank = _pseudo_inverse(product(jac, jac))
    chi2 = float((product(r, r) - cross.T @ inverse @ cross)[0, 0])
    n = problem.n - rank
    reference = problem.samples.u_reference
    counted = float(n)
    if reference is not None and problem.samples.reference_sharing > 1:
        q = np.minimum(reference**2 / variance, 1.0)
        counted = n / (1 + (problem.samples.reference_sharing - 1) * float(np.mean(q**2)))
    chi2 = max(chi2, 0.0)
    scaled = chi2 * counted / n
    above, below = stats.chi2.sf(scaled, counted), stats.chi2.cdf(scaled, counted)
    verdict = "fits"
    if above < OUTSIDE and chi2 > MATERIAL * n:
        verdict = "too large"
    elif below < OUTSIDE and chi2 < n / MATERIAL:
        verdict = "too small"
    return chi2, float(n), float(min(above, below)), verdict


# ---------------------------------------------------------------- groups of samples


@dataclass(frozen=True)
class _Grouping:
    """A group number for every sample, -1 for none, and each group in words."""

    group: NDArray[np.int64]
    words: list[str]
    theta_i_deg: list[float | None]


RINGS = "angle from the mirror direction, by incidence"
NEIGHBOURING = "neighbouring samples"
HEMISPHERE = "cells of the hemisphere about the lobe, by incidence"
_MAPPED = (RINGS, HEMISPHERE)


def _groupings(problem: Problem) -> dict[str, _Grouping]:
    d, n = problem.samples.directions, problem.n
    theta_i, phi_i, theta_r, phi_r = (
        np.asarray(np.broadcast_to(a, (n,)), float)
        for a in (d.theta_i, d.phi_i, d.theta_r, d.phi_r)
    )
    w_i, w_r = unit_vectors(theta_i, phi_i), unit_vectors(theta_r, phi_r)
    mirror = unit_vectors(theta_i, phi_i + np.pi)
    away = 2 * np.arcsin(np.clip(np.linalg.norm(w_r - mirror, axis=1) / 2, 0, 1))
    incidence = _classes(np.degrees(theta_i), min(MOST_INCIDENCES, max(1, n // 60)))
    middle = [float(np.median(np.degrees(theta_i)[incidence == k]))
              for k in range(incidence.max(initial=0) + 1)]  # fmt: skip
    ring = np.searchsorted(np.radians(RINGS_DEG), away)
    half = w_i + w_r
    azimuth = np.degrees(np.arctan2(half[:, 1], half[:, 0])) % 180
    sector = np.minimum((azimuth / 22.5).astype(np.int64), 7)
    near = np.minimum(np.searchsorted(np.radians([8.0, 25.0]), away), 2)
    polar = _classes(np.degrees(theta_r), 12)
    middle_r = [float(np.median(np.degrees(theta_r)[polar == k]))
                for k in range(polar.max(initial=0) + 1)]  # fmt: skip
    cells, cell_words = _cells(theta_r, phi_r - phi_i - np.pi)
    edges = ("0", *(f"{e:g}" for e in RINGS_DEG), "180")
    ring_words = [f"within {edges[k + 1]} deg of the mirror direction" if k == 0 else
                  f"{edges[k]} to {edges[k + 1]} deg from the mirror direction"
                  for k in range(len(edges) - 1)]  # fmt: skip
    sector_words = [f"with the half vector at {22.5 * k:g} to {22.5 * (k + 1):g} deg from +x, "
                    f"{zone} the mirror direction"
                    for zone in ("within 8 deg of", "8 to 25 deg from", "beyond 25 deg of")
                    for k in range(8)]  # fmt: skip
    return {
        RINGS: _by_incidence(ring, ring_words, incidence, middle),
        HEMISPHERE: _by_incidence(cells, cell_words, incidence, middle),
        "angle of incidence": _merged(incidence, [""] * len(middle), list(middle)),
        "viewing angle": _merged(
            polar, [f"at theta_r near {t:.0f} deg" for t in middle_r], [None] * len(middle_r)
        ),
        "azimuth of the half vector on the sample": _merged(
            near * 8 + sector, sector_words, [None] * len(sector_words)
        ),
    }


def _classes(values: FloatArray, most: int) -> NDArray[np.int64]:
    """Classes of values: the values themselves (to 1 deg) where few, else equally filled."""
    levels, number = np.unique(np.round(values), return_inverse=True)
    if len(levels) > most:
        edges = np.unique(np.quantile(values, np.linspace(0, 1, most + 1)[1:-1]))
        number = np.unique(np.searchsorted(edges, values), return_inverse=True)[1]
    return np.asarray(number, dtype=np.int64)


def _cells(theta_r: FloatArray, azimuth: FloatArray) -> tuple[NDArray[np.int64], list[str]]:
    """Cells of nearly equal solid angle; azimuth 0 is the side of the mirror direction."""
    cell = np.zeros(len(theta_r), dtype=np.int64)
    words: list[str] = []
    for k, (low, sectors) in enumerate(CELLS):
        high = CELLS[k + 1][0] if k + 1 < len(CELLS) else 90.0
        inside = (np.degrees(theta_r) >= low) & ((np.degrees(theta_r) < high) | (high == 90.0))
        width = 360 / sectors
        turned = (np.degrees(azimuth) + width / 2) % 360
        sector = np.minimum((turned / width).astype(np.int64), sectors - 1)
        cell[inside] = len(words) + sector[inside]
        for s in range(sectors):
            at = f", {s * width:g} deg in azimuth from the mirror side" if sectors > 1 else ""
            words.append(f"at theta_r = {low:g} to {high:g} deg{at}")
    return cell, words


def _by_incidence(
    group: NDArray[np.int64],
    words: list[str],
    incidence: NDArray[np.int64],
    middle: list[float],
) -> _Grouping:
    at = [float(t) for t in middle for _ in words]
    return _merged(incidence * len(words) + group, words * len(middle), list(at))


def _merged(
    group: NDArray[np.int64], words: list[str], theta_i_deg: Sequence[float | None]
) -> _Grouping:
    """Groups with enough samples, numbered from 0; the rest is in none."""
    counts = np.bincount(group, minlength=len(words))
    kept: list[int] = np.flatnonzero(counts >= LEAST).tolist()
    number = np.full(len(words), -1, dtype=np.int64)
    number[kept] = np.arange(len(kept))
    return _Grouping(number[group], [words[k] for k in kept], [theta_i_deg[k] for k in kept])


# ---------------------------------------------------------------- tests


def _sums(left: _Left, grouping: _Grouping) -> tuple[FloatArray, FloatArray]:
    """Sums of z over the groups and their covariance under unit noise."""
    from scipy.sparse import csr_array

    inside = np.flatnonzero(grouping.group >= 0)
    k = len(grouping.words)
    b = csr_array((np.ones(len(inside)), (inside, grouping.group[inside])), (len(left.z), k))
    cross = np.asarray((b.T @ left.columns).toarray())
    counts = np.bincount(grouping.group[inside], minlength=k)
    return np.asarray(b.T @ left.z), np.diag(counts) - cross @ left.inverse @ cross.T


def _compared(left: _Left, name: str, grouping: _Grouping) -> Test | None:
    """Fisher's test of the sums over groups against the scatter inside them."""
    from scipy import stats

    if len(grouping.words) < 2:
        return None
    t, covariance = _sums(left, grouping)
    scale = np.sqrt(np.maximum(np.bincount(grouping.group[grouping.group >= 0]), 1.0))
    t, covariance = t / scale, covariance / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(covariance)
    good = values > 1e-6
    rank = int(np.count_nonzero(good))
    rest = left.dof - rank
    if rank == 0 or rest < LEAST:
        return None
    between = float(np.sum((vectors[:, good].T @ t) ** 2 / values[good]))
    total = float(left.z @ left.z)
    within = max(total - between, 1e-300 + 1e-12 * total) / rest
    statistic = between / rank / within
    share = float(np.clip((between - rank * within) / total, 0.0, 1.0))
    return Test(name, statistic, rank, float(stats.f.sf(statistic, rank, rest)), share)


def _neighbours(problem: Problem, left: _Left) -> Test | None:
    """Whether neighbouring samples err alike: products of neighbours, self-normalised.

    Each product has expectation 0 and no correlation with the others where errors are independent
    and symmetric, whatever their size (Moran 1950 with weights 0 and 1).
    """
    from scipy import stats
    from scipy.spatial import cKDTree

    d = problem.samples.directions
    w_i, w_r = d.vectors()
    # Another incidence is no neighbour unless it is as near as the viewing directions are.
    point = np.column_stack([np.broadcast_to(w, (problem.n, 3)) for w in (w_i, w_r)])
    some = np.unique(np.linspace(0, problem.n - 1, min(problem.n, NEIGHBOURS)).astype(np.int64))
    _, near = cKDTree(point).query(point[some], k=2)
    other = np.where(near[:, 0] == some, near[:, 1], near[:, 0])
    pairs = np.unique(np.sort(np.column_stack([some, other]), axis=1), axis=0)
    products = left.z[pairs[:, 0]] * left.z[pairs[:, 1]]
    size = float(np.sqrt(np.sum(products**2)))
    if len(products) < 3 * LEAST or size == 0:
        return None
    statistic = float(np.sum(products)) / size
    alike = float(2 * np.sum(products) / np.sum(left.z[pairs] ** 2))
    p_value = float(stats.norm.sf(statistic))
    return Test(NEIGHBOURING, statistic, len(products), p_value, float(np.clip(alike, 0.0, 1.0)))


# ---------------------------------------------------------------- where it lives


def _all_places(left: _Left, grouping: _Grouping) -> list[Place]:
    """Every group with its mean residual, in the order of the grouping."""
    inside = grouping.group >= 0
    k = len(grouping.words)
    number = grouping.group[inside]
    weight = left.root[inside] ** 2
    noise = np.sqrt(max(float(left.z @ left.z) / left.dof, 1e-300))
    counts = np.bincount(number, minlength=k)
    z = np.bincount(number, weights=left.z[inside], minlength=k)
    above = np.bincount(number, weights=weight * left.residual[inside], minlength=k)
    below = np.bincount(number, weights=weight * left.f[inside], minlength=k)
    return [
        Place(
            grouping.words[g],
            grouping.theta_i_deg[g],
            int(counts[g]),
            round(float(z[g] / (noise * np.sqrt(counts[g]))), 3),
            float(f"{above[g] / below[g]:.3g}") if below[g] > 0 else None,
        )
        for g in range(k)
    ]


def _places(left: _Left, groupings: Mapping[str, _Grouping], telling: list[Test]) -> list[Place]:
    """The groups that stand out most in the test that sees most of the structure."""
    if not telling:
        return []
    best = max(telling, key=lambda test: test.share)
    found = _all_places(left, groupings[best.name])
    found.sort(key=lambda place: -abs(place.z))
    return [place for place in found[:PLACES] if abs(place.z) > 3]


def _said(place: Place) -> str:
    """A place as part of a sentence."""
    side = "low" if place.z > 0 else "high"
    by = ""
    if place.relative is not None:
        by = f" by {100 * abs(place.relative):.2g} %"
    at = "" if place.theta_i_deg is None else f"at theta_i = {place.theta_i_deg:.0f} deg"
    where = " ".join(part for part in (place.where, at) if part)
    return f"too {side}{by} {where}"


def _p(p: float) -> str:
    return f"p = {p:.2g}" if p >= 1e-6 else "p < 1e-6"
