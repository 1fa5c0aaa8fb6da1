"""What several commands share: parameters on the command line and tables on the terminal."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.errors import ConfigurationError, DataError

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console

    from gonio.models import Model, Parameter

# Wide enough that a table sent to a file or a pipe is not folded.
_PIPE_WIDTH = 200


# For commands that read a FIT.json.
model_of_fit = click.option(
    "--model",
    metavar="FILE.py",
    help="The file of the model that the fit was made with, where it is not part of gonio.",
)


def given(model: str | None) -> None:
    """Make the model that `--model` names known, so that a fit's name leads to it."""
    if model is not None:
        from gonio.models import resolve

        resolve(model)


def parse_parameters(model: Model, items: Iterable[str]) -> dict[str, float]:
    """Parameters of a model from texts such as ``sigma=30``.

    Parameters
    ----------
    model : Model
        Says which names, units and ranges are allowed.
    items : iterable of str
        ``NAME=VALUE``, the value in the unit of files: degrees for angles.

    Returns
    -------
    dict
        Values in the unit of Python, radians for angles; only the names that were given.

    Raises
    ------
    ConfigurationError
        If a text is not NAME=VALUE, the name is unknown or repeated, or the value is no number
        or out of range.

    Examples
    --------
    >>> from gonio import models
    >>> parse_parameters(models.get("ward"), ["rho_d=0.1", "alpha_x=0.05"])
    {'rho_d': 0.1, 'alpha_x': 0.05}
    """
    found: dict[str, float] = {}
    for item in items:
        name, sign, text = (part.strip() for part in item.partition("="))
        if not sign or not name:
            example = model.parameters[0]
            raise ConfigurationError(
                f"-p {item!r} is not NAME=VALUE; write for example "
                f"-p {example.name}={_file_value(example, example.default)}.",
                value=item,
            )
        parameter = model.parameter(name)
        if name in found:
            raise ConfigurationError(f"-p {name} is given twice; give it once.", value=item)
        try:
            number = float(text)
        except ValueError:
            raise ConfigurationError(
                f"{name} = {text!r} is not a number; allowed is {file_range(parameter)}.",
                value=text,
            ) from None
        found[name] = _checked(parameter, number)
    return found


def _checked(parameter: Parameter, number: float) -> float:
    """The value in radians, refused in the unit in which it was given."""
    try:
        return parameter.check(parameter.from_file(number))
    except ConfigurationError:
        unit = f" {parameter.file_unit}" if parameter.file_unit else ""
        raise ConfigurationError(
            f"{parameter.name} = {number:g}{unit} is out of range; "
            f"allowed is {file_range(parameter)}.",
            value=number,
        ) from None


def check_target(output: Path) -> None:
    """Refuse a file that cannot be written before minutes of work, not after.

    Raises
    ------
    DataError
        If its folder does not exist.
    ConfigurationError
        If it is a folder itself.
    """
    if not output.parent.is_dir():
        raise DataError(
            f"{output}: the folder {output.parent} does not exist; make it first.", value=output
        )
    if output.is_dir():
        raise ConfigurationError(f"{output}: is a folder; give the name of a file.", value=output)


def file_range(parameter: Parameter) -> str:
    """The allowed range of a parameter, in the unit of files.

    Examples
    --------
    >>> from gonio import models
    >>> file_range(models.get("ward").parameter("alpha_x"))
    '0.005 to 2'
    """
    low, high = (_file_value(parameter, bound) for bound in (parameter.lower, parameter.upper))
    unit = f" {parameter.file_unit}" if parameter.file_unit else ""
    return f"{low} to {high}{unit}"


def file_text(parameter: Parameter, value: float) -> str:
    """A value of Python as files print it, with its unit.

    Examples
    --------
    >>> from gonio import models
    >>> file_text(models.get("lambert").parameter("rho"), 0.25)
    '0.25'
    """
    unit = f" {parameter.file_unit}" if parameter.file_unit else ""
    return f"{_file_value(parameter, value)}{unit}"


def refuse_both(*formats: bool) -> None:
    """Refuse more than one of --json, --csv and --latex.

    Raises
    ------
    ConfigurationError
        If stdout would hold two documents.
    """
    if sum(formats) > 1:
        raise ConfigurationError("--json, --csv and --latex exclude each other; give one of them.")


def echo_json(document: Any) -> None:
    """Print one JSON document on stdout."""
    click.echo(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False))


def table_console() -> Console:
    """A console on stdout that does not fold tables when the output is not a terminal."""
    from rich.console import Console

    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console.width = _PIPE_WIDTH
    return console


def _file_value(parameter: Parameter, value: float) -> str:
    return f"{parameter.to_file(value):.6g}"
