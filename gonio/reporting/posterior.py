"""Charts of a posterior: every parameter, every pair of them, and the chains."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

import gonio.models as models
from gonio.fitting.result import FitResult
from gonio.geometry import FloatArray
from gonio.models import Parameter
from gonio.plotting.style import BLUE, COLOURS, SKY, VERMILLION, unit_text
from gonio.reporting.chart import Chart, Trace, View, axis, faded, short, spread

BINS = 36
SMOOTHING = 1.2  # bins: a contour would follow the noise of the counts
LEVELS = (0.95, 0.68)
CHAINS = 6
STEPS = 300  # of a chain, in the trace
GAP = 0.02  # of the width, between panels


def named(q: Parameter) -> str:
    """A parameter's symbol as HTML of plotly, with its unit."""
    letter, _, index = q.symbol.partition("_")
    unit = f" ({unit_text(q.file_unit)})" if q.file_unit else ""
    return letter + (f"<sub>{index}</sub>" if index else "") + unit


def corner(fit: FitResult, draws: Any) -> Chart:
    """Histograms on the diagonal, contours of 68 % and 95 % below it."""
    model = models.of_fit(fit)
    parameters = [model.parameter(name) for name, e in fit.parameters.items() if e.unknown]
    drawn = [np.asarray(draws[q.name].values, float).ravel() for q in parameters]
    truth: Mapping[str, float] = fit.source.get("truth") or {}
    true = [truth.get(q.name) for q in parameters]
    ranges = [_axis_range(column, t) for column, t in zip(drawn, true, strict=True)]
    n = len(parameters)
    data: list[Trace] = []
    layout: dict[str, Any] = {
        "showlegend": False,
        "shapes": [],
        "margin": {"l": 70, "r": 15, "t": 15, "b": 70},
    }
    for row in range(n):
        for column in range(row + 1):
            k = _axis_suffix(row * n + column)
            if row == column:
                data.append(_counts(drawn[row], ranges[row], k))
            else:
                data += _pair(drawn[column], drawn[row], ranges[column], ranges[row], k)
            layout |= _axes(parameters, ranges, row, column, k)
            layout["shapes"] += _true(true[column], true[row] if row != column else None, k)
    caption = (
        f"{drawn[0].size} draws. Diagonal: histogram of a parameter; below it: regions that hold "
        "68 % and 95 % of the draws of a pair." + (" Lines: true values." if truth else "")
    )
    return Chart(
        "corner",
        "",
        (View("", data, layout),),
        caption,
        height=150 * n + 60,
        min_width=140 * n,
        print_height=370,
    )


def _axis_range(column: FloatArray, true: float | None) -> tuple[float, float]:
    """Range of an axis: nearly all draws, and the true value within three widths of them."""
    low, high = (float(q) for q in np.quantile(column, [0.001, 0.999]))
    width = high - low or max(abs(high), 1.0) * 1e-6
    if true is not None and low - 3 * width < true < high + 3 * width:
        low, high = min(low, true), max(high, true)
    return low - 0.06 * width, high + 0.06 * width


def _axis_suffix(k: int) -> str:
    """Suffix that plotly gives to the names of the k-th pair of axes, counted from 0."""
    return "" if k == 0 else str(k + 1)


def _counts(column: FloatArray, span: tuple[float, float], k: str) -> Trace:
    counts, edges = np.histogram(column, BINS, range=span)
    return {
        "type": "bar", "x": short((edges[1:] + edges[:-1]) / 2, 6), "y": counts.tolist(),
        "width": float(edges[1] - edges[0]), "xaxis": f"x{k}", "yaxis": f"y{k}",
        "marker": {"color": SKY, "line": {"width": 0}},
        "hovertemplate": "%{x}: %{y} draws<extra></extra>",
    }  # fmt: skip


def _pair(
    x: FloatArray,
    y: FloatArray,
    x_range: tuple[float, float],
    y_range: tuple[float, float],
    k: str,
) -> list[Trace]:
    counts, x_edges, y_edges = np.histogram2d(x, y, BINS, range=[x_range, y_range])
    density = gaussian_filter(counts, SMOOTHING, mode="constant").T
    common = {
        "x": short((x_edges[1:] + x_edges[:-1]) / 2, 6),
        "y": short((y_edges[1:] + y_edges[:-1]) / 2, 6),
        "z": short(density, 3), "type": "contour", "showscale": False, "hoverinfo": "skip",
        "xaxis": f"x{k}", "yaxis": f"y{k}", "line": {"color": BLUE, "width": 1.2},
    }  # fmt: skip
    return [
        {
            **common,
            "contours": {"type": "constraint", "operation": "<", "value": level},
            "fillcolor": faded(BLUE, alpha),
        }
        for level, alpha in zip(_densities(density), (0.2, 0.35), strict=True)
    ]


def _densities(density: FloatArray) -> list[float]:
    """Densities above which the shares LEVELS of all draws lie."""
    ordered = np.sort(density, axis=None)[::-1]
    cumulative = np.cumsum(ordered) / max(float(ordered.sum()), 1e-300)
    at = np.minimum(np.searchsorted(cumulative, LEVELS), ordered.size - 1)
    return [float(f"{ordered[j]:.6g}") for j in at]


def _axes(
    parameters: list[Parameter],
    ranges: list[tuple[float, float]],
    row: int,
    column: int,
    k: str,
) -> dict[str, Any]:
    n = len(parameters)
    across = [column / n + GAP / 2, (column + 1) / n - GAP / 2]
    up = [1 - (row + 1) / n + GAP / 2, 1 - row / n - GAP / 2]
    last, first = row == n - 1, column == 0 and row > 0
    common = {"nticks": 4, "zeroline": False, "showgrid": False}
    return {
        f"xaxis{k}": {
            **common, "domain": across, "anchor": f"y{k}", "range": list(ranges[column]),
            "showticklabels": last, "tickangle": -45,
            "title": {"text": named(parameters[column]) if last else ""},
        },
        f"yaxis{k}": {
            **common, "domain": up, "anchor": f"x{k}", "showticklabels": first,
            "title": {"text": named(parameters[row]) if first else ""},
            **({"range": list(ranges[row])} if row != column else {"rangemode": "tozero"}),
        },
    }  # fmt: skip


def _true(x: float | None, y: float | None, k: str) -> list[dict[str, Any]]:
    """Lines at the true values of a panel."""
    line = {"type": "line", "line": {"color": VERMILLION, "width": 1}}
    lines = []
    if x is not None:
        lines.append(
            {**line, "xref": f"x{k}", "yref": f"y{k} domain", "x0": x, "x1": x, "y0": 0, "y1": 1}
        )
    if y is not None:
        lines.append(
            {**line, "xref": f"x{k} domain", "yref": f"y{k}", "x0": 0, "x1": 1, "y0": y, "y1": y}
        )
    return lines


def trace(fit: FitResult, draws: Any) -> Chart:
    """Some of the chains against the number of the draw, one parameter a view."""
    model = models.of_fit(fit)
    views = []
    unknowns = [name for name, e in fit.parameters.items() if e.unknown]
    for name in unknowns:
        values = np.atleast_2d(np.asarray(draws[name].values, float))
        steps = np.asarray(spread(range(values.shape[1]), STEPS), int)
        data: list[Trace] = [
            {"type": "scatter", "mode": "lines", "x": steps.tolist(), "name": f"chain {k}",
             "y": short(values[k, steps], 5), "line": {"color": colour, "width": 0.8}}
            for k, colour in zip(
                spread(range(values.shape[0]), CHAINS), COLOURS[1:], strict=False)
        ]  # fmt: skip
        layout = {"xaxis": axis("draw"), "yaxis": axis(named(model.parameter(name)))}
        views.append(View(name, data, {**layout, "showlegend": False}))
    n = np.atleast_2d(draws[unknowns[0]].values).shape
    caption = (
        f"{min(n[0], CHAINS)} of {n[0]} chains, {min(n[1], STEPS)} of {n[1]} draws of each. A "
        "chain that has converged shows no drift, and all chains fill the same band."
    )
    return Chart("trace", "Parameter", tuple(views), caption, height=300)
