"""Frames: the sensor's noise, and a whole frame from directions to counts, against numpy."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.timing import Row, best_in_turn
from gonio.calibration.reflector import reflected_angles
from gonio.geometry import FloatArray, unit_vectors
from gonio.instrument.noise import expose
from gonio.models import get

SIDE = 1024
TIME_S = 0.01
DARK, WELL, GAIN, NOISE, BLACK, TOP = 32.0, 171_200.0, 0.38, 3.8, 1024.0, 65520
FIGURES = {
    "dark_e_per_s": DARK, "full_well_e": WELL, "gain_dn_per_e": GAIN, "noise_dn": NOISE,
    "black_dn": BLACK, "saturation_dn": TOP, "seed": 1, "frame": 1, "threads": 1,
}  # fmt: skip
# Electrons a pixel; below 64 photons are drawn in another way than above.
SCENES = {
    "pixels of a bright frame": (2e3, 2e4),
    "pixels of a dim frame": (0.0, 20.0),
    "pixels from dark to bright": (0.0, 2e3),
}
# Rolled aluminum at 30 deg on an ellipsoid of 150 mm, 180 deg over the picture's side.
METAL = (0.1, 0.21, 0.04, 0.09)
THETA_I = np.radians(30)
R, D = 150.0, 15.0
WHITE = 3.2e6  # e-/s of a perfect white at normal incidence


def numpy_counts(rate: FloatArray, rng: np.random.Generator) -> np.ndarray:
    """Shot noise, full well, read noise, gain, black level and ADC, each an array."""
    electrons = np.minimum(rng.poisson(TIME_S * (rate + DARK)), WELL)
    counts = GAIN * electrons + NOISE * rng.standard_normal(rate.shape) + BLACK
    return np.clip(np.rint(counts), 0, TOP).astype(np.uint16)


def pixel_angles() -> tuple[FloatArray, FloatArray]:
    """theta_c and phi_c of an equidistant picture."""
    x = (np.arange(SIDE) - (SIDE - 1) / 2) * (np.pi / SIDE)
    columns, rows = np.meshgrid(x, x)
    return np.hypot(columns, rows), np.arctan2(rows, columns)


def numpy_frame(rng: np.random.Generator) -> np.ndarray:
    """A whole frame: directions by eq. (3), f by eq. (5a), noise."""
    theta_c, phi_c = pixel_angles()
    s = np.sin(theta_c) * np.sin(phi_c)
    r_c = D * s + np.sqrt(D**2 * s**2 + R**2 - D**2)
    x, y = r_c * np.sin(theta_c) * np.cos(phi_c), r_c * s - 2 * D
    theta_r = np.arctan2(np.hypot(x, y), r_c * np.cos(theta_c))
    phi_r = np.arctan2(y, x)
    w_r = np.stack(
        [np.sin(theta_r) * np.cos(phi_r), np.sin(theta_r) * np.sin(phi_r), np.cos(theta_r)], -1
    )
    w_i = np.array([np.sin(THETA_I), 0.0, np.cos(THETA_I)])
    rho_d, rho_s, alpha_x, alpha_y = METAL
    h = w_i + w_r
    exponent = ((h[..., 0] / alpha_x) ** 2 + (h[..., 1] / alpha_y) ** 2) / h[..., 2] ** 2
    lobe = np.exp(-exponent) / (4 * np.pi * alpha_x * alpha_y)
    with np.errstate(invalid="ignore"):
        f = rho_d / np.pi + rho_s * lobe / np.sqrt(w_i[2] * w_r[..., 2])
    return numpy_counts(WHITE * np.pi * w_i[2] * np.where(w_r[..., 2] > 0, f, 0.0), rng)


def our_frame() -> Callable[[], np.ndarray]:
    """The same with directions that are computed once, as for all images of a session."""
    model = get("ward")
    p = np.array(METAL)
    theta_c, phi_c = pixel_angles()
    w_r = unit_vectors(*reflected_angles(theta_c, phi_c, R=R, D=D))
    w_i = unit_vectors(np.full((SIDE, SIDE), THETA_I), 0.0)

    def work() -> np.ndarray:
        rate = model.evaluate(w_i, w_r, p, threads=1)
        rate *= WHITE * np.pi * np.cos(THETA_I)
        return expose(rate, TIME_S, **FIGURES)

    return work


def run() -> list[Row]:
    """Pixels a second on one thread."""
    rng = np.random.default_rng(0)
    works = {
        scene: (
            partial(expose, rate, TIME_S, **FIGURES),
            partial(numpy_counts, rate, rng),
        )
        for scene, (low, high) in SCENES.items()
        for rate in [rng.uniform(low, high, (SIDE, SIDE)) / TIME_S]
    }
    works["pixels, directions and f too"] = (our_frame(), partial(numpy_frame, rng))
    rows = []
    for scene, (ours, numpy) in works.items():
        times = best_in_turn({"ours": ours, "numpy": numpy}, 5)
        mine = times["ours"]
        note = f"{1e3 * mine:.1f} ms for {SIDE} x {SIDE}"
        rows.append(Row(scene, SIDE**2 / mine, "numpy", times["numpy"] / mine, note))
    return rows
