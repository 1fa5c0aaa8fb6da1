"""A joint fit on the command line: its inputs and its parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from gonio.cli.measured import pairs
from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult, PartFit
    from gonio.models import Model


def shared_names(model: Model, text: str) -> tuple[str, ...]:
    """Parameters to share, from a comma-separated list, `all` or `none`.

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
    """The inputs by short names: file names without folder and suffix, if these differ.

    Raises
    ------
    ConfigurationError
        If an input is given twice.
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
    """The result with the name of its file in every part."""
    parts = [
        part if part.input is None else replace(part, input=str(named[part.input]))
        for part in result.parts
    ]
    return replace(result, parts=tuple(parts))


def chooser(
    source: Path, selections: tuple[str, ...], *, middle: bool = False
) -> Callable[[FitResult], FitResult]:
    """Function that selects the part that --select names; other fits are returned unchanged.

    Parameters
    ----------
    middle : bool
        Take the middle part if nothing is selected, and print a note.

    Raises
    ------
    ConfigurationError
        Raised by the returned function if the selection matches no part or several.
    """
    from gonio.fitting.part_choice import part_chooser

    def note_choice(fit: FitResult, part: PartFit) -> None:
        click.echo(
            f"{source} is a fit of {len(fit.parts)} parts: drawn is {part.name}; choose with "
            f"{how_to_choose(part)}.",
            err=True,
        )

    choose_part = part_chooser(
        pairs(selections),
        where=str(source),
        middle=note_choice if middle else None,
        shown=how_to_choose,
    )

    def choose(fit: FitResult) -> FitResult:
        try:
            return choose_part(fit)
        except ConfigurationError as error:
            text = str(error).replace("the selection", "--select")
            if text.startswith("selection "):
                text = f"--select {text.removeprefix('selection ')}"
            raise ConfigurationError(text, value=error.value) from None

    return choose


def how_to_choose(part: PartFit) -> str:
    """Options that select this part on the command line."""
    from gonio.fitting.part_choice import how_to_select

    return " ".join(
        f"--select '{key}={value}'" if " " in value else f"--select {key}={value}"
        for key, value in how_to_select(part).items()
    )
