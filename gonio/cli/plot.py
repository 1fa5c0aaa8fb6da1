"""`gonio plot`: BRDF samples or a fit as a picture."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.errors import ConfigurationError, DataError

if TYPE_CHECKING:
    from gonio.fitting.result import FitResult
    from gonio.samples import BRDFSamples
    from gonio.session import Session


@click.command(name="plot")
@click.argument("source", metavar="INPUT", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    metavar="OUT.png",
    type=click.Path(path_type=Path),
    help="Picture to write, .png, .pdf or .svg; INPUT with .png where not given.",
)
def command(source: Path, output: Path | None) -> None:
    """Draw BRDF samples or a fit on one page.

    INPUT is a FIT.json that 'gonio fit' wrote, a samples file, any BRDF file that gonio reads,
    or a session. With a fit come the samples it was made to, its posterior and, where the session
    is still there, raw frames: the files are looked for by the names they had, from the current
    folder and from the folder of INPUT.
    """
    output = source.with_suffix(".png") if output is None else output
    _check(source, output)
    from gonio.plot import save, summary

    if source.suffix == ".json":
        from gonio.fitting.result import FitResult

        fit = FitResult.load(source)
        samples, session = _fitted(source, fit)
        draws = _draws(source, fit)
        figure = summary(fit, samples, session, draws)
    else:
        samples, session = _measured(source, source, {})
        samples = _one_channel(source, samples)
        figure = summary(None, samples, session)
    save(figure, output)
    click.echo(f"written to {output}", err=True)


def _check(source: Path, output: Path) -> None:
    """Refuse what cannot be drawn or written before matplotlib is loaded."""
    from gonio.plot.style import format_of

    if not source.exists():
        raise DataError(f"{source}: no such file; give a fit or BRDF samples.", value=source)
    format_of(output)
    if output.is_dir():
        raise ConfigurationError(f"{output}: is a folder; give the name of a file.", value=output)
    if not output.parent.is_dir():
        raise DataError(
            f"{output}: the folder {output.parent} does not exist; make it first.", value=output
        )


def _fitted(source: Path, fit: FitResult) -> tuple[BRDFSamples, Session | None]:
    """The samples that the fit was made to, cut as it was, and their session."""
    name = fit.source.get("input")
    if not name:
        raise DataError(
            f"{source}: does not say which samples it was fitted to (source.input); "
            "make the fit again with 'gonio fit'.",
            value=source,
        )
    path = _find(str(name), source)
    if path is None:
        raise DataError(
            f"{source}: was fitted to {name}, which is neither in the current folder nor in that "
            "of the fit; put it there or change to the folder in which 'gonio fit' was run.",
            value=name,
        )
    samples, session = _measured(path, source, fit.cuts.get("select") or {})
    limits = (fit.cuts.get(key) for key in ("max_theta_i_deg", "max_theta_r_deg"))
    theta_i, theta_r = (None if limit is None else _radians(limit) for limit in limits)
    samples = samples.limited(max_theta_i=theta_i, max_theta_r=theta_r)
    if len(samples) != fit.n_samples:
        raise DataError(
            f"{path}: holds {len(samples)} samples and {source} was fitted to {fit.n_samples}; "
            "the file has changed since, make the fit again.",
            value=path,
        )
    return samples, session


def _measured(
    path: Path, source: Path, select: Mapping[str, str]
) -> tuple[BRDFSamples, Session | None]:
    """Samples from a file or a session, and the session where it is there."""
    from gonio import formats

    if not path.is_dir():
        samples = formats.read(path, select=select)
        return samples, _session(path, source, samples)
    from gonio.calibration.reduction import reduce
    from gonio.cli.progress import progress
    from gonio.session import Session

    session = Session.open(path)
    session.require_complete()
    with progress(f"reducing {path.name or path}", "images") as callback:
        return formats.choose(reduce(session, progress=callback), select), session


def _session(path: Path, source: Path, samples: BRDFSamples) -> Session | None:
    """The session that the samples came from; without it the frames are left out."""
    from gonio.session import Session

    name = samples.metadata.get("session")
    if not name:
        return None
    found = _find(str(name), path, source)
    if found is None:
        _left_out(f"the session {name} is not there: its frames are")
        return None
    return Session.open(found)


def _one_channel(source: Path, samples: BRDFSamples) -> BRDFSamples:
    """One BRDF at a time: of several wavelengths or channels the middle one, and says which."""
    from gonio import formats

    for key, column in (("wavelength", samples.wavelength_nm), ("channel", samples.channel)):
        values = [] if column is None else sorted(set(column.tolist()))
        if len(values) > 1:
            middle = str(values[len(values) // 2])
            click.echo(f"{source} holds {len(values)} {key}s: drawn is {key} {middle}.", err=True)
            samples = formats.choose(samples, {key: middle})
    return samples


def _draws(source: Path, fit: FitResult) -> Path | None:
    """The posterior's draws; without them the posterior is left out."""
    if fit.posterior is None or fit.posterior.draws is None:
        return None
    found = _find(fit.posterior.draws, source)
    if found is None:
        _left_out(f"the draws {fit.posterior.draws} are not there: the posterior is")
    return found


def _find(name: str, *beside: Path) -> Path | None:
    """A file by the name it had: from the current folder, or beside one of these files."""
    candidates = [Path(name)]
    for file in beside:
        candidates += [file.parent / name, file.parent / Path(name).name]
    return next((path for path in candidates if path.exists()), None)


def _left_out(text: str) -> None:
    click.echo(f"{text} left out of the picture.", err=True)


def _radians(limit: Any) -> float:
    from math import radians

    return radians(float(limit))
