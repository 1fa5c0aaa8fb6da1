"""A fit's result as text: the page that `print` and the command show, and the longer summary."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

from rich.console import Console, RenderableType

from gonio.fitting.result.estimates import Estimate
from gonio.fitting.result.explained import explained, residual_lines
from gonio.fitting.result.joint_tables import joint_tables
from gonio.fitting.result.lines import (
    WEIGHTS,
    cuts_line,
    engine_text,
    nuisance_lines,
    posterior_lines,
)
from gonio.fitting.result.record import FitRecord
from gonio.fitting.result.tables import parameter_table
from gonio.fitting.result.verdict import WORDS
from gonio.wording import counted

WIDTH = 100  # columns of a page that goes to no terminal
MOST = 8  # parameters that a short line names


def page(
    record: FitRecord,
    title: str,
    *,
    known: Mapping[str, float] | None = None,
    width: int = WIDTH,
    explain: bool = False,
) -> list[RenderableType]:
    """Lines of text, which are not folded, and tables, in the order in which they are read.

    Parameters
    ----------
    record : FitRecord
    title : str
        The model's title and reference.
    known : mapping of str to float, optional
        Values of a simulation to stand beside, in the unit of files.
    width : int
        Columns.
    explain : bool
        With what the data say of each parameter, and where the residuals are.
    """
    parts = f" in {counted(len(record.parts), 'part')}" if record.parts else ""
    pieces: list[RenderableType] = [
        title,
        *([] if record.verdict is None else [record.verdict.line]),
        f"{counted(record.n_samples, 'sample')}{parts}{cuts_line(record.cuts)}; "
        f"weights: {WEIGHTS.get(record.weights, record.weights)}",
        f"loss: {record.loss}; engine: {engine_text(record.engine, record.polish)}",
    ]
    if record.parts:
        pieces += joint_tables(record, known, width)
    else:
        pieces.append(parameter_table(record, known))
    stated = record.weights == "sd" and record.loss == "chi2"
    ratio = f"; chi2/dof {record.chi2 / record.dof:.4g} by the independent noise" if stated else ""
    pieces.append(f"status: {record.status.replace('_', ' ')}{ratio}")
    allowance = record.diagnostics.get("allowance")
    pieces += [str(allowance["text"])] if allowance else []
    pieces += record.diagnostics.get("self_calibration", {}).get("notes", [])
    if record.posterior is not None:
        pieces += posterior_lines(record.posterior)
    if record.nuisance:
        pieces += nuisance_lines(record.nuisance)
    pieces += residual_lines(record)
    pieces += [f"warning: {warning}" for warning in record.warnings]
    return pieces + (explained(record) if explain else [])


def rendered(pieces: Sequence[RenderableType], width: int = WIDTH) -> str:
    """The pieces as one plain text."""
    text = io.StringIO()
    # Without markup: rich would take the unit in "sigma [deg]" for a style and drop it.
    console = Console(file=text, width=width, highlight=False, markup=False, color_system=None)
    for piece in pieces:
        if isinstance(piece, str):
            text.write(piece + "\n")
        else:
            console.print(piece)
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines())


def short(record: FitRecord) -> str:
    """One line: the model, the first parameters and the status."""
    shown = [f"{name} = {_value(e)}" for name, e in list(record.parameters.items())[:MOST]]
    if len(record.parameters) > MOST:
        shown.append(f"... {len(record.parameters) - MOST} more")
    facts = [] if record.verdict is None else [WORDS[record.verdict.kind]]
    facts += [record.status.replace("_", " "), counted(record.n_samples, "sample")]
    if record.posterior is not None:
        facts.append("posterior")
    if record.warnings:
        facts.append(counted(len(record.warnings), "warning"))
    return f"<FitResult {record.model}: {', '.join(shown)}; {', '.join(facts)}>"


def _value(estimate: Estimate) -> str:
    unit = f" {estimate.unit}" if estimate.unit else ""
    if estimate.fixed:
        return f"{estimate.value:.4g}{unit} (fixed)"
    if estimate.tied_to:
        return f"{estimate.value:.4g}{unit} (tied to {estimate.tied_to})"
    if estimate.at_bound is not None:
        return f"{estimate.value:.4g}{unit} at its {estimate.at_bound} bound"
    if estimate.stderr is None:
        return f"{estimate.value:.4g}{unit} (not determined)"
    weak = " (not established)" if estimate.established is False else ""
    return f"{estimate.value:.4g} ± {estimate.stderr:.2g}{unit}{weak}"
