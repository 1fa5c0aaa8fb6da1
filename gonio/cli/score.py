"""`gonio fit --score`: how well a fit predicts the samples of another file."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult, Score
    from gonio.samples import BRDFSamples

SCHEMA = "gonio.score/1"


def is_fit(sources: tuple[Path, ...]) -> bool:
    """Whether the input is a fit that was made before, by its suffix."""
    return len(sources) == 1 and sources[0].suffix.lower() == ".json"


def score_file(
    fit: FitResult,
    path: Path,
    selections: tuple[str, ...],
    threads: int | None,
    sizes: dict[str, float | None],
) -> Score:
    """The score of a fit by the samples of a file, within the limits of angles of the fit.

    Parameters
    ----------
    sizes : dict
        Shared errors of the file, as `with_shared_errors` takes them.
    """
    from gonio.cli.measured import read_samples
    from gonio.samples.stated_errors import with_shared_errors

    samples: BRDFSamples
    limits = (fit.cuts.get("max_theta_i_deg"), fit.cuts.get("max_theta_r_deg"))
    samples, _ = read_samples(path, selections, *limits, threads)
    return fit.score(with_shared_errors(samples, **sizes))


def print_score(found: Score) -> None:
    """Print a score: the class first, numbers below."""
    click.echo(found.line)
    low, high = (f"{100 * x:.2g}" for x in found.interval)
    click.echo(
        f"{found.n} samples; typical error {100 * found.typical_error:.2g} % of f "
        f"(95 % interval {low} to {high} %); mean of measured less predicted "
        f"{100 * found.bias:+.2g} %"
    )
    if found.chi2 is not None and found.dof:
        click.echo(
            f"chi2 of the prediction {found.chi2 / found.dof:.4g} per sample, by their noise and "
            f"its uncertainty (p = {found.p:.2g})"
        )


def score_of_fit(
    ctx: click.Context,
    source: Path,
    path: Path,
    read: Callable[[FitResult], Score],
    *,
    strict: bool,
    as_json: bool,
) -> None:
    """Print how well a fit of a file predicts; exit 1 with --strict unless it fits.

    Parameters
    ----------
    read : callable
        Makes the score of the fit.
    """
    from gonio.fitting.result import FitResult

    found = read(FitResult.load(source))
    if as_json:
        document: dict[str, Any] = {"schema": SCHEMA, "fit": str(source), "input": str(path)}
        document |= found.to_dict()
        click.echo(json.dumps(document, indent=1, allow_nan=False, ensure_ascii=False))
    else:
        print_score(found)
    if strict and found.kind not in ("fits", "fits_within_shared"):
        ctx.exit(1)
