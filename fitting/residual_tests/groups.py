"""Groups of samples in which structure of the residuals is looked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gonio.fitting.problem.protocol import Problem
from gonio.geometry import FloatArray, unit_vectors

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


def groupings_of(problem: Problem) -> dict[str, Grouping]:
    d, n = problem.samples.directions, problem.n
    theta_i, phi_i, theta_r, phi_r = (
        np.asarray(np.broadcast_to(a, (n,)), float)
        for a in (d.theta_i, d.phi_i, d.theta_r, d.phi_r)
    )
    w_i, w_r = unit_vectors(theta_i, phi_i), unit_vectors(theta_r, phi_r)
    mirror = unit_vectors(theta_i, phi_i + np.pi)
    away = 2 * np.arcsin(np.clip(np.linalg.norm(w_r - mirror, axis=1) / 2, 0, 1))
    incidence = classes(np.degrees(theta_i), min(MOST_INCIDENCES, max(1, n // 60)))
    middle = [float(np.median(np.degrees(theta_i)[incidence == k]))
              for k in range(incidence.max(initial=0) + 1)]  # fmt: skip
    ring = np.searchsorted(np.radians(RINGS_DEG), away)
    half = w_i + w_r
    azimuth = np.degrees(np.arctan2(half[:, 1], half[:, 0])) % 180
    sector = np.minimum((azimuth / 22.5).astype(np.int64), 7)
    near = np.minimum(np.searchsorted(np.radians([8.0, 25.0]), away), 2)
    polar = classes(np.degrees(theta_r), 12)
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


def incidence_directions(problem: Problem) -> NDArray[np.int64]:
    """Number of the direction of incidence of each sample to 1 degree, (N,), from 0 on."""
    d, n = problem.samples.directions, problem.n
    theta, phi = (np.degrees(np.broadcast_to(a, (n,))) for a in (d.theta_i, d.phi_i))
    phi = np.where(theta < NORMAL_DEG, 0.0, np.round(phi) % 360)
    return np.unique(360 * np.round(theta) + phi, return_inverse=True)[1].astype(np.int64)


def classes(values: FloatArray, most: int) -> NDArray[np.int64]:
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
