"""Speed and error of the numerical Oren-Nayar model and of its table.

Run from the root of the checkout: python -m benchmarks.oren_nayar_numeric

Speeds are of one thread, by the clock and by processor time, which differ where the machine was
busy. The error of the integral is that against 40 nodes where it has 14 and 12, the
error of the table that against the integral; both are of f, rho = 0.8, polar angles to 85 deg.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.timing import Row, best, cores
from gonio.geometry import FloatArray, unit_vectors
from gonio.models import _vcavity
from gonio.models.oren_nayar_numeric import MODEL, kernel, surrogate

SIGMAS_DEG = (3, 10, 20, 30, 45, 60)
RHO = 0.8


def per_second(work: Callable[[], object], n: int) -> tuple[float, float]:
    """Evaluations a second by the clock and by processor time, best of three."""
    fastest = [0.0, 0.0]
    for _ in range(3):
        clock, cpu = time.perf_counter(), time.process_time()
        work()
        fastest[0] = max(fastest[0], n / (time.perf_counter() - clock))
        fastest[1] = max(fastest[1], n / (time.process_time() - cpu))
    return fastest[0], fastest[1]


def pairs(n: int, near_kink: bool = False) -> tuple[FloatArray, FloatArray]:
    """Random directions up to 85 deg, or such that light and viewer nearly coincide."""
    rng = np.random.default_rng(1)
    theta = rng.uniform(0, math.radians(85), (2, n))
    phi = rng.uniform(0, 2 * np.pi, (2, n))
    if near_kink:
        theta[1] = np.clip(theta[0] + 0.03 * rng.standard_normal(n), 0, math.radians(85))
        phi[1] = phi[0] + 0.03 * rng.standard_normal(n)
    return unit_vectors(theta[0], phi[0]), unit_vectors(theta[1], phi[1])


def converged(w_i: FloatArray, w_r: FloatArray, p: FloatArray) -> FloatArray:
    """f with 40 nodes in slope and azimuth, by the interpreter."""
    x, w = np.polynomial.legendre.leggauss(40)
    original = _vcavity._SLOPE, _vcavity._AZIMUTH
    nodes = [(float(a), float(b)) for a, b in zip(x, w, strict=True)]
    try:
        _vcavity._SLOPE = tuple(((1 + a) / 2, b / 2) for a, b in nodes)  # type: ignore[assignment]
        _vcavity._AZIMUTH = tuple((a, b) for a, b in nodes if a > 0)  # type: ignore[assignment]
        return np.array([kernel(*i, *r, *p)[0] for i, r in zip(w_i, w_r, strict=True)])
    finally:
        _vcavity._SLOPE, _vcavity._AZIMUTH = original


def quantiles(error: FloatArray) -> str:
    """Median, 99 per cent and largest."""
    return "  ".join(f"{q:.1e}" for q in (*np.quantile(error, [0.5, 0.99]), error.max()))


def run() -> list[Row]:
    """Pairs a second of the integral and of its table, one thread."""
    few, many = pairs(4000), pairs(1_000_000)
    table, rows = surrogate(), []
    for sigma in (10, 30):
        p = np.array([RHO, math.radians(sigma)])
        exact = len(few[0]) / best(partial(MODEL.evaluate, *few, p, threads=1), 3)
        work, slab = table.look_up_loop(), table.slabs(float(p[1]))[0]
        out = np.empty((len(many[0]), 2))
        quick = len(many[0]) / best(partial(work, *many, slab, float(p[1]), 0, out))
        name = f"oren_nayar_numeric at {sigma} deg"
        rows.append(Row(f"{name}, integral", exact, "", None))
        rows.append(Row(f"{name}, table", quick, "the integral", quick / exact))
    return rows


def main() -> None:
    """Print the tables."""
    print(f"cores: {cores():.2f} of {os.cpu_count()}")
    start = time.perf_counter()
    table = surrogate()
    print(f"table computed or read in {time.perf_counter() - start:.1f} s")

    few, many, hard = pairs(8000), pairs(1_000_000), pairs(8000, near_kink=True)
    print("\nsigma  integral /s (clock, cpu)   table /s (clock, cpu)")
    for sigma in SIGMAS_DEG:
        p = np.array([RHO, math.radians(sigma)])
        MODEL.evaluate(few[0][:9], few[1][:9], p)
        exact = per_second(partial(MODEL.evaluate, *few, p, threads=1), len(few[0]))
        table.evaluate(few[0][:9], few[1][:9], p)
        work, slab = table.look_up_loop(), table.slabs(float(p[1]))[0]
        out = np.empty((len(many[0]), 2))
        looked_up = per_second(partial(work, *many, slab, float(p[1]), 0, out), len(many[0]))
        print(
            f"{sigma:5d}  {exact[0]:10.3g} {exact[1]:10.3g}      "
            f"{looked_up[0]:10.3g} {looked_up[1]:10.3g}"
        )

    print("\nrelative error of f: median, 99 %, largest")
    print("sigma  integral, 100 pairs         table                      table near the kink")
    for sigma in SIGMAS_DEG:
        p = np.array([RHO, math.radians(sigma)])
        sample = few[0][:100], few[1][:100]
        columns = [
            quantiles(np.abs(MODEL.evaluate(*sample, p) / converged(*sample, p) - 1)),
            *(
                quantiles(np.abs(table.evaluate(*each, p) / MODEL.evaluate(*each, p) - 1))
                for each in (few, hard)
            ),
        ]
        print(f"{sigma:5d}  " + "   ".join(columns))


if __name__ == "__main__":
    main()
