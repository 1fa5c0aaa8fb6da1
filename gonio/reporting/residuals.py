"""Residuals: maps over the hemisphere and a histogram."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import gonio.models as models
from gonio.fitting.problem.single import SingleProblem
from gonio.fitting.result import FitResult
from gonio.geometry import FloatArray
from gonio.plotting.style import BLUE, VERMILLION
from gonio.reporting.chart import Chart, Trace, View, axis, faded, short, spread
from gonio.reporting.lobe import Image, columns, images
from gonio.samples import BRDFSamples

MOST_DRAWN = 12_000  # samples in all maps together
MOST_MAPS = 64
WITHIN = 0.95  # share of the samples within the range of the colours
BINS = np.linspace(-5, 5, 51)
_COLOURS = [[0, BLUE], [0.5, "#dcdcdc"], [1, VERMILLION]]


@dataclass(frozen=True)
class Residuals:
    """Measured minus fitted, averaged over the cell of each sample.

    Parameters
    ----------
    z : ndarray, shape (N,)
        The residuals in the unit that `unit` names.
    unit : str
        Their unit in words.
    in_uncertainties : bool
        Whether the unit is the standard uncertainty of a sample.
    percent : ndarray, shape (N,)
        The residuals in per cent of the fitted f; NaN where that is not above zero.
    """

    z: FloatArray
    unit: str
    in_uncertainties: bool
    percent: FloatArray


def residuals(samples: BRDFSamples, fit: FitResult) -> Residuals:
    """Residuals in standard uncertainties, or in root mean squares where those are unknown."""
    model = models.of_fit(fit)
    problem = SingleProblem.from_samples(samples, model)
    p = model.vector(fit.values())
    f = problem.values(p)
    difference = samples.value - f
    percent = 100 * difference / np.where(f > 0, f, np.nan)
    if samples.u_independent is None:
        scale = np.sqrt(np.mean(difference**2)) or 1.0
        return Residuals(difference / scale, "their root mean square", False, percent)
    # The weights of the fit: the noise at the model's value, not at the measured one.
    u = np.sqrt(problem.variance(f))
    if fit.noise_scale == 1:
        return Residuals(difference / u, "their standard uncertainties", True, percent)
    unit = f"{fit.noise_scale:.3g} times their standard uncertainties, as the fit scaled them"
    return Residuals(difference / (fit.noise_scale * u), unit, True, percent)


def colour_limit(percent: FloatArray) -> float:
    """End of the colours of a map: 1, 2 or 5 times a power of ten, beyond most residuals.

    Examples
    --------
    >>> colour_limit(np.array([-0.3, 0.1, 1.4, np.nan]))
    2.0
    """
    finite = np.abs(percent[np.isfinite(percent)])
    most = max(float(np.quantile(finite, WITHIN)) if len(finite) else 1.0, 1e-6)
    decade = 10.0 ** np.floor(np.log10(most))
    return float(next(step * decade for step in (1, 2, 5, 10) if step * decade >= most))


def maps(samples: BRDFSamples, residual: Residuals) -> Chart:
    """Residuals over the hemisphere of viewing directions, a map for each incidence."""
    shown = spread(images(samples), MOST_MAPS)
    each = max(1, MOST_DRAWN // len(shown))
    limit = colour_limit(residual.percent)
    views, n = [], 0
    for image in shown:
        trace = _map(samples, residual, image, each, limit)
        n += len(trace["x"])
        views.append(View(image.label, [trace, _specular(image)], _disc()))
    caption = (
        f"Measured less fitted, in per cent of the fitted f; colours end at ±{limit:g} %. Equal "
        "areas of the disc are equal solid angles; the normal is in the middle, circles lie at "
        "θr = 30°, 60° and 90°, the small cross is the specular direction. "
        f"Drawn: {n} of {len(samples)} samples."
    )
    missing = int(np.sum(~np.isfinite(residual.percent)))
    if missing:
        caption += f" Where the fitted f is not above zero there is no per cent: {missing} samples."
    return Chart("residual-maps", "Incidence", tuple(views), caption, height=470)


def _map(samples: BRDFSamples, residual: Residuals, image: Image, most: int, limit: float) -> Trace:
    at = np.asarray(spread(image.index, most), np.int64)
    at = at[np.isfinite(residual.percent[at])]
    _, _, theta_r, phi_r = (column[at] for column in columns(samples))
    r = radius(theta_r)
    text = [
        f"{t:.0f}°, {p:.0f}°: {percent:+.3g} % of f, {z:+.2g}"
        for t, p, percent, z in zip(
            np.degrees(theta_r), np.degrees(phi_r) % 360, residual.percent[at], residual.z[at],
            strict=True,
        )
    ]  # fmt: skip
    return {
        "type": "scatter", "mode": "markers", "x": short(r * np.cos(phi_r)),
        "y": short(r * np.sin(phi_r)), "text": text,
        "hovertemplate": f"θr, φr = %{{text}} of {residual.unit}<extra></extra>",
        "marker": {
            "color": short(residual.percent[at], 3), "cmin": -limit, "cmax": limit,
            "colorscale": _COLOURS, "size": 11, "symbol": "square", "line": {"width": 0},
            "colorbar": {"thickness": 12, "len": 0.8, "title": {"text": "% of f"}},
        },
    }  # fmt: skip


def _specular(image: Image) -> Trace:
    r = radius(image.theta_i)
    return {
        "type": "scatter", "mode": "markers", "hoverinfo": "skip",
        "x": short([-r * np.cos(image.phi_i)]), "y": short([-r * np.sin(image.phi_i)]),
        "marker": {"symbol": "cross-thin", "size": 12, "line": {"width": 2, "color": "#777777"}},
    }  # fmt: skip


def radius(theta: Any) -> Any:
    """Distance from the middle of an equal-area disc of radius 1 at the horizon.

    Examples
    --------
    >>> float(radius(0.0)), round(float(radius(np.pi / 2)), 12)
    (0.0, 1.0)
    """
    return np.sqrt(2) * np.sin(np.asarray(theta) / 2)


def _disc() -> dict[str, Any]:
    """Circles of constant theta_r on a square without axes."""
    bare = {"visible": False, "range": [-1.06, 1.06], "constrain": "domain"}
    circles = [
        {"type": "circle", "xref": "x", "yref": "y", "x0": -r, "x1": r, "y0": -r, "y1": r,
         "layer": "below", "line": {"width": 0.8, "color": "#888888"}}
        for r in map(float, radius(np.radians([30, 60, 90])))
    ]  # fmt: skip
    return {
        "xaxis": bare,
        "yaxis": {**bare, "scaleanchor": "x"},
        "shapes": circles,
        "showlegend": False,
        "margin": {"l": 10, "r": 10, "t": 10, "b": 10},
    }


def histogram(residual: Residuals) -> Chart:
    """Histogram of the residuals, with the density of independent normal errors."""
    n = len(residual.z)
    counts, _ = np.histogram(np.clip(residual.z, BINS[0], BINS[-1]), BINS)
    centre, width = (BINS[1:] + BINS[:-1]) / 2, float(BINS[1] - BINS[0])
    x = np.linspace(BINS[0], BINS[-1], 121)
    data: list[Trace] = [
        {"type": "bar", "name": "samples", "x": short(centre), "y": counts.tolist(),
         "marker": {"color": faded(BLUE, 0.7), "line": {"width": 0}}},
        {"type": "scatter", "mode": "lines", "name": "normal distribution", "x": short(x),
         "y": short(n * width * np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi)),
         "line": {"color": VERMILLION, "width": 1.6}},
    ]  # fmt: skip
    layout = {"xaxis": axis("residual"), "yaxis": axis("samples"), "bargap": 0}
    caption = (
        f"All {n} residuals, in units of {residual.unit}. Residuals beyond ±5 are counted in the "
        "last bars. Line: a normal distribution of standard deviation 1."
    )
    return Chart("residuals", "", (View("", data, layout),), caption, height=320)
