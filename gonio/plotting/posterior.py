"""Corner plot of a posterior: every parameter, and every pair of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import blended_transform_factory
from scipy.ndimage import gaussian_filter

import gonio.models as models
from gonio.errors import DataError
from gonio.geometry import FloatArray
from gonio.models import Parameter
from gonio.plotting.style import BLUE, SKY, VERMILLION, _new_figure, nothing_to_draw, style, symbol

LEVELS = (0.68, 0.95)
BINS = 40
SMOOTHING = 1.2  # bins: without it a contour would follow the noise of the counts
MARGINS = (0.75, 0.1, 0.75, 0.1)  # left, right, bottom, top, inches
GAP = 0.08  # between the panels, inches
FAR = 3.0  # widths of the draws beyond which a true value is not drawn


def corner(
    draws: Any,
    truth: Mapping[str, float] | None = None,
    figure: Figure | SubFigure | None = None,
) -> list[list[Axes]]:
    """Lower triangle of histograms of each parameter and contours of each pair.

    Parameters
    ----------
    draws : xarray.Dataset
        Group "posterior" of a file of draws, or of `FitResult.inference_data()`: variables over
        (chain, draw), each in the unit that its attribute `units` names (degrees where it has
        none), with the model's name in the attribute `model`.
    truth : mapping of str to float, optional
        Known values, angles in radians, drawn as thin lines.
    figure : Figure or SubFigure, optional
        Where to draw; a new figure where not given.

    Returns
    -------
    list of lists of Axes
        Row k holds the k + 1 axes of parameter k, the histogram last.

    Raises
    ------
    DataError
        If the dataset holds no draws of its model's parameters.

    Notes
    -----
    Shaded in the histograms is the central 68 % interval; the contours hold 68 % and 95 % of the
    draws. A true value more than three widths away from all draws is left out.
    """
    parameters, columns = _draws_of(draws)
    n = len(parameters)
    true_values = truth or {}
    truth = {q.name: q.to_file(true_values[q.name]) for q in parameters if q.name in true_values}
    ranges = [_axis_range(c, truth.get(q.name)) for q, c in zip(parameters, columns, strict=True)]
    with style():
        if figure is None:
            figure = _new_figure(1.6 * n + 0.8, 1.6 * n + 0.4)
        triangle = _triangle(figure, n)
        for row, axes in enumerate(triangle):
            for column in range(row):
                _pair(axes[column], columns[column], columns[row], ranges[column], ranges[row])
            _histogram(axes[row], columns[row], ranges[row])
        _finish(triangle, parameters, ranges, truth)
        _name_axes(figure, triangle, parameters)
        with_truth = any(q.name in truth for q in parameters)
        _explain(figure, with_truth=with_truth, pairs=n > 1)
    return triangle


def _draws_of(draws: Any) -> tuple[list[Parameter], list[FloatArray]]:
    name = draws.attrs.get("model")
    if name is None:
        raise DataError("the draws do not name their model (attribute 'model').")
    parameters = [q for q in models.get(str(name)).parameters if q.name in draws]
    columns = [_in_degrees(draws[q.name]) for q in parameters]
    if not columns or not columns[0].size:
        raise nothing_to_draw(f"the draws hold no parameter of {name}")
    return parameters, columns


def _in_degrees(variable: Any) -> FloatArray:
    values = np.asarray(variable.values, float).ravel()
    return np.degrees(values) if variable.attrs.get("units") == "rad" else values


def _axis_range(column: FloatArray, true: float | None) -> tuple[float, float]:
    """Range of an axis: nearly all draws, and the true value unless it lies far from them."""
    low, high = (float(q) for q in np.quantile(column, [0.001, 0.999]))
    width = high - low or max(abs(high), 1.0) * 1e-6
    if true is not None and low - FAR * width < true < high + FAR * width:
        low, high = min(low, true), max(high, true)
    margin = 0.06 * max(high - low, width)
    return low - margin, high + margin


def _triangle(figure: Figure | SubFigure, n: int) -> list[list[Axes]]:
    """Axes of equal size, whatever their tick labels, with margins in inches."""
    width, height = _inches(figure)
    left, right, bottom, top = MARGINS
    step_x, step_y = (width - left - right) / n, (height - bottom - top) / n
    boxes = [
        [
            (
                (left + column * step_x) / width,
                (height - top - (row + 1) * step_y) / height,
                (step_x - GAP) / width,
                (step_y - GAP) / height,
            )
            for column in range(row + 1)
        ]
        for row in range(n)
    ]
    return [[figure.add_axes(box) for box in row] for row in boxes]


def _explain(figure: Figure | SubFigure, *, with_truth: bool, pairs: bool) -> None:
    """What the shades and lines are, in the empty corner."""
    marks: list[Artist] = [
        Patch(color=SKY, alpha=0.35, linewidth=0, label="central 68 %"),
        Line2D([], [], color=BLUE, linewidth=0.8, linestyle="--", label="median"),
    ]
    if pairs:
        marks.append(Line2D([], [], color=BLUE, linewidth=0.8, label="contours: 68 %, 95 %"))
    if with_truth:
        marks.append(Line2D([], [], color=VERMILLION, linewidth=0.8, label="true value"))
    figure.legend(handles=marks, loc="upper right", title="posterior", alignment="left")


def _histogram(ax: Axes, column: FloatArray, span: tuple[float, float]) -> None:
    low, median, high = np.quantile(column, [0.16, 0.5, 0.84])
    counts, edges = np.histogram(column, BINS, range=span)
    ax.axvspan(float(low), float(high), color=SKY, alpha=0.35, linewidth=0)
    ax.stairs(counts, edges, color=BLUE, linewidth=1.0)
    ax.axvline(float(median), color=BLUE, linewidth=0.8, linestyle="--")
    ax.set_ylim(0, 1.12 * max(counts.max(), 1))


def _pair(
    ax: Axes,
    x: FloatArray,
    y: FloatArray,
    x_range: tuple[float, float],
    y_range: tuple[float, float],
) -> None:
    counts, x_edges, y_edges = np.histogram2d(x, y, BINS, range=[x_range, y_range])
    density = gaussian_filter(counts, SMOOTHING, mode="constant")
    centres = [(edges[1:] + edges[:-1]) / 2 for edges in (x_edges, y_edges)]
    levels = [*_levels(density), float(density.max()) * (1 + 1e-9)]
    if np.all(np.diff(levels) > 0):
        ax.contourf(*centres, density.T, levels=levels, colors=[SKY, BLUE], alpha=0.45)
        ax.contour(*centres, density.T, levels=levels[:-1], colors=BLUE, linewidths=0.8)
    else:  # too few draws for a contour
        ax.plot(x, y, ".", color=BLUE, markersize=1.5)


def _levels(density: FloatArray) -> list[float]:
    """Densities above which 95 % and 68 % of the draws lie, growing."""
    ordered = np.sort(density, axis=None)[::-1]
    cumulative = np.cumsum(ordered) / max(float(ordered.sum()), 1e-300)
    where = np.searchsorted(cumulative, sorted(LEVELS, reverse=True))
    return [float(level) for level in ordered[np.minimum(where, ordered.size - 1)]]


def _finish(
    triangle: list[list[Axes]],
    parameters: list[Parameter],
    ranges: list[tuple[float, float]],
    truth: Mapping[str, float],
) -> None:
    """Axis ranges, true values, and labels at the left and at the bottom only."""
    last = len(triangle) - 1
    for row, axes in enumerate(triangle):
        for column, ax in enumerate(axes):
            ax.set_xlim(*ranges[column])
            ax.xaxis.set_major_locator(MaxNLocator(3, prune="both"))
            ax.tick_params(axis="x", labelrotation=45)
            if column < row:
                ax.set_ylim(*ranges[row])
                ax.yaxis.set_major_locator(MaxNLocator(3, prune="both"))
            else:
                ax.set_yticks([])
                ax.spines["left"].set_visible(False)
            _true_lines(ax, truth, parameters[column], parameters[row], column < row)
            ax.tick_params(labelbottom=row == last, labelleft=column == 0 and row > 0)


def _name_axes(
    figure: Figure | SubFigure, triangle: list[list[Axes]], parameters: list[Parameter]
) -> None:
    """Symbols in one line below and in one line at the left, however long the numbers are."""
    width, height = _inches(figure)
    below, left = 0.24 / height, 0.16 / width
    for ax, q in zip(triangle[-1], parameters, strict=True):
        ax.set_xlabel(symbol(q, unit=True), fontsize=10)
        at = blended_transform_factory(ax.transAxes, figure.transSubfigure)
        ax.xaxis.set_label_coords(0.5, below, transform=at)
    for (ax, *_), q in zip(triangle[1:], parameters[1:], strict=True):
        ax.set_ylabel(symbol(q, unit=True), fontsize=10)
        at = blended_transform_factory(figure.transSubfigure, ax.transAxes)
        ax.yaxis.set_label_coords(left, 0.5, transform=at)


def _inches(figure: Figure | SubFigure) -> tuple[float, float]:
    dpi = figure.figure.dpi if isinstance(figure, SubFigure) else figure.dpi
    return figure.bbox.width / dpi, figure.bbox.height / dpi


def _true_lines(
    ax: Axes, truth: Mapping[str, float], across: Parameter, up: Parameter, pair: bool
) -> None:
    if across.name in truth:
        ax.axvline(truth[across.name], color=VERMILLION, linewidth=0.8)
    if pair and up.name in truth:
        ax.axhline(truth[up.name], color=VERMILLION, linewidth=0.8)
