"""The hemisphere of viewing directions as a disc in which equal areas are equal solid angles."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from gonio.geometry import FloatArray, equal_area, unit_vectors
from gonio.plotting.style import BLACK, GREY

CIRCLES_DEG = (30.0, 60.0, 90.0)
NO_DATA = "#d9d9d9"
_LABELS_AT_DEG = -33.75
_AROUND = np.linspace(0, 2 * np.pi, 181)


def at(theta_deg: float, phi: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Position on the disc of a polar angle in degrees and azimuths in radians."""
    return equal_area(unit_vectors(np.radians(theta_deg), phi))


def draw_disc(ax: Axes, *, background: str = NO_DATA) -> None:
    """Circles of equal theta_r with their angles, azimuths around, x to the right."""
    ax.fill(*at(90.0, _AROUND), color=background, linewidth=0, zorder=0)
    for circle in CIRCLES_DEG:
        line = "-" if circle == CIRCLES_DEG[-1] else ":"
        ax.plot(*at(circle, _AROUND), color=GREY, linewidth=0.7, linestyle=line, zorder=3)
        ax.annotate(
            f"{circle:g}°", at(circle, np.radians(_LABELS_AT_DEG)), fontsize=7, ha="center",
            va="center", zorder=4, bbox={"facecolor": "white", "pad": 0.6, "linewidth": 0},
        )  # fmt: skip
    for phi in (0.0, 90.0, 180.0, 270.0):
        x, y = 1.08 * np.array(at(90.0, np.radians(phi)))
        ax.text(x, y, f"{phi:g}°", ha="center", va="center", fontsize=7, color=GREY)
    ax.set_aspect(1)
    ax.set_xlim(-1.16, 1.16)
    ax.set_ylim(-1.16, 1.16)
    ax.axis("off")


def mark_incidence(ax: Axes, theta_i: float, phi_i: float) -> None:
    """A ring about the direction of the light and a cross at that of the mirror, radians.

    Their white edge makes them visible on dark colours and on light ones.
    """
    degrees = float(np.degrees(theta_i))
    for phi, marker, size, label in (
        (phi_i, "o", 8, "light"),
        (phi_i + np.pi, "+", 9, "mirror direction"),
    ):
        x, y = at(degrees, phi)
        for colour, width in (("white", 3.0), (BLACK, 1.2)):
            ax.plot(
                x, y, marker, color=colour, markersize=size, markerfacecolor="none",
                markeredgewidth=width, linestyle="none", zorder=5,
                label=label if colour == BLACK else None,
            )  # fmt: skip
