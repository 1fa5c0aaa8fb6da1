"""`gonio fit`: BRDF samples -> parameters with uncertainties."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.cli import explain, posteriors
from gonio.cli.measured import WEIGHTS, cuts_told, read_samples, sample_options
from gonio.cli.posteriors import posterior_options, read_priors
from gonio.errors import ConfigurationError, DataError

if TYPE_CHECKING:
    from rich.console import Console

    from gonio.fitting.result import Estimate, FitResult
    from gonio.models import Model
    from gonio.samples import BRDFSamples

# As `gonio.fitting.minimum.engines` and `losses` name them, which are slow to load.
ENGINES = ("gauss_newton", "slsqp", "lbfgs", "mma", "bobyqa", "sbplx", "mlsl")
LOSSES = ("chi2", "log", "cube_root", "student_t")
_HINT = "Or fit them together with --share NAME,..., the parameters that they have in common."


@click.command(name="fit")
@click.argument(
    "sources", metavar="INPUT...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option("--model", "model_name", required=True, metavar="MODEL", help="Model to fit.")
@sample_options
@click.option(
    "--share",
    metavar="NAME,...|all|none",
    help="Fit all channels, wavelengths and inputs together, with these parameters in common; each "
    "has its own values of the others.",
)
@click.option(
    "--start",
    "starts",
    multiple=True,
    metavar="NAME=VALUE",
    help="Starting value; without any, the data suggest them.",
)
@click.option("--engine", type=click.Choice(ENGINES), default=ENGINES[0], show_default=True,
              help="What searches for the minimum before the Gauss-Newton steps in which every fit "
              "ends.")  # fmt: skip
@click.option("--loss", type=click.Choice(LOSSES), default=LOSSES[0], show_default=True,
              help="What is made small: squared residuals, squared differences of "
              "ln(1 + f cos theta_r) or of (f cos theta_r)^(1/3), or Student's t, which outliers "
              "hardly move.")  # fmt: skip
@click.option(
    "--nuisance",
    default="none",
    show_default=True,
    metavar="all|none|NAME,...",
    help="Shared errors that the fit may learn from the data, with priors from the session's "
    "budget; the others are propagated. 'geometry' stands for every 'geometry, mode k'.",
)
@posterior_options
@click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, show_default=True,
              help="Seed of everything random.")  # fmt: skip
@click.option(
    "--truth",
    type=click.Path(path_type=Path),
    metavar="SESSION",
    help="Simulated session whose true parameters are shown beside; the fit does not use them.",
)
@click.option("--threads", type=click.IntRange(min=1), metavar="N",
              help="Threads to use; the result does not depend on it.")  # fmt: skip
@click.option(
    "-o",
    "--output",
    metavar="FIT.json",
    type=click.Path(path_type=Path),
    help="Where to write the result; the posterior's draws go beside it.",
)
@click.option(
    "--explain",
    "explained",
    is_flag=True,
    help="Show what the data say of each parameter, and where the residuals are.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON document.")
@click.pass_context
def command(
    ctx: click.Context,
    sources: tuple[Path, ...],
    model_name: str,
    weights: Any,
    selections: tuple[str, ...],
    max_theta_i: float | None,
    max_theta_r: float | None,
    share: str | None,
    starts: tuple[str, ...],
    engine: str,
    loss: str,
    nuisance: str,
    posterior: bool,
    sampler: Any,
    priors: tuple[str, ...],
    seed: int,
    truth: Path | None,
    threads: int | None,
    output: Path | None,
    explained: bool,
    as_json: bool,
) -> None:
    """Fit MODEL to the BRDF samples of INPUT.

    INPUT is a session, a samples file, or any BRDF file that gonio reads; several inputs are
    several materials, fitted together with --share. The exit code is 1 where the fit did not meet
    its own checks.
    """
    from gonio.cli import joint
    from gonio.cli.options import check_target
    from gonio.cli.progress import progress
    from gonio.fitting.fit import fit
    from gonio.fitting.problem.nuisance_names import parse_names
    from gonio.models import get

    model = get(model_name)
    start = _starts(model, starts) if starts else None
    believed = read_priors(priors, model, posterior=posterior)
    if output is not None:
        check_target(output)
    shared = None if share is None else joint.shared_names(model, share)
    named = _inputs(sources, shared)
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
    known = _truths(named, inputs, truth, model)
    draws = output.with_suffix(".draws.nc") if posterior and output is not None else None

    def run(callback: Any = None) -> FitResult:
        return fit(
            samples,
            model=model,
            share=shared,
            weights=weights,
            start=start,
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
            progress=callback,
        )

    if posterior:
        with progress(f"fitting {model.name} and sampling its posterior", "steps") as callback:
            result = run(callback)
    else:
        result = run()
    true = joint.true_parameters(result, known) if result.parts else known[0]
    origin = str(sources[0]) if len(sources) == 1 else [str(source) for source in sources]
    result = joint.with_inputs(result, named)
    result = replace(result, source={**result.source, "input": origin, "truth": true})
    if output is not None:
        result.save(output)
    if as_json:
        click.echo(result.to_json(), nl=False)
    else:
        _tell(result, model, true, output, explained=explained)
    if not result.ok:
        ctx.exit(1)


def _starts(model: Model, items: tuple[str, ...]) -> dict[str, float]:
    """Starting values as `-p` reads parameters, its messages with the name of this option."""
    from gonio.cli.options import parse_parameters

    try:
        return parse_parameters(model, items)
    except ConfigurationError as error:
        text = str(error).replace("-p ", "--start ")
        raise ConfigurationError(text, value=error.value) from None


def _inputs(sources: tuple[Path, ...], shared: tuple[str, ...] | None) -> dict[str, Path]:
    """The inputs by name; several are refused where nothing says how they belong together."""
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
    """True parameters of every part, in file units, where the inputs are simulated sessions."""
    from gonio.fitting.problem.channels import split

    found: list[dict[str, float] | None] = []
    raw = {name: _truth(truth or path, model, asked=truth is not None)
           for name, path in named.items()}  # fmt: skip
    for channel in split(inputs):
        name = channel.material or next(iter(named))
        values = raw[name]
        if values is None:
            found.append(None)
            continue
        if any(isinstance(value, list) for value in values.values()):
            k = _channel_index(truth or named[name], channel.samples)
            values = {q: v[k] if isinstance(v, list) else v for q, v in values.items()}
        found.append({q.name: q.to_file(values[q.name]) for q in model.parameters})
    return found


def _truth(session: Path, model: Model, *, asked: bool) -> dict[str, Any] | None:
    """True parameters as a simulated session of this model holds them; a list is by channel."""
    from gonio.session import read_truth

    found = read_truth(session) if session.is_dir() else None
    if found is None:
        if asked:
            raise DataError(
                f"{session}: holds no truth; give a session that 'gonio simulate' wrote.",
                value=session,
            )
        return None
    if found["model"] != model.name:
        click.echo(
            f"the session was simulated with {found['model']}, not {model.name}: "
            "no true values are shown.",
            err=True,
        )
        return None
    return {q.name: found["parameters"][q.name] for q in model.parameters}


def _channel_index(session: Path, samples: BRDFSamples) -> int:
    """Which channel of a simulated session the samples are of, by name or else by wavelength."""
    from gonio.session import Session

    channels = Session.open(session).metadata.plan.channels
    listed: list[Any] = [channel.name for channel in channels]
    own: Any = None
    of = "of no stated channel"
    if samples.channel is not None:
        own = str(samples.channel[0])
        of = f"of channel {own}"
    elif samples.wavelength_nm is not None:
        listed = [channel.wavelength_nm for channel in channels]
        own = float(samples.wavelength_nm[0])
        of = f"of {own:g} nm"
    if listed.count(own) == 1:
        return listed.index(own)
    names = ", ".join(channel.name for channel in channels)
    raise ConfigurationError(
        f"{session}: its true parameters differ between the channels {names}, and the samples are "
        f"{of}; give samples of one of these channels, or a session of their own.",
        value=own,
    )


def _tell(
    result: FitResult,
    model: Model,
    truth: dict[str, float] | None,
    output: Path | None,
    *,
    explained: bool = False,
) -> None:
    """The result as a table, with warnings under it."""
    from rich.console import Console

    parts = f" in {len(result.parts)} parts" if result.parts else ""
    click.echo(f"{model.title} ({model.reference})")
    click.echo(
        f"{result.n_samples} samples{parts}{cuts_told(result.cuts)}; "
        f"weights: {WEIGHTS[result.weights]}"
    )
    click.echo(f"loss: {result.loss}; engine: {result.engine}")
    # Without markup: rich would take the unit in "sigma [deg]" for a style and drop it.
    console = Console(width=max(80, _terminal_width()), highlight=False, markup=False)
    if result.parts:
        from gonio.cli import joint

        joint.show(result, truth, console)
    else:
        _show(result, truth, console)
    known = result.weights == "sd" and result.loss == "chi2"
    ratio = f"chi2/dof {result.chi2 / result.dof:.4g}, " if known else ""
    click.echo(f"{ratio}status: {result.status.replace('_', ' ')}")
    if result.posterior is not None:
        for line in posteriors.lines(result.posterior):
            click.echo(line)
    if result.nuisance:
        from gonio.cli import nuisance

        for line in nuisance.lines(result.nuisance):
            click.echo(line)
    for line in explain.lines(result):
        click.echo(line)
    for warning in result.warnings:
        click.echo(f"warning: {warning}")
    if explained:
        explain.show(result, console)
    if output is not None:
        click.echo(f"written to {output}", err=True)


def _show(result: FitResult, truth: dict[str, float] | None, console: Console) -> None:
    """One row a parameter."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("parameter")
    for heading in ("value", "std. unc.", "95 % interval"):
        table.add_column(heading, justify="right", no_wrap=True)
    if truth is not None:
        for heading in ("true", "error"):
            table.add_column(heading, justify="right", no_wrap=True)
    for name, estimate in result.parameters.items():
        table.add_row(*parameter_row(name, estimate, None if truth is None else truth[name]))
    console.print(table)


def parameter_row(name: str, estimate: Estimate, true: float | None) -> list[str]:
    """Cells of one parameter: value, standard uncertainty, interval, and true value and error."""
    estimate = estimate.in_file_units()
    unit = f" {estimate.unit}" if estimate.unit else ""
    digits = _decimals(estimate)
    interval = "unknown"
    if estimate.interval_95 is not None:
        low, high = estimate.interval_95
        interval = f"{low:.{digits}f} .. {high:.{digits}f}"
    stderr = "at bound" if estimate.at_bound else "none"
    if estimate.stderr is not None:
        stderr = f"{estimate.stderr:.{digits}f}"
    row = [name + (f" [{estimate.unit}]" if unit else ""), f"{estimate.value:.{digits}f}", stderr,
           interval]  # fmt: skip
    if true is not None:
        error = f"{100 * (estimate.value / true - 1):+.2f} %" if true else ""
        row += [f"{true:g}", error]
    return row


def _decimals(estimate: Estimate) -> int:
    """Decimals that show two digits of the standard uncertainty."""
    u = estimate.stderr
    if not u and estimate.interval_95 is not None:
        u = (estimate.interval_95[1] - estimate.interval_95[0]) / 4
    if not u:
        return 4
    return min(max(1 - math.floor(math.log10(u)), 0), 9)


def _terminal_width() -> int:
    import shutil

    return shutil.get_terminal_size((80, 24)).columns
