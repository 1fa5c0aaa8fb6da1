"""Fits: from angles and values to a minimum that passed its checks, without a start, against scipy.

The comparison is a fit without gonio: Ward's model in numpy from the angles, differences for the
Jacobian, and starting values near the truth.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from scipy.optimize import least_squares

from benchmarks.timing import Row, best_in_turn
from gonio.fitting.minimum.find import find_minimum
from gonio.geometry import Directions, FloatArray
from gonio.models import get
from gonio.samples import BRDFSamples

TRUTH = (0.15, 0.19, 0.088, 0.13)  # rho_d, rho_s, alpha_x, alpha_y
START = (0.3, 0.1, 0.2, 0.2)
BOUNDS = ([0.0, 0.0, 0.005, 0.005], [1.0, 1.0, 2.0, 2.0])
ROUNDS = {2_000: 15, 20_000: 7, 200_000: 3, 2_000_000: 1}


def measured(n: int) -> BRDFSamples:
    """n values of Ward's model up to 70 deg with 1 % noise and a floor of 0.001/sr."""
    rng = np.random.default_rng(n)
    theta = np.radians(rng.uniform(0, 70, (2, n)))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    where = Directions(theta[0], phi[0], theta[1], phi[1])
    f = get("ward").evaluate(*where.vectors(), np.array(TRUTH))
    noise = 0.01 * f * rng.standard_normal(n) + 1e-3 * rng.standard_normal(n)
    return BRDFSamples(where, f + noise)


def residuals(p: FloatArray, d: Directions, value: FloatArray) -> FloatArray:
    """Ward 1992, eq. (5a), from angles, less the values."""
    rho_d, rho_s, alpha_x, alpha_y = p
    sin_i, sin_r = np.sin(d.theta_i), np.sin(d.theta_r)
    cos_i, cos_r = np.cos(d.theta_i), np.cos(d.theta_r)
    x = sin_i * np.cos(d.phi_i) + sin_r * np.cos(d.phi_r)
    y = sin_i * np.sin(d.phi_i) + sin_r * np.sin(d.phi_r)
    exponent = ((x / alpha_x) ** 2 + (y / alpha_y) ** 2) / (cos_i + cos_r) ** 2
    lobe = np.exp(-exponent) / (4 * np.pi * alpha_x * alpha_y * np.sqrt(cos_i * cos_r))
    return rho_d / np.pi + rho_s * lobe - value


def run() -> list[Row]:
    """Fits a second on one thread."""
    model = get("ward")
    rows = []
    for n, rounds in ROUNDS.items():
        samples = measured(n)
        works = {
            "ours": partial(find_minimum, samples, model, threads=1),
            "scipy": partial(
                least_squares, residuals, START, bounds=BOUNDS,
                args=(samples.directions, samples.value),
            ),
        }  # fmt: skip
        times = best_in_turn(works, rounds)
        mine = times["ours"]
        note = f"{1e3 * mine:.3g} ms, start-free; scipy has a start"
        rows.append(
            Row(f"fits of {n} samples, ward", 1 / mine, "scipy", times["scipy"] / mine, note)
        )
    return rows
