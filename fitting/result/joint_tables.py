"""Tables of a joint fit, in the unit of files, for a terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from gonio.fitting.result.estimates import Estimate, Sharing
from gonio.fitting.result.record import FitRecord
from gonio.fitting.result.tables import parameter_row, table
from gonio.fitting.result.verdict import ALARM, per_cent

if TYPE_CHECKING:
    from rich.table import Table

Cell = list[str]


def joint_tables(
    record: FitRecord, known: Mapping[str, float] | None, width: int
) -> list[Table | str]:
    """Shared parameters as one table, the parts' own in others that fit the width; the verdict.

    Parameters
    ----------
    record : FitRecord
        Of a joint fit.
    known : mapping of str to float, optional
        Values of a simulation, in the unit of files.
    width : int
        Columns of the terminal.
    """
    known = known or {}
    pieces: list[Table | str] = []
    own = {name for part in record.parts for name in part.parameters.values()}
    shared = [name for name in record.parameters if all(
        name in part.parameters.values() for part in record.parts)]  # fmt: skip
    if shared:
        shown = table(
            "shared", "value", "std. unc.", "95 % interval", *_true_heading(known, shared)
        )
        for name in shared:
            shown.add_row(*_shared_row(name, record.parameters[name], known, shared))
        pieces.append(shown)
    columns = [_part_column(record), *_own_columns(record, own - set(shared), known)]
    if record.weights == "sd":
        columns.append(["chi2/dof", *(f"{p.chi2 / p.dof:#.3g}" for p in record.parts)])
    for some in _chunks(columns, width):
        shown = table(*(column[0] for column in some))
        for row in zip(*(column[1:] for column in some), strict=True):
            shown.add_row(*row)
        pieces.append(shown)
    return [*pieces, _verdict(record)]


def _true_heading(known: Mapping[str, float], names: Sequence[str]) -> Cell:
    return ["true"] if any(name in known for name in names) else []


def _shared_row(
    name: str, estimate: Estimate, known: Mapping[str, float], shared: Sequence[str]
) -> Cell:
    row = parameter_row(name, estimate, None)
    if _true_heading(known, shared):
        row.append(f"{known[name]:g}" if name in known else "")
    return row


def _part_column(record: FitRecord) -> Cell:
    keys = {key for part in record.parts for key in part.select}
    materials = any(part.input is not None for part in record.parts)
    heading = "part" if len(keys) + materials != 1 else "material" if materials else keys.pop()
    return [heading, *(part.name for part in record.parts)]


def _own_columns(record: FitRecord, own: set[str], known: Mapping[str, float]) -> list[Cell]:
    """A column for each parameter that is the parts' own, and one for its true values."""
    columns = []
    for q in record.parts[0].parameters:
        names = [part.parameters[q] for part in record.parts]
        if names[0] not in own:
            continue
        estimates = [record.parameters[name].in_file_units() for name in names]
        unit = f" [{estimates[0].unit}]" if estimates[0].unit else ""
        digits = _common_decimals(estimates)
        tied_to = estimates[0].tied_to
        tie = f" = {tied_to.partition('[')[0]}" if tied_to else ""
        columns.append([q + tie + unit, *(_cell(estimate, digits) for estimate in estimates)])
        if _true_heading(known, names):
            columns.append(["true", *(f"{known[n]:g}" if n in known else "" for n in names)])
    return columns


def _cell(estimate: Estimate, digits: int) -> str:
    """Value and standard uncertainty; at a bound how far the data let it be from there."""
    if estimate.at_bound is not None:
        text = f"{estimate.value:.4g} at bound"
        if estimate.interval_95 is not None:
            lower = estimate.at_bound == "lower"
            text = f"{'<' if lower else '>'} {estimate.interval_95[1 if lower else 0]:.2g}"
        return text
    if estimate.stderr is None:
        return f"{estimate.value:.4g} ± none"
    return f"{estimate.value:.{digits}f} ± {estimate.stderr:.{digits}f}"


def _common_decimals(estimates: Sequence[Estimate]) -> int:
    """Two digits of the middle uncertainty, one more at most where some are smaller."""
    ordered = sorted(e.stderr for e in estimates if e.stderr)
    if not ordered:
        return 4
    middle, least = (
        1 - math.floor(math.log10(u)) for u in (ordered[len(ordered) // 2], ordered[0])
    )
    return min(max(min(least, middle + 1), 0), 9)


def _chunks(columns: list[Cell], width: int) -> list[list[Cell]]:
    """Columns in tables no wider than the terminal, the parts' names at the left of each."""
    first, *rest = columns
    wide = {id(column): max(map(len, column)) + 2 for column in columns}
    tables: list[list[Cell]] = [[first]]
    used = wide[id(first)]
    for column in rest:
        if used + wide[id(column)] > width and len(tables[-1]) > 1:
            tables.append([first])
            used = wide[id(first)]
        tables[-1].append(column)
        used += wide[id(column)]
    return tables


def _small(test: Sharing) -> str:
    """Why a clear difference is not refused."""
    if test.refused or test.p_value is None or test.p_value >= ALARM or test.change is None:
        return ""
    return f", but sharing changes f by {per_cent(test.change)} only"


def _verdict(record: FitRecord) -> str:
    """What the test of the sharing found."""
    test = record.sharing
    if test is None:
        return "nothing is shared: each part was fitted by itself"
    if test.p_value is None:
        return "sharing: nothing to test, no two parts establish a shared parameter"
    chance = f"p = {test.p_value:.2g}" if test.p_value > 1e-15 else "p < 1e-15"
    outcome = "the data REJECT it" if test.refused else "the data allow it"
    if test.distance is not None:
        return (
            f"sharing: {outcome}; separate estimates differ by at most {test.distance:.2g} "
            f"standard uncertainties, misfit allowed for ({chance}){_small(test)}"
        )
    return (
        f"sharing: {outcome}; chi2 grows by {test.growth:.4g} over separate fits, "
        f"{test.dof} expected ({chance})"
    )
