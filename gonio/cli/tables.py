"""Tables of estimates on the terminal."""

from __future__ import annotations

import math
import shutil
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table

    from gonio.fitting.result import Estimate


def table(first: str, *others: str, fold: bool = False) -> Table:
    """An empty table: names at the left, which may fold, numbers at the right."""
    from rich import box
    from rich.table import Table

    empty = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    empty.add_column(first, no_wrap=not fold)
    for heading in others:
        empty.add_column(heading, justify="right", no_wrap=True)
    return empty


def terminal_width() -> int:
    """Columns of the terminal; 80 where there is none."""
    return shutil.get_terminal_size((80, 24)).columns


def parameter_row(name: str, estimate: Estimate, true: float | None) -> list[str]:
    """Cells of one parameter: value, standard uncertainty, interval, and true value and error."""
    estimate = estimate.in_file_units()
    unit = f" {estimate.unit}" if estimate.unit else ""
    digits = _decimals(estimate)
    interval = "unknown"
    if estimate.interval_95 is not None:
        low, high = estimate.interval_95
        interval = f"{low:.{digits}f} .. {high:.{digits}f}"
    stderr = "at bound" if estimate.at_bound else "none"
    if estimate.stderr is not None:
        stderr = f"{estimate.stderr:.{digits}f}"
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
