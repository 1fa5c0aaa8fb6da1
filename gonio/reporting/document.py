"""One HTML file that contains everything: a reader needs no other file and no network."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Callable
from importlib.resources import files

from gonio._version import __version__
from gonio.errors import GonioError
from gonio.reporting import budget, diagnosis, lobe, posterior, residuals, sections
from gonio.reporting.chart import Chart
from gonio.reporting.inputs import Inputs
from gonio.reporting.markup import Markup, section, tag, text
from gonio.reporting.statement import Statement

Put = Callable[[Chart | None], Markup]
_NO_SAMPLES = "Left out: the samples that the fit was made to are not there."
_NO_DRAWS = "Left out: the posterior's draws are not there."


def page(inputs: Inputs, stated: Statement | None = None) -> str:
    """The report as one HTML document.

    Parameters
    ----------
    inputs : Inputs
        What `gather` found.
    stated : Statement, optional
        Operator, dates, serial numbers and coverage; only the page contains them.

    Returns
    -------
    str
        It holds plotly.js, 4.8 MB, a policy that forbids all network traffic and, as JSON, the
        data of its charts, thinned.
    """
    body, charts = _body(inputs, stated or Statement())
    scripts = [_plotly(), _resource("report.js")]
    hashes = " ".join(f"'sha256-{_digest(script)}'" for script in scripts)
    policy = (
        f"default-src 'none'; script-src {hashes}; style-src 'unsafe-inline'; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    head = "\n".join(
        [
            '<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta name="color-scheme" content="light dark">',
            f'<meta name="generator" content="gonio {text(__version__)}">',
            tag("title", sections.title(inputs.fit)),
            f"<style>\n{_resource('report.css')}</style>",
        ]
    )
    blocks = "\n".join(f"<script>{script}</script>" for script in scripts)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n{head}\n</head>\n<body>\n{body}\n'
        f'<script type="application/json" id="charts">{_as_json(charts)}</script>\n'
        f"{blocks}\n</body>\n</html>\n"
    )


def _body(inputs: Inputs, stated: Statement) -> tuple[Markup, list[Chart]]:
    """Header and sections, and the charts that stand in them."""
    fit, samples = inputs.fit, inputs.samples
    charts: list[Chart] = []

    def put(chart: Chart | None) -> Markup:
        if chart is None:
            return Markup("")
        charts.append(chart)
        return figure(chart)

    residual = _residuals(inputs)
    missing = tag("p", _NO_SAMPLES, class_="note")
    slices = Markup("") if samples is None else put(lobe.slices(samples, fit))
    surface = missing if samples is None else put(lobe.surface(samples, fit))
    maps = missing
    histogram = Markup("")
    if samples is not None and residual is not None:
        maps = put(residuals.maps(samples, residual))
        histogram = put(residuals.histogram(residual))
    parts = [
        sections.heading(inputs, stated),
        sections.parameters(fit, stated),
        section("lobe", "Measured and fitted lobe", sections.reference(fit), slices, surface),
        section("residual", "Residuals", maps),
        section("goodness", "Goodness of fit", *sections.goodness(fit, residual), histogram),
        diagnosis.part(inputs, put),
        section("posterior", "Posterior", sections.convergence(fit), *_posterior(inputs, put)),
        section(
            "uncertainty",
            "Uncertainty budget",
            put(budget.bars(fit)),
            sections.parameter_budget(fit, stated),
            sections.sample_budget(inputs),
            sections.unknown(fit),
        ),
        sections.measurement(inputs),
        sections.reproduce(inputs),
        tag("noscript", tag("p", "The charts need JavaScript; all tables are complete without.")),
        tag("footer", f"Written by gonio {__version__}. This file asks nothing of the network."),
    ]
    return tag("main", *parts), charts


def _residuals(inputs: Inputs) -> residuals.Residuals | None:
    if inputs.samples is None:
        return None
    try:
        return residuals.residuals(inputs.samples, inputs.fit)
    except GonioError:  # with fewer samples than parameters residuals mean nothing
        return None


def _posterior(inputs: Inputs, put: Put) -> list[Markup]:
    if inputs.fit.posterior is None:
        return []
    if inputs.draws is None:
        return [tag("p", _NO_DRAWS, class_="note")]
    return [
        put(posterior.corner(inputs.fit, inputs.draws)),
        put(posterior.trace(inputs.fit, inputs.draws)),
    ]


def figure(chart: Chart) -> Markup:
    """Element that holds a chart, with a menu where there are several views."""
    menu = Markup("")
    if len(chart.views) > 1:
        options = [
            tag(
                "option", view.label, value=str(k), **({"selected": ""} if k == chart.first else {})
            )
            for k, view in enumerate(chart.views)
        ]
        choice = tag("select", *options, id=f"{chart.ident}-menu")
        menu = tag("label", f"{chart.chooses}: ", choice, class_="menu")
    style = f"height:{chart.height}px;min-width:{chart.min_width}px"
    plot = tag("div", id=f"{chart.ident}-plot", class_="plot", style=style)
    still = tag("img", id=f"{chart.ident}-still", class_="still", alt="").removesuffix("</img>")
    return tag(
        "figure",
        menu,
        tag("div", plot, class_="scroll"),
        Markup(still) if chart.ident == "surface" else Markup(""),
        tag("figcaption", chart.caption),
        id=chart.ident,
    )


def _as_json(charts: list[Chart]) -> str:
    """JSON inside an element of HTML: < is escaped, so that no text ends the element."""
    documents = [
        {
            "id": chart.ident,
            "print_height": min(chart.height, chart.print_height),
            "views": [{"data": view.data, "layout": view.layout} for view in chart.views],
        }
        for chart in charts
    ]
    return json.dumps(documents, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _plotly() -> str:
    script = files("plotly").joinpath("package_data", "plotly.min.js").read_text(encoding="utf-8")
    # A parser of HTML ends a script at these words, wherever they stand in it.
    return script.replace("</script", "<\\/script").replace("<!--", "<\\!--")


def _resource(name: str) -> str:
    return files("gonio.reporting").joinpath(name).read_text(encoding="utf-8")


def _digest(script: str) -> str:
    """SHA-256 as a Content-Security-Policy names the scripts that may run."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
