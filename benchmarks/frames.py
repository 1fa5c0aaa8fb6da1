"""The sensor's noise, pixel by pixel, against the same chain as one writes it with numpy."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.timing import Row, best_in_turn
from gonio.geometry import FloatArray
from gonio.instrument.noise import expose

SIDE = 1024
TIME_S = 0.01
DARK, WELL, GAIN, NOISE, BLACK, TOP = 32.0, 171_200.0, 0.38, 3.8, 1024.0, 65520
# Electrons a pixel; below 30 photons are drawn in another way than above.
SCENES = {
    "pixels of a bright frame": (2e3, 2e4),
    "pixels of a dim frame": (0.0, 20.0),
    "pixels from dark to bright": (0.0, 2e3),
}


def plain(rate: FloatArray, rng: np.random.Generator) -> np.ndarray:
    """Shot noise, full well, read noise, gain, black level and ADC, each an array."""
    electrons = np.minimum(rng.poisson(TIME_S * (rate + DARK)), WELL)
    counts = GAIN * electrons + NOISE * rng.standard_normal(rate.shape) + BLACK
    return np.clip(np.rint(counts), 0, TOP).astype(np.uint16)


def run() -> list[Row]:
    """Pixels a second on one thread."""
    rng = np.random.default_rng(0)
    rows = []
    for scene, (low, high) in SCENES.items():
        rate = rng.uniform(low, high, (SIDE, SIDE)) / TIME_S
        ours = partial(
            expose, rate, TIME_S, dark_e_per_s=DARK, full_well_e=WELL, gain_dn_per_e=GAIN,
            noise_dn=NOISE, black_dn=BLACK, saturation_dn=TOP, seed=1, frame=1, threads=1,
        )  # fmt: skip
        times = best_in_turn({"ours": ours, "numpy": partial(plain, rate, rng)}, 5)
        mine = times["ours"]
        note = f"{1e3 * mine:.1f} ms for {SIDE} x {SIDE}"
        rows.append(Row(scene, rate.size / mine, "numpy", times["numpy"] / mine, note))
    return rows
