"""Values of the BRDF a second, against numpy and against the speed of the memory.

Run from the root of the checkout: python -m benchmarks.kernels

10^6 pairs of random directions up to 80 deg, six arrays in and one out, one thread, all
arrays allocated before. The memory's speed is that of a loop that adds the six arrays and does
nothing else. Compared runs are measured in turn.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.timing import Row, Work, best_in_turn
from gonio.geometry import unit_vectors
from gonio.models import get, names

N = 1_000_000
FEW = 5_000  # for the model that is an integral
REAL = (np.float64, np.float32)

Array = NDArray[Any]


def pairs(real: type, n: int = N) -> tuple[Array, Array]:
    """Random directions up to 80 deg, each component contiguous."""
    rng = np.random.default_rng(1)
    theta, phi = rng.uniform(0, 1.4, (2, n)), rng.uniform(0, 2 * np.pi, (2, n))
    w_i, w_r = (unit_vectors(*each).astype(real) for each in zip(theta, phi, strict=True))
    return w_i, w_r


def numpy_ward(w_i: Array, w_r: Array, p: Array) -> Array:
    """Eq. (5a) in numpy, with the half vector and no angle."""
    rho_d, rho_s, alpha_x, alpha_y = p
    h = w_i + w_r
    exponent = ((h[:, 0] / alpha_x) ** 2 + (h[:, 1] / alpha_y) ** 2) / h[:, 2] ** 2
    lobe = np.exp(-exponent) / (4 * np.pi * alpha_x * alpha_y)
    return rho_d / np.pi + rho_s * lobe / np.sqrt(w_i[:, 2] * w_r[:, 2])


def numpy_oren_nayar(angles: tuple[Array, Array, Array], p: Array) -> Array:
    """Eqs (14)-(16) in numpy, from theta_i, theta_r and dphi."""
    theta_i, theta_r, dphi = angles
    rho, sigma = p
    s2 = sigma**2
    alpha, beta = np.maximum(theta_i, theta_r), np.minimum(theta_i, theta_r)
    cos = np.cos(dphi)
    c1 = 1 - 0.5 * s2 / (s2 + 0.33)
    c2 = np.sin(alpha) - np.where(cos >= 0, 0, (2 * beta / np.pi) ** 3)
    c2 *= 0.45 * s2 / (s2 + 0.09)
    c3 = 0.125 * s2 / (s2 + 0.09) * (4 * alpha * beta / np.pi**2) ** 2
    f = c1 + cos * c2 * np.tan(beta) + (1 - np.abs(cos)) * c3 * np.tan((alpha + beta) / 2)
    twice = 0.17 * rho**2 / np.pi * s2 / (s2 + 0.13) * (1 - cos * (2 * beta / np.pi) ** 2)
    return rho / np.pi * f + twice


def angles(w_i: Array, w_r: Array) -> tuple[Array, Array, Array]:
    """theta_i, theta_r and dphi, the arguments of `numpy_oren_nayar`."""
    phi_i, phi_r = (np.arctan2(w[:, 1], w[:, 0]) for w in (w_i, w_r))
    return np.arccos(w_i[:, 2]), np.arccos(w_r[:, 2]), phi_r - phi_i


def stream(real: type) -> Work:
    """Six arrays in and one out, and nothing else."""
    from numba import njit

    @njit(nogil=True)
    def add(a: Array, b: Array, c: Array, d: Array, e: Array, f: Array, out: Array) -> None:
        for k in range(out.shape[0]):
            out[k] = a[k] + b[k] + c[k] + d[k] + e[k] + f[k]

    six = [w[:, k] for w in pairs(real) for k in range(3)]
    return partial(add, *six, np.empty(N, real))


def ours(name: str, real: type, n: int = N) -> Work:
    """f of a model at its default parameters, on one thread."""
    model = get(name)
    out = np.empty(n, real)
    return partial(model.evaluate, *pairs(real, n), model.vector({}), out=out, threads=1)


def against(name: str, peer: str, real: type, times: dict[str, float], note: str = "") -> Row:
    """One row from the times of a group that was measured in turn."""
    label = name if real is np.float64 else f"{name}, float32"
    mine = times[f"{name} {real.__name__}"]
    return Row(label, N / mine, peer, times[f"{peer} {real.__name__}"] / mine, note)


def compared(name: str, in_numpy: Work, in_numpy_single: Work, note: str) -> list[Row]:
    """A model against numpy and against the memory, in both precisions."""
    works = {
        f"{name} float64": ours(name, np.float64),
        "numpy float64": in_numpy,
        "memory float64": stream(np.float64),
        f"{name} float32": ours(name, np.float32),
        "numpy float32": in_numpy_single,
        "memory float32": stream(np.float32),
    }
    times = best_in_turn(works, rounds=11)
    rows = [
        against(name, peer, real, times, text)
        for real in REAL
        for peer, text in (("numpy", note), ("memory", "ours over six arrays in, one out"))
    ]
    single, double = times[f"{name} float32"], times[f"{name} float64"]
    return [*rows, Row(f"{name}, float32", N / single, "float64", double / single)]


def ward() -> list[Row]:
    """The Ward model."""
    p = get("ward").vector({})
    in_numpy = [partial(numpy_ward, *pairs(real), p.astype(real)) for real in REAL]
    return compared("ward", *in_numpy, "half vector, no angle")


def oren_nayar() -> list[Row]:
    """The Oren-Nayar model; numpy gets the angles and computes no arc functions."""
    p = get("oren_nayar").vector({})
    in_numpy = [partial(numpy_oren_nayar, angles(*pairs(real)), p.astype(real)) for real in REAL]
    return compared("oren_nayar", *in_numpy, "numpy is given angles, gonio vectors")


def others(of: Iterable[str]) -> list[Row]:
    """Models against the memory, and the Ward model with its derivatives."""
    rows = []
    for name in of:
        n = FEW if name == "oren_nayar_numeric" else N
        times = best_in_turn({"ours": ours(name, np.float64, n), "memory": stream(np.float64)})
        mine = times["ours"] / n
        note = "reads two of the six arrays" if name == "lambert" else ""
        rows.append(Row(name, 1 / mine, "memory", times["memory"] / N / mine, note))
    model = get("ward")
    slopes = partial(model.gradient, *pairs(np.float64), model.vector({}), threads=1)
    times = best_in_turn({"f": ours("ward", np.float64), "slopes": slopes})
    note = "five new arrays out instead of one that was there"
    name = "ward with its four derivatives"
    return [*rows, Row(name, N / times["slopes"], "ward", times["f"] / times["slopes"], note)]


def run() -> list[Row]:
    """All rows."""
    rest = [name for name in names() if name not in {"ward", "oren_nayar"}]
    return [*ward(), *oren_nayar(), *others(rest)]


CALL = """
import sys, time
import numpy as np
from gonio import models
model = models.get(sys.argv[1])
up = np.array([[0.0, 0.0, 1.0]])
start = time.perf_counter()
getattr(model, sys.argv[2])(up, up, model.vector({}), threads=1)
print(time.perf_counter() - start)
"""


def compile_times() -> dict[str, float]:
    """Seconds of a first call in a new process, with an empty cache and with a full one.

    The import of numba, half a second, is part of either.
    """
    found = {}
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "GONIO_CACHE_DIR": cache}
        for name in ("ward", "oren_nayar", "rough_plastic"):
            for loop in ("evaluate", "gradient"):
                command = [sys.executable, "-c", CALL, name, loop]
                for state in ("compiled", "from the cache"):
                    done = subprocess.run(
                        command, env=environment, capture_output=True, text=True, check=True
                    )
                    found[f"{name}, {loop}, {state}"] = float(done.stdout)
    return found


def main() -> None:
    """Print the rows."""
    for row in run():
        print(f"{row.name:32} {row.ratio:7.3g} x {row.ratio_to:8} {row.note}")
    for name, time_s in compile_times().items():
        print(f"{name}: {time_s:.2f} s")


if __name__ == "__main__":
    main()
