"""The picture of the angles: normal, tangent x, both directions and the half vector."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from gonio.geometry import FloatArray, angles, unit_vectors
from gonio.plotting import save, style
from gonio.plotting.style import BLUE, GREEN, VERMILLION

LIGHT = np.radians([40.0, 155.0])  # theta_i, phi_i
VIEWER = np.radians([70.0, 35.0])  # theta_r, phi_r
EYE = np.radians([62.0, -65.0])  # from where the picture is seen
BEHIND = "#bbbbbb"


def draw(path: Path) -> None:
    """Write the picture."""
    import matplotlib.pyplot as plt

    with style():
        figure, ax = plt.subplots(figsize=(6.4, 3.9), layout="constrained")
        ax.set_axis_off()
        ax.set_aspect("equal")
        surface(ax)
        i, r = unit_vectors(*LIGHT), unit_vectors(*VIEWER)
        h = (i + r) / np.linalg.norm(i + r)
        for w, colour, index in ((i, VERMILLION, "i"), (r, BLUE, "r")):
            direction(ax, w, colour, index)
        arrow(ax, h, GREEN)
        note(ax, h, "$h$ ∝ $d_i + d_r$", GREEN, (6, 0), ha="left")
        arc(ax, angles(h), 0.78, GREEN, r"$δ$", (3, 5))
    save(figure, path)
    plt.close(figure)


def flat(v: FloatArray) -> FloatArray:
    """Place in the picture of points (..., 3), seen from afar."""
    theta, phi = EYE
    right = np.array([-np.sin(phi), np.cos(phi), 0.0])
    up = np.cross(unit_vectors(theta, phi), right)
    return np.stack([v @ right, v @ up], axis=-1)


def surface(ax: Axes) -> None:
    """The sample with its frame: x, y and the normal."""
    rim = unit_vectors(np.pi / 2, np.linspace(0, 2 * np.pi, 181))
    ax.fill(*flat(1.12 * rim).T, color="#f2f2f2", zorder=0)
    ax.plot(*flat(1.12 * rim).T, color=BEHIND, linewidth=0.6)
    frame = np.eye(3)
    for axis, name, offset in zip(
        (1.3 * frame[0], 1.3 * frame[1], 1.25 * frame[2]),
        ("$x$, the tangent: φ = 0", "$y$", "$n$, the normal"),
        ((6, -2), (4, 4), (0, 5)),
        strict=True,
    ):
        arrow(ax, axis, "black", linewidth=1.0)
        note(ax, axis, name, "black", offset, ha="center" if axis[2] else "left")


def direction(ax: Axes, w: FloatArray, colour: str, index: str) -> None:
    """A direction that leaves the surface, its polar angle and its azimuth."""
    theta, phi = angles(w)
    phi = phi % (2 * np.pi)
    foot = w * np.array([1, 1, 0])
    arrow(ax, 1.1 * w, colour, linewidth=2.0)
    what = {"i": "towards the light", "r": "towards the viewer"}[index]
    left = flat(w)[0] < 0
    note(
        ax,
        1.1 * w,
        rf"$d_{index}$, {what}",
        colour,
        (24 if left else 4, 4),
        ha="right" if left else "left",
    )
    for start, end in ((np.zeros(3), 1.1 * foot), (1.1 * w, 1.1 * foot)):
        ax.plot(*flat(np.stack([start, end])).T, color=colour, linewidth=0.8, linestyle=(0, (4, 3)))
    arc(ax, (theta, phi), 0.5, colour, rf"$θ_{index}$", (-2 if left else 3, 4))
    radius = {"i": 0.42, "r": 0.66}[index]
    turn = np.linspace(0, phi, 61)
    curve(ax, radius * unit_vectors(np.pi / 2, turn), colour)
    at = radius * unit_vectors(np.pi / 2, phi * {"i": 0.93, "r": 0.5}[index])
    note(ax, at, rf"$φ_{index}$", colour, {"i": (-6, 4), "r": (4, -1)}[index], ha="left")


def arc(
    ax: Axes,
    to: tuple[Any, Any],
    radius: float,
    colour: str,
    name: str,
    offset: tuple[float, float],
) -> None:
    """The angle between the normal and a direction."""
    theta, phi = to
    curve(ax, radius * unit_vectors(np.linspace(0, theta, 41), phi), colour)
    note(ax, radius * unit_vectors(0.55 * theta, phi), name, colour, offset)


def curve(ax: Axes, points: FloatArray, colour: str) -> None:
    """A line that ends in an arrow's head."""
    place = flat(points)
    ax.plot(*place.T, color=colour, linewidth=1.0)
    head = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.0, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", place[-1], place[-4], arrowprops=head)


def arrow(ax: Axes, tip: FloatArray, colour: str, linewidth: float = 1.6) -> None:
    """An arrow from the centre of the sample."""
    end, start = flat(np.stack([tip, np.zeros(3)]))
    head = {"arrowstyle": "-|>", "color": colour, "linewidth": linewidth, "shrinkA": 0}
    ax.annotate("", end, start, arrowprops={**head, "shrinkB": 0}, zorder=3)
    ax.update_datalim([end, start])


def note(
    ax: Axes,
    at: FloatArray,
    text: str,
    colour: str,
    offset: tuple[float, float],
    ha: str = "center",
) -> None:
    """A text beside a point; the offset is in points."""
    ax.annotate(
        text,
        flat(at),
        offset,
        textcoords="offset points",
        color=colour,
        ha=ha,
        va="bottom",
        fontsize=10,
    )
