"""The BRDF in the plane of incidence, measured and fitted, as in Ward 1992, Fig. 6."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator

from gonio import models
from gonio.fitting.result import FitResult
from gonio.geometry import Directions, FloatArray
from gonio.plot.style import COLOURS, GREY, new_axes, nothing_to_draw, style
from gonio.samples import BRDFSamples

N_SLICES = 6
LEAST_POINTS = 4  # in the plane, for an incidence to be drawn
IN_PLANE = np.radians(2.0)  # distance from the plane that is allowed where cells have no size
SAME_ANGLE = np.radians(0.05)
LOG_FROM = 20.0  # ratio of the largest to the smallest value from which the scale is logarithmic
LABEL_WIDTH = np.radians(5.0)  # half the width of a label on the axis, about


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
        Most incidence angles to draw.

    Returns
    -------
    Axes
        theta_r in degrees, positive on the specular side; BRDF in sr^-1, cosine not included.

    Raises
    ------
    DataError
        If no incidence has samples near its plane.
    """
    drawn = in_plane(samples, n)
    if not drawn:
        raise nothing_to_draw("the samples hold no incidence with samples near its plane")
    with style():
        ax = new_axes() if axes is None else axes
        lines = [_model_line(result, part, _edge(drawn)) for part in drawn]
        logarithmic = _wants_log(drawn, lines)
        if logarithmic:
            ax.set_yscale("log")
        for part, line, colour in zip(drawn, lines, _colours(len(drawn)), strict=True):
            _points(ax, part, colour, faint=line is not None)
            if line is not None:
                ax.plot(*line, color=colour, linewidth=1.0, zorder=3)
        _limits(ax, drawn, lines, logarithmic=logarithmic)
        _labels(ax, drawn, lines)
        _legend(ax, result, has_bars=any(part.u.any() for part in drawn))
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
    found = []
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
        found.append(
            Slice(
                float(theta_i[at[0]]),
                float(phi_i[at[0]]),
                signed[order],
                samples.value[at][order],
                np.zeros(len(at)) if u is None else u[at][order],
            )
        )
    return _spread(found, n)


def _half_width(samples: BRDFSamples) -> FloatArray | float:
    """Distance of the plane from a sample's centre within which it cuts the sample's cell."""
    if samples.solid_angle is None:
        return float(IN_PLANE)
    return np.sqrt(samples.solid_angle) / 2


def _distinct(values: FloatArray) -> FloatArray:
    """Angles that differ by more than rounding."""
    ordered = np.unique(values)
    first = np.concatenate([[True], np.diff(ordered) > SAME_ANGLE]) if len(ordered) else []
    return ordered[np.asarray(first, bool)]


def _spread(found: list[Slice], n: int) -> list[Slice]:
    if len(found) <= n:
        return found
    angles = np.array([part.theta_i for part in found])
    wanted = np.linspace(angles[0], angles[-1], n)
    return [found[k] for k in sorted({int(np.argmin(np.abs(angles - w))) for w in wanted})]


def _edge(drawn: list[Slice]) -> float:
    """Largest theta_r of the points: the model is drawn as far as it was measured."""
    return max(float(np.abs(part.theta_r).max()) for part in drawn)


def _model_line(
    result: FitResult | None, part: Slice, edge: float
) -> tuple[FloatArray, FloatArray] | None:
    """theta_r in degrees and the fitted BRDF in the plane of incidence."""
    if result is None:
        return None
    model = models.get(result.model)
    values = {
        name: model.parameter(name).from_file(value) for name, value in result.values().items()
    }
    # The peak itself is one of the angles: a narrow lobe keeps its height.
    signed = np.union1d(np.linspace(-edge, edge, 721), [part.theta_i])
    phi_r = np.where(signed > 0, part.phi_i + np.pi, part.phi_i)
    f = model(Directions(part.theta_i, part.phi_i, np.abs(signed), phi_r), **values)
    return np.degrees(signed), f


def _wants_log(drawn: list[Slice], lines: list[tuple[FloatArray, FloatArray] | None]) -> bool:
    values = np.concatenate(
        [part.value for part in drawn] if lines[0] is None else [line[1] for line in lines if line]
    )
    if values.max() <= 0:
        return False
    low = np.percentile(values[values > 0], 2)
    return bool(values.max() > LOG_FROM * low)


def _colours(n: int) -> list[str]:
    return [COLOURS[k % len(COLOURS)] for k in range(n)]


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


def _limits(
    ax: Axes,
    drawn: list[Slice],
    lines: list[tuple[FloatArray, FloatArray] | None],
    *,
    logarithmic: bool,
) -> None:
    """Room for the labels above; noise around zero must not stretch a logarithmic axis."""
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
        ax.set_ylim(low * 1.05, top + 0.15 * (top - low))
    edge = np.degrees(_edge(drawn)) + 3
    ax.set_xlim(-edge, edge)
    ax.xaxis.set_major_locator(MultipleLocator(30))
    ax.xaxis.set_minor_locator(MultipleLocator(10))


def _labels(
    ax: Axes, drawn: list[Slice], lines: list[tuple[FloatArray, FloatArray] | None]
) -> None:
    """theta_i of each slice above its specular direction, clear of all curves there."""
    x = np.concatenate([part.theta_r for part in drawn])
    y = np.concatenate([part.value for part in drawn])
    for line in lines:
        if line is not None:
            x, y = np.append(x, np.radians(line[0])), np.append(y, line[1])
    for number, (part, colour) in enumerate(zip(drawn, _colours(len(drawn)), strict=True)):
        at = np.abs(x - part.theta_i) < LABEL_WIDTH
        if not at.any():
            at = np.ones(len(x), np.bool_)
        prefix = r"$θ_{\mathrm{i}}$ = " if number == 0 else ""
        ax.annotate(
            f"{prefix}{np.degrees(part.theta_i):.4g}°",
            (np.degrees(part.theta_i), float(y[at].max())),
            (0, 4),
            textcoords="offset points",
            ha="right" if prefix and len(drawn) > 1 else "center",
            va="bottom",
            color=colour,
            fontweight="bold",
            fontsize=7.5,
        )


def _legend(ax: Axes, result: FitResult | None, *, has_bars: bool) -> None:
    """What points, bars and lines are, in a neutral colour."""
    measured = "measured, with standard uncertainty" if has_bars else "measured"
    ax.plot([], [], "o", color=GREY, alpha=0.6, markersize=4.5, label=measured)
    if result is not None:
        ax.plot([], [], color=GREY, linewidth=1.0, label=f"fitted: {result.model}")
    ax.legend(loc="upper left", borderaxespad=0.2)


def _name_axes(ax: Axes) -> None:
    ax.set_xlabel(
        r"reflected angle $θ_{\mathrm{r}}$ in the plane of incidence (°), "
        "positive on the specular side"
    )
    ax.set_ylabel(r"BRDF (sr$^{-1}$)")
