"""BRDF over the whole hemisphere, of a model or as measured, and the residuals of a fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection, QuadMesh
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure, SubFigure

import gonio.models as models
from gonio.errors import ConfigurationError
from gonio.fitting.result import FitResult
from gonio.geometry import HORIZON, FloatArray, equal_area, unit_vectors
from gonio.models import Model
from gonio.plotting.disc import NO_DATA, draw_disc, mark_incidence
from gonio.plotting.style import BLUE, VERMILLION, _new_figure, nothing_to_draw, style
from gonio.samples import BRDFSamples

THETA_I = tuple(np.radians([0.0, 30.0, 60.0]))
DECADES = 4.0  # most that the colours span
PANELS = 3
_STEEPEST = 89.0  # degrees: at the horizon itself f is 0 by definition
_SAME = np.radians(0.05)
_MAP = "viridis"  # its lightness grows with the value, so that a grey print shows it too


def hemisphere_map(
    model: Model | str,
    parameters: Mapping[str, float] | None = None,
    axes: Sequence[Axes] | None = None,
    *,
    theta_i: Sequence[float] = THETA_I,
    phi_i: float = 0.0,
) -> list[Axes]:
    """A model over the hemisphere of viewing directions, logarithmic colours.

    Parameters
    ----------
    model : Model or str
    parameters : mapping, optional
        Parameters by name, angles in radians; those left out take their defaults.
    axes : sequence of Axes, optional
        One for each incidence; new ones where not given.
    theta_i : sequence of float
        Angles of incidence, radians, below the horizon.
    phi_i : float
        Their azimuth, radians.

    Returns
    -------
    list of Axes
        Equal areas are equal solid angles; the normal is in the middle, x to the right. All
        panels have one scale, in sr^-1, cosine not included.

    Raises
    ------
    ConfigurationError
        For an unknown name, an incidence at or below the horizon, or a wrong number of axes.
    DataError
        If f is 0 everywhere.

    Examples
    --------
    >>> axes = hemisphere_map("ward", {"alpha_y": 0.3})
    >>> len(axes)
    3
    >>> import matplotlib.pyplot as plt
    >>> plt.close(axes[0].figure)
    """
    model = models.get(model)
    for angle in theta_i:
        if not 0 <= angle < HORIZON:
            raise ConfigurationError(
                f"theta_i = {angle:.6g} rad is not above the horizon; allowed is 0 up to pi/2.",
                value=angle,
            )
    vector = model.vector(parameters or {})
    # Rings at equal steps of the disc's radius, sqrt(2) sin(theta/2).
    theta = 2 * np.arcsin(np.linspace(0, np.sin(np.radians(_STEEPEST) / 2), 91))
    w_r = unit_vectors(theta[:, None], np.linspace(0, 2 * np.pi, 241)[None, :])
    values = [model.evaluate(unit_vectors(angle, phi_i), w_r, vector) for angle in theta_i]
    norm = _norm(np.concatenate([f.ravel() for f in values]))
    with style():
        axes = _panels(axes, len(values))
        for ax, angle, f in zip(axes, theta_i, values, strict=True):
            draw_disc(ax)
            x, y = equal_area(w_r)
            drawn = ax.pcolormesh(
                x, y, _shown(f, norm), norm=norm, cmap=_MAP, shading="gouraud", rasterized=True,
                zorder=1,
            )  # fmt: skip
            _finish(ax, float(angle), phi_i)
        _bar(axes, drawn, r"BRDF $f$ (sr$^{-1}$)")
    return list(axes)


def hemisphere_samples(
    samples: BRDFSamples, axes: Sequence[Axes] | None = None, *, n: int = PANELS
) -> list[Axes]:
    """Measured BRDF over the hemisphere of viewing directions, logarithmic colours.

    Parameters
    ----------
    samples : BRDFSamples
    axes : sequence of Axes, optional
        One for each incidence that is drawn; new ones where not given.
    n : int
        Most incidences to draw, evenly spread.

    Returns
    -------
    list of Axes
        As `hemisphere_map`; values that are not positive are drawn in grey.

    Raises
    ------
    DataError
        If no value is positive.
    ConfigurationError
        If the number of axes is not that of the incidences.
    """
    chosen = _incidences(samples, n)
    norm = _norm(samples.value)
    with style():
        axes = _panels(axes, len(chosen))
        for ax, (theta_i, phi_i, index) in zip(axes, chosen, strict=True):
            draw_disc(ax, background="white")
            x, y, size = _positions(samples, index)
            value = samples.value[index]
            ax.scatter(
                x[value <= 0],
                y[value <= 0],
                size[value <= 0],
                color=NO_DATA,
                linewidths=0,
                zorder=1,
            )
            lit = value > 0
            drawn = ax.scatter(
                x[lit],
                y[lit],
                size[lit],
                c=value[lit],
                norm=norm,
                cmap=_MAP,
                linewidths=0,
                zorder=1,
            )
            _finish(ax, theta_i, phi_i)
        _bar(axes, drawn, r"measured BRDF (sr$^{-1}$)")
    return list(axes)


def residual_map(
    samples: BRDFSamples,
    result: FitResult,
    axes: Sequence[Axes] | None = None,
    *,
    n: int = PANELS,
) -> list[Axes]:
    """Measured minus fitted over the hemisphere, in per cent of the fitted f.

    Parameters
    ----------
    samples : BRDFSamples
        What the fit was made to.
    result : FitResult
    axes : sequence of Axes, optional
        One for each incidence that is drawn; new ones where not given.
    n : int
        Most incidences to draw, evenly spread.

    Returns
    -------
    list of Axes
        A triangle for each sample: upwards where the measurement is above the fit, downwards
        where it is below. A darker colour is a larger residual. The shape shows the sign as well
        as the colour does, for print and for the colour-blind. Samples at which the fitted f is
        not above zero are left out.

    Raises
    ------
    ConfigurationError
        If the number of axes is not that of the incidences.

    Notes
    -----
    95 % of the residuals lie within the range of the colours. A wrong model or a wrong direction
    shows as neighbours of one sign.
    """
    from gonio.reporting.residuals import colour_limit, residuals

    percent = residuals(samples, result).percent
    chosen = _incidences(samples, n)
    limit = colour_limit(percent)
    norm = Normalize(-limit, limit)
    with style():
        axes = _panels(axes, len(chosen))
        for ax, (theta_i, phi_i, index) in zip(axes, chosen, strict=True):
            draw_disc(ax, background="white")
            x, y, size = _positions(samples, index)
            values = percent[index]
            for side, marker in ((values >= 0, "^"), (values < 0, "v")):
                drawn = ax.scatter(
                    x[side], y[side], 1.3 * size[side], c=values[side], norm=norm,
                    cmap=_diverging(), marker=marker, linewidths=0, zorder=1,
                )  # fmt: skip
            _finish(ax, theta_i, phi_i)
        _bar(axes, drawn, "measured − fitted (% of the fitted f)")
    return list(axes)


def _diverging() -> str:
    """Name of a colour map from blue by pale grey to red-orange, equally dark at both ends."""
    import matplotlib as mpl
    from matplotlib.colors import LinearSegmentedColormap

    name = "gonio_residuals"
    if name not in mpl.colormaps:
        mpl.colormaps.register(
            LinearSegmentedColormap.from_list(name, [BLUE, "#e6e6e6", VERMILLION])
        )
    return name


def _norm(values: FloatArray) -> LogNorm:
    lit = values[np.isfinite(values) & (values > 0)]
    if not len(lit):
        raise nothing_to_draw("f is nowhere above 0")
    top, low = float(lit.max()), float(np.percentile(lit, 1))
    low = max(low, top / 10**DECADES)
    # A constant BRDF is drawn in one colour; its rounding errors are not stretched.
    return LogNorm(low, top) if low < 0.8 * top else LogNorm(0.5 * top, 1.25 * top)


def _shown(f: FloatArray, norm: LogNorm) -> FloatArray:
    return np.maximum(f, norm.vmin or 0.0)


def _panels(axes: Sequence[Axes] | None, n: int) -> list[Axes]:
    if axes is None:
        figure = _new_figure(2.75 * n + 0.9, 3.15)
        return list(np.ravel(figure.subplots(1, n, squeeze=False)))
    if len(axes) != n:
        raise ConfigurationError(f"{len(axes)} axes were given for {n} maps; give one for each.")
    return list(axes)


def _finish(ax: Axes, theta_i: float, phi_i: float) -> None:
    mark_incidence(ax, theta_i, phi_i)
    turned = phi_i % (2 * np.pi)
    azimuth = rf", $φ_{{\mathrm{{i}}}}$ = {np.degrees(turned):.4g}°" if turned > _SAME else ""
    ax.set_title(rf"$θ_{{\mathrm{{i}}}}$ = {round(np.degrees(theta_i), 2):.4g}°{azimuth}", pad=5)


def _bar(axes: Sequence[Axes], drawn: QuadMesh | PathCollection, label: str) -> None:
    figure: Figure | SubFigure = axes[-1].figure
    figure.colorbar(drawn, ax=list(axes), label=label, shrink=0.75, pad=0.01, aspect=18)
    axes[0].legend(loc="upper left", bbox_to_anchor=(-0.02, 0.02), ncols=2, handletextpad=0.1,
                   columnspacing=0.8)  # fmt: skip


def _incidences(samples: BRDFSamples, n: int) -> list[tuple[float, float, FloatArray]]:
    """Up to n incidences, evenly spread in theta_i: theta_i, phi_i and the samples' indices."""
    d = samples.directions
    theta_i, phi_i = (np.broadcast_to(a, (len(samples),)) for a in (d.theta_i, d.phi_i))
    ordered = np.unique(theta_i)
    every = ordered[np.diff(ordered, prepend=-np.inf) > _SAME]
    targets = np.linspace(every[0], every[-1], min(n, len(every)))
    incidences = []
    for angle in sorted({float(every[np.argmin(np.abs(every - w))]) for w in targets}):
        index = np.flatnonzero(np.abs(theta_i - angle) < _SAME)
        turn = (phi_i[index] + np.pi) % (2 * np.pi) - np.pi
        azimuth = float(turn[np.argmin(np.abs(turn))])
        index = index[np.abs(np.angle(np.exp(1j * (phi_i[index] - azimuth)))) < _SAME]
        incidences.append((angle, azimuth, index))
    return incidences


def _positions(
    samples: BRDFSamples, index: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions on the disc, and areas of markers, points^2, by the solid angle of the cells."""
    d, shape = samples.directions, (len(samples),)
    theta, phi = (np.broadcast_to(a, shape)[index] for a in (d.theta_r, d.phi_r))
    x, y = equal_area(unit_vectors(theta, phi))
    if samples.solid_angle is None:
        share = np.full(len(index), 2 * np.pi / max(len(index), 1))
    else:
        share = samples.solid_angle[index]
    # The disc is some 150 points across and stands for 2 pi sr.
    return x, y, np.clip(1.1 * share / (2 * np.pi) * np.pi * 75**2, 2.0, 60.0)
