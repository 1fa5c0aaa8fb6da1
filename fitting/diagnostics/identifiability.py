"""What the data say of each parameter, what they cannot tell apart, and what to measure next."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.diagnostics.exchanges import (
    TAKES_PART,
    causes_of,
    depends_on,
    step_along,
)
from gonio.fitting.diagnostics.next_measurement import SuggestedMeasurement, suggest_measurement
from gonio.fitting.minimum import curvature
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.problem.shared_columns import thinned
from gonio.fitting.result import plain
from gonio.fitting.uncertainty.information import information
from gonio.geometry import FloatArray
from gonio.kernels.boxed import UNDETERMINED

STRONG = 0.95  # correlation that is reported
INFLATED = 10.0  # growth of an uncertainty by exchange that makes it a weak one
MOST = 20_000  # samples from which the bound is computed where these share errors


@dataclass(frozen=True)
class Axis:
    """An axis of the ellipsoid of uncertainty, parameters in units of their own information.

    Parameters
    ----------
    information : float
        Eigenvalue of the information scaled to a unit diagonal: 1 where nothing is exchanged,
        0 where a change along the axis leaves every sample as it is.
    change : mapping of str to float
        Change of the parameters along it in file units; the largest relative one is 10 %.
    """

    information: float
    change: Mapping[str, float]


@dataclass(frozen=True)
class Identifiability:
    """What the data say of the parameters.

    Parameters
    ----------
    parameters : tuple of str
        Those that are free, in the order of `correlation`.
    correlation : list of lists of float or None
        Of the independent errors; None beside a parameter without information.
    bound : mapping of str to float or None
        Cramer and Rao's bound on the standard uncertainty, file units, shared errors
        marginalised: no unbiased estimator does better. None where there is no information or
        the noise is unknown.
    alone : mapping of str to float or None
        The same by the independent errors if all other parameters were known.
    axes : tuple of Axis
        Weakest first.
    not_identified, hardly_identified : tuple of str
        No finite uncertainty; or one that is larger than the value and at least ten times what
        it would be without exchange.
    correlated : tuple of (str, str, float)
        Pairs with a correlation beyond 0.95, strongest first.
    causes : tuple of str
        One sentence for each thing that is not identified.
    suggested_measurement : SuggestedMeasurement or None
        The measurement that would help most.
    """

    parameters: tuple[str, ...]
    correlation: list[list[float | None]]
    bound: Mapping[str, float | None]
    alone: Mapping[str, float | None]
    axes: tuple[Axis, ...]
    not_identified: tuple[str, ...]
    hardly_identified: tuple[str, ...]
    correlated: tuple[tuple[str, str, float], ...]
    causes: tuple[str, ...]
    suggested_measurement: SuggestedMeasurement | None

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a JSON document."""
        return dict(plain(self))

    @property
    def warnings(self) -> list[str]:
        """What a reader must know; nothing where everything is identified."""
        if not (self.not_identified or self.hardly_identified):
            return []
        sentences = list(self.causes)
        if self.suggested_measurement is not None and sentences:
            sentences[-1] += f" {self.suggested_measurement.text}"
        return sentences


def identify(minimum: Minimum) -> Identifiability:
    """Identifiability of a problem's parameters at its minimum.

    Parameters
    ----------
    minimum : Minimum

    Notes
    -----
    The scaled information is D^-1/2 J^T W J D^-1/2 with D the diagonal of J^T W J. Its eigenvectors
    with small eigenvalues are the exchanges that the data do not determine, whatever the units of
    the parameters (Belsley, Kuh & Welsch 1980, Regression Diagnostics, ch. 3).

    Examples
    --------
    >>> from gonio.fitting.minimum.minimise import minimise
    >>> from gonio.fitting.problem.single import SingleProblem
    >>> from gonio.geometry import Directions
    >>> from gonio.models import get
    >>> from gonio.samples import BRDFSamples
    >>> samples = BRDFSamples(Directions(0.3, 0.0, np.linspace(0, 1.2, 20), 0.0), np.full(20, 0.1))
    >>> problem = SingleProblem.from_samples(samples, get("lambert"))
    >>> identify(Minimum.of(problem, minimise(problem, np.array([0.5])), 0.01)).not_identified
    ()
    """
    problem, optimum, noise_scale = minimum.problem, minimum.optimum, minimum.noise_scale
    parameters = problem.parameters
    h = optimum.curvature
    informed = np.asarray(np.diag(h) > 0)
    free = np.flatnonzero(optimum.free)
    index = free[informed[free]]
    values, vectors, scale = curvature.axes(h, index)
    missing = {int(k) for k in free if not informed[k]}
    for value, vector in zip(values, vectors.T, strict=True):
        if value < UNDETERMINED:
            missing |= set(index[np.abs(vector) > TAKES_PART].tolist())
    hard = _hardly(minimum, index, missing)
    causes = causes_of(problem, optimum, index, values, vectors, scale, missing, hard)
    correlation, pairs = _correlation(problem, h, free, missing)
    curable = [
        k for k in sorted(missing | hard) if informed[k] or not depends_on(problem, optimum, k)
    ]
    if not curable and pairs:
        order = [q.name for q in parameters]
        curable = sorted({order.index(name) for a, b, _ in pairs for name in (a, b)})
    suggested = suggest_measurement(minimum, curable) if curable else None
    names = tuple(parameters[k].name for k in range(len(parameters)))
    return Identifiability(
        parameters=tuple(names[k] for k in free),
        correlation=correlation,
        bound=_bounds(minimum, free, missing),
        alone={names[k]: _alone(problem, h, int(k), noise_scale) for k in range(len(parameters))},
        axes=tuple(
            Axis(float(max(v, 0.0)), step_along(problem, optimum, index, vector / scale))
            for v, vector in zip(values, vectors.T, strict=True)
        ),
        not_identified=tuple(names[k] for k in sorted(missing)),
        hardly_identified=tuple(names[k] for k in sorted(hard)),
        correlated=pairs,
        causes=tuple(causes),
        suggested_measurement=suggested,
    )


# ---------------------------------------------------------------- information


def _determined(free: NDArray[np.int64], missing: set[int]) -> NDArray[np.int64]:
    return np.array([k for k in free if k not in missing], dtype=np.int64)


def _hardly(minimum: Minimum, informed: NDArray[np.int64], missing: set[int]) -> set[int]:
    """Parameters that other ones replace so well that they are hardly determined."""
    problem, optimum, noise = minimum.problem, minimum.optimum, minimum.noise_scale
    index = _determined(informed, missing)
    if len(index) == 0:
        return set()
    h = optimum.curvature
    variance = np.diag(curvature.marginal_inverse(h, optimum.free)[1])[index] * noise**2
    replaceable = set()
    for k, v in zip(index.tolist(), variance, strict=True):
        q = problem.parameters[k]
        inflation = v * h[k, k] / noise**2 if noise > 0 else 0.0
        size = min(max(abs(float(optimum.p[k])), 1e-3 * (q.upper - q.lower)), q.upper - q.lower)
        if np.sqrt(v) > size and inflation > INFLATED**2:
            replaceable.add(k)
    return replaceable


def _correlation(
    problem: Problem, h: FloatArray, free: NDArray[np.int64], missing: set[int]
) -> tuple[list[list[float | None]], tuple[tuple[str, str, float], ...]]:
    index = _determined(free, missing)
    r = np.eye(0)
    if len(index):
        inverse = curvature.marginal_inverse(h, np.isin(np.arange(len(h)), free))[1]
        index = index[np.diag(inverse)[index] > 0]
        sd = np.sqrt(np.diag(inverse)[index])
        r = np.clip(inverse[np.ix_(index, index)] / np.outer(sd, sd), -1, 1)
    row_of = {int(k): n for n, k in enumerate(index)}

    def of(a: int, b: int) -> float | None:
        if a not in row_of or b not in row_of:
            return None
        return round(float(r[row_of[a], row_of[b]]), 6)

    rows = [[of(int(a), int(b)) for b in free] for a in free]
    names = [q.name for q in problem.parameters]
    pairs = [
        (names[a], names[b], round(float(r[row_of[a], row_of[b]]), 6))
        for a in row_of
        for b in row_of
        if a < b and abs(r[row_of[a], row_of[b]]) > STRONG
    ]
    return rows, tuple(sorted(pairs, key=lambda pair: -abs(pair[2])))


def _bounds(
    minimum: Minimum, free: NDArray[np.int64], missing: set[int]
) -> dict[str, float | None]:
    """Cramer and Rao's bound; None without information or noise, and at a bound."""
    problem, optimum, noise_scale = minimum.problem, minimum.optimum, minimum.noise_scale
    bounds: dict[str, float | None] = {q.name: None for q in problem.parameters}
    index = _determined(free, missing)
    if noise_scale <= 0 or len(index) == 0 or len(problem.pieces()) > 1:
        return bounds
    if problem.quadratic and not (problem.profiled or problem.samples.shared):
        all_told = optimum.curvature / noise_scale**2
    else:
        # Shared errors are marginalised here, none is profiled. Of many samples some stand for
        # all, each with the information of several.
        some = thinned(problem.independent, MOST)
        all_told = information(some, optimum.p, noise_scale * np.sqrt(some.n / problem.n))
    _, inverse = curvature.marginal_inverse(all_told, optimum.free)
    for k, v in zip(index.tolist(), np.diag(inverse)[index], strict=True):
        q = problem.parameters[k]
        bounds[q.name] = q.to_file(float(np.sqrt(v))) if v > 0 else None
    return bounds


def _alone(problem: Problem, h: FloatArray, k: int, noise: float) -> float | None:
    if not (h[k, k] > 0 and noise > 0):
        return None
    return problem.parameters[k].to_file(noise / float(np.sqrt(h[k, k])))


# ---------------------------------------------------------------- words
