"""Code shared by commands: parameters on the command line and tables on the terminal."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.errors import ConfigurationError, DataError

if TYPE_CHECKING:
    from rich.console import Console

    from gonio.models import Model, Parameter

# Wide enough that a table sent to a file or a pipe is not folded.
_PIPE_WIDTH = 200


# For commands that read a FIT.json.
model_of_fit = click.option(
    "--model",
    metavar="FILE.py",
    help="File of the model of the fit, if the model is not part of gonio.",
)


samples_of_fit = click.option(
    "--samples",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Samples that the fit was made to; default: those that FIT.json names. Their SHA-256 "
    "must be that of the fit.",
)


def given(model: str | None, fit: Path) -> None:
    """Register the model that `--model` names, so that the name in a fit resolves to it.

    Raises
    ------
    ConfigurationError
        If the fit was made with another model.
    """
    if model is None:
        return
    from gonio.models import resolve

    chosen = resolve(model).name
    if fit.suffix != ".json" or not fit.exists():
        return
    from gonio.fitting.result import FitResult

    fitted = FitResult.load(fit).model
    if chosen not in fitted.split("+"):
        raise ConfigurationError(
            f"--model {model} is the model {chosen}, and {fit} is a fit of {fitted}; give the file "
            f"that defines {fitted}, or leave --model out if it is part of gonio.",
            value=model,
        )


def parse_parameters(model: Model, items: Iterable[str]) -> dict[str, float]:
    """Parameters of a model from texts such as ``sigma=30``.

    Parameters
    ----------
    model : Model
        Defines the allowed names, units and ranges.
    items : iterable of str
        ``NAME=VALUE``, the value in the unit of files: degrees for angles.

    Returns
    -------
    dict
        Values in the units of Python, radians for angles; only the given names.

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
    values: dict[str, float] = {}
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
        if name in values:
            raise ConfigurationError(f"-p {name} is given twice; give it once.", value=item)
        try:
            number = float(text)
        except ValueError:
            raise ConfigurationError(
                f"{name} = {text!r} is not a number; allowed is {file_range(parameter)}.",
                value=text,
            ) from None
        values[name] = _checked(parameter, number)
    return values


def _checked(parameter: Parameter, number: float) -> float:
    """The checked value in radians; an error states it in the given unit."""
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
    """Refuse, before a long computation, a file that cannot be written.

    Raises
    ------
    DataError
        If its folder does not exist.
    ConfigurationError
        If it is a folder.
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
    """A value in the unit of files, with that unit.

    Examples
    --------
    >>> from gonio import models
    >>> file_text(models.get("lambert").parameter("rho"), 0.25)
    '0.25'
    """
    return parameter.file_text(value)


def refuse_both(*formats: bool) -> None:
    """Refuse more than one of --json, --csv and --latex.

    Raises
    ------
    ConfigurationError
        If more than one is set.
    """
    if sum(formats) > 1:
        raise ConfigurationError("--json, --csv and --latex exclude each other; give one of them.")


def echo_json(document: Any) -> None:
    """Print one JSON document on stdout."""
    click.echo(json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False))


def table_console() -> Console:
    """A console on stdout that does not wrap tables if the output is not a terminal."""
    from rich.console import Console

    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console.width = _PIPE_WIDTH
    return console


def _file_value(parameter: Parameter, value: float) -> str:
    return f"{parameter.to_file(value):.6g}"
