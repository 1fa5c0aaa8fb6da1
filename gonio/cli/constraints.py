"""`--fix` and `--tie`: parameters that a fit does not search for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from gonio.models import Model


def constraint_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --fix and --tie to a command."""
    options = [
        click.option(
            "--fix",
            "fixes",
            multiple=True,
            metavar="NAME=VALUE",
            help="Hold a parameter at a value (degrees for angles); it is not fitted.",
        ),
        click.option(
            "--tie",
            "ties",
            multiple=True,
            metavar="NAME=NAME",
            help="Set a parameter equal to another one: --tie alpha_y=alpha_x fits one width.",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command


def read_fixed(model: Model, items: tuple[str, ...]) -> dict[str, float]:
    """Fixed values in the units of Python, read in the same way as `-p`.

    Raises
    ------
    ConfigurationError
        As for `parse_parameters`; the message names this option.
    """
    from gonio.cli.options import parse_parameters

    try:
        return parse_parameters(model, items)
    except ConfigurationError as error:
        raise ConfigurationError(str(error).replace("-p ", "--fix "), value=error.value) from None


def read_tied(items: tuple[str, ...]) -> dict[str, str]:
    """Ties by name: each tied parameter and the one whose value it takes.

    Raises
    ------
    ConfigurationError
        If an item is not NAME=NAME, or a name is tied twice.

    Examples
    --------
    >>> read_tied(("alpha_y=alpha_x",))
    {'alpha_y': 'alpha_x'}
    """
    tied: dict[str, str] = {}
    for item in items:
        name, _, other = (word.strip() for word in item.partition("="))
        if not name or not other:
            raise ConfigurationError(
                f"--tie {item!r} is not NAME=NAME; write for example --tie alpha_y=alpha_x.",
                value=item,
            )
        if name in tied:
            raise ConfigurationError(f"--tie {name} is given twice; give it once.", value=item)
        tied[name] = other
    return tied


def constraints_line(fixed: Mapping[str, str], tied: Mapping[str, str]) -> str:
    """One line with the fixed and tied parameters; empty if there are none.

    Examples
    --------
    >>> constraints_line({"rho_d": "0"}, {"alpha_y": "alpha_x"})
    'fixed: rho_d = 0; tied: alpha_y = alpha_x'
    """
    parts = [("fixed", fixed), ("tied", tied)]
    return "; ".join(
        f"{word}: {', '.join(f'{name} = {what}' for name, what in values.items())}"
        for word, values in parts
        if values
    )
