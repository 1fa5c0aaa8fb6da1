"""Which further measurement would tell of a parameter that the data do not determine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.minimum.curvature import TAKES_PART, axes, marginal_inverse
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.uncertainty.established import ENOUGH
from gonio.geometry import Directions, FloatArray, angles, unit_vectors
from gonio.kernels.boxed import UNDETERMINED

INCIDENCES_DEG = (30, 40, 50, 20, 60, 10, 0, 70, 80)  # the easiest to measure first
ROTATIONS_DEG = (0, 45, 90)
PATTERNS = {
    "hemisphere": "over the whole hemisphere",
    "mirror 20": "within 20 deg of the mirror direction",
    "mirror 5": "within 5 deg of the mirror direction",
    "in plane": "in the plane of incidence",
    "across": "across the plane of incidence, through the mirror direction",
}
NARROW = {"mirror 1": "within 1 deg of the mirror direction"}  # where few samples saw the lobe
_WORDS = PATTERNS | NARROW
N = 72  # directions of each
STEEPEST = np.radians(80.0)  # largest theta_r
DISCOUNT = 1e-3  # of the information of samples that carry a parameter alone
AS_GOOD = 0.4  # of ln u: a measurement that is earlier in the lists is preferred by as much
_MISSING = 100.0  # what a parameter without information adds to a merit


@dataclass(frozen=True)
class SuggestedMeasurement:
    """A measurement that would determine what the data do not.

    Parameters
    ----------
    theta_i_deg : float
        Angle of incidence.
    rotation_deg : float
        By which the sample is turned against the first measurement.
    pattern : str
        Where to look from, in words.
    n : int
        Directions that `expected` counts with, each as noisy as samples of its size are now.
    expected : mapping of str to float or None
        Standard uncertainty of each parameter with it, file units; None where still unknown or
        where the noise is.
    text : str
        The same as a sentence.
    """

    theta_i_deg: float
    rotation_deg: float
    pattern: str
    n: int
    expected: Mapping[str, float | None]
    text: str


def suggest_measurement(
    minimum: Minimum, wanted: list[int], *, anew: bool = False
) -> SuggestedMeasurement | None:
    """The best single measurement for the wanted parameters; None if none determines them all.

    Parameters
    ----------
    minimum : Minimum
    wanted : list of int
        Numbers of the parameters.
    anew : bool
        Few samples carry them so far: these count for next to nothing, and at least 10 effective
        samples of the measurement must carry each.
    """
    problem, optimum, noise_scale = minimum.problem, minimum.optimum, minimum.noise_scale
    if len(problem.independent.pieces()) > 1:
        return None  # the parts of a joint fit have their own directions
    d = problem.samples.directions
    base = float(np.broadcast_to(d.phi_i, (problem.n,))[0])
    patterns = (*PATTERNS, *NARROW) if anew else tuple(PATTERNS)
    candidates = _candidates(patterns, base, isotropic=problem.model.claims.isotropic)
    f, jacobian = problem.model_at(candidates.directions, optimum.p)
    u = _noise(problem, optimum.p, f, noise_scale)
    now = optimum.curvature / (noise_scale or 1.0) ** 2 * (DISCOUNT if anew else 1.0)
    free = np.flatnonzero(optimum.free)
    size = np.maximum(np.abs(optimum.p), 1e-12)
    best: tuple[float, int, FloatArray] | None = None
    for k, (start, n) in enumerate(candidates.blocks):
        rows = jacobian[start : start + n] / u[start : start + n, None]
        # As many directions for each, also where part of a pattern lies below the horizon.
        reached = _standard(now + rows.T @ rows * (N / n), free)
        merit = float(
            np.sum(np.where(np.isfinite(reached), np.log(reached / size), _MISSING)[wanted])
        )
        if best is not None and not merit < best[0] - AS_GOOD * len(wanted):
            continue
        if not anew or _carried(now, rows, optimum.free, wanted) >= ENOUGH:
            best = (merit, k, reached)
    if best is None or not np.all(np.isfinite(best[2][wanted])):
        return None
    kind = candidates.kinds[best[1]]
    return _suggestion(problem, kind, best[2], wanted, noise_known=noise_scale > 0)


def _suggestion(
    problem: Problem,
    kind: tuple[float, float, str],
    uncertainties: FloatArray,
    wanted: list[int],
    *,
    noise_known: bool,
) -> SuggestedMeasurement:
    theta_i, rotation, pattern = kind
    expected = {
        q.name: q.to_file(float(u)) if noise_known and np.isfinite(u) else None
        for q, u in zip(problem.parameters, uncertainties, strict=True)
    }
    turned = f" with the sample turned by {np.degrees(rotation):.0f} deg" if rotation else ""
    text = f"Measure {_WORDS[pattern]} at theta_i = {np.degrees(theta_i):.0f} deg{turned}"
    shown = []
    for k in wanted:
        q = problem.parameters[k]
        u = expected[q.name]
        if u is not None:
            unit = f" {q.file_unit}" if q.file_unit else ""
            shown.append(f"{q.name} to {u:.2g}{unit}")
    text += f": {N} samples as good as these would give {', '.join(shown)}." if shown else "."
    return SuggestedMeasurement(
        round(float(np.degrees(theta_i)), 6), round(float(np.degrees(rotation)), 6),
        _WORDS[pattern], N, expected, text,
    )  # fmt: skip


@dataclass(frozen=True)
class _Candidates:
    """Measurements to choose from, the simplest first."""

    kinds: tuple[tuple[float, float, str], ...]  # incidence, rotation (radians) and pattern
    directions: Directions  # of all, one measurement after the other
    blocks: tuple[tuple[int, int], ...]  # first of each measurement's directions, and their number


@lru_cache(maxsize=16)  # the same ones for every fit of samples that begin at one azimuth
def _candidates(patterns: tuple[str, ...], base: float, *, isotropic: bool) -> _Candidates:
    """Every candidate for samples whose first azimuth of incidence is `base`."""
    kinds = tuple(
        (float(np.radians(theta_i)), float(np.radians(rotation)), pattern)
        for pattern in patterns
        for rotation in ((0,) if isotropic else ROTATIONS_DEG)
        for theta_i in INCIDENCES_DEG
    )
    seen = [unit_directions(i, base + r, pattern) for i, r, pattern in kinds]
    counts = [len(theta_r) for theta_r, _ in seen]
    w_i = np.repeat([unit_vectors(i, base + r) for i, r, _ in kinds], counts, axis=0)
    theta_r, phi_r = (np.concatenate([each[k] for each in seen]) for k in (0, 1))
    starts = np.cumsum([0, *counts[:-1]]).tolist()
    directions = Directions(*angles(w_i), theta_r, phi_r)
    return _Candidates(kinds, directions, tuple(zip(starts, counts, strict=True)))


def unit_directions(theta_i: float, phi_i: float, pattern: str) -> tuple[FloatArray, FloatArray]:
    """Polar angles and azimuths (K,), radians, of a pattern of viewing directions, K <= N."""
    mirror = unit_vectors(theta_i, phi_i + np.pi)
    across = np.array([-np.sin(phi_i), np.cos(phi_i), 0.0])
    along = np.cross(across, mirror)
    k = np.arange(N) + 0.5
    turn = k * np.pi * (3 - np.sqrt(5))
    if pattern == "hemisphere":
        z = 1 - k / N * (1 - np.cos(STEEPEST))
        return np.arccos(z), turn
    if pattern.startswith("mirror"):
        z = 1 - k / N * (1 - np.cos(np.radians(float(pattern.split()[1]))))
        s = np.sqrt(1 - z**2)[:, None]
        w = z[:, None] * mirror + s * (
            np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * along
        )
    else:
        t = np.linspace(-STEEPEST, STEEPEST, N)[:, None]
        if pattern == "in plane":
            w = np.cos(t) * [0.0, 0.0, 1.0] + np.sin(t) * unit_vectors(np.pi / 2, phi_i + np.pi)
        else:
            w = np.cos(t) * mirror + np.sin(t) * across
    theta_r, phi_r = angles(w)
    above = theta_r <= STEEPEST + np.radians(5.0)
    return theta_r[above], phi_r[above]


def _noise(problem: Problem, p: FloatArray, f: FloatArray, noise_scale: float) -> FloatArray:
    """Standard uncertainty of a sample of value f, as the samples near that value have it."""
    sd = (noise_scale or 1.0) / np.sqrt(problem.inverse_variance)
    value = problem.values(p)
    order = np.array_split(np.argsort(value), min(20, problem.n))
    x = np.array([np.median(value[k]) for k in order])
    y = np.array([np.median(sd[k]) for k in order])
    # Beyond the brightest sample the noise grows with the value.
    brighter = np.maximum(f / x[-1], 1.0) if x[-1] > 0 else 1.0
    return np.asarray(np.interp(f, x, y) * brighter)


def _carried(
    now: FloatArray,
    rows: FloatArray,
    free: NDArray[np.bool_],
    wanted: list[int],
) -> float:
    """Least effective number of samples that carry what is wanted, the old counted as one."""
    covariance = marginal_inverse(now + rows.T @ rows * (N / len(rows)), free)[1][:, wanted]
    new = (rows @ covariance) ** 2 * (N / len(rows))
    old = np.sum(covariance * (now @ covariance), axis=0)
    size = np.maximum(old + new.sum(axis=0), 1e-300)
    old, new = old / size, new / size
    squares = old**2 + np.sum(new**2, axis=0)
    return float(np.min(1 / np.maximum(squares, 1e-300)))


def _standard(information: FloatArray, free: np.ndarray) -> FloatArray:
    """Standard uncertainties (P,); infinite where there is no information."""
    u = np.full(len(information), np.inf)
    index = free[np.diag(information)[free] > 0]
    values, vectors, scale = axes(information, index)
    # A direction without information makes its parameters unknown.
    share = vectors**2 / np.maximum(values, 1e-300)
    lost = np.any((values < UNDETERMINED) & (np.abs(vectors) > TAKES_PART), axis=1)
    u[index] = np.where(lost, np.inf, np.sqrt(share.sum(axis=1)) / scale)
    return u


def facts(problem: Problem) -> list[str]:
    """What in the choice of directions may be the cause, in a few words each."""
    d = problem.samples.directions
    n = problem.n
    theta_i, phi_i, theta_r, phi_r = (
        np.broadcast_to(a, (n,)) for a in (d.theta_i, d.phi_i, d.theta_r, d.phi_r)
    )
    gaps = []
    if np.ptp(theta_i) < np.radians(0.5):
        gaps.append(f"a single angle of incidence, {np.degrees(theta_i[0]):.3g} deg")
    off = np.sin(theta_r) * np.sin(phi_r - phi_i) * (theta_i > 0.01)
    across = np.sin(theta_i) * np.sin(phi_i - phi_i[0])
    if np.max(np.abs(off)) < 0.01 and np.max(np.abs(across)) < 0.01 and np.any(theta_i > 0.01):
        gaps.append(f"only one plane was measured, phi = {np.degrees(phi_i[0]) % 180:.3g} deg")
    along = np.sin(theta_i) * np.sin(theta_r) * np.cos(phi_r - phi_i)
    nearest = float(np.max(np.cos(theta_i) * np.cos(theta_r) - along))
    if nearest < np.cos(np.radians(10.0)):
        gap = np.degrees(np.arccos(np.clip(nearest, -1, 1)))
        gaps.append(f"no sample within {gap:.0f} deg of the mirror direction")
    return gaps
