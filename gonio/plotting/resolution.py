"""Blur and coverage of an instrument over the hemisphere of viewing directions."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from gonio.geometry import FloatArray, equal_area, unit_vectors
from gonio.instrument.resolution import WHOLE, Resolution, principal
from gonio.plotting.disc import at, draw_disc
from gonio.plotting.style import BLACK, BLUE, VERMILLION, _new_figure, style

_ELLIPSE = 0.09  # longest diameter of an ellipse, of the hemisphere's radius


def resolution_map(resolution: Resolution) -> Figure:
    """Two hemispheres of viewing directions in the equal-area map, x to the right, y up.

    Parameters
    ----------
    resolution : Resolution
        Blur and coverage of an instrument.

    Returns
    -------
    Figure
        Left: the blur's larger standard deviation as colour, and ellipses of the blur, enlarged.
        Right: the share of a pixel's rays that land on lit sample, lamp at normal incidence, and
        the incidence angles that the lamp's arm reaches. Grey: no pixel receives it. The rim mask
        of the reduction is drawn over both.
    """
    covered = resolution.share > 0
    blur = np.where(covered, np.degrees(principal(resolution.blur)[..., 0]), np.nan)
    with style():
        figure = _new_figure(9.4, 4.3)
        left, right = figure.subplots(1, 2)
        inside = resolution.usable & covered
        shown = blur[inside if inside.any() else covered]
        top = float(shown.max()) if len(shown) else 1.0
        least = float(shown.min()) if len(shown) else 0.0
        norm = Normalize(min(least, 0.9 * top), top)  # a constant blur is drawn in one colour
        _panel(left, resolution, blur, norm, "viridis", "blur, sd on the larger axis (°)")
        _ellipses(left, resolution)
        share = np.where(covered, resolution.share, np.nan)
        _panel(right, resolution, share, Normalize(0, 1), "cividis", "share of rays on lit sample")
        _outline(right, resolution)
        _arm(right, resolution)
        left.set_title("Blur; ellipses show its shape, enlarged")
        right.set_title("Coverage, lamp at normal incidence")
        right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.01), ncols=3)
        figure.suptitle(resolution.instrument.name, fontsize=9)
    return figure


def _panel(
    ax: Axes, resolution: Resolution, values: FloatArray, norm: Normalize, cmap: str, label: str
) -> None:
    draw_disc(ax)
    # The first azimuth is repeated at the end; a cell has the value of the point where it begins.
    x, y = (np.concatenate([v, v[:, :1]], axis=1) for v in equal_area(resolution.w_r))
    image = ax.pcolormesh(
        x, y, values[:-1], norm=norm, cmap=cmap, shading="flat", rasterized=True, zorder=1
    )
    rim = resolution.instrument.usable_theta_r_deg
    ax.plot(
        *at(rim, np.linspace(0, 2 * np.pi, 181)),
        color=BLACK,
        linewidth=1.2,
        zorder=3,
        label=f"rim mask, {rim:g}°",
    )
    ax.figure.colorbar(image, ax=ax, label=label, shrink=0.8, pad=0.02)


def _ellipses(ax: Axes, resolution: Resolution) -> None:
    """The blur's ellipses at some directions, as the map would show them if they were large."""
    picked = [
        (theta, phi)
        for theta, n in ((0.0, 1), (20.0, 8), (50.0, 12), (72.0, 16))
        for phi in np.arange(n) * 2 * np.pi / n
    ]
    tensors = [(w, resolution.at(resolution.blur, np.radians(w[0]), w[1])) for w in picked]
    drawn = [(w, tensor) for w, tensor in tensors if tensor is not None]
    if not drawn:
        return
    shapes = [_on_map(np.radians(theta), phi, tensor) for (theta, phi), tensor in drawn]
    sizes = np.array([np.sqrt(np.linalg.eigvalsh(shape)[::-1]) for shape in shapes])
    turns = [np.degrees(np.arctan2(*np.linalg.eigh(shape)[1][::-1, 1])) for shape in shapes]
    widths, heights = (sizes * (_ELLIPSE / sizes.max())).T
    ax.add_collection(
        EllipseCollection(
            widths, heights, turns, units="xy", offsets=[at(*w) for w, _ in drawn],
            offset_transform=ax.transData, facecolors="none", edgecolors=BLACK, linewidths=0.8,
            zorder=4, path_effects=[withStroke(linewidth=2.0, foreground="white")],
        )
    )  # fmt: skip


def _on_map(theta: float, phi: float, tensor: FloatArray) -> FloatArray:
    """A tensor (2, 2) on the tangents in the coordinates of the map."""
    w, step = unit_vectors(theta, phi), 1e-5
    t_x = np.array([1.0, 0.0, 0.0]) - w[0] * w
    t_x /= np.linalg.norm(t_x)
    moved = [np.subtract(equal_area(w + step * t), equal_area(w - step * t)) / (2 * step)
             for t in (t_x, np.cross(w, t_x))]  # fmt: skip
    jacobian = np.stack(moved, axis=1)
    return np.asarray(jacobian @ tensor @ jacobian.T)


def _outline(ax: Axes, resolution: Resolution) -> None:
    """Where the share of rays falls below WHOLE."""
    x, y = equal_area(resolution.w_r)
    closed = [np.concatenate([v, v[:, :1]], axis=1) for v in (x, y, resolution.share)]
    if resolution.share.min() < WHOLE < resolution.share.max():
        ax.contour(*closed, levels=[WHOLE], colors=[VERMILLION], linewidths=1.0, zorder=3)
        ax.plot([], [], color=VERMILLION, linewidth=1.0, label=f"{100 * WHOLE:g} % of the rays")


def _arm(ax: Axes, resolution: Resolution) -> None:
    limit = resolution.instrument.theta_i_max_deg
    ends = np.transpose([at(theta, 0.0) for theta in (0.0, limit)])
    ax.plot(*ends, color=BLUE, linewidth=1.4, marker="o", markersize=3, zorder=4,
            label=f"lamp's arm, to {limit:g}°")  # fmt: skip
