"""Speeds as ratios in one run, beside the cores that the machine really gave.

Run from the root of the checkout, in its environment: python benchmarks/speed.py

Absolute times depend on the machine and on what else it does; the ratios compare two ways to do the
same work, measured in turn.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from multiprocessing import Process

import numpy as np

from gonio.geometry import Directions
from gonio.models import get

N = 1_000_000


def best(work: Callable[[], object], rounds: int = 7) -> float:
    """Shortest of several runs, s, after one to warm up."""
    work()
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def spin(seconds: float = 0.5) -> int:
    """Count in a busy loop."""
    count, end = 0, time.perf_counter() + seconds
    while time.perf_counter() < end:
        count += 1
    return count


def cores() -> float:
    """How many busy loops ran at full speed when two were started."""
    alone = spin()
    other = Process(target=spin)
    other.start()
    together = spin()
    other.join()
    return 1 + together / alone if (os.cpu_count() or 1) > 1 else 1.0


def naive_ward(w_i: np.ndarray, w_r: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Eq. (5a) as one writes it with numpy."""
    rho_d, rho_s, alpha_x, alpha_y = p
    h = w_i + w_r
    exponent = ((h[:, 0] / alpha_x) ** 2 + (h[:, 1] / alpha_y) ** 2) / h[:, 2] ** 2
    lobe = np.exp(-exponent) / (4 * np.pi * alpha_x * alpha_y)
    return rho_d / np.pi + rho_s * lobe / np.sqrt(w_i[:, 2] * w_r[:, 2])


def naive_frame(rate: np.ndarray, time_s: float, rng: np.random.Generator) -> np.ndarray:
    """Shot noise, read noise, gain, black level and ADC as one writes them with numpy."""
    electrons = np.minimum(rng.poisson(time_s * rate), 171_200)
    counts = 0.38 * electrons + 3.8 * rng.standard_normal(rate.shape) + 1024
    return np.clip(np.rint(counts), 0, 65520).astype(np.uint16)


def main() -> None:
    """Print one line a comparison."""
    from gonio.instrument.noise import expose

    print(f"cores given: {cores():.1f} of {os.cpu_count()}")
    rng = np.random.default_rng(0)
    d = Directions(
        rng.uniform(0, 1.4, N), 0.0, rng.uniform(0, 1.4, N), rng.uniform(0, 2 * np.pi, N)
    )
    w_i, w_r = d.vectors()
    model = get("ward")
    p = model.vector({})
    ours = best(lambda: model.evaluate(w_i, w_r, p, threads=1))
    plain = best(lambda: naive_ward(w_i, w_r, p))
    print(f"ward, 10^6 pairs, one thread: {N / ours / 1e6:.0f} M/s, {plain / ours:.1f} x numpy")
    both = best(lambda: model.gradient(w_i, w_r, p, threads=1))
    print(f"ward with its four derivatives: {N / both / 1e6:.0f} M/s")
    rate = rng.uniform(2e5, 2e6, (1024, 1024))
    figures = {
        "dark_e_per_s": 32.0, "full_well_e": 171_200.0, "gain_dn_per_e": 0.38, "noise_dn": 3.8,
        "black_dn": 1024.0, "saturation_dn": 65520, "seed": 1, "frame": 1, "threads": 1,
    }  # fmt: skip
    ours = best(lambda: expose(rate, 0.01, **figures))
    plain = best(lambda: naive_frame(rate, 0.01, rng), rounds=3)
    print(f"frame of 1024 x 1024: {1e3 * ours:.1f} ms, {plain / ours:.1f} x numpy")
    start = best(
        lambda: subprocess.run(
            [sys.executable, "-m", "gonio", "--help"], capture_output=True, check=True
        )
    )
    bare = best(lambda: subprocess.run([sys.executable, "-c", ""], check=True))
    print(f"gonio --help: {start:.2f} s, of which Python alone {bare:.2f} s")


if __name__ == "__main__":
    main()
