"""A joint fit on the command line: its inputs, its tables, its parts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from gonio.cli.measured import pairs
from gonio.cli.tables import parameter_row, table
from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from rich.console import Console

    from gonio.fitting.result import Estimate, FitResult, PartFit
    from gonio.models import Model

Cell = list[str]


def shared_names(model: Model, text: str) -> tuple[str, ...]:
    """Parameters to share from a list with commas, `all` or `none`.

    Raises
    ------
    ConfigurationError
        If a name is no parameter of the model.

    Examples
    --------
    >>> from gonio import models
    >>> shared_names(models.get("ward"), "alpha_x,alpha_y")
    ('alpha_x', 'alpha_y')
    >>> shared_names(models.get("ward"), "none")
    ()
    """
    if text.strip() in ("all", "none"):
        return model.names if text.strip() == "all" else ()
    names = tuple(name.strip() for name in text.split(",") if name.strip())
    if not names:
        raise ConfigurationError(
            f"--share {text!r}: give parameters of {model.name}, with commas, or all or none.",
            value=text,
        )
    for name in names:
        model.parameter(name)
    return names


def input_names(sources: Sequence[Path]) -> dict[str, Path]:
    """The inputs by short names: those of the files without folder and suffix, where they differ.

    Raises
    ------
    ConfigurationError
        If one is given twice.
    """
    for source in sources:
        if list(sources).count(source) > 1:
            raise ConfigurationError(f"{source} is given twice; give it once.", value=source)
    stems = [source.stem for source in sources]
    named = {}
    for source, stem in zip(sources, stems, strict=True):
        named[stem if stems.count(stem) == 1 else str(source)] = source
    return named


def with_inputs(result: FitResult, named: Mapping[str, Path]) -> FitResult:
    """The result whose parts name the files they are of."""
    parts = [
        part if part.input is None else replace(part, input=str(named[part.input]))
        for part in result.parts
    ]
    return replace(result, parts=tuple(parts))


def part_chooser(
    source: Path, selections: tuple[str, ...], *, middle: bool = False
) -> Callable[[FitResult], FitResult]:
    """What takes the part that --select names out of a joint fit, and leaves another fit alone.

    Parameters
    ----------
    middle : bool
        Take the middle part where nothing is selected, and say so.

    Raises
    ------
    ConfigurationError
        By the function, if the selection leaves no part or several.
    """
    select = pairs(selections)

    def choose(fit: FitResult) -> FitResult:
        part = _chosen(fit, source, select)
        if not fit.parts:
            return fit
        if part is None and middle and not select:
            part = fit.parts[len(fit.parts) // 2]
            click.echo(f"{source} is a fit of {len(fit.parts)} parts: drawn is {part.name}; "
                       f"choose with {how_to_choose(part)}.", err=True)  # fmt: skip
        if part is None:
            raise ConfigurationError(
                f"{source}: is a joint fit of {len(fit.parts)} parts; choose one, as with "
                f"{how_to_choose(fit.parts[0])}, of {', '.join(p.name for p in fit.parts)}.",
                value=source,
            )
        return fit.part(part.name)

    return choose


def _chosen(fit: FitResult, source: Path, select: Mapping[str, str]) -> PartFit | None:
    """The part that is selected, with the name of the option in the messages."""
    from gonio.fitting.part_choice import choose_part

    try:
        return choose_part(fit, select, where=str(source))
    except ConfigurationError as error:
        text = str(error).replace("the selection", "--select")
        if text.startswith("selection "):
            text = f"--select {text.removeprefix('selection ')}"
        raise ConfigurationError(text, value=error.value) from None


def how_to_choose(part: PartFit) -> str:
    """What to write behind a command to choose this part."""
    pairs = dict(part.select) if part.input is None else {"part": part.name}
    return " ".join(
        f"--select '{key}={value}'" if " " in value else f"--select {key}={value}"
        for key, value in pairs.items()
    )


# ---------------------------------------------------------------------- the terminal


def show(result: FitResult, truth: Mapping[str, float] | None, console: Console) -> None:
    """Shared parameters as one table, the parts' own as another that fits the terminal."""
    truth = truth or {}
    own = {name for part in result.parts for name in part.parameters.values()}
    shared = [name for name in result.parameters if all(
        name in part.parameters.values() for part in result.parts)]  # fmt: skip
    if shared:
        shown = table("shared", "value", "std. unc.", "95 % interval", *_known(truth, shared))
        for name in shared:
            shown.add_row(*_shared_row(name, result.parameters[name], truth, shared))
        console.print(shown)
    columns = [_part_column(result), *_own_columns(result, own - set(shared), truth)]
    if result.weights == "sd":
        columns.append(["chi2/dof", *(f"{p.chi2 / p.dof:#.3g}" for p in result.parts)])
    for some in _chunks(columns, console.width):
        shown = table(*(column[0] for column in some))
        for row in zip(*(column[1:] for column in some), strict=True):
            shown.add_row(*row)
        console.print(shown)
    click.echo(_verdict(result))


def _known(truth: Mapping[str, float], names: Sequence[str]) -> Cell:
    return ["true"] if any(name in truth for name in names) else []


def _shared_row(
    name: str, estimate: Estimate, truth: Mapping[str, float], shared: Sequence[str]
) -> Cell:
    row = parameter_row(name, estimate, None)
    if _known(truth, shared):
        row.append(f"{truth[name]:g}" if name in truth else "")
    return row


def _part_column(result: FitResult) -> Cell:
    keys = {key for part in result.parts for key in part.select}
    materials = any(part.input is not None for part in result.parts)
    heading = "part" if len(keys) + materials != 1 else "material" if materials else keys.pop()
    return [heading, *(part.name for part in result.parts)]


def _own_columns(result: FitResult, own: set[str], truth: Mapping[str, float]) -> list[Cell]:
    """A column for each parameter that is the parts' own, and one for its true values."""
    columns = []
    for q in result.parts[0].parameters:
        names = [part.parameters[q] for part in result.parts]
        if names[0] not in own:
            continue
        estimates = [result.parameters[name].in_file_units() for name in names]
        unit = f" [{estimates[0].unit}]" if estimates[0].unit else ""
        digits = _common_decimals(estimates)
        columns.append([q + unit, *(_cell(estimate, digits) for estimate in estimates)])
        if _known(truth, names):
            columns.append(["true", *(f"{truth[n]:g}" if n in truth else "" for n in names)])
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
    known = sorted(e.stderr for e in estimates if e.stderr)
    if not known:
        return 4
    middle, least = (1 - math.floor(math.log10(u)) for u in (known[len(known) // 2], known[0]))
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


def _verdict(result: FitResult) -> str:
    """What the test of the sharing found."""
    test = result.sharing
    if test is None:
        return "nothing is shared: the parts were fitted each for itself"
    if test.p_value is None:
        return "sharing: nothing to test, no shared parameter is determined in two parts"
    chance = f"{test.p_value:.2g}" if test.p_value > 1e-15 else "< 1e-15"
    found = "the data REFUSE it" if test.refused else "the data allow it"
    return (
        f"sharing: {found}; chi2 grows by {test.growth:.4g} over separate fits, "
        f"{test.dof} expected (p {chance if test.p_value <= 1e-15 else '= ' + chance})"
    )
