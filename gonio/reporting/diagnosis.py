"""Identifiability of the parameters, profiles, and structure of the residuals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import gonio.models as models
from gonio.errors import GonioError
from gonio.fitting.minimum.minimise import minimise
from gonio.fitting.minimum.record import Minimum
from gonio.fitting.problem.constraints import Constraints
from gonio.fitting.problem.protocol import Problem
from gonio.fitting.problem.reduced import ReducedProblem
from gonio.fitting.problem.shared_columns import thinned
from gonio.fitting.problem.single import SingleProblem
from gonio.fitting.result import FitResult
from gonio.fitting.result.correlation import correlation
from gonio.fitting.uncertainty.profile_likelihood import profile
from gonio.plotting.style import BLUE, VERMILLION
from gonio.reporting.chart import Chart, Trace, View, axis, short
from gonio.reporting.inputs import Inputs
from gonio.reporting.markup import Markup, section, table, tag
from gonio.reporting.posterior import named

PROFILED = 2000  # samples that profiles are computed from
POINTS = 15
HALF_WIDTH = 3.0  # of a profile, standard uncertainties
AXES = 3
N_GROUPS = 10
_COLOURS = [[0, BLUE], [0.5, "#dcdcdc"], [1, VERMILLION]]


def part(inputs: Inputs, put: Any) -> Markup:
    """The section of a report; empty where the fit has no diagnostics."""
    fit = inputs.fit
    identified = fit.diagnostics.get("identifiability")
    tests = fit.diagnostics.get("residuals")
    if not identified or not tests:
        return Markup("")
    content: list[object] = [_summary(identified), *_identified(fit, identified)]
    content.append(put(profiles(inputs)))
    for number, one in enumerate(tests.get("parts") or [tests], 1):
        of = f", part {number}" if "parts" in tests else ""
        content += [tag("h3", f"Structure of the residuals{of}"), *_structure(one, of)]
    if "parts" not in tests:
        content.append(put(rings(tests)))
    return section("diagnosis", "What the data say", *content)


def _summary(identified: Mapping[str, Any]) -> Markup:
    """What is not identified, and the suggested measurement."""
    lines = [str(cause) for cause in identified["causes"]]
    if identified["suggested_measurement"] is not None:
        lines.append(str(identified["suggested_measurement"]["text"]))
    if not lines:
        return tag("p", "Every parameter that is free is identified by these data.")
    return tag("div", *(tag("p", line) for line in lines), class_="note", id="identified")


def _identified(fit: FitResult, identified: Mapping[str, Any]) -> list[Markup]:
    parts = []
    matrix = correlation(fit)
    if matrix is not None and matrix.names:
        rows = [
            [name, *(_shade(r) for r in row)]
            for name, row in zip(matrix.names, matrix.rows, strict=True)
        ]
        parts.append(table(["", *matrix.names], rows, matrix.of))
    rows = []
    for name, fitted in fit.parameters.items():
        estimate = fitted.in_file_units()
        unit = f" ({estimate.unit})" if estimate.unit else ""
        deviations = (identified["alone"].get(name), identified["bound"].get(name), estimate.stderr)
        rows.append([name + unit, *(None if u is None else f"{u:.2g}" for u in deviations)])
    head = ["parameter", "if all others were known", "Cramér-Rao bound", "standard uncertainty"]
    parts.append(table(head, rows, "How well the data can tell each parameter"))
    rows = [
        [f"{axis_['information']:.2g}", _moved(fit, axis_["change"])]
        for axis_ in identified["axes"][:AXES]
    ]
    caption = "Weakest directions; information is 1 where nothing is exchanged"
    parts.append(table(["information", "change along it"], rows, caption))
    return parts


def _shade(r: float | None) -> object:
    """A correlation on a ground whose strength is its size."""
    if r is None:
        return None
    colour = "230, 100, 20" if r > 0 else "0, 114, 178"
    style = f"background:rgba({colour}, {0.5 * r * r:.2f});padding:0 0.4rem"
    return tag("span", f"{r:+.2f}".replace("-", "−"), style=style)


def _moved(fit: FitResult, change: Mapping[str, float]) -> str:
    """A change along an axis in per cent of the values, small parts left out."""
    shown = []
    for name, step in change.items():
        value = fit.parameters[name].in_file_units().value
        if value and abs(step / value) >= 0.005:
            shown.append(f"{name} {100 * step / value:+.0f} %".replace("-", "−"))
    return ", ".join(shown)


def profiles(inputs: Inputs) -> Chart | None:
    """Profile of chi-squared along each parameter; None where it cannot be computed."""
    fit, samples = inputs.fit, inputs.samples
    if samples is None or fit.parts or fit.nuisance or fit.noise_scale <= 0:
        return None
    model = models.of_fit(fit)
    try:
        problem: Problem = SingleProblem.from_samples(
            samples,
            model,
            fit.weights,  # type: ignore[arg-type]
            loss=fit.loss,
        )
    except GonioError:
        return None
    values = fit.parameters.items()
    constraints = Constraints.of(
        model,
        {name: e.value for name, e in values if e.fixed and e.tied_to is None},
        {name: e.tied_to for name, e in values if e.tied_to is not None},
    )
    if constraints:
        problem = ReducedProblem.of(problem, constraints)
    p = problem.vector({q.name: fit.parameters[q.name].value for q in problem.parameters})
    whole = problem.n
    problem = thinned(problem.reweighted(p), PROFILED)
    optimum = minimise(problem, p, search=False)
    minimum = Minimum.of(problem, optimum)
    unit = fit.noise_scale**2 * problem.n / whole
    views = []
    for j, q in enumerate(problem.parameters):
        estimate = fit.parameters[q.name]
        if estimate.interval_95 is None:
            continue
        low, high = estimate.interval_95
        middle, half = (low + high) / 2, (high - low) / 2 * HALF_WIDTH / 1.96
        # Fewer samples have another minimum: the profile is drawn about that one.
        points = np.linspace(middle - half, middle + half, POINTS) + optimum.p[j] - p[j]
        points = np.unique(np.clip(np.append(points, optimum.p[j]), q.lower, q.upper))
        growth = (profile(minimum, j, points) - optimum.chi2) / unit
        x = [q.to_file(float(v - optimum.p[j] + p[j])) for v in points]
        views.append(View(q.name, [_curve(x, growth)], _levels(named(q))))
    if not views:
        return None
    caption = (
        "Growth of chi-squared where one parameter is held and the others follow, in units of the "
        "independent noise; shared errors are not in it. Lines: 1 and 3.84, the 68 % and 95 % "
        "levels. A parabola means that the standard uncertainty says it all."
    )
    if whole > problem.n:
        caption += (
            f" Computed from {problem.n} of {whole} samples, evenly chosen, and scaled to all."
        )
    return Chart("profiles", "Parameter", tuple(views), caption, height=300)


def _curve(x: list[float], growth: Any) -> Trace:
    return {
        "type": "scatter", "mode": "lines+markers", "x": short(x, 6),
        "y": short(np.maximum(growth, 0.0), 4), "line": {"color": BLUE, "shape": "spline"},
        "hovertemplate": "%{x}: +%{y}<extra></extra>",
    }  # fmt: skip


def _levels(name: str) -> dict[str, Any]:
    lines = [
        {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": y, "y1": y,
         "line": {"color": VERMILLION, "width": 1, "dash": "dot"}}
        for y in (1, 3.84)
    ]  # fmt: skip
    return {"xaxis": axis(name), "yaxis": axis("growth of χ²", rangemode="tozero"),
            "shapes": lines, "showlegend": False}  # fmt: skip


def _structure(tests: Mapping[str, Any], of: str) -> list[Markup]:
    """Tests for structure, and the groups of samples with the largest mean residuals."""
    rows: list[list[object]] = [
        [test["name"], f"{test['statistic']:.3g}", f"{test['p_value']:.2g}",
         f"{100 * test['share']:.1f} %"]
        for test in tests["tests"]
    ]  # fmt: skip
    line = str(tests["line"])
    parts = [tag("p", line[0].upper() + line[1:] + f"; {tests['n']} samples examined.")]
    if not rows:
        return parts
    head = ["compared by", "statistic", "p", "share of the variance"]
    parts.append(table(head, rows, f"Tests for structure that noise would not have{of}"))
    groups = [group for of_map in tests["maps"].values() for group in of_map]
    groups.sort(key=lambda group: -abs(group["z"]))
    rows = [
        [
            group["where"],
            "all" if group["theta_i_deg"] is None else f"{group['theta_i_deg']:.0f}°",
            group["n"],
            f"{group['z']:+.1f}".replace("-", "−"),
            _percent(group["relative"]),
        ]
        for group in groups[:N_GROUPS]
    ]
    head = ["where", "θi", "samples", "z", "measured less fitted"]
    parts.append(table(head, rows, f"Largest mean residuals{of}; z is in units of their noise"))
    return parts


def _percent(share: float | None) -> str | None:
    return None if share is None else f"{100 * share:+.3g} %".replace("-", "−")


def rings(tests: Mapping[str, Any]) -> Chart | None:
    """Mean residuals by angle from the mirror direction and incidence."""
    name = next((key for key in tests["maps"] if key.startswith("angle from")), None)
    groups = tests["maps"][name] if name else []
    if not groups:
        return None
    across = list(dict.fromkeys(group["where"] for group in groups))
    across.sort(key=_first_number)
    up = sorted({group["theta_i_deg"] for group in groups})
    grid = np.full((len(up), len(across)), np.nan)
    for group in groups:
        z = float(np.clip(group["z"], -10, 10))
        grid[up.index(group["theta_i_deg"]), across.index(group["where"])] = z
    data: list[Trace] = [
        {"type": "heatmap", "x": [_ring(label) for label in across],
         "y": [f"{t:.0f}°" for t in up], "z": short(grid, 3), "zmin": -5, "zmax": 5,
         "colorscale": _COLOURS, "colorbar": {"thickness": 12, "title": {"text": "z"}},
         "hovertemplate": "%{x}, θi %{y}: z = %{z}<extra></extra>"}
    ]  # fmt: skip
    layout = {
        "xaxis": axis("angle from the mirror direction (deg)", type="category"),
        "yaxis": axis("θi", type="category"),
    }
    caption = (
        "Mean residual of every ring about the mirror direction, by incidence, in units of what "
        "noise alone would give; beyond ±3 noise is rare. Orange: the model is too low."
    )
    return Chart("rings", "", (View("", data, layout),), caption, height=130 + 26 * len(up),
                 print_height=300)  # fmt: skip


def _first_number(label: str) -> float:
    """For sorting: where a ring begins.

    Examples
    --------
    >>> _first_number("within 1 deg of the mirror direction"), _first_number("3 to 4.5 deg")
    (-1.0, 3.0)
    """
    first = label.split()[0]
    return -1.0 if first == "within" else float(first)


def _ring(label: str) -> str:
    """A ring as the label of an axis.

    Examples
    --------
    >>> _ring("within 1 deg of the mirror direction"), _ring("3 to 4.5 deg from the mirror")
    ('< 1', '3–4.5')
    """
    parts = label.split()
    return f"< {parts[1]}" if parts[0] == "within" else f"{parts[0]}–{parts[2]}"
