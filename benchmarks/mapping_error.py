"""Error of eq. (3) against the exact mirror: table and figure.

Run from the root of the checkout, in its environment:

    python benchmarks/mapping_error.py -o docs/images/mapping_error.png

Prints the table, median and largest angle between the direction by Ward's eq. (3) and the exact
chief ray's, in degrees, over theta_r up to 60, 75 and 85 deg weighted by solid angle, for a sphere
and for the ellipsoid with its foci in camera and target; and draws the errors over the hemisphere.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from gonio.calibration.reflector import (
    Mapping,
    Shape,
    camera_angles,
    reflected_angles,
    reflected_directions,
)
from gonio.files import atomic_path
from gonio.geometry import FloatArray, angles, from_equal_area, hemisphere_quadrature, unit_vectors
from gonio.plotting.style import BLUE, VERMILLION, format_of, style

R = 150.0
RATIOS = (0.02, 0.05, 0.10, 0.15)
LIMITS_DEG = (60, 75, 85)
SHAPES: tuple[Shape, ...] = ("sphere", "ellipsoid")


def chief_ray_directions(
    w_c: FloatArray, ratio: float, shape: Shape, mapping: Mapping, R: float = R
) -> FloatArray:
    """Directions from the sample along the camera's chief rays (n, 3)."""
    D = ratio * R
    pupil = np.array([0.0, -D, 0.0])
    return reflected_directions(pupil, w_c, R=R, D=D, shape=shape, mapping=mapping)[0]


def errors(ratio: float, shape: Shape, n: int = 400) -> tuple[FloatArray, FloatArray, FloatArray]:
    """theta_r, error of eq. (3) (both deg) and solid angle of rays over the hemisphere."""
    D = ratio * R
    theta, phi, weight = hemisphere_quadrature(n, 2 * n)
    w_c, zero = unit_vectors(theta, phi), np.zeros(3)
    e_theta = unit_vectors(theta + np.pi / 2, phi)
    e_phi = unit_vectors(np.pi / 2, phi + np.pi / 2)
    w_r, (d_theta, d_phi) = reflected_directions(
        np.array([0.0, -D, 0.0]), w_c, ((zero, e_theta), (zero, e_phi)),
        R=R, D=D, shape=shape, mapping="exact",
    )  # fmt: skip
    solid_angle = weight * np.linalg.norm(np.cross(d_theta, d_phi), axis=1)
    return (
        np.degrees(angles(w_r)[0]),
        apart(w_r, chief_ray_directions(w_c, ratio, shape, "eq3")),
        solid_angle,
    )


def apart(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angle between unit vectors, degrees, exact for small ones."""
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


def weighted_median(values: FloatArray, weights: FloatArray) -> float:
    """Value below which half of the weight lies."""
    order = np.argsort(values)
    share = np.cumsum(weights[order]) - weights[order] / 2
    return float(np.interp(0.5 * weights.sum(), share, values[order]))


def largest_with(ratio: float, length: float) -> float:
    """Largest error on the ellipsoid, theta_r <= 85 deg, with another length in place of R."""
    theta, phi, _ = hemisphere_quadrature(200, 400)
    exact = chief_ray_directions(unit_vectors(theta, phi), ratio, "ellipsoid", "exact")
    ward = unit_vectors(*reflected_angles(theta, phi, R=length, D=ratio * R))
    inside = exact[:, 2] >= np.cos(np.radians(85))
    return float(apart(exact, ward)[inside].max())


def table() -> str:
    """The table as Markdown."""
    head = (
        "| D/R | sphere | ellipsoid, R = b | ellipsoid, R = a | ellipsoid, R = (2 b + a)/3 |",
        "|---|---|---|---|---|",
    )
    rows = []
    for ratio in RATIOS:
        cells = []
        for shape in SHAPES:
            theta_r, error, weight = errors(ratio, shape)
            digits = 3 if error.max() > 1e-3 else 4
            errors_of_shape = []
            for limit in LIMITS_DEG:
                inside = theta_r <= limit
                median = weighted_median(error[inside], weight[inside])
                errors_of_shape.append(f"{median:.{digits}f}/{error[inside].max():.{digits}f}")
            cells.append(", ".join(errors_of_shape))
        a = R * float(np.hypot(1, ratio))
        others = [f"{largest_with(ratio, length):.4f}" for length in (a, (2 * R + a) / 3)]
        rows.append(f"| {ratio:.2f} | {' | '.join([*cells, *others])} |")
    return "\n".join([*head, *rows])


def draw(path: Path) -> None:
    """Error over the hemisphere for D/R = 0.1, and its largest value against D/R."""
    import matplotlib.pyplot as plt

    with style():
        figure, axes = plt.subplots(1, 3, figsize=(9.6, 3.2), layout="constrained")
        for shape, ax in zip(SHAPES, axes, strict=False):
            _draw_map(ax, shape)
        _draw_growth(axes[2])
        with atomic_path(path) as temporary:
            figure.savefig(temporary, format=format_of(path))
        plt.close(figure)


def _draw_map(ax: Any, shape: Shape) -> None:
    x, y = np.meshgrid(*2 * [np.linspace(-1, 1, 401)])
    inside = np.hypot(x, y) < 0.9999
    w_r = from_equal_area(x[inside], y[inside])
    # Eq. (3) and its inverse lead from a direction by eq. (3) to the ray that is meant.
    w_c = unit_vectors(*camera_angles(*angles(w_r), R=R, D=0.1 * R))
    error = np.full(x.shape, np.nan)
    error[inside] = apart(chief_ray_directions(w_c, 0.1, shape, "exact"), w_r)
    picture = ax.pcolormesh(x, y, error, cmap="viridis", vmin=0, rasterized=True)
    ax.figure.colorbar(picture, ax=ax, label="error of eq. (3), deg", shrink=0.85)
    turn = np.linspace(0, 2 * np.pi, 361)
    for theta in (30, 60, 90):
        r = np.sqrt(2) * np.sin(np.radians(theta) / 2)
        ax.plot(r * np.cos(turn), r * np.sin(turn), color="white", lw=0.6, alpha=0.8)
        if theta < 90:
            ax.text(0.02, r + 0.02, f"{theta}\N{DEGREE SIGN}", color="white", fontsize=7)
    ax.set_title(f"{shape}, D/R = 0.1")
    ax.set_aspect("equal")
    ax.spines[:].set_visible(False)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_xlabel("x (plane of the lamp)")
    ax.set_ylabel("y (from the camera to the target)")


def _draw_growth(ax: Any) -> None:
    ratio = np.geomspace(0.01, 0.2, 9)
    for shape, power, colour in zip(SHAPES, (2, 3), (BLUE, VERMILLION), strict=True):
        largest = [float(errors(float(r), shape, 100)[1].max()) for r in ratio]
        ax.loglog(ratio, largest, "o", color=colour, ms=4, label=shape)
        # Largest value of sin(2 gamma) and of cos^2(gamma) sin(gamma).
        factor, text = {2: (1.0, ""), 3: (2 / np.sqrt(27), "0.385 ")}[power]
        leading = np.degrees(factor * ratio**power)
        ax.loglog(ratio, leading, color=colour, label=f"{text}(D/R)$^{power}$ rad")
    ax.set_xlabel("D/R")
    ax.set_ylabel("largest error of eq. (3), deg")
    ax.set_title("growth with the camera's distance")
    ax.grid(which="both", lw=0.3, alpha=0.5)
    ax.legend()


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("-o", "--output", type=Path, required=True, help="figure, .png or .svg")
    arguments = parser.parse_args()
    print(table())
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    draw(arguments.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
