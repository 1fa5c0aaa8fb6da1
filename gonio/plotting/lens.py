"""Residuals of a fitted lens at the corners of its boards."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from gonio.calibration.lens.from_photos import LensFromPhotos
from gonio.geometry import FloatArray
from gonio.plotting.style import BLUE, GREY, ORANGE, VERMILLION, _new_figure, style

CIRCLES_DEG = (30.0, 60.0, 90.0)
ARROW_SHARE = 0.025  # length of an arrow as long as the rms, over the picture's width
_BIN_DEG = 5.0


def residual_map(calibration: LensFromPhotos) -> Figure:
    """Residuals of all corners: as arrows over the image, and along the radius by angle.

    Parameters
    ----------
    calibration : LensFromPhotos
        A lens with the photographs that it was fitted to.

    Returns
    -------
    Figure
        Left: observed minus projected, enlarged, at the corners; circles of equal theta.
        Right: the part along the radius, each corner and the mean with its standard error in
        steps of 5 deg, and twice the standard uncertainty of the lens. A wave in the means
        is what the lens model cannot describe.
    """
    pixels = np.vstack([view.pixels for view in calibration.fit.views])
    residuals = np.vstack(calibration.fit.residuals)
    with style():
        figure = _new_figure(9.6, 4.6)
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.05))
        _arrows(left, calibration, pixels, residuals)
        _along_radius(right, calibration, pixels, residuals)
    return figure


def _arrows(
    ax: Axes, calibration: LensFromPhotos, pixels: FloatArray, residuals: FloatArray
) -> None:
    rows, columns = calibration.shape
    rms = calibration.fit.rms_px
    scale = rms / (ARROW_SHARE * columns)  # pixels of residual for a pixel of the picture
    _circles(ax, calibration)
    arrows = ax.quiver(
        *pixels.T, *residuals.T, angles="xy", scale_units="xy", scale=scale, color=BLUE,
        width=0.0016, headwidth=4, headlength=5,
    )  # fmt: skip
    ax.quiverkey(
        arrows, 0.08, 0.03, 2 * rms, f"{2 * rms:.2g} px", labelpos="E", coordinates="axes",
        fontproperties={"size": 7.5},
    )  # fmt: skip
    ax.set_xlim(-0.5, columns - 0.5)
    ax.set_ylim(rows - 0.5, -0.5)  # rows grow downwards, as the sensor has them
    ax.set_aspect(1)
    ax.locator_params(nbins=5)
    ax.set_xlabel("column (pixel)")
    ax.set_ylabel("row (pixel)")
    ax.set_title(
        f"{calibration.fit.n_corners} corners in {len(calibration.fit.views)} photographs, "
        f"rms {rms:.3f} px"
    )


def _circles(ax: Axes, calibration: LensFromPhotos) -> None:
    lens = calibration.fit.lens
    for circle in CIRCLES_DEG:
        radius = float(lens.radius(np.radians(circle)))
        size = 2 * radius, 2 * radius * lens.ratio
        ax.add_patch(Ellipse(lens.centre, *size, fill=False, color=ORANGE, linewidth=0.8))
        at = lens.centre[0] + radius * np.sqrt(0.5), lens.centre[1] + radius * np.sqrt(0.5)
        ax.annotate(
            f"{circle:g}°", at, fontsize=7, color=ORANGE, ha="center", va="center",
            bbox={"facecolor": "white", "pad": 0.6, "linewidth": 0},
        )  # fmt: skip
    ax.plot(*lens.centre, "+", color=VERMILLION, markersize=8)


def _along_radius(
    ax: Axes, calibration: LensFromPhotos, pixels: FloatArray, residuals: FloatArray
) -> None:
    fit = calibration.fit
    theta = np.degrees(fit.theta())
    outward = pixels - fit.lens.centre
    outward /= np.maximum(np.hypot(*outward.T), 1e-9)[:, None]
    along = np.sum(residuals * outward, axis=1)
    ax.plot(theta, along, ".", color=GREY, markersize=2, alpha=0.35, label="corners")
    grid = np.radians(np.linspace(1, max(90.0, theta.max()), 90))
    band = 2 * fit.theta_sd(grid) * fit.lens.slope(grid)
    label = "2 std. uncertainties of the lens"
    ax.fill_between(np.degrees(grid), -band, band, color=ORANGE, alpha=0.35, lw=0, label=label)
    middles, means, errors = _means(theta, along)
    ax.errorbar(
        middles, means, errors, fmt="o", color=BLUE, markersize=3, linewidth=1, label="means"
    )
    limit = 5 * max(float(np.std(along)), 1e-6)
    ax.set_ylim(-limit, limit)
    ax.set_xlim(0, max(90.0, float(theta.max())) + 1)
    ax.axhline(0, color=GREY, linewidth=0.6)
    ax.set_xlabel(r"$θ_{\mathrm{c}}$ (°)")
    ax.set_ylabel("residual along the radius (pixel)")
    ax.set_title(f"corners reach θ = {calibration.reach_deg:.1f}°")
    ax.legend(loc="upper left", ncols=3, markerscale=2)


def _means(theta: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean angle, mean residual and its standard error in steps of the angle, 3 corners or more."""
    bins = []
    for start in np.arange(0, theta.max(), _BIN_DEG):
        inside = (theta >= start) & (theta < start + _BIN_DEG)
        if (n := int(inside.sum())) >= 3:
            values = along[inside]
            bins.append((theta[inside].mean(), values.mean(), values.std(ddof=1) / np.sqrt(n)))
    columns = np.array(bins).reshape(-1, 3).T
    return columns[0], columns[1], columns[2]
