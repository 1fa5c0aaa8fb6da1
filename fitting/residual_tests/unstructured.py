"""What residuals beyond the stated noise are where they have no structure.

An error of the model is the same at neighbouring directions, so that the tests of structure see it
where samples are close enough. Where they would have seen an error of this size and see none, what
the residuals have beyond the noise is independent from sample to sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gonio.fitting.residual_tests.excess import Excess, stated_variance
from gonio.fitting.residual_tests.misfit import MOST, errors_of_parts, misfit_test_of
from gonio.fitting.residual_tests.model_errors import FINE, SMOOTH, VIEW
from gonio.fitting.residual_tests.quadratic_forms import combined, ratio_test
from gonio.fitting.residual_tests.standardised import LEAST, Standardised, standardise
from gonio.fitting.residual_tests.whitened import Base
from gonio.fitting.result.verdict import ALARM
from gonio.geometry import FloatArray

KINDS = (SMOOTH, FINE, VIEW)  # errors that a wrong model makes
DRAWS = 20  # of each kind, by which the power is counted
POWERFUL = 0.9  # share of errors that a test sees from which on its silence means something
SPREAD = 0.5  # typical residual over the root mean square; 1 for normal noise of one size
MAD_TO_SD = 1.4826  # of normal noise, from the median of its absolute values
BANDS = 4  # of readings, from dark to bright, whose noise is compared
AS_STATED = 1.5  # factor by which the noise of the brightest may miss what is stated
TIMES = 2.5  # by which that of the darkest must exceed that of the brightest
AGREES = (0.6, 1.5)  # noise of all bands in units of stated noise with a floor

FEWER = 5.0  # standard deviations by which readings below zero are fewer than noise would make

_Part = tuple[FloatArray, slice, FloatArray]  # columns of unit size, samples, eigenvalues


def samples_of_half(excess: Excess) -> int | None:
    """How many samples make half of chi-squared, where these are few; None where it is spread."""
    typical = MAD_TO_SD * float(np.median(np.abs(excess.z)))
    if typical >= SPREAD * np.sqrt(excess.chi2 / max(excess.dof, 1.0)):
        return None
    largest = np.cumsum(np.sort(excess.z**2)[::-1])
    return int(np.searchsorted(largest, largest[-1] / 2)) + 1


def negative_readings(left: Standardised) -> tuple[float, int] | None:
    """How many readings noise as large as the residuals makes negative, where fewer are; else None.

    Noise that is larger than f leaves nearly every other reading below zero. Where it does not, the
    residuals are no noise of one size, whoever stated none. The second number is that of the
    readings that are zero or below.
    """
    from scipy.special import ndtr

    scatter = float(np.sqrt(left.z @ left.z / left.dof))
    chance = ndtr(-left.level / scatter)
    expected, count = float(chance.sum()), int(np.count_nonzero(left.problem.samples.value <= 0))
    sd = float(np.sqrt(np.sum(chance * (1 - chance))))
    return (expected, count) if expected - count > FEWER * sd else None


def sees_smooth_errors(base: Base, excess: Excess) -> bool:
    """Whether the tests of structure would see nearly every smooth error as large as the excess.

    Errors of each kind are drawn with a fixed seed, as large as the excess, and tested.
    """
    base = base.thinned(MOST)
    left = standardise(base, shared=False)
    if left is None:
        return False
    share = min(excess.dof / max(excess.chi2, 1e-300), 1.0)  # of the noise in chi-squared
    rng = np.random.default_rng(0)
    parts: dict[str, list[_Part]] = {kind: [] for kind in KINDS}
    for where, every in errors_of_parts(base, left):
        for columns in every:
            for kind, (gram, by_fit) in columns.sums(left.q[where]).items():
                if kind in parts:
                    size2 = max(float(np.max(np.diag(gram))), 1e-300)
                    values = np.linalg.eigvalsh((gram - by_fit @ by_fit.T) / size2)
                    own = np.asarray(columns.full(kind) / np.sqrt(size2))
                    parts[kind].append((own, where, np.asarray(values, np.float64)))
    return all(_power(left, parts[kind], share, rng) >= POWERFUL for kind in KINDS)


def _power(left: Standardised, parts: list[_Part], share: float, rng: np.random.Generator) -> float:
    """Share of errors of a kind that its test would see."""
    seen = 0
    for _ in range(DRAWS):
        error = np.zeros(left.z.size)
        for own, where, _ in parts:
            error[where] = own @ rng.standard_normal(own.shape[1])
        noise = rng.standard_normal(left.z.size)
        z = _scaled(left, error, 1 - share) + _scaled(left, noise, share)
        square = float(z @ z)
        chances = [
            ratio_test(values, float(np.sum((own.T @ z[where]) ** 2)), square, left.dof)
            for own, where, values in parts
        ]
        seen += combined([p for p in chances if p is not None]) < ALARM
    return seen / DRAWS


def _scaled(left: Standardised, z: FloatArray, share: float) -> FloatArray:
    """What the parameters cannot follow of z, with such a share of the degrees of freedom."""
    z = z - left.q @ (left.q.T @ z)
    size = max(float(np.linalg.norm(z)), 1e-300)
    return np.asarray(z * np.sqrt(share * left.dof) / size)


@dataclass(frozen=True)
class MissingFloor:
    """Noise of dark readings that the stated uncertainty leaves out.

    Parameters
    ----------
    size : float
        Standard deviation, sr^-1.
    below : float
        Fitted values below which it exceeds what is stated, sr^-1.
    """

    size: float
    below: float


def missing_floor(base: Base, excess: Excess) -> MissingFloor | None:
    """The constant noise that would make the stated noise right; None where it would not.

    The noise of the brightest readings must be as stated, that of the darkest far larger. With the
    floor all bands of brightness must have their noise, the residuals no structure, and an error
    of the model must not be able to hide.
    """
    problem = base.problem
    if problem.weights != "sd" or len(problem.pieces()) > 1 or base.shared.shape[1]:
        return None
    variance = stated_variance(problem, base.f)
    order = np.array_split(np.argsort(np.abs(base.f)), BANDS)
    if min(len(band) for band in order) < LEAST:
        return None

    def noise(added: float) -> FloatArray:
        squares = base.residual**2 / (variance + added)
        return np.sqrt([np.mean(squares[band]) for band in order])

    stated = noise(0.0)
    if stated[-1] > AS_STATED or stated[0] < TIMES * max(stated[-1], 1.0):
        return None
    added = _floor(base.residual**2, variance, excess.dof)
    with_floor = noise(added)
    if not (with_floor.min() > AGREES[0] and with_floor.max() < AGREES[1]):
        return None
    other = replace(base, problem=problem.with_weights(1 / (variance + added)))
    test = misfit_test_of(other)
    if test is None or test.p < ALARM:
        return None
    dark = np.abs(base.f)[variance < added]
    return MissingFloor(float(np.sqrt(added)), float(dark.max(initial=0.0)))


def _floor(squares: FloatArray, variance: FloatArray, dof: float) -> float:
    """The variance that makes chi-squared its degrees of freedom."""
    low, high = 0.0, float(np.sum(squares)) / max(dof, 1.0)
    for _ in range(60):
        middle = (low + high) / 2
        if np.sum(squares / (variance + middle)) > dof:
            low = middle
        else:
            high = middle
    return high
