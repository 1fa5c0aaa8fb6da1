"""`gonio check`: a model against its claims, or a file against reciprocity."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.cli.completion import complete_model
from gonio.errors import ConfigurationError
from gonio.verbs.check import check, named_target

if TYPE_CHECKING:
    from gonio.checks import ModelReport
    from gonio.models import Model


@click.command(name="check")
@click.argument("target", shell_complete=complete_model)
@click.option(
    "-p",
    "--parameter",
    "items",
    multiple=True,
    metavar="NAME=VALUE",
    help="Value of a parameter of the model, angles in degrees; repeat for each parameter. "
    "See 'gonio models MODEL'.",
)
@click.option(
    "--select",
    "selections",
    multiple=True,
    metavar="KEY=VALUE",
    help="Check part of a file, such as wavelength=650 or channel=red.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
@click.pass_context
def command(
    context: click.Context,
    target: str,
    items: tuple[str, ...],
    selections: tuple[str, ...],
    as_json: bool,
) -> None:
    """Check a model or a file for reciprocity, energy and plausibility.

    TARGET is a model, a material or a file of BRDF samples. A model is tested against its claims.
    The samples of a file are asked whether they can be what they claim: angles, unit, quantity, and
    values that are no measurements. A fit asks the same. The exit code is 1 if a claim fails, if
    the values are not a BRDF, or if a fit would warn of the samples or refuse them.
    """
    from gonio.cli.options import echo_json

    chosen, parameters = _model_of(target, items)
    if chosen is not None:
        if selections:
            raise ConfigurationError(f"{target} is a model; --select is for files of samples.")
        report = check(chosen, parameters)
        if as_json:
            echo_json(_document(chosen, report))
        else:
            click.echo(report)
        passed = report.passed
    else:
        passed = _check_file(Path(target), items, selections, as_json)
    if not passed:
        context.exit(1)


def _model_of(target: str, items: tuple[str, ...]) -> tuple[Model | None, dict[str, float]]:
    """The model and parameters that the target names; None if it is a file."""
    from gonio.cli.options import parse_parameters

    named = named_target(target)
    if named is None:
        return None, {}
    chosen, own = named
    return chosen, {**own, **parse_parameters(chosen, items)}


def _check_file(
    path: Path, items: tuple[str, ...], selections: tuple[str, ...], as_json: bool
) -> bool:
    import gonio.formats as formats
    from gonio.cli.options import echo_json

    if items:
        raise ConfigurationError(f"{path} is a file; -p is for models and materials.")
    samples = formats.read(path, select=_selected(selections))
    report = check(samples)
    if as_json:
        echo_json({**report.describe(), "file": str(path), "format": samples.metadata["format"]})
    else:
        click.echo(f"{path}: {report}")
    return report.passed


def _selected(selections: tuple[str, ...]) -> dict[str, str]:
    by_key = {}
    for item in selections:
        key, sign, value = (part.strip() for part in item.partition("="))
        if not sign or not key or not value:
            raise ConfigurationError(
                f"--select {item!r}: give KEY=VALUE, for instance wavelength=650.", value=item
            )
        by_key[key] = value
    return by_key


def _document(model: Model, report: ModelReport) -> dict[str, Any]:
    """The report with parameters in the unit of files."""
    return {
        **report.describe(),
        "parameters": {p.name: p.to_file(report.parameters[p.name]) for p in model.parameters},
        "units": {p.name: p.file_unit for p in model.parameters},
    }
