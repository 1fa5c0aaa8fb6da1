"""`gonio compare`: which of several models predicts the samples best."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.cli.completion import complete_models
from gonio.cli.constraints import constraint_options, constraints_line, read_fixed, read_tied
from gonio.cli.inputs import require_measured
from gonio.cli.measured import read_samples, sample_options
from gonio.cli.stated_errors import read_stated_errors, stated_error_options
from gonio.errors import ConfigurationError
from gonio.fitting.result.lines import WEIGHTS, cuts_line
from gonio.fitting.result.verdict import WORDS

if TYPE_CHECKING:
    from gonio.fitting.comparison.records import Comparison, Entry, Score
    from gonio.models import Model

LARGE = 1e5  # from which a number is written with an exponent


@click.command(name="compare")
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.option(
    "--models",
    "model_names",
    shell_complete=complete_models,
    required=True,
    metavar="MODEL,MODEL,...",
    help="Models to compare, at least two.",
)
@sample_options
@stated_error_options
@constraint_options
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True,
              help="Seed of the random numbers.")  # fmt: skip
@click.option("--threads", type=click.IntRange(min=1), metavar="N",
              help="Number of worker threads; the result does not depend on it.")  # fmt: skip
@click.option(
    "-o",
    "--output",
    metavar="OUT.json",
    type=click.Path(path_type=Path),
    help="File to write the comparison to.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the comparison as one JSON document.")
@click.option("--csv", "as_csv", is_flag=True, help="Print the table as CSV, with all digits.")
@click.option("--latex", "as_latex", is_flag=True, help="Print the table as LaTeX.")
@click.pass_context
def command(
    ctx: click.Context,
    source: Path,
    model_names: str,
    weights: Any,
    selections: tuple[str, ...],
    max_theta_i: float | None,
    max_theta_r: float | None,
    u_scale: str | None,
    u_angle: float | None,
    fixes: tuple[str, ...],
    ties: tuple[str, ...],
    seed: int,
    threads: int | None,
    output: Path | None,
    as_json: bool,
    as_csv: bool,
    as_latex: bool,
) -> None:
    """Compare models on the BRDF samples of INPUT.

    Each model is fitted to all samples. It then predicts the samples of each incidence from a fit
    to all other incidences. The table begins with the best model and shows the differences of the
    others from it. The exit code is 1 if a fit fails its own checks.
    """
    from gonio.cli.options import check_target, refuse_both
    from gonio.cli.progress import progress
    from gonio.models import resolve

    stated = read_stated_errors(u_scale, u_angle)
    refuse_both(as_json, as_csv, as_latex)
    models = [resolve(name) for name in _names(model_names)]
    fixed, tied = _fixed(models, fixes), read_tied(ties)
    if output is not None:
        check_target(output)
    require_measured(source)
    from gonio.fitting.comparison.compare import compare

    samples, cuts = read_samples(source, selections, max_theta_i, max_theta_r, threads)
    with progress(f"comparing {len(models)} models", "models") as callback:
        comparison = compare(
            samples,
            models,
            weights=weights,
            fixed=fixed,
            tied=tied,
            seed=seed,
            threads=threads,
            cuts=cuts,
            **stated,
            progress=callback,
        )
    comparison = replace(comparison, source={**comparison.source, "input": str(source)})
    if output is not None:
        comparison.save(output)
    if as_json:
        click.echo(comparison.to_json(), nl=False)
    elif as_csv or as_latex:
        from gonio.reporting.tables import comparison_table

        table = comparison_table(comparison)
        click.echo(table.latex() if as_latex else table.csv(), nl=False)
    else:
        _print(comparison, output)
    if not comparison.ok:
        ctx.exit(1)


def _fixed(models: list[Model], items: tuple[str, ...]) -> dict[str, float]:
    """Fixed values of parameters; at least one of the models has each of them."""
    fixed: dict[str, float] = {}
    for item in items:
        name = item.partition("=")[0].strip()
        owners = [model for model in models if name in model.names]
        again = [*fixed, name].count(name) > 1
        if again:
            raise ConfigurationError(f"--fix {name} is given twice; give it once.", value=item)
        fixed |= read_fixed(owners[0] if owners else models[0], (item,))
    return fixed


def _names(text: str) -> list[str]:
    """Models of a comma-separated list; fewer than two are refused before a file is read."""
    names = [name.strip() for name in text.split(",") if name.strip()]
    if len(names) < 2:
        raise ConfigurationError(
            f"--models {text!r}: give two models at least, for instance --models ward,ward_duer.",
            value=text,
        )
    return names


def _print(comparison: Comparison, output: Path | None) -> None:
    """Print the comparison as a table, followed by the conclusion."""
    import shutil

    from rich import box
    from rich.console import Console
    from rich.table import Table

    click.echo(
        f"{comparison.n_samples} samples, {len(comparison.groups)} incidences"
        f"{cuts_line(comparison.cuts)}; "
        f"weights: {WEIGHTS[comparison.weights]}"
    )
    fixed = {name: f"{value:.6g}" for name, value in comparison.fixed.items()}
    if line := constraints_line(fixed, comparison.tied):
        click.echo(line)
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("model", overflow="fold")
    table.add_column("verdict", overflow="fold")
    table.add_column("P", justify="right", no_wrap=True)
    stated = comparison.weights == "sd"
    for heading in ("chi2/dof" if stated else "rel.chi2", "held-out", "LOO", "log Z"):
        table.add_column(heading, justify="right", no_wrap=True)
    unit = 1.0 if stated else comparison.noise_scale**2
    for entry in comparison.entries:
        table.add_row(*_row(entry, unit, first=entry is comparison.best))
    width = max(80, shutil.get_terminal_size((80, 24)).columns)
    Console(width=width, highlight=False, markup=False).print(table)
    best = comparison.best
    for name, score in (("held-out", best.held_out), ("LOO", best.loo)):
        if score is not None:
            click.echo(f"{name} score of {best.model}: {_plus_minus(score.value, score.stderr)}")
    failed = [entry.model for entry in comparison.entries if entry.status != "converged"]
    click.echo(f"status: {'NOT converged: ' + ', '.join(failed) if failed else 'all converged'}")
    click.echo(_legend(comparison, stated))
    click.echo(comparison.conclusion)
    for note in comparison.notes:
        click.echo(f"note: {note}")
    for entry in comparison.entries:
        if entry.verdict is not None:
            click.echo(f"{entry.model}: {entry.verdict.line}")
        for note in entry.notes:
            click.echo(f"{entry.model}: {note}")
    if output is not None:
        click.echo(f"written to {output}", err=True)


def _legend(comparison: Comparison, stated: bool) -> str:
    """Meaning of the columns."""
    parts = [
        "P: parameters",
        "held-out, LOO: log predictive density less that of the first, ± standard error",
        "log Z: log evidence, priors flat between the bounds",
    ]
    parts += [] if stated else ["rel.chi2: chi2/dof by that of the best fit"]
    doubtful = any(_doubtful(entry) for entry in comparison.entries)
    return "; ".join(parts + (["?: unreliable standard error"] if doubtful else []))


def _row(entry: Entry, unit: float, *, first: bool) -> list[str]:
    evidence = "none"
    if entry.log_evidence is not None and entry.log_evidence_stderr is not None:
        evidence = _number(entry.log_evidence, 1 if entry.log_evidence_stderr < 0.05 else 0)
    loo = _difference(entry.loo, first=first) + ("?" if _doubtful(entry) else "")
    held_out = _difference(entry.held_out, first=first)
    ratio = f"{entry.chi2 / entry.dof / unit:.3g}"
    name = "\n  ".join([entry.model, *_remarks(entry)])
    verdict = "unknown" if entry.verdict is None else WORDS[entry.verdict.kind]
    return [name, verdict, str(entry.n_parameters), ratio, held_out, loo, evidence]


def _remarks(entry: Entry) -> list[str]:
    """Lines below the name of a model: only problems are listed."""
    remarks = [] if entry.status == "converged" else ["NOT converged"]
    for what, names in (("at bound", entry.at_bound), ("undetermined", entry.undetermined)):
        remarks += [f"{what}: {', '.join(names)}"] if names else []
    return remarks


def _doubtful(entry: Entry) -> bool:
    from gonio.fitting.comparison.predictive_scores import MAX_K_HAT

    return entry.loo is not None and not (entry.loo_k_hat or 0.0) <= MAX_K_HAT


def _difference(score: Score | None, *, first: bool) -> str:
    if score is None:
        return "none"
    return "0" if first else _plus_minus(score.difference, score.difference_stderr)


def _plus_minus(value: float, stderr: float) -> str:
    decimals = 0 if stderr >= 10 else 1 if stderr >= 0.1 else 2
    return f"{_number(value, decimals)} ± {_number(stderr, decimals)}"


def _number(value: float, decimals: int) -> str:
    """A number that fits its column, even if a model is far off."""
    if abs(value) >= LARGE:
        mantissa, _, exponent = f"{value:.2e}".partition("e")
        return f"{mantissa}e{int(exponent)}"
    shown = f"{value:.{decimals}f}"
    return shown if float(shown) else f"{0:.{decimals}f}"
