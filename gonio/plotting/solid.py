"""A model's lobe as a solid: its radius in every viewing direction grows with f."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import gonio.models as models
from gonio.errors import ConfigurationError
from gonio.geometry import HORIZON, unit_vectors
from gonio.models import Model
from gonio.plotting.model import _curve, _radius, _values_text
from gonio.plotting.style import BLACK, GREY, VERMILLION, _new_figure, style

_EDGE = np.radians(89.5)
_VIEWER_DEG = 24.0, -62.0  # elevation and azimuth


def lobe_solid(
    model: Model | str,
    parameters: Mapping[str, float] | None = None,
    axes: Any = None,
    *,
    theta_i: float = np.radians(45.0),
    phi_i: float = 0.0,
) -> Any:
    """A model's BRDF for one incidence as a surface in space.

    Parameters
    ----------
    model : Model or str
    parameters : mapping, optional
        Parameters by name, angles in radians; those left out take their defaults.
    axes : mpl_toolkits.mplot3d.Axes3D, optional
        New ones where not given.
    theta_i, phi_i : float
        Direction of the light, radians.

    Returns
    -------
    mpl_toolkits.mplot3d.Axes3D
        The distance of the surface from the middle is f, on the scale that the title names: linear
        where f varies little in the plane of incidence, else logarithmic.

    Raises
    ------
    ConfigurationError
        For an unknown name, or an incidence at or below the horizon.
    DataError
        If f is 0 everywhere in the plane of incidence.

    Examples
    --------
    >>> ax = lobe_solid("ward", {"alpha_y": 0.3})
    >>> ax.get_zlabel()
    'normal'
    >>> import matplotlib.pyplot as plt
    >>> plt.close(ax.figure)
    """
    model = models.get(model)
    if not 0 <= theta_i < HORIZON:
        raise ConfigurationError(
            f"theta_i = {theta_i:.6g} rad is not above the horizon; allowed is 0 up to pi/2.",
            value=theta_i,
        )
    vector = model.vector(parameters or {})
    scale = _radius([_curve(model, vector, theta_i, phi_i)])
    w_r, w_i = _grid(theta_i, phi_i), unit_vectors(theta_i, phi_i)
    r = scale.of(np.minimum(model.evaluate(w_i, w_r, vector), scale.high))
    x, y, z = np.moveaxis(w_r * r[..., None], -1, 0)
    with style():
        ax = _new_figure(4.4, 3.7).add_subplot(projection="3d") if axes is None else axes
        ax.plot_surface(
            x, y, z, rcount=len(w_r), ccount=w_r.shape[1], color="#d9d9d9", linewidth=0,
            antialiased=False, shade=True, rasterized=True,
        )  # fmt: skip
        ax.plot(*np.outer(w_i, [0.0, 1.15]), color=VERMILLION, label="light")
        ax.plot(*np.outer(w_i * [-1, -1, 1], [0.0, 1.15]), color=BLACK, linestyle="--",
                linewidth=0.8, label="mirror direction")  # fmt: skip
        rim = np.linspace(0, 2 * np.pi, 121)
        ax.plot(np.cos(rim), np.sin(rim), 0 * rim, color=GREY, linewidth=0.6)
        _frame(ax)
        kind = "logarithmic" if scale.logarithmic else "linear"
        named = dict(zip(model.names, vector.tolist(), strict=True))
        ax.set_title(
            f"{_values_text(model, named)}\n$f$, {kind}, {scale.low:.3g} in the middle, "
            rf"{scale.high:.3g} sr$^{{-1}}$ at the ring",
            fontsize=7.5,
        )
        ax.legend(loc="upper left", bbox_to_anchor=(-0.1, 0.95))
    return ax


def _grid(theta_i: float, phi_i: float) -> Any:
    """Directions of view, close together about the mirror direction, where a lobe is narrow."""
    near = np.radians(np.linspace(-12, 12, 61))
    theta = np.union1d(np.linspace(0, _EDGE, 61), theta_i + near)
    phi = np.union1d(np.linspace(-np.pi, np.pi, 121), 3 * near)
    theta = theta[(theta >= 0) & (theta <= _EDGE)]
    return unit_vectors(theta[:, None], phi_i + np.pi + phi[None, :])


def _frame(ax: Any) -> None:
    """Equal axes without numbers; the title gives the scale."""
    ax.set_xlim(-1, 1)
    ax.set_ylim(-1, 1)
    ax.set_zlim(0, 1)
    ax.set_box_aspect((2, 2, 1), zoom=1.15)
    ax.view_init(*_VIEWER_DEG)
    for axis, name in ((ax.xaxis, "x"), (ax.yaxis, "y"), (ax.zaxis, "normal")):
        axis.set_ticks([])
        axis.set_pane_color((1, 1, 1, 0))
        axis.set_label_text(name)
        axis.labelpad = -12
