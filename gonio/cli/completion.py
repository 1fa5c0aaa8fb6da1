"""Names that a shell completes: models, materials and instruments.

The options and arguments of the commands take these functions as `shell_complete`. A shell calls
them at every press of the key, so they import no numerical package.
"""

from __future__ import annotations

from collections.abc import Iterable

import rich_click as click
from click.shell_completion import CompletionItem


def complete_model(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Models, also as a term after "+" in a sum; otherwise files."""
    from gonio import models

    start, term = _last(incomplete, "+")
    return _items(start, term, models.names()) or _files(incomplete)


def complete_models(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Models of a comma-separated list, each also as a term of a sum."""
    from gonio import models

    start, name = _last(incomplete, ",")
    sum_start, term = _last(name, "+")
    return _items(start + sum_start, term, models.names())


def complete_material(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Materials of the papers."""
    from gonio import materials

    return _items("", incomplete, materials.names())


def complete_instrument(
    ctx: click.Context, param: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Presets; otherwise files."""
    from gonio.instrument import preset_names

    return _items("", incomplete, preset_names()) or _files(incomplete)


def _last(text: str, separator: str) -> tuple[str, str]:
    """The complete part of a text, and the beginning of its last name."""
    before, sign, rest = text.rpartition(separator)
    return before + sign, rest


def _items(start: str, beginning: str, names: Iterable[str]) -> list[CompletionItem]:
    return [CompletionItem(start + name) for name in names if name.startswith(beginning)]


def _files(incomplete: str) -> list[CompletionItem]:
    """Let the shell complete a file name."""
    return [CompletionItem(incomplete, type="file")]
