"""The BRDF in the plane of incidence, measured and fitted, as in Ward 1992, Fig. 6."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator

import gonio.models as models
from gonio.fitting.result import FitResult
from gonio.geometry import Directions, FloatArray
from gonio.plotting.style import COLOURS, GREY, new_axes, nothing_to_draw, style
from gonio.samples import BRDFSamples

N_SLICES = 6  # at most one for each colour
LEAST_POINTS = 4  # in the plane, for an incidence to be drawn
IN_PLANE = np.radians(2.0)  # largest distance from the plane where cells have no size
SAME_ANGLE = np.radians(0.05)
LOG_FROM = 20.0  # ratio of the largest to the smallest value from which the scale is logarithmic
LABEL_WIDTH = 5.0  # degrees: half the width of a label on the axis, about
LABEL_HEIGHT = 0.06  # of the axis
EDGE_MARGIN = 3.0  # degrees beyond the last point
EDGE_ROOM = 22.0  # degrees, for labels at the edge
_THETA_I = r"$θ_{\mathrm{i}}$ = "

Line = tuple[FloatArray, FloatArray]
Corner = Literal["upper left", "upper right"]


@dataclass(frozen=True)
class Slice:
    """Samples of one incidence near its plane.

    Parameters
    ----------
    theta_i, phi_i : float
        Radians.
    theta_r : ndarray
        Signed, radians: positive is forward, the side of the specular direction.
    value, u : ndarray
        BRDF and its independent standard uncertainty (0 where unknown), sr^-1.
    """

    theta_i: float
    phi_i: float
    theta_r: FloatArray
    value: FloatArray
    u: FloatArray


def slices(
    samples: BRDFSamples,
    result: FitResult | None = None,
    axes: Axes | None = None,
    *,
    n: int = N_SLICES,
) -> Axes:
    """Measured BRDF in the plane of incidence as points, the fitted model as lines.

    Parameters
    ----------
    samples : BRDFSamples
        Cells that the plane cuts are drawn, at the rotation nearest to phi_i = 0.
    result : FitResult, optional
        The fitted model to draw as lines.
    axes : Axes, optional
        New ones where not given.
    n : int
        Most incidence angles to draw, up to 7.

    Returns
    -------
    Axes
        theta_r in degrees, positive on the specular side; BRDF in sr^-1, cosine not included.

    Raises
    ------
    DataError
        If no incidence has samples near its plane.
    """
    drawn = in_plane(samples, min(n, len(COLOURS)))
    if not drawn:
        raise nothing_to_draw("the samples hold no incidence with samples near its plane")
    with style():
        ax = new_axes() if axes is None else axes
        lines = [_model_line(result, part, _edge(drawn)) for part in drawn]
        logarithmic = _wants_log(drawn, lines)
        if logarithmic:
            ax.set_yscale("log")
        for part, line, colour in zip(drawn, lines, COLOURS, strict=False):
            _points(ax, part, colour, faint=line is not None)
            if line is not None:
                ax.plot(*line, color=colour, linewidth=1.0, zorder=3)
            else:  # a faint line leads the eye from point to point
                ax.plot(np.degrees(part.theta_r), part.value, color=colour, linewidth=0.4)
        _set_axis_limits(ax, drawn, lines, logarithmic=logarithmic)
        corner = _label(ax, drawn, _curves(drawn, lines))
        _legend(ax, result, corner, has_bars=any(part.u.any() for part in drawn))
        _name_axes(ax)
    return ax


def in_plane(samples: BRDFSamples, n: int = N_SLICES) -> list[Slice]:
    """Up to n incidences, evenly spread, that have samples near their plane.

    Parameters
    ----------
    samples : BRDFSamples
    n : int

    Returns
    -------
    list of Slice
        In the order of theta_i.
    """
    size = (len(samples),)
    d = samples.directions
    theta_i, phi_i, theta_r, phi_r = (
        np.broadcast_to(a, size) for a in (d.theta_i, d.phi_i, d.theta_r, d.phi_r)
    )
    side = np.sin(theta_r)
    near = np.abs(np.sin(phi_r - phi_i)) * side < _half_width(samples)
    index = np.flatnonzero(near)
    incidences = []
    for angle in _distinct(theta_i[index]):
        at = index[np.abs(theta_i[index] - angle) < SAME_ANGLE]
        turn = (phi_i[at] + np.pi) % (2 * np.pi) - np.pi
        azimuth = turn[np.argmin(np.abs(turn))]
        at = at[np.abs(turn - azimuth) < SAME_ANGLE]
        if len(at) < LEAST_POINTS:
            continue
        forward = np.where(np.cos(phi_r[at] - phi_i[at]) > 0, -1.0, 1.0)
        signed = forward * theta_r[at]
        order = np.argsort(signed, kind="stable")
        u = samples.u_independent
        incidences.append(
            Slice(
                float(theta_i[at[0]]),
                float(phi_i[at[0]]),
                signed[order],
                samples.value[at][order],
                np.zeros(len(at)) if u is None else u[at][order],
            )
        )
    return _spread(incidences, n)


def _half_width(samples: BRDFSamples) -> FloatArray | float:
    """Distance of the plane from a sample's centre within which it cuts the sample's cell."""
    if samples.solid_angle is None:
        return float(IN_PLANE)
    return np.sqrt(samples.solid_angle) / 2


def _distinct(values: FloatArray) -> FloatArray:
    """Angles that differ by more than rounding."""
    ordered = np.unique(values)
    return np.asarray(ordered[np.diff(ordered, prepend=-np.inf) > SAME_ANGLE])


def _spread(incidences: list[Slice], n: int) -> list[Slice]:
    if len(incidences) <= n:
        return incidences
    angles = np.array([part.theta_i for part in incidences])
    targets = np.linspace(angles[0], angles[-1], n)
    return [incidences[k] for k in sorted({int(np.argmin(np.abs(angles - w))) for w in targets})]


def _edge(drawn: list[Slice]) -> float:
    """Largest theta_r of the points: the model is drawn as far as it was measured."""
    return max(float(np.abs(part.theta_r).max()) for part in drawn)


def _model_line(result: FitResult | None, part: Slice, edge: float) -> Line | None:
    """theta_r in degrees and the fitted BRDF in the plane of incidence."""
    if result is None:
        return None
    model = models.of_fit(result)
    # The peak itself is one of the angles: a narrow lobe keeps its height.
    signed = np.union1d(np.linspace(-edge, edge, 721), [min(part.theta_i, edge)])
    phi_r = np.where(signed > 0, part.phi_i + np.pi, part.phi_i)
    f = model(Directions(part.theta_i, part.phi_i, np.abs(signed), phi_r), **result.values())
    return np.degrees(signed), f


def _wants_log(drawn: list[Slice], lines: list[Line | None]) -> bool:
    values = np.concatenate(
        [part.value for part in drawn] if lines[0] is None else [line[1] for line in lines if line]
    )
    if values.max() <= 0:
        return False
    low = np.percentile(values[values > 0], 2)
    return bool(values.max() > LOG_FROM * low)


def _points(ax: Axes, part: Slice, colour: str, *, faint: bool) -> None:
    ax.errorbar(
        np.degrees(part.theta_r),
        part.value,
        yerr=part.u if part.u.any() else None,
        fmt="o",
        color=colour,
        markersize=4.5 if faint else 3.0,
        markeredgewidth=0,
        elinewidth=0.8,
        alpha=0.45 if faint else 1.0,  # the line stays visible within its points
        zorder=2,
    )


def _set_axis_limits(
    ax: Axes,
    drawn: list[Slice],
    lines: list[Line | None],
    *,
    logarithmic: bool,
) -> None:
    """Set the axis limits with room for labels; noise about zero must not stretch a log axis."""
    values = np.concatenate([part.value for part in drawn])
    curves = [line[1] for line in lines if line]
    top = float(max([values.max(), *(c.max() for c in curves)]))
    if logarithmic:
        low = float(np.percentile(values[values > 0], 1))
        low = min([low, *(float(c[c > 0].min()) for c in curves if (c > 0).any())])
        span = np.log10(top / low)
        ax.set_ylim(low / 10 ** (0.05 * span), top * 10 ** (0.12 * span))
    else:
        low = min(0.0, float(values.min()))
        ax.set_ylim(low * 1.05, top + 0.25 * (top - low))
    edge = np.degrees(_edge(drawn)) + EDGE_MARGIN
    ax.set_xlim(-edge, edge)
    ax.xaxis.set_major_locator(MultipleLocator(30))
    ax.xaxis.set_minor_locator(MultipleLocator(10))


def _curves(drawn: list[Slice], lines: list[Line | None]) -> list[Line]:
    """theta_r in degrees and BRDF of each slice: the model where there is one, else the points."""
    return [
        (np.degrees(part.theta_r), part.value) if line is None else line
        for part, line in zip(drawn, lines, strict=True)
    ]


def _label(ax: Axes, drawn: list[Slice], curves: list[Line]) -> Corner:
    """Write theta_i at each slice; returns the corner that stays free for the legend.

    A lobe is labelled at its peak. Curves that have none at the specular direction, such as those
    of a rough diffuse surface, are labelled at the edge where they lie farthest apart.
    """
    if _has_peaks(drawn, curves):
        _label_peaks(ax, drawn, curves)
        return "upper left"
    edge = ax.get_xlim()[1]
    ends = [np.array([y[0] for _, y in curves]), np.array([y[-1] for _, y in curves])]
    left = bool(np.ptp(_height(ax, ends[0])) >= np.ptp(_height(ax, ends[1])))
    heights = _apart(_height(ax, ends[0] if left else ends[1]))
    ax.set_xlim(*((-edge - EDGE_ROOM, edge) if left else (-edge, edge + EDGE_ROOM)))
    for part, height, colour in zip(drawn, heights, COLOURS, strict=False):
        ax.annotate(
            _angle_text(part, "" if part is not drawn[-1] else _THETA_I),
            (-edge + 1 if left else edge - 1, float(height)),
            xycoords=("data", "axes fraction"),
            ha="right" if left else "left",
            va="center",
            **_label_style(colour),
        )
    return "upper right" if left else "upper left"


def _has_peaks(drawn: list[Slice], curves: list[Line]) -> bool:
    """Whether most curves are the highest at their own specular direction, all of them measured."""
    if max(part.theta_i for part in drawn) > _edge(drawn) + np.radians(EDGE_MARGIN):
        return False
    n_peaks = 0
    for part, (x, y) in zip(drawn, curves, strict=True):
        at = np.degrees(part.theta_i)
        others = [float(np.interp(at, *curve)) for curve in curves]
        n_peaks += float(np.interp(at, x, y)) >= 0.95 * max(others)
    return 2 * n_peaks > len(drawn)


def _label_peaks(ax: Axes, drawn: list[Slice], curves: list[Line]) -> None:
    """theta_i above each specular direction, clear of all points and curves there."""
    parts = [(np.degrees(part.theta_r), part.value) for part in drawn]
    x = np.concatenate([x for x, _ in (*curves, *parts)])
    y = np.concatenate([y for _, y in (*curves, *parts)])
    for part, colour in zip(drawn, COLOURS, strict=False):
        centre = np.degrees(part.theta_i)
        at = np.abs(x - centre) < LABEL_WIDTH
        prefix = _THETA_I if part is drawn[0] else ""
        ax.annotate(
            _angle_text(part, prefix),
            (centre, float(y[at].max() if at.any() else y.max())),
            (0, 4),
            textcoords="offset points",
            ha="right" if prefix and len(drawn) > 1 else "center",
            va="bottom",
            **_label_style(colour),
        )


def _height(ax: Axes, y: FloatArray) -> FloatArray:
    """Fraction of the axis at which values lie."""
    bottom, top = ax.get_ylim()
    if ax.get_yscale() == "log":
        bottom, top, y = np.log10(bottom), np.log10(top), np.log10(np.maximum(y, bottom))
    return np.asarray((y - bottom) / (top - bottom))


def _apart(heights: FloatArray) -> FloatArray:
    """Heights moved up from the lowest until labels do not overlap."""
    moved = np.array(heights, float)
    order = np.argsort(moved, kind="stable")
    for below, above in pairwise(order):
        moved[above] = max(moved[above], moved[below] + LABEL_HEIGHT)
    return moved - max(0.0, float(moved.max()) - 0.97)


def _angle_text(part: Slice, prefix: str) -> str:
    return f"{prefix}{round(np.degrees(part.theta_i), 2):.4g}°"


def _label_style(colour: str) -> dict[str, Any]:
    return {"color": colour, "fontweight": "bold", "fontsize": 7.5}


def _legend(ax: Axes, result: FitResult | None, corner: Corner, *, has_bars: bool) -> None:
    """What points, bars and lines are, in a neutral colour."""
    measured = "measured, with standard uncertainty" if has_bars else "measured"
    ax.plot([], [], "o", color=GREY, alpha=0.6, markersize=4.5, label=measured)
    if result is not None:
        ax.plot([], [], color=GREY, linewidth=1.0, label=f"fitted: {result.model}")
    ax.legend(loc=corner, borderaxespad=0.2)


def _name_axes(ax: Axes) -> None:
    ax.set_xlabel(
        r"reflected angle $θ_{\mathrm{r}}$ in the plane of incidence (°), "
        "positive on the specular side"
    )
    ax.set_ylabel(r"BRDF (sr$^{-1}$)")
