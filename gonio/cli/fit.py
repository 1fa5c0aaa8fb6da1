"""`gonio fit`: BRDF samples -> parameters with uncertainties."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.cli.completion import complete_model
from gonio.cli.constraints import constraint_options, read_fixed, read_tied
from gonio.cli.inputs import require_measured
from gonio.cli.measured import read_samples, sample_options
from gonio.cli.posteriors import posterior_options, read_priors
from gonio.cli.stated_errors import read_stated_errors, stated_error_options
from gonio.errors import ConfigurationError

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult, Score
    from gonio.models import Model
    from gonio.samples import BRDFSamples

# As `gonio.fitting.minimum.engines` and `losses` name them, which are slow to load.
ENGINES = ("lbfgs", "slsqp", "mma", "bobyqa", "sbplx", "mlsl", "gauss_newton")
LOSSES = ("chi2", "log", "cube_root", "relative", "student_t")
_HINT = "Or fit them together with --share NAME,..., the parameters that they have in common."


@click.command(name="fit")
@click.argument(
    "sources", metavar="INPUT...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option(
    "--model",
    "model_name",
    metavar="MODEL",
    shell_complete=complete_model,
    help="Model to fit: a name of 'gonio models', FILE.py or FILE.py:NAME. "
    "A FIT.json with --score needs none.",
)
@sample_options
@stated_error_options
@click.option(
    "--share",
    metavar="NAME,...|all|none",
    help="Fit all channels, wavelengths and inputs together. They share these parameters; "
    "the other parameters have a value for each.",
)
@click.option(
    "--start",
    "starts",
    multiple=True,
    metavar="NAME=VALUE",
    help="Starting value of a parameter; default: derived from the data.",
)
@constraint_options
@click.option("--engine", type=click.Choice(ENGINES), default=ENGINES[0], show_default=True,
              help="Method that searches for the minimum; Gauss-Newton steps follow. "
              "gauss_newton: no search before them.")  # fmt: skip
@click.option("--loss", type=click.Choice(LOSSES), default=LOSSES[0], show_default=True,
              help="Loss to minimise: squared residuals, squared differences of "
              "ln(1 + f cos theta_r), of (f cos theta_r)^(1/3) or of ln f (relative), or Student's "
              "t, which is robust against outliers.")  # fmt: skip
@click.option(
    "--nuisance",
    default="none",
    show_default=True,
    metavar="all|none|NAME,...",
    help="Shared errors to estimate from the data as nuisance parameters, with priors from "
    "the uncertainty budget of the session; the others are propagated. 'geometry' "
    "stands for every 'geometry, mode k'.",
)
@click.option(
    "--self-calibrate",
    is_flag=True,
    help="Find the slope errors of the dome together with the material, from the samples of one "
    "session.",
)
@posterior_options
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True,
              help="Seed of the random numbers.")  # fmt: skip
@click.option(
    "--truth",
    type=click.Path(path_type=Path),
    metavar="SESSION",
    help="Simulated session whose true parameters are shown next to the estimates; the fit "
    "does not use them.",
)
@click.option("--threads", type=click.IntRange(min=1), metavar="N",
              help="Number of worker threads; the result does not depend on it.")  # fmt: skip
@click.option(
    "-o",
    "--output",
    metavar="FIT.json",
    type=click.Path(path_type=Path),
    help="File to write the result to; draws of the posterior go to a file next to it.",
)
@click.option(
    "--explain",
    "explained",
    is_flag=True,
    help="Show how well the data determine each parameter, and where the residuals are large.",
)
@click.option(
    "--score",
    "scored",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Show how well the fit predicts the samples of FILE. INPUT may be a FIT.json.",
)
@click.option(
    "--strict",
    is_flag=True,
    help="Exit with 1 unless the verdict is 'fits' or 'fits within the stated shared errors'.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON document.")
@click.pass_context
def command(
    ctx: click.Context,
    sources: tuple[Path, ...],
    model_name: str | None,
    weights: Any,
    selections: tuple[str, ...],
    max_theta_i: float | None,
    max_theta_r: float | None,
    u_scale: str | None,
    u_angle: float | None,
    share: str | None,
    starts: tuple[str, ...],
    fixes: tuple[str, ...],
    ties: tuple[str, ...],
    engine: str,
    loss: str,
    nuisance: str,
    self_calibrate: bool,
    posterior: bool,
    sampler: Any,
    priors: tuple[str, ...],
    seed: int,
    truth: Path | None,
    threads: int | None,
    output: Path | None,
    explained: bool,
    scored: Path | None,
    strict: bool,
    as_json: bool,
) -> None:
    """Fit MODEL to the BRDF samples of INPUT.

    INPUT is a session, a samples file, or any BRDF file that gonio reads. Several inputs are
    several materials, fitted together with --share. The exit code is 1 if the fit fails its own
    checks: it has not converged, explains less than half of the variance of f, or predicts
    unseen incidences worse than a constant.
    """
    from gonio.cli import joint, score
    from gonio.cli.options import check_target
    from gonio.cli.progress import progress
    from gonio.models import resolve

    stated = read_stated_errors(u_scale, u_angle)

    def score_by(result: FitResult) -> Score:
        assert scored is not None
        return score.score_file(result, scored, selections, threads, stated)

    if scored is not None and score.is_fit(sources):
        score.score_of_fit(ctx, sources[0], scored, score_by, strict=strict, as_json=as_json)
        return
    if model_name is None:
        raise ConfigurationError(
            "a fit needs --model MODEL, a name of 'gonio models' or a file; a FIT.json needs "
            "--score FILE."
        )
    model = resolve(model_name)
    start = _starts(model, starts) if starts else None
    fixed, tied = read_fixed(model, fixes), read_tied(ties)
    believed = read_priors(priors, model, posterior=posterior)
    if output is not None:
        check_target(output)
    shared = None if share is None else joint.shared_names(model, share)
    named = _inputs(sources, shared)
    for source in sources:
        require_measured(source)
    from gonio.fitting.fit import fit
    from gonio.fitting.problem.constraints import Constraints
    from gonio.fitting.problem.nuisance_names import parse_names
    from gonio.recovery import true_parameters

    Constraints.of(model, fixed, tied)  # before anything is read
    read = {
        name: read_samples(
            source, selections, max_theta_i, max_theta_r, threads,
            several=share is not None, hint=f" {_HINT}",
        )
        for name, source in named.items()
    }  # fmt: skip
    cuts = next(iter(read.values()))[1]
    inputs = {name: samples for name, (samples, _) in read.items()}
    samples = next(iter(inputs.values())) if len(inputs) == 1 else inputs
    true_values = _truths(named, inputs, truth, model)
    draws = output.with_suffix(".draws.nc") if posterior and output is not None else None

    def run(callback: Any = None) -> FitResult:
        return fit(
            samples,
            model=model,
            share=shared,
            weights=weights,
            start=start,
            fixed=fixed,
            tied=tied,
            engine=engine,
            loss=loss,
            nuisance=parse_names(nuisance),
            posterior=posterior,
            draws=draws,
            sampler=sampler,
            priors=believed,
            seed=seed,
            threads=threads,
            cuts=cuts,
            **stated,
            self_calibrate=self_calibrate,
            progress=callback,
        )

    if posterior:
        with progress(f"fitting {model.name} and sampling its posterior", "steps") as callback:
            result = run(callback)
    else:
        result = run()
    true = true_parameters(result, true_values)
    origin = str(sources[0]) if len(sources) == 1 else [str(source) for source in sources]
    result = joint.with_inputs(result, named)
    result = replace(result, source={**result.source, "input": origin, "truth": true})
    found = None if scored is None else score_by(result)
    if found is not None:
        result = replace(result, diagnostics={**result.diagnostics, "score": found.to_dict()})
    if output is not None:
        result.save(output)
    if as_json:
        click.echo(result.to_json(), nl=False)
    else:
        _print(result, model, true, output, explained=explained)
        if found is not None:
            score.print_score(found)
    if not result.ok or (strict and not (result.verdict and result.verdict.fits)):
        ctx.exit(1)


def _starts(model: Model, items: tuple[str, ...]) -> dict[str, float]:
    """Starting values, read in the same way as `-p`; messages name this option."""
    from gonio.cli.options import parse_parameters

    try:
        return parse_parameters(model, items)
    except ConfigurationError as error:
        text = str(error).replace("-p ", "--start ")
        raise ConfigurationError(text, value=error.value) from None


def _inputs(sources: tuple[Path, ...], shared: tuple[str, ...] | None) -> dict[str, Path]:
    """The inputs by name; several inputs are refused without --share."""
    from gonio.cli.joint import input_names

    if len(sources) > 1 and shared is None:
        raise ConfigurationError(
            f"{len(sources)} inputs are fitted together with --share NAME,..., the parameters that "
            "they have in common, or --share none.",
            value=[str(source) for source in sources],
        )
    return input_names(sources)


def _truths(
    named: dict[str, Path],
    inputs: dict[str, BRDFSamples],
    truth: Path | None,
    model: Model,
) -> list[dict[str, float] | None]:
    """True parameters of every part, in file units, if the inputs are simulated sessions."""
    from gonio.recovery import true_by_part

    parts, others = true_by_part(named, inputs, model, session=truth)
    for other in others:
        click.echo(
            f"the session was simulated with {other}, not {model.name}: no true values are shown.",
            err=True,
        )
    return parts


def _print(
    result: FitResult,
    model: Model,
    truth: dict[str, float] | None,
    output: Path | None,
    *,
    explained: bool = False,
) -> None:
    """Print the result as a table, followed by the warnings."""
    import shutil

    from rich.console import Console

    from gonio.fitting.result.text import page

    width = max(80, shutil.get_terminal_size((80, 24)).columns)
    # Without markup: rich would take the unit in "sigma [deg]" for a style and drop it.
    console = Console(width=width, highlight=False, markup=False)
    title = model.heading
    for piece in page(result, title, known=truth, width=width, explain=explained):
        if isinstance(piece, str):
            click.echo(piece)
        else:
            console.print(piece)
    if output is not None:
        click.echo(f"written to {output}", err=True)
