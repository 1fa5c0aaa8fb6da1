"""`gonio fit`: BRDF samples -> parameters with uncertainties."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.cli.measured import WEIGHTS, read_samples, sample_options
from gonio.errors import ConfigurationError, DataError

if TYPE_CHECKING:
    from gonio.fitting.result import Estimate, FitResult
    from gonio.models import Model
    from gonio.samples import BRDFSamples


@click.command(name="fit")
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.option("--model", "model_name", required=True, metavar="MODEL", help="Model to fit.")
@sample_options
@click.option(
    "--start",
    "starts",
    multiple=True,
    metavar="NAME=VALUE",
    help="Starting value; without any, the data suggest them.",
)
@click.option("--posterior", is_flag=True, help="Sample the posterior with emcee.")
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
@click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON document.")
@click.pass_context
def command(
    ctx: click.Context,
    source: Path,
    model_name: str,
    weights: Any,
    selections: tuple[str, ...],
    max_theta_i: float | None,
    max_theta_r: float | None,
    starts: tuple[str, ...],
    posterior: bool,
    seed: int,
    truth: Path | None,
    threads: int | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """Fit MODEL to the BRDF samples of INPUT.

    INPUT is a session, a samples file, or any BRDF file that gonio reads. The exit code is 1
    where the fit did not meet its own checks.
    """
    from gonio.cli.options import check_target
    from gonio.cli.progress import progress
    from gonio.fitting.least_squares import fit
    from gonio.models import get

    model = get(model_name)
    start = _starts(model, starts) if starts else None
    if output is not None:
        check_target(output)
    samples, cuts = read_samples(source, selections, max_theta_i, max_theta_r, threads)
    known = _truth(source if truth is None else truth, model, samples, asked=truth is not None)
    draws = output.with_suffix(".draws.nc") if posterior and output is not None else None

    def run(callback: Any = None) -> FitResult:
        return fit(
            samples,
            model=model,
            weights=weights,
            start=start,
            posterior=posterior,
            draws=draws,
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
    result = replace(result, source={**result.source, "input": str(source), "truth": known})
    if output is not None:
        result.save(output)
    if as_json:
        click.echo(result.to_json(), nl=False)
    else:
        _tell(result, model, known, output)
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


def _truth(
    session: Path, model: Model, samples: BRDFSamples, *, asked: bool
) -> dict[str, float] | None:
    """True parameters in file units, where the session is a simulated one of this model."""
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
    true = {q.name: found["parameters"][q.name] for q in model.parameters}
    if any(isinstance(value, list) for value in true.values()):
        k = _channel_index(session, samples)
        true = {name: v[k] if isinstance(v, list) else v for name, v in true.items()}
    return {q.name: q.to_file(true[q.name]) for q in model.parameters}


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
    result: FitResult, model: Model, truth: dict[str, float] | None, output: Path | None
) -> None:
    """The result as a table, with warnings under it."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    cuts = [
        f"{name} <= {limit:g} deg"
        for name, limit in (
            ("theta_i", result.cuts["max_theta_i_deg"]),
            ("theta_r", result.cuts["max_theta_r_deg"]),
        )
        if limit is not None
    ]
    cuts += [f"{key} = {value}" for key, value in result.cuts["select"].items()]
    click.echo(f"{model.title} ({model.reference})")
    click.echo(
        f"{result.n_samples} samples" + (f" with {', '.join(cuts)}" if cuts else "")
        + f"; weights: {WEIGHTS[result.weights]}"
    )  # fmt: skip
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("parameter")
    for heading in ("value", "std. unc.", "95 % interval"):
        table.add_column(heading, justify="right", no_wrap=True)
    if truth is not None:
        for heading in ("true", "error"):
            table.add_column(heading, justify="right", no_wrap=True)
    for name, estimate in result.parameters.items():
        table.add_row(*_row(name, estimate, None if truth is None else truth[name]))
    # Without markup: rich would take the unit in "sigma [deg]" for a style and drop it.
    console = Console(width=max(80, _terminal_width()), highlight=False, markup=False)
    console.print(table)
    ratio = f"chi2/dof {result.chi2 / result.dof:.4g}, " if result.weights == "sd" else ""
    click.echo(f"{ratio}status: {result.status.replace('_', ' ')}")
    if result.posterior is not None:
        p = result.posterior
        click.echo(
            f"posterior: {'converged' if p.converged else 'NOT converged'}, {p.ess:.0f} effective "
            f"draws, R-hat {p.r_hat:.4f}, autocorrelation {p.tau:.1f} steps; intervals are its "
            "quantiles"
        )
    for warning in result.warnings:
        click.echo(f"warning: {warning}")
    if output is not None:
        click.echo(f"written to {output}", err=True)


def _row(name: str, estimate: Estimate, true: float | None) -> list[str]:
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
