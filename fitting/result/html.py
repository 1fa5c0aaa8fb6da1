"""A fit's result as HTML for a notebook."""

from __future__ import annotations

from html import escape

from gonio.fitting.result.lines import posterior_lines
from gonio.fitting.result.record import FitRecord
from gonio.fitting.result.tables import parameter_row
from gonio.wording import counted

MOST = 40  # parameters of a joint fit that are shown
_HEAD = ("parameter", "value", "standard uncertainty", "95 % interval")
_RIGHT = ' style="text-align:right"'


def html(record: FitRecord, title: str) -> str:
    """The parameters as a table with the goodness of fit below, warnings last."""
    names = list(record.parameters)
    rows = [_row("td", parameter_row(name, record.parameters[name], None)) for name in names[:MOST]]
    facts = [counted(record.n_samples, "sample"), record.status.replace("_", " ")]
    if record.weights == "sd" and record.loss == "chi2":
        facts.append(f"χ²/dof {record.chi2 / record.dof:.4g} by the independent noise")
    if len(names) > MOST:
        facts.append(f"{counted(len(names) - MOST, 'more parameter')}: to_dataframe() has all")
    lines = ["; ".join(facts)]
    if record.posterior is not None:
        lines += posterior_lines(record.posterior)
    parts = [
        f"<p><strong>{escape(title)}</strong></p>",
        "" if record.verdict is None else f"<p>{escape(record.verdict.line)}</p>",
        f"<table><thead>{_row('th', _HEAD)}</thead><tbody>{''.join(rows)}</tbody></table>",
        f"<p>{'<br>'.join(map(escape, lines))}</p>",
    ]
    if record.warnings:
        items = "".join(f"<li>{escape(warning)}</li>" for warning in record.warnings)
        heading = counted(len(record.warnings), "warning")
        parts.append(f"<details><summary>{heading}</summary><ul>{items}</ul></details>")
    return f"<div>{''.join(parts)}</div>"


def _row(tag: str, cells: tuple[str, ...] | list[str]) -> str:
    first, *others = map(escape, cells)
    shown = "".join(f"<{tag}{_RIGHT}>{cell}</{tag}>" for cell in others)
    return f'<tr><{tag} style="text-align:left">{first}</{tag}>{shown}</tr>'
