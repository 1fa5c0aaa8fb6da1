"""`gonio check`: a model against its claims, or a file against reciprocity."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.cli.completion import complete_model
from gonio.errors import ConfigurationError
from gonio.verbs.check import check, named_target

if TYPE_CHECKING:
    from gonio.checks import ModelReport, Pairing, SamplesReport
    from gonio.models import Model

_WIDTH = 80


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
    """Check a model or a file for reciprocity, energy and quantity.

    TARGET is a model, a material or a file of BRDF samples. A model is tested against its claims.
    The samples of a file are tested for reciprocity, which also shows whether the values still
    contain a cosine. The exit code is 1 if a claim fails or the values are not a BRDF.
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
            _show_model(chosen, report)
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
        _show_samples(path, report)
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


def _show_model(model: Model, report: ModelReport) -> None:
    from gonio.cli.options import file_text

    values = (f"{p.name} = {file_text(p, report.parameters[p.name])}" for p in model.parameters)
    _say(f"{model.name}: {', '.join(values)}")
    click.echo(f"\n{'property':<12} {'claimed':<8} {'result':<8} found")
    for finding in report.findings:
        if finding.holds:
            result = "ok"
        else:
            result = "FAILS" if finding.claimed else "no"
        claimed = "yes" if finding.claimed else "no"
        start = f"{finding.name:<12} {claimed:<8} {result:<8} "
        _say(finding.text, start)
        if not finding.holds and finding.where is not None:
            names = ("theta_i", "phi_i", "theta_r", "phi_r")
            where = (f"{n} {a:.5g}" for n, a in zip(names, finding.where, strict=False))
            _say(f"at {', '.join(where)} deg", " " * len(start))
    click.echo(f"\n{'theta_i':>8} {'albedo':>10} {'error':>9}   (phi_i = 0)")
    for theta, albedo in report.albedos.items():
        click.echo(f"{theta:>8g} {albedo.value:>10.5f} {albedo.error:>9.1g}")
    uniform = report.bihemispherical
    click.echo(
        f"{'uniform':>8} {uniform.value:>10.5f} {uniform.error:>9.1g}   (from the whole hemisphere)"
    )
    click.echo()
    if report.passed:
        _say("The model keeps what it claims.")
    else:
        broken = [finding.name for finding in report.findings if not finding.passed]
        _say(f"The model breaks what it claims: {', '.join(broken)}.")
    if not report.conserves_energy:
        _say("It reflects more light than falls on it with these parameters.")


def _show_samples(path: Path, report: SamplesReport) -> None:
    _say(f"{path}: {report.n_samples} samples, {report.n_negative} of them negative.")
    within = f"partners within {report.tolerance_deg:g} deg"
    click.echo(f"\n{within:<28} {'pairs':>7} {'median':>8} {'rms':>8}")
    _show_pairing("light and viewer exchanged", report.reciprocity)
    _show_pairing("phi_r - phi_i = +x and -x", report.mirror)
    click.echo(f"\n{'if the values are':<28} {'pairs':>7} {'median':>8}   of reciprocal pairs")
    for name, median in report.candidates.items():
        click.echo(f"{name:<28} {report.n_telling:>7} {median:>8.1%}")
    if not report.candidates:
        click.echo("no pair tells BRDF and BRDF*cos apart")
    click.echo(f"\nQuantity: {report.quantity}")
    for note in report.notes:
        _say(note, "- ")


def _show_pairing(name: str, pairing: Pairing) -> None:
    median, rms = (
        "-" if fraction is None else f"{fraction:.1%}" for fraction in (pairing.median, pairing.rms)
    )
    click.echo(f"{name:<28} {pairing.n_pairs:>7} {median:>8} {rms:>8}")


def _say(text: str, start: str = "") -> None:
    """Print a paragraph of 80 columns, indented after its start."""
    click.echo(
        textwrap.fill(
            text,
            _WIDTH,
            initial_indent=start,
            subsequent_indent=" " * len(start),
            break_on_hyphens=False,
            break_long_words=False,
        )
    )
