"""`gonio design`: which images determine the parameters of a surface."""

from __future__ import annotations

import math
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.cli.completion import complete_instrument, complete_model
from gonio.cli.constraints import constraint_options, read_fixed, read_tied
from gonio.errors import ConfigurationError, unknown_name

if TYPE_CHECKING:
    from collections.abc import Iterable

    from gonio.models import Model
    from gonio.planning.result import DesignResult

SMALLEST = 3  # images, as `gonio.planning.plan_search` has it, which is slow to load


@click.command(name="design")
@click.option(
    "--model",
    required=True,
    shell_complete=complete_model,
    help="Model of the surface: a name of 'gonio models', FILE.py or FILE.py:NAME.",
)
@click.option(
    "-p",
    "--parameter",
    "items",
    multiple=True,
    metavar="NAME=VALUE",
    help="Expected value of a parameter, degrees for angles; the plan is optimised for it.",
)
@click.option(
    "--instrument",
    shell_complete=complete_instrument,
    default="modern12",
    show_default=True,
    metavar="PRESET|FILE.toml",
    help="Virtual instrument; see 'gonio instruments'.",
)
@constraint_options
@click.option(
    "--want",
    metavar="NAME=SHARE,...",
    help="Relative standard uncertainties to reach, such as alpha_x=0.01,rho_s=0.02. Without "
    "--want and --budget, those of the default plan.",
)
@click.option(
    "--budget",
    type=int,
    metavar="N",
    help="Largest total number of images of sample, standard and background.",
)
@click.option(
    "-o",
    "--output",
    metavar="PLAN.toml",
    type=click.Path(path_type=Path),
    help="File to write the plan to, as a TOML table [plan].",
)
@click.option(
    "--verify",
    type=click.IntRange(min=2),
    metavar="N",
    help="Simulate, reduce and fit the plan with N seeds, and compare the scatter with the "
    "prediction.",
)
@click.option(
    "--threads", type=click.IntRange(min=1), metavar="N", help="Number of worker threads."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON document.")
@click.pass_context
def command(
    ctx: click.Context,
    model: str,
    items: tuple[str, ...],
    instrument: str,
    fixes: tuple[str, ...],
    ties: tuple[str, ...],
    want: str | None,
    budget: int | None,
    output: Path | None,
    verify: int | None,
    threads: int | None,
    as_json: bool,
) -> None:
    """Plan the images that give parameters with a wanted precision.

    The plan sets incidence angles, rotations, exposures, and repeats of standard and background. It
    is chosen by Fisher information, which includes the errors that images share. The surface is
    assumed to follow the model exactly, with the given parameters. The exit code is 1 if the plan
    does not reach the wanted precision.
    """
    from gonio.cli.options import check_target, echo_json
    from gonio.cli.progress import stages
    from gonio.instrument import load

    chosen, parameters = _surface(model, items)
    fixed, tied = read_fixed(chosen, fixes), read_tied(ties)
    wanted = _wanted(chosen, parameters, want)
    if budget is not None and budget < SMALLEST:
        raise ConfigurationError(
            f"--budget {budget}: at least {SMALLEST} images are needed, one each of sample, "
            "standard and background.",
            value=budget,
        )
    if output is not None:
        check_target(output)
    chosen_instrument = load(instrument)
    from gonio.planning.plan_search import design

    with stages() as callback:
        result = design(
            chosen,
            parameters,
            instrument=chosen_instrument,
            wanted=wanted,
            budget=budget,
            fixed=fixed,
            tied=tied,
            verify=verify,
            threads=threads,
            progress=callback,
        )
    document = result.document() | {"command": _command(result, instrument)}
    if verify is not None:
        document["verification"] = result.verification
    if output is not None:
        result.save(output)
    if as_json:
        echo_json(document | {"output": None if output is None else str(output)})
    else:
        words = _surface_words(result, instrument)
        _show(document, None if output is None else f"{words} --plan {output} -o SESSION")
    if document["reached"] is False:
        ctx.exit(1)


def _surface(name: str, items: tuple[str, ...]) -> tuple[Model, dict[str, float]]:
    import gonio.models as models
    from gonio.cli.options import file_text, parse_parameters

    model = models.resolve(name)
    given = parse_parameters(model, items)
    left_out = [p for p in model.parameters if p.name not in given]
    if left_out:
        defaults = ", ".join(f"{p.name} = {file_text(p, p.default)}" for p in left_out)
        click.echo(f"Default values are used for {defaults}.", err=True)
    return model, {p.name: given.get(p.name, p.default) for p in model.parameters}


def _wanted(model: Model, parameters: dict[str, float], text: str | None) -> dict[str, float]:
    """Wanted relative standard uncertainties by name.

    Examples
    --------
    >>> from gonio import models
    >>> _wanted(models.get("ward"), {"alpha_x": 0.1}, "alpha_x=0.01")
    {'alpha_x': 0.01}
    """
    wanted_u: dict[str, float] = {}
    for item in text.split(",") if text is not None else ():
        name, sign, share = (part.strip() for part in item.partition("="))
        if not sign or not name:
            raise ConfigurationError(
                f"--want {item!r} is not NAME=SHARE; write for example "
                f"--want {model.parameters[0].name}=0.01 for 1 %.",
                value=item,
            )
        if name not in model.names:
            raise unknown_name("parameter", name, model.names, of=model.name)
        if name in wanted_u:
            raise ConfigurationError(f"--want {name} is given twice; give it once.", value=item)
        try:
            number = float(share)
        except ValueError:
            number = math.nan
        if not 0 < number < math.inf:
            raise ConfigurationError(
                f"--want {name}={share}: a relative standard uncertainty is a positive number; "
                "0.01 is 1 %.",
                value=share,
            )
        if parameters[name] == 0:
            raise ConfigurationError(
                f"--want {name}={share}: {name} is 0, of which no share can be wanted; "
                f"give another value with -p {name}=VALUE.",
                value=share,
            )
        wanted_u[name] = number
    return wanted_u


# ---------------------------------------------------------------- the terminal


def _surface_words(result: DesignResult, instrument: str) -> str:
    """Arguments of 'gonio simulate' for the surface and the instrument."""
    model = result.setup.model
    given = " ".join(
        f"-p {q.name}={q.to_file(result.parameters[q.name]):.10g}" for q in model.parameters
    )
    return f"gonio simulate --model {model.name} {given} --instrument {instrument}"


def _command(result: DesignResult, instrument: str) -> str:
    """The command that records the angles of the plan."""
    from gonio.plan_file import listed

    theta_i = listed(result.plan.theta_i_deg).replace(" ", "")
    rotations = listed(result.plan.rotations_deg).replace(" ", "")
    words = _surface_words(result, instrument)
    return f"{words} --theta-i {theta_i} --rotations {rotations} -o SESSION"


def _show(document: dict[str, Any], whole: str | None) -> None:
    from gonio.plan_file import listed

    plan, default = document["plan"], document["default"]
    rows, columns = document["pixels"]
    click.echo(f"{document['model']} on {document['instrument']} ({rows} x {columns} pixels)")
    click.echo()
    for label, values in (
        ("theta_i, deg", plan["theta_i_deg"]),
        ("rotations, deg", plan["rotations_deg"]),
        ("exposures, ms", [1e3 * t for t in plan["exposures_s"]]),
        ("takes of standard and background", [plan["repeats"]]),
    ):
        _say(f"{label}: {listed(values)}")
    click.echo(
        f"{plan['images']} images, {plan['frames']} frames; default plan: "
        f"{default['images']} images, {default['frames']} frames"
    )
    click.echo()
    _show_parameters(document["parameters"])
    if "verification" in document:
        _show_verification(document["verification"])
    click.echo()
    for line in document["remarks"]:
        _say(line)
    _say(
        "Expected is how far a 'gonio fit' to this plan's images lies off, one standard "
        "deviation, if the surface follows the model. Whether it does, further angles must tell."
    )
    _show_use(document, whole)


def _show_parameters(rows: list[dict[str, Any]]) -> None:
    click.echo("standard uncertainty in % of the value (in its unit where that is 0)")
    head = ("value", "default", "expected", "wanted")
    click.echo(_line("", head, "largest source", "helped most by"))
    for row in rows:
        helped = row["helped_most_by"]
        at = "-"
        if helped is not None:
            at = f"theta_i {helped['theta_i_deg']:g}, rotation {helped['rotation_deg']:g}"
        values = (
            f"{row['value']:.4g}{' ' * bool(row['unit'])}{row['unit']}",
            *(
                "fixed" if row.get("fixed") else _percent(row[key], row["value"])
                for key in ("u_of_default", "u")
            ),
            "-" if row["wanted"] is None else f"{100 * row['wanted']:.3g}",
        )
        source = row["largest_source"] or "-"
        if "tied_to" in row:
            source, at = f"tied to {row['tied_to']}", "-"
        click.echo(_line(row["name"], values, source, at))


def _show_verification(check: dict[str, Any]) -> None:
    click.echo()
    click.echo(
        f"{check['seeds']} simulated sessions; their scatter is itself known to "
        f"{check['relative_sd_of_scatter']:.0%}"
    )
    click.echo(f"{'':<12}{'predicted':>12}{'scatter':>12}{'ratio':>8}{'bias':>12}")
    for row in check["parameters"]:
        values = [row["predicted"], row["scatter"], row["bias"]]
        predicted, scatter, bias = ("-" if x is None else f"{x:.3g}" for x in values)
        ratio = "-" if row["ratio"] is None else f"{row['ratio']:.2f}"
        click.echo(f"{row['name']:<12}{predicted:>12}{scatter:>12}{ratio:>8}{bias:>12}")


def _show_use(document: dict[str, Any], whole: str | None) -> None:
    """Print how to use the plan: its angles alone, or all of it from a file."""
    click.echo()
    click.echo("Its angles, with every exposure of the instrument:")
    click.echo(f"  {document['command']}")
    if whole is None:
        click.echo("With -o PLAN.toml the whole plan goes to a file.")
        return
    click.echo("All of it; its file is also the [plan] of a session.toml for 'gonio import':")
    click.echo(f"  {whole}")


def _line(name: str, values: Iterable[str], source: str, at: str) -> str:
    numbers = "".join(f"{text:>10}" for text in values)
    return f"{name:<10}{numbers}  {source:<20}{at}".rstrip()


def _percent(u: float | None, value: float) -> str:
    if u is None:
        return "?"
    return f"{100 * u / abs(value):.3g}" if value else f"{u:.3g}"


def _say(text: str) -> None:
    click.echo(textwrap.fill(text, 90, subsequent_indent="  ", break_long_words=False))
