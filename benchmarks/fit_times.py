"""Times of fits that lines of the standard input name: python benchmarks/fit_times.py.

It needs nothing but an installed gonio, so that interpreters with different versions can take turns
(`benchmarks.whole_fits`). A line is the kind of fit, the model, the samples and a seed.
"""

from __future__ import annotations

import sys
import time
from functools import partial

import numpy as np

import gonio
from gonio.geometry import Directions
from gonio.models import get
from gonio.samples import BRDFSamples

TRUTH = {
    "ward": {"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.2, "alpha_y": 0.3},
    "ward_isotropic": {"rho_d": 0.1, "rho_s": 0.2, "alpha": 0.2},
}
SHARED = {"ward": "alpha_x", "ward_isotropic": "alpha"}
INCIDENCES_DEG = (5.0, 15.0, 25.0, 35.0, 45.0, 55.0)
KINDS = ("known", "unknown", "joint")  # noise of one BRDF, or two BRDFs that share a parameter


def measured(n: int, model: str, seed: int, *, known: bool) -> BRDFSamples:
    """n values at six incidences with noise of 1 % of f, which the samples state or not."""
    rng = np.random.default_rng(seed)
    theta_i = np.radians(np.resize(INCIDENCES_DEG, n))
    phi_r, theta_r = rng.uniform(0, 2 * np.pi, n), np.arccos(rng.uniform(0.2, 1, n))
    where = Directions(theta_i, 0.0, theta_r, phi_r)
    f = get(model)(where, **TRUTH[model])
    value = f * (1 + 0.01 * rng.standard_normal(n))
    return BRDFSamples(where, value, 0.01 * f if known else None)


def work(kind: str, model: str, n: int, seed: int) -> partial[object]:
    """A fit that is ready to be called."""
    if kind == "joint":
        parts = [measured(n // 2, model, 2 * seed + k, known=True) for k in (0, 1)]
        return partial(gonio.fit, parts, model=model, share=SHARED[model], threads=1)
    samples = measured(n, model, seed, known=kind == "known")
    return partial(gonio.fit, samples, model=model, threads=1)


def answer() -> None:
    """Processor time, in ms, of the fits that lines of the standard input name."""
    for line in sys.stdin:
        kind, model, n, seed = line.split()
        call = work(kind, model, int(n), int(seed))
        start = time.process_time()
        call()
        print(1e3 * (time.process_time() - start), flush=True)


if __name__ == "__main__":
    answer()
