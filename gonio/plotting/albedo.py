"""Directional albedo of a model against the angle of incidence."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator

import gonio.models as models
from gonio.models import Model
from gonio.models.albedo import directional_albedo
from gonio.plotting.style import BLUE, GREY, VERMILLION, new_axes, style

_THETA_DEG = np.concatenate([np.arange(0, 80, 5), np.arange(80, 89, 2.0)])
_COARSE_DEG = np.arange(0, 90, 15.0)  # of a model that takes long


def albedo_curve(
    model: Model | str,
    parameters: Mapping[str, float] | None = None,
    axes: Axes | None = None,
) -> Axes:
    """Fraction of the light that a model reflects, from normal to grazing incidence.

    Parameters
    ----------
    model : Model or str
    parameters : mapping, optional
        Parameters by name, angles in radians; those left out take their defaults.
    axes : Axes, optional
        New ones where not given.

    Returns
    -------
    Axes
        One line, or two for an anisotropic model: light along x and along y. Dashed is the bound
        that the model claims, dotted is 1 where the curve comes near it.

    Raises
    ------
    ConfigurationError
        For an unknown name or a parameter out of range.

    Examples
    --------
    >>> ax = albedo_curve("ward", {"rho_d": 0.1, "rho_s": 0.2})
    >>> ax.get_ylabel()
    'directional albedo'
    >>> import matplotlib.pyplot as plt
    >>> plt.close(ax.figure)
    """
    model = models.get(model)
    vector = model.vector(parameters or {})
    named = dict(zip(model.names, vector.tolist(), strict=True))
    theta = _COARSE_DEG if model.costly else _THETA_DEG
    planes = (0.0,) if model.claims.isotropic else (0.0, 90.0)
    rtol = 1e-2 if model.costly else 1e-4
    most = 1000 if model.costly else 200_000
    curves = [
        np.array([
            directional_albedo(model, named, np.radians(t), np.radians(phi), rtol=rtol,
                               max_evaluations=most).value
            for t in theta
        ])
        for phi in planes
    ]  # fmt: skip
    with style():
        ax = new_axes(4.6, 3.2) if axes is None else axes
        for phi, curve, colour, line in zip(
            planes, curves, (BLUE, VERMILLION), ("-", (0, (5, 1.5))), strict=False
        ):
            label = None if len(planes) == 1 else rf"$φ_{{\mathrm{{i}}}}$ = {phi:g}°"
            ax.plot(theta, curve, color=colour, linestyle=line, label=label)
        _bounds(ax, model, named, float(max(curve.max() for curve in curves)))
        ax.set_xlim(0, 90)
        ax.set_ylim(0, None)
        ax.xaxis.set_major_locator(MultipleLocator(15))
        ax.set_xlabel(r"angle of incidence $θ_{\mathrm{i}}$ (°)")
        ax.set_ylabel("directional albedo")
        ax.set_title(model.name)
        if ax.get_legend_handles_labels()[1]:
            ax.legend(loc="best")
    return ax


def _bounds(ax: Axes, model: Model, named: Mapping[str, float], top: float) -> None:
    """The bound that is claimed, and 1 where the curve comes near it."""
    bound = model.claims.albedo_bound(named)
    if bound is not None:
        names = model.claims.albedo_at_most or ()
        text = " + ".join(names) if names else "1"
        ax.axhline(bound, color=GREY, linewidth=0.9, linestyle="--", label=f"at most {text}")
    if top > 0.8 and bound != 1:
        ax.axhline(1.0, color=GREY, linewidth=0.9, linestyle=":", label="1: all light comes back")
