"""Maps of materials: many small fits, against a loop over scipy's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from scipy.optimize import least_squares

from benchmarks.kernels import angles as angles_of
from benchmarks.kernels import numpy_oren_nayar, numpy_ward
from benchmarks.timing import Row, best_in_turn
from gonio.fitting.texels import TexelFit, fit_texels
from gonio.geometry import Directions, FloatArray, angles, unit_vectors
from gonio.models import get

TEXELS = 100_000
SAMPLES = 100
TIMED = 200  # texels that scipy fits
ROUNDS = 3
NOISE = 0.03  # of the mean surface
RANGES = {
    "ward": {
        "rho_d": (0.05, 0.6), "rho_s": (0.02, 0.3), "alpha_x": (0.05, 0.4), "alpha_y": (0.05, 0.4),
    },
    "oren_nayar": {"rho": (0.1, 0.9), "sigma": (0.1, 0.7)},
}  # fmt: skip

Plain = Callable[[FloatArray], FloatArray]


def view_directions() -> Directions:
    """Five incidences; views about the mirror direction, where a lobe is, and far from it."""
    rng = np.random.default_rng(0)
    incidence = np.arange(SAMPLES) % 5
    theta_i, phi_i = rng.uniform(0.1, 1.1, 5)[incidence], rng.uniform(-3, 3, 5)[incidence]
    w_i = unit_vectors(theta_i, phi_i)
    h = np.stack([*(0.2 * rng.standard_normal((2, SAMPLES))), np.ones(SAMPLES)], axis=-1)
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    theta_r, phi_r = angles(2 * np.sum(w_i * h, axis=1, keepdims=True) * h - w_i)
    return Directions(theta_i, phi_i, np.minimum(theta_r, 1.4), phi_r)


def stack(model: str, texels: int) -> tuple[FloatArray, FloatArray]:
    """Values (texels, samples) of surfaces drawn at random, and their uncertainty (samples,)."""
    rng = np.random.default_rng(1)
    w_i, w_r = view_directions().vectors()
    low, high = np.array(list(RANGES[model].values())).T
    chosen = rng.uniform(low, high, (texels, len(low)))
    values = np.stack([get(model).evaluate(w_i, w_r, p, threads=1) for p in chosen])
    u = NOISE * values.mean(axis=0)
    values += u * rng.standard_normal(values.shape)
    return values, u


def numpy_model(model: str) -> Plain:
    """The model in numpy; terms without parameters are computed once."""
    w_i, w_r = view_directions().vectors()
    if model == "ward":
        return partial(numpy_ward, w_i, w_r)
    return partial(numpy_oren_nayar, angles_of(w_i, w_r))


def by_scipy(model: str, values: FloatArray, u: FloatArray) -> FloatArray:
    """chi2 of each texel by `least_squares` from the model's default values."""
    parameters = get(model).parameters
    bounds = [q.lower for q in parameters], [q.upper for q in parameters]
    start = [q.default for q in parameters]
    f = numpy_model(model)
    fits = [least_squares(lambda p, v=v: (f(p) - v) / u, start, bounds=bounds) for v in values]
    return 2 * np.array([each.cost for each in fits])


def compared(model: str, note: str, per_texel: bool = False) -> Row:
    """One thread; scipy fits some of the texels."""
    values, u = stack(model, TEXELS)
    where = view_directions()
    if per_texel:
        shape = (TEXELS, SAMPLES)
        columns: Sequence[FloatArray] = [np.broadcast_to(a, shape) for a in vars(where).values()]
        where = Directions(*columns)
    ours = partial(fit_texels, where, values, model, u=u, threads=1)
    others = partial(by_scipy, model, values[:TIMED], u)
    times = best_in_turn({"ours": ours, "scipy": others}, ROUNDS)
    rate, scipy_rate = TEXELS / times["ours"], TIMED / times["scipy"]
    worse = excess(ours(), others())
    return Row(
        f"texels, {model}{note}", rate, "scipy least_squares, a loop", rate / scipy_rate, worse
    )


def excess(fit: TexelFit, chi2: FloatArray) -> str:
    """Comparison of our minima with scipy's, in one phrase."""
    ratio = fit.chi2[: len(chi2)] / chi2 - 1
    equal = np.abs(ratio) < 1e-6
    deeper = int(np.count_nonzero(ratio <= -1e-6))
    note = f"chi2 the same to 1e-6 in {equal.sum()} of {len(chi2)}"
    note += f", ours less in {deeper}" if deeper else ""
    higher = len(chi2) - int(equal.sum()) - deeper
    note += f", more in {higher}" if higher else ""
    lost = len(fit) - fit.count("converged")
    return note + (f"; {lost} of {len(fit)} not converged" if lost else "")


def run() -> list[Row]:
    """Texels a second on one thread."""
    return [
        compared("ward", ""),
        compared("ward", ", directions of their own", per_texel=True),
        compared("oren_nayar", ""),
    ]


if __name__ == "__main__":
    for row in run():
        print(row)
