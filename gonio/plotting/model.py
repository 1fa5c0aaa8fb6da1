"""A model's BRDF in the plane of incidence, as a polar diagram."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes

import gonio.models as models
from gonio.errors import ConfigurationError
from gonio.geometry import Directions, FloatArray
from gonio.models import Model
from gonio.plotting.style import COLOURS, GREY, nothing_to_draw, style, symbol, unit_text

THETA_I = tuple(np.radians([0.0, 30.0, 60.0]))
DECADES = 4.0  # most that a logarithmic radius spans
LOG_FROM = 8.0  # ratio of the largest to the smallest value from which the radius is logarithmic
EDGE = 89.5  # degrees: at the horizon itself f is 0 by definition
STEEP = 75.0  # degrees: smaller values beyond do not stretch the scale
_DASHES: tuple[Any, ...] = ("-", (0, (5, 1.5)), (0, (5, 1.5, 1, 1.5)))
_SIZE = (3.8, 2.55)  # inches of one panel
_GRID = "#cccccc"
_HALF = np.radians(np.linspace(-90, 90, 181))

Line = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class Radius:
    """How f becomes a radius between 0 and 1.

    Parameters
    ----------
    low, high : float
        f in sr^-1 at the centre and at the rim.
    logarithmic : bool
    """

    low: float
    high: float
    logarithmic: bool

    def of(self, f: FloatArray) -> FloatArray:
        """Radius of values of f; what is below `low` lies at the centre."""
        f = np.maximum(f, self.low)
        if self.logarithmic:
            return np.asarray(np.log(f / self.low) / np.log(self.high / self.low))
        return np.asarray((f - self.low) / (self.high - self.low))

    def rings(self) -> FloatArray:
        """Values of f at which a ring is drawn: decades, or steps of 1, 2 or 5."""
        if self.logarithmic:
            powers = np.arange(np.ceil(np.log10(self.low)), np.floor(np.log10(self.high)) + 1)
            return np.asarray(10.0**powers)
        about = (self.high - self.low) / 4
        decade = 10.0 ** np.floor(np.log10(about))
        step = decade * next(k for k in (1, 2, 5, 10) if k * decade >= about)
        return np.asarray(self.low + step * np.arange(int((self.high - self.low) / step) + 1))


def model_lobe(
    model: Model | str,
    parameters: Mapping[str, float] | None = None,
    *,
    phi_i: float = 0.0,
    theta_i: Sequence[float] = THETA_I,
    radius: Radius | None = None,
    ax: Axes | None = None,
) -> Axes:
    r"""Polar diagram of a model's BRDF in one plane of incidence.

    The normal points up. The light comes from the left, along the arrows, so that the mirror
    directions lie to the right. The distance from the centre is f, cosine not included: a
    Lambertian surface is a half circle.

    Parameters
    ----------
    model : Model or str
        A model or its name.
    parameters : mapping, optional
        Parameters by name, angles in radians; those left out take their defaults.
    phi_i : float
        Azimuth of the plane, radians.
    theta_i : sequence of float
        Up to seven angles of incidence, radians, below the horizon of pi/2.
    radius : Radius, optional
        The scale; where not given, linear from 0 for a BRDF that varies little over the plane and
        else logarithmic over at most four decades.
    ax : Axes, optional
        New ones where not given.

    Returns
    -------
    Axes

    Raises
    ------
    ConfigurationError
        If the model or a parameter is refused, an incidence is not above the horizon, or there
        are more than seven.
    DataError
        If f is 0 everywhere in the plane.

    Examples
    --------
    >>> ax = model_lobe("ward", {"alpha_x": 0.05, "alpha_y": 0.16}, phi_i=0.0)
    >>> ax.get_title()
    'in the plane of incidence at $φ_{\\mathrm{i}}$ = 0°'
    >>> import matplotlib.pyplot as plt
    >>> plt.close(ax.figure)
    """
    model = models.get(model)
    _check(theta_i)
    values = model.vector(parameters or {})
    curves = [_curve(model, values, angle, phi_i) for angle in theta_i]
    scale = radius or _radius(curves)
    with style():
        ax = _new_panels(1)[0] if ax is None else ax
        _frame(ax, scale)
        for angle, (signed, f), k in zip(theta_i, curves, range(len(curves)), strict=True):
            x, y = _points(signed, scale.of(f))
            ax.plot(x, y, color=COLOURS[k], linestyle=_DASHES[k % 3], zorder=3)
            _incidence(ax, angle, COLOURS[k])
        ax.set_title(_plane_text(model, phi_i))
    return ax


def model_lobes(model: Model | str, parameters: Mapping[str, float] | None = None) -> list[Axes]:
    """The lobe of a model on a figure of its own, its parameters above.

    Parameters
    ----------
    model : Model or str
    parameters : mapping, optional
        As in `model_lobe`.

    Returns
    -------
    list of Axes
        One panel; for an anisotropic model two, the planes phi_i = 0 and 90 degrees, on one scale.

    Raises
    ------
    ConfigurationError, DataError
        As `model_lobe`.

    Examples
    --------
    >>> axes = model_lobes("ward", {"alpha_y": 0.3})
    >>> len(axes)
    2
    >>> import matplotlib.pyplot as plt
    >>> plt.close(axes[0].figure)
    """
    model = models.get(model)
    values = model.vector(parameters or {})
    named = dict(zip(model.names, values.tolist(), strict=True))
    planes = (0.0,) if model.claims.isotropic else (0.0, np.pi / 2)
    scale = _radius([_curve(model, values, angle, phi) for angle in THETA_I for phi in planes])
    with style():
        panels = _new_panels(len(planes))
        for ax, phi in zip(panels, planes, strict=True):
            model_lobe(model, named, phi_i=phi, radius=scale, ax=ax)
        panels[0].figure.suptitle(_values_text(model, named), fontsize=8.5, color=GREY)
    return panels


def _check(theta_i: Sequence[float]) -> None:
    if not 0 < len(theta_i) <= len(COLOURS):
        raise ConfigurationError(
            f"{len(theta_i)} angles of incidence were given; 1 to {len(COLOURS)} can be told "
            "apart in one diagram.",
            value=theta_i,
        )
    for angle in theta_i:
        if not 0 <= angle < np.pi / 2:
            raise ConfigurationError(
                f"theta_i = {angle:.6g} rad is not above the horizon; allowed is 0 up to pi/2.",
                value=angle,
            )


def _curve(model: Model, values: FloatArray, theta_i: float, phi_i: float) -> Line:
    """Signed theta_r in the plane, positive on the mirror side, and f there."""
    edge = np.radians(EDGE)
    # Closely spaced about the mirror direction, itself included: a narrow lobe keeps its height.
    near = theta_i + np.radians(np.linspace(-3, 3, 241))
    signed = np.union1d(np.linspace(-edge, edge, 1433), near[np.abs(near) < edge])
    phi_r = np.where(signed > 0, phi_i + np.pi, phi_i)
    at = Directions(theta_i, phi_i, np.abs(signed), phi_r)
    return signed, model.evaluate(*at.vectors(), values)


def _radius(curves: Sequence[Line]) -> Radius:
    """A scale that shows all of the curves, and not only their fall towards the horizon."""
    high = max(float(f.max()) for _, f in curves)
    low = min(float(f[np.abs(signed) < np.radians(STEEP)].min()) for signed, f in curves)
    if high <= 0:
        raise nothing_to_draw("f is 0 everywhere in the plane of incidence")
    if low > high / LOG_FROM or low < 0:  # a formula may fall below 0: no logarithm then
        return Radius(0.0, 1.12 * high, logarithmic=False)
    floor = max(low, high / 10**DECADES)
    # A whole decade at the centre, low enough that no curve lies within the first tenth.
    centre = 10 ** np.floor(np.log10(floor) - 0.1)
    return Radius(float(centre), 1.25 * high, logarithmic=True)


def _new_panels(n: int) -> list[Axes]:
    import matplotlib.pyplot as plt

    figure = plt.figure(figsize=(n * _SIZE[0], _SIZE[1]), layout="constrained")
    return list(figure.subplots(1, n, squeeze=False)[0])


def _frame(ax: Axes, scale: Radius) -> None:
    """The upper half circle, its rings of equal f and spokes of equal theta_r."""
    ax.set_axis_off()
    ax.set_aspect("equal")
    ax.set_xlim(-1.4, 1.4)
    ax.set_ylim(-0.3, 1.3)
    rings = scale.rings()
    for f, r in zip(rings, scale.of(rings), strict=True):
        ax.plot(*_points(_HALF, r), color=_GRID, linewidth=0.5, zorder=1)
        for x in {-r, r}:
            ax.text(x, -0.03, _ring_text(f, scale), ha="center", va="top", fontsize=7)
    ax.plot(*_points(_HALF, 1.0), color=GREY, linewidth=0.6, zorder=1)
    ax.plot([-1, 1], [0, 0], color="black", linewidth=1.0, zorder=2)  # the surface
    for spoke in np.radians([-60, -30, 0, 30, 60]):
        ax.plot(*_points(spoke, np.array([0.0, 1.0])), color=_GRID, linewidth=0.5, zorder=1)
    for degrees in (30, 60, 90):
        name = r"$θ_{\mathrm{r}}$ = " if degrees == 30 else ""
        x, y = _point(math.radians(degrees), 1.03)
        ax.text(x, y, f"{name}{degrees}°", ha="left", va="center", fontsize=7.5, color=GREY)
    kind = "logarithmic" if scale.logarithmic else "linear"
    ax.text(0, -0.16, rf"radius: BRDF $f$ (sr$^{{-1}}$), {kind}", ha="center", va="top", fontsize=8)


def _points(angle: FloatArray | float, radius: FloatArray | float) -> Line:
    """x and y of points at a signed angle from the normal, positive to the right."""
    return np.asarray(radius * np.sin(angle)), np.asarray(radius * np.cos(angle))


def _point(angle: float, radius: float) -> tuple[float, float]:
    """`_points` for one."""
    return radius * math.sin(angle), radius * math.cos(angle)


def _ring_text(f: float, scale: Radius) -> str:
    if scale.logarithmic and f < 0.01:
        return rf"$10^{{{round(np.log10(f))}}}$"
    return f"{f:.4g}"


def _incidence(ax: Axes, theta_i: float, colour: str) -> None:
    """An arrow along the light, outside of the rim, with its angle."""
    tail, tip = _point(-theta_i, 1.15), _point(-theta_i, 1.01)
    arrow = {"arrowstyle": "-|>", "color": colour, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", tip, tail, arrowprops=arrow)
    x, y = _point(-theta_i, 1.17)
    ax.text(
        x,
        y,
        rf"$θ_{{\mathrm{{i}}}}$ = {np.degrees(theta_i):.4g}°",
        color=colour,
        ha="right" if theta_i > 0 else "center",
        va="bottom",
        fontsize=8,
    )


def _plane_text(model: Model, phi_i: float) -> str:
    if model.claims.isotropic:
        return "in the plane of incidence"
    return rf"in the plane of incidence at $φ_{{\mathrm{{i}}}}$ = {np.degrees(phi_i):.4g}°"


def _values_text(model: Model, named: Mapping[str, float]) -> str:
    parts = []
    for p in model.parameters:
        unit = unit_text(p.file_unit)
        parts.append(f"{symbol(p)} = {p.to_file(named[p.name]):.3g}{unit}")
    return f"{model.name}:  " + ", ".join(parts)
