"""Slices through the lobe and its shape over the hemisphere, measured and fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import gonio.models as models
from gonio.fitting.result import FitResult
from gonio.geometry import Directions, FloatArray, angles, unit_vectors
from gonio.plotting.lobe import IN_PLANE, SAME_ANGLE, in_plane
from gonio.plotting.style import COLOURS, VERMILLION
from gonio.reporting.chart import Chart, Trace, View, axis, short, spread
from gonio.samples import BRDFSamples

N_INCIDENCES = 6
LEAST_POINTS = 4
MOST_POINTS = 400  # in one view of the surface
Curve = Callable[[Directions], FloatArray]
Plane = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Image:
    """Samples of one direction of incidence, angles in radians."""

    theta_i: float
    phi_i: float
    index: NDArray[np.int64]

    @property
    def label(self) -> str:
        """Its incidence, as a menu shows it."""
        return f"θi = {np.degrees(self.theta_i):.4g}°, φi = {np.degrees(self.phi_i):.4g}°"


def images(samples: BRDFSamples) -> list[Image]:
    """Samples by direction of incidence, in the order of theta_i and then of phi_i."""
    theta_i, phi_i, _, _ = columns(samples)
    turn = np.mod(phi_i + SAME_ANGLE / 2, 2 * np.pi) - SAME_ANGLE / 2
    keys = np.round(np.stack([theta_i, turn], axis=1) / SAME_ANGLE)
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    group = group.ravel()
    order = np.argsort(group, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(group))[:-1])
    return [
        Image(float(theta_i[k]), float(turn[k]), part) for k, part in zip(first, parts, strict=True)
    ]


def columns(samples: BRDFSamples) -> list[FloatArray]:
    """theta_i, phi_i, theta_r and phi_r of every sample, radians."""
    d = samples.directions
    return [
        np.broadcast_to(getattr(d, name), (len(samples),))
        for name in ("theta_i", "phi_i", "theta_r", "phi_r")
    ]


def fitted(fit: FitResult) -> Curve:
    """The fitted model as a function of directions."""
    model = models.of_fit(fit)
    values = fit.values()
    return lambda directions: np.asarray(model(directions, **values))


def slices(samples: BRDFSamples, fit: FitResult) -> Chart | None:
    """The BRDF in the plane of incidence and across it, at several incidences."""
    model = fitted(fit)
    inside = _inside(samples, model)
    across = _across(samples, model)
    if not inside and not across:
        return None
    views = []
    if inside:
        views.append(
            View(
                "in the plane of incidence",
                inside,
                _cartesian("θr (°), forward positive", samples.quantity),
            )
        )
        views.append(View("in the plane, polar", _polar(inside), _half_circle()))
    if across:
        title = "angle from the specular direction (°)"
        views.append(
            View(
                "across it, at the specular direction", across, _cartesian(title, samples.quantity)
            )
        )
    caption = (
        "Points: measured, with standard uncertainty of the independent errors where it is known; "
        f"lines: the fitted model. {samples.quantity} in sr⁻¹ on a logarithmic scale, cosine not "
        "included: values below zero, which are noise, are not on it. Across: the great circle "
        "through the specular direction, at right angles to the plane of incidence."
    )
    return Chart("slices", "Slice", tuple(views), caption, height=460)


def _cartesian(title: str, quantity: str) -> dict[str, Any]:
    logarithmic = {"type": "log", "exponentformat": "none", "dtick": 1}
    return {
        "xaxis": axis(title, zeroline=False),
        "yaxis": axis(f"{quantity} (sr⁻¹)", **logarithmic),
    }


def _half_circle() -> dict[str, Any]:
    """A half circle, the normal at the top, forward to the right."""
    return {
        "margin": {"l": 45, "r": 45, "t": 40, "b": 10},
        "polar": {
            "sector": [0, 180],
            "angularaxis": {
                "rotation": 90,
                "direction": "clockwise",
                "tickvals": [-90, -60, -30, 0, 30, 60, 90],
                "ticktext": ["−90°", "−60°", "−30°", "0°", "30°", "60°", "90°"],
            },
            "radialaxis": {"type": "log", "dtick": 1, "exponentformat": "none", "angle": 90},
        },
    }


def _inside(samples: BRDFSamples, model: Curve) -> list[Trace]:
    traces = []
    parts = in_plane(samples, N_INCIDENCES)
    edge = max((float(np.abs(part.theta_r).max()) for part in parts), default=0.0)
    for part, colour in zip(parts, COLOURS[1:], strict=False):
        signed = np.union1d(
            np.linspace(-edge, edge, 241), part.theta_i + np.linspace(-0.2, 0.2, 81)
        )
        signed = signed[np.abs(signed) <= edge]
        phi_r = np.where(signed > 0, part.phi_i + np.pi, part.phi_i)
        f = model(Directions(part.theta_i, part.phi_i, np.abs(signed), phi_r))
        traces += _pair(_angle(part.theta_i), colour, part.theta_r, part.value, part.u, signed, f)
    return traces


def _across(samples: BRDFSamples, model: Curve) -> list[Trace]:
    """As `_inside`, along the great circle through the specular direction."""
    traces: list[Trace] = []
    chosen = spread(_nearest_turn(images(samples)), N_INCIDENCES)
    for image, colour in zip(chosen, COLOURS[1:], strict=False):
        s = unit_vectors(image.theta_i, image.phi_i + np.pi)
        n = unit_vectors(np.pi / 2, image.phi_i + np.pi / 2)
        w_r = samples.directions.vectors()[1][image.index]
        near = np.abs(w_r @ np.cross(s, n)) < _half_width(samples, image.index)
        near &= w_r @ s > 0
        if np.count_nonzero(near) < LEAST_POINTS:
            continue
        at, w = image.index[near], w_r[near]
        t = np.arctan2(w @ n, w @ s)
        order = np.argsort(t, kind="stable")
        edge = float(np.abs(t).max())
        fine = np.union1d(np.linspace(-edge, edge, 181), np.linspace(-0.3, 0.3, 81))
        fine = fine[np.abs(fine) <= edge]
        theta_r, phi_r = angles(np.cos(fine)[:, None] * s + np.sin(fine)[:, None] * n)
        f = model(Directions(image.theta_i, image.phi_i, theta_r, phi_r))
        u = np.zeros(len(at)) if samples.u_independent is None else samples.u_independent[at]
        traces += _pair(
            _angle(image.theta_i), colour, t[order], samples.value[at][order], u[order], fine, f
        )
    return traces


def _half_width(samples: BRDFSamples, index: NDArray[np.int64]) -> FloatArray | float:
    """Distance from a plane within which it cuts a sample's cell."""
    if samples.solid_angle is None:
        return float(IN_PLANE)
    return np.asarray(np.sqrt(samples.solid_angle[index]) / 2)


def _nearest_turn(candidates: list[Image]) -> list[Image]:
    """One image of each incidence angle, that of the smallest turn of the sample."""
    best: dict[int, Image] = {}
    for image in candidates:
        key = round(image.theta_i / SAME_ANGLE)
        if key not in best or _turn(image) < _turn(best[key]):
            best[key] = image
    return [best[key] for key in sorted(best)]


def _turn(image: Image) -> float:
    return abs((image.phi_i + np.pi) % (2 * np.pi) - np.pi)


def _angle(theta_i: float) -> str:
    return f"θi = {np.degrees(theta_i):.4g}°"


def _pair(
    name: str,
    colour: str,
    x: FloatArray,
    value: FloatArray,
    u: FloatArray,
    fine: FloatArray,
    f: FloatArray,
) -> list[Trace]:
    """Points and line of one incidence; one entry of the legend shows or hides both."""
    positive = value > 0
    points: Trace = {
        "type": "scatter", "mode": "markers", "name": name, "legendgroup": name,
        "x": short(np.degrees(x[positive])), "y": short(value[positive]),
        "marker": {"color": colour, "size": 6, "opacity": 0.6},
    }  # fmt: skip
    if u.any():
        points["error_y"] = {
            "array": short(u[positive]), "color": colour, "thickness": 0.8, "width": 0,
        }  # fmt: skip
    lit = f > 0
    line: Trace = {
        "type": "scatter", "mode": "lines", "name": f"{name}, model", "legendgroup": name,
        "showlegend": False, "x": short(np.degrees(fine[lit])), "y": short(f[lit]),
        "line": {"color": colour, "width": 1.6},
    }  # fmt: skip
    return [points, line]


def _polar(traces: list[Trace]) -> list[Trace]:
    turned = []
    for trace in traces:
        common = {k: v for k, v in trace.items() if k not in ("x", "y", "error_y")}
        turned.append({**common, "type": "scatterpolar", "theta": trace["x"], "r": trace["y"]})
    return turned


def surface(samples: BRDFSamples, fit: FitResult) -> Chart:
    """The fitted lobe as a surface to turn, with the measured values as points."""
    model = fitted(fit)
    views = []
    for image in spread(_nearest_turn(images(samples)), N_INCIDENCES):
        at = np.asarray(spread(image.index, MOST_POINTS), np.int64)
        _, _, theta_r, phi_r = (column[at] for column in columns(samples))
        mesh = np.meshgrid(*_grid(image), indexing="ij")
        f = model(Directions(image.theta_i, image.phi_i, *mesh))
        data = [_mesh(mesh, f), _points(theta_r, phi_r, samples.value[at])]
        views.append(View(image.label, data, _scene()))
    caption = (
        f"Distance from the origin is the cube root of the {samples.quantity}, so that the diffuse "
        f"part stays visible beside the peak; shown values are {samples.quantity} in sr⁻¹. "
        "Surface: the fitted model; "
        f"points: measured, at most {MOST_POINTS} of an image; values below zero lie at the "
        "origin. Drag to turn."
    )
    return Chart("surface", "Incidence", tuple(views), caption, height=480, first=len(views) // 2)


def _grid(image: Image) -> tuple[FloatArray, FloatArray]:
    """theta_r and phi_r, finer around the specular direction."""
    theta = np.radians(np.union1d(np.arange(0, 91, 3), np.degrees(image.theta_i) + _NEAR))
    specular = np.degrees(image.phi_i) + 180
    phi = np.radians(specular + np.union1d(np.arange(-180, 181, 5), 1.5 * _NEAR))
    return theta[(theta >= 0) & (theta <= np.pi / 2)], phi


_NEAR = np.arange(-9.0, 9.1, 1.5)  # degrees


def _mesh(mesh: Sequence[FloatArray], f: FloatArray) -> Trace:
    x, y, z = np.moveaxis(np.cbrt(np.maximum(f, 0))[..., None] * unit_vectors(*mesh), -1, 0)
    return {
        "type": "surface", "name": "model", "x": short(x, 3), "y": short(y, 3), "z": short(z, 3),
        "surfacecolor": short(np.cbrt(np.maximum(f, 0)), 3), "colorscale": "Cividis",
        "showscale": False, "opacity": 0.9, "hoverinfo": "skip",
    }  # fmt: skip


def _points(theta_r: FloatArray, phi_r: FloatArray, value: FloatArray) -> Trace:
    radius = np.cbrt(np.maximum(value, 0))
    x, y, z = np.moveaxis(radius[:, None] * unit_vectors(theta_r, phi_r), -1, 0)
    return {
        "type": "scatter3d", "mode": "markers", "name": "measured",
        "x": short(x), "y": short(y), "z": short(z), "customdata": short(value),
        "hovertemplate": "%{customdata} sr⁻¹<extra>measured</extra>",
        "marker": {"size": 2.5, "color": VERMILLION},
    }  # fmt: skip


def _scene() -> dict[str, Any]:
    bare = {"showticklabels": False, "showspikes": False}
    return {
        "showlegend": False,
        "scene": {
            "aspectmode": "data",
            "xaxis": axis("x", **bare), "yaxis": axis("y", **bare), "zaxis": axis("normal", **bare),
            "camera": {"eye": {"x": 1.4, "y": -2.2, "z": 0.7}},
        },
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
    }  # fmt: skip
