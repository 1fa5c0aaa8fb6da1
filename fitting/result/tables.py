"""Tables of estimates, in the unit of files, for a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from gonio.fitting.result.estimates import Estimate
from gonio.fitting.result.record import FitRecord

if TYPE_CHECKING:
    from rich.table import Table


def table(first: str, *others: str, fold: bool = False, title: str | None = None) -> Table:
    """An empty table: names at the left, which may fold, numbers at the right."""
    from rich import box
    from rich.table import Table

    empty = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    empty.add_column(first, no_wrap=not fold)
    for heading in others:
        empty.add_column(heading, justify="right", no_wrap=not title)
    return empty


def parameter_table(record: FitRecord, known: Mapping[str, float] | None) -> Table:
    """One row a parameter, with known values and the error where there are some.

    Parameters
    ----------
    record : FitRecord
    known : mapping of str to float, optional
        Values of a simulation, in the unit of files.
    """
    headings = ["value", "std. unc.", "95 % interval"]
    headings += ["true", "error"] if known is not None else []
    shown = table("parameter", *headings, fold=True)
    for name, estimate in record.parameters.items():
        shown.add_row(*parameter_row(name, estimate, None if known is None else known[name]))
    return shown


def parameter_row(name: str, estimate: Estimate, true: float | None) -> list[str]:
    """Cells of one parameter: value, standard uncertainty, interval, and true value and error."""
    estimate = estimate.in_file_units()
    unit = f" {estimate.unit}" if estimate.unit else ""
    digits = _decimals(estimate)
    interval = "" if estimate.fixed else "unknown"
    if estimate.interval_95 is not None:
        low, high = estimate.interval_95
        interval = f"{low:.{digits}f} .. {high:.{digits}f}"
    stderr = "at bound" if estimate.at_bound else "fixed" if estimate.fixed else "none"
    if estimate.stderr is not None:
        weak = estimate.established is False
        stderr = "not established" if weak else f"{estimate.stderr:.{digits}f}"
    name += f" = {estimate.tied_to}" if estimate.tied_to else ""
    row = [name + (f" [{estimate.unit}]" if unit else ""), f"{estimate.value:.{digits}f}", stderr,
           interval]  # fmt: skip
    if true is not None:
        error = f"{100 * (estimate.value / true - 1):+.2f} %" if true else ""
        row += [f"{true:g}", error]
    return row


def _decimals(estimate: Estimate) -> int:
    """Decimals that show two digits of the standard uncertainty."""
    u = estimate.stderr
    if not u and estimate.interval_95 is not None:
        u = (estimate.interval_95[1] - estimate.interval_95[0]) / 4
    if not u:
        return 4
    return min(max(1 - math.floor(math.log10(u)), 0), 9)
