"""The map of a dome: displacement of directions, and where it is known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from gonio.dome_map import DomeMap
from gonio.errors import ConfigurationError
from gonio.geometry import equal_area, from_equal_area, unit_vectors
from gonio.plotting.disc import draw_disc
from gonio.plotting.style import BLACK, _new_figure, style

_GRID = 121
_ARROWS = 17
_LEFT = 1.0  # posterior over prior sd: nothing known


def dome_map(dome: DomeMap, axes: Sequence[Axes] | None = None) -> list[Axes]:
    """Size and direction of the displacement, and posterior over prior standard deviation.

    Parameters
    ----------
    dome : DomeMap
    axes : sequence of two Axes, optional
        New ones where not given.

    Returns
    -------
    list of Axes
        Equal areas are equal solid angles; the zenith is in the middle, the lamp's azimuth to the
        right. Arrows are longer than what they show.

    Raises
    ------
    ConfigurationError
        For another number of axes.
    """
    if axes is not None and len(axes) != 2:
        raise ConfigurationError(
            f"a map of a dome has two panels and {len(axes)} axes were given; give two.",
            value=len(axes),
        )
    farthest = float(np.arccos(np.min(dome.nodes.directions[:, 2])))
    edge = float(equal_area(unit_vectors(min(farthest, np.pi / 2), 0.0))[0])
    x, y, inside, directions = _grid(_GRID, edge)
    size = np.full(inside.shape, np.nan)
    size[inside] = np.degrees(np.linalg.norm(dome.displacement(directions), axis=1))
    after, before = dome.sd(directions)
    left = np.full(inside.shape, np.nan)
    left[inside] = np.sqrt(np.mean(after**2, axis=1)) / before
    with style():
        if axes is None:
            axes = _new_figure(8.4, 4.2).subplots(1, 2)
        for ax, values, top, label in (
            (axes[0], size, None, "displacement of directions (deg)"),
            (axes[1], left, _LEFT, "standard deviation, with the map over without"),
        ):
            draw_disc(ax)
            drawn = ax.pcolormesh(
                x, y, values, vmin=0.0, vmax=top, cmap="viridis", shading="nearest",
                rasterized=True, zorder=1,
            )  # fmt: skip
            ax.figure.colorbar(drawn, ax=ax, label=label, shrink=0.75)
        _arrows(axes[0], dome, edge)
        axes[0].set_title(f"dome of {dome.rig}", fontsize=9)
        axes[1].set_title("known where dark", fontsize=9)
    return list(axes)


def _grid(n: int, edge: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    line = np.linspace(-edge, edge, n)
    x, y = np.meshgrid(line, line)
    inside = np.hypot(x, y) <= edge
    return x, y, inside, from_equal_area(x[inside], y[inside])


def _arrows(ax: Axes, dome: DomeMap, edge: float) -> None:
    x, y, inside, directions = _grid(_ARROWS, edge)
    shift = dome.displacement(directions)
    # The ends of a small step on the disc show its direction there.
    step = 1e-3
    end = directions + step * shift / np.maximum(np.max(np.abs(shift)), 1e-12)
    u, v = (b - a for a, b in zip((x[inside], y[inside]), equal_area(_unit(end)), strict=True))
    length = np.hypot(u, v)
    # Nine of ten arrows are no longer than the distance of their feet; the others are cut.
    usual = max(float(np.quantile(length, 0.9)), 1e-15)
    size = np.minimum(length, usual) / usual * (2 * edge / _ARROWS) / np.maximum(length, 1e-15)
    ax.quiver(
        x[inside], y[inside], size * u, size * v, color=BLACK, width=0.003, zorder=4,
        angles="xy", scale_units="xy", scale=1.0,
    )  # fmt: skip


def _unit(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
