"""Where the uncertainty of the parameters comes from."""

from __future__ import annotations

import numpy as np

import gonio.models as models
from gonio.fitting.result import FitResult
from gonio.plotting.style import COLOURS
from gonio.reporting.chart import Chart, View, axis, short
from gonio.reporting.posterior import named

OTHERS = "others"
_GREY = "#999999"


def shares(fit: FitResult) -> dict[str, dict[str, float]]:
    """Share of each source in the variance of each parameter, largest sources first.

    A parameter without known components is left out, because its budget is not determined.
    """
    squares = {
        name: {source: u**2 for source, u in estimate.components.items()}
        for name, estimate in fit.parameters.items()
        if estimate.stderr is not None and any(estimate.components.values())
    }
    relative = {
        name: {source: v / sum(parts.values()) for source, v in parts.items()}
        for name, parts in squares.items()
    }
    sources = {source for parts in relative.values() for source in parts}
    order = sorted(sources, key=lambda s: (-max(p.get(s, 0.0) for p in relative.values()), s))
    return {name: {s: parts[s] for s in order if s in parts} for name, parts in relative.items()}


def bars(fit: FitResult) -> Chart | None:
    """A bar a parameter, divided by source."""
    by_parameter = shares(fit)
    if not by_parameter:
        return None
    model = models.of_fit(fit)
    order = list(dict.fromkeys(s for parts in by_parameter.values() for s in parts))
    order.sort(key=lambda s: -max(parts.get(s, 0.0) for parts in by_parameter.values()))
    palette = COLOURS[1:]
    main = order[: len(palette)]
    y = [named(model.parameter(name)) for name in by_parameter]
    rows = [(s, c, [parts.get(s, 0.0) for parts in by_parameter.values()])
            for s, c in zip(main, palette, strict=False)]  # fmt: skip
    if len(order) > len(main):
        others = [
            sum(parts.get(s, 0.0) for s in order[len(main) :]) for parts in by_parameter.values()
        ]
        rows.append((OTHERS, _GREY, others))
    data = [
        {"type": "bar", "orientation": "h", "name": _escaped(source), "y": y,
         "x": short(100 * np.asarray(part), 3), "marker": {"color": colour},
         "hovertemplate": f"%{{y}}: %{{x}} %<extra>{_escaped(source)}</extra>"}
        for source, colour, part in rows
    ]  # fmt: skip
    layout = {
        "barmode": "stack",
        "xaxis": axis("share of the variance (%)", range=[0, 100]),
        "yaxis": {"autorange": "reversed"},
    }
    caption = "Share of each source in the variance of a parameter; the table gives all of them."
    return Chart("budget", "", (View("", data, layout),), caption, height=110 + 60 * len(y))


def _escaped(text: str) -> str:
    """Text for a template of plotly, which reads tags and braces."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace("%{", "% {")
