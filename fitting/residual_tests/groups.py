"""Groups of samples in which structure of the residuals is looked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.checks.distinct import numbered
from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray

LEAST = 8  # samples in a group
NORMAL_DEG = 0.5  # theta_i below which phi_i means nothing
MOST_INCIDENCES = 12
RINGS_DEG = (1, 2, 3, 4.5, 6, 8, 11, 15, 20, 30, 45, 60, 90)  # edges about the mirror direction
CELLS = ((0.0, 1), (25.0, 6), (50.0, 10))  # lower theta_r (deg) and sectors of every ring of cells


@dataclass(frozen=True)
class Grouping:
    """A group number for every sample, -1 for none, and each group in words."""

    group: NDArray[np.int64]
    words: list[str]
    theta_i_deg: list[float | None]


RINGS = "angle from the mirror direction, by incidence"
HEMISPHERE = "cells of the hemisphere about the lobe, by incidence"
MAPPED = (RINGS, HEMISPHERE)


def groupings_of(problem: Problem, vectors: tuple[FloatArray, FloatArray]) -> dict[str, Grouping]:
    """Groups of samples by what they are told apart.

    Parameters
    ----------
    problem : Problem
    vectors : tuple of ndarray, shape (N, 3)
        Unit vectors towards the light and towards the viewer.
    """
    theta_i, phi_i, theta_r, phi_r = directions_of(problem)
    w_i, w_r = vectors
    off = [w_r[:, 0] + w_i[:, 0], w_r[:, 1] + w_i[:, 1], w_r[:, 2] - w_i[:, 2]]  # from the mirror
    away = 2 * np.arcsin(np.minimum(np.sqrt(off[0] ** 2 + off[1] ** 2 + off[2] ** 2) / 2, 1.0))
    incidence = classes(np.degrees(theta_i), min(MOST_INCIDENCES, max(1, problem.n // 60)))
    middle = _medians(np.degrees(theta_i), incidence)
    ring = np.searchsorted(np.radians(RINGS_DEG), away)
    azimuth = np.degrees(np.arctan2(off[1], off[0])) % 180  # of the half vector
    sector = np.minimum((azimuth / 22.5).astype(np.int64), 7)
    near = np.minimum(np.searchsorted(np.radians([8.0, 25.0]), away), 2)
    polar = classes(np.degrees(theta_r), 12)
    middle_r = _medians(np.degrees(theta_r), polar)
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


def directions_of(problem: Problem) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """theta_i, phi_i, theta_r and phi_r of each sample, (N,), radians."""
    d, n = problem.samples.directions, problem.n
    theta_i, phi_i, theta_r, phi_r = (
        np.asarray(np.broadcast_to(a, (n,)), float)
        for a in (d.theta_i, d.phi_i, d.theta_r, d.phi_r)
    )
    return theta_i, phi_i, theta_r, phi_r


def _medians(values: FloatArray, number: NDArray[np.int64]) -> list[float]:
    """Median of the values of each class."""
    order = np.argsort(number, kind="stable")
    ends = np.cumsum(np.bincount(number, minlength=1))
    ranked = [np.sort(own) for own in np.split(values[order], ends[:-1])]
    return [float(own[(len(own) - 1) // 2] + own[len(own) // 2]) / 2 for own in ranked]


def incidence_directions(problem: Problem) -> NDArray[np.int64]:
    """Number of the direction of incidence of each sample to 1 degree, (N,), from 0 on."""
    d, n = problem.samples.directions, problem.n
    theta, phi = (np.degrees(np.broadcast_to(a, (n,))) for a in (d.theta_i, d.phi_i))
    phi = np.where(theta < NORMAL_DEG, 0.0, np.round(phi) % 360)
    return numbered(np.asarray(np.round(theta), np.int64), np.asarray(phi, np.int64))


def classes(values: FloatArray, most: int) -> NDArray[np.int64]:
    """Classes of values: the values themselves (to 1 deg) where few, else equally filled."""
    number = numbered(np.round(values))
    if int(number.max(initial=-1)) + 1 > most:
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
) -> Grouping:
    at = [float(t) for t in middle for _ in words]
    return _merged(incidence * len(words) + group, words * len(middle), list(at))


def _merged(
    group: NDArray[np.int64], words: list[str], theta_i_deg: Sequence[float | None]
) -> Grouping:
    """Groups with enough samples, numbered from 0; the rest is in none."""
    counts = np.bincount(group, minlength=len(words))
    kept: list[int] = np.flatnonzero(counts >= LEAST).tolist()
    number = np.full(len(words), -1, dtype=np.int64)
    number[kept] = np.arange(len(kept))
    return Grouping(number[group], [words[k] for k in kept], [theta_i_deg[k] for k in kept])
