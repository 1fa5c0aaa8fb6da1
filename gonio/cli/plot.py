"""`gonio plot`: a model, BRDF samples or a fit as a picture."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rich_click as click

from gonio.errors import ConfigurationError, DataError, unknown_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gonio.fitting.result import FitResult
    from gonio.models import Model
    from gonio.samples import BRDFSamples
    from gonio.session import Session

# What each kind of picture is made of.
KINDS = {
    "summary": "samples",
    "slices": "samples",
    "hemisphere": "samples or model",
    "residuals": "fit",
    "frames": "session",
    "lobe": "model",
    "solid": "model",
    "albedo": "model",
}
SMALLEST_PAGE = 0.85  # of the size that the page is made for
SIGNS = ("model:", "material:")


@dataclass(frozen=True)
class _Content:
    """What there is to draw; what is not there is None."""

    fit: FitResult | None = None
    samples: BRDFSamples | None = None
    session: Session | None = None
    draws: Any = None
    model: Model | None = None
    parameters: Mapping[str, float] | None = None

    def has(self, what: str) -> bool:
        """Whether there is one of the things that are named, as in "samples or model"."""
        return any(getattr(self, word) is not None for word in what.split(" or "))


@click.command(name="plot")
@click.argument("source", metavar="INPUT")
@click.option(
    "--kind",
    metavar="|".join(KINDS),
    help="One picture in place of the page: the plane of incidence, the hemisphere of viewing "
    "directions, what a fit leaves over, raw frames, a model's polar lobe, its lobe in space or "
    "its albedo.",
)
@click.option(
    "-p",
    "--parameter",
    "items",
    multiple=True,
    metavar="NAME=VALUE",
    help="A parameter of model:NAME or material:NAME, angles in degrees; repeat for each.",
)
@click.option(
    "-o",
    "--output",
    metavar="OUT.png|.pdf|.svg",
    type=click.Path(path_type=Path),
    help="Picture to write; its suffix decides the format; INPUT with .png where not given.",
)
@click.option(
    "--size",
    metavar="WxH",
    help="Width and height of the picture in inches, or with a unit, such as 160x100mm; letters "
    "keep their size.",
)
@click.option(
    "--dpi",
    type=float,
    metavar="N",
    help="Dots an inch of a PNG, and of the images inside a PDF or SVG; 160 where not given.",
)
@click.option(
    "--select",
    "selections",
    multiple=True,
    metavar="KEY=VALUE",
    help="Part of a file or of a joint fit: wavelength=650, channel=NAME or part=NAME.",
)
def command(
    source: str,
    kind: str | None,
    items: tuple[str, ...],
    output: Path | None,
    size: str | None,
    dpi: float | None,
    selections: tuple[str, ...],
) -> None:
    """Draw a model, BRDF samples or a fit.

    INPUT is a FIT.json that 'gonio fit' wrote, a samples file, any BRDF file that gonio reads,
    a session, or model:NAME or material:NAME. Without --kind it is drawn on one page, a model as
    its lobe. With a fit come the samples it was made to, its posterior and, where the session is
    still there, raw frames: the files are looked for by the names they had, from the current
    folder and from the folder of INPUT.
    """
    named = source.startswith(SIGNS)
    if output is None:
        name = source.partition(":")[2] if named else source
        output = Path(f"{name}.png") if named else Path(source).with_suffix(".png")
    _check(None if named else Path(source), output, kind, items)
    inches = _inches(size, dpi)
    content = _named(source, items) if named else _read(Path(source), selections)
    kind = kind or ("lobe" if named else "summary")
    if not content.has(KINDS[kind]):
        raise ConfigurationError(
            f"--kind {kind} is drawn of {KINDS[kind]}, and {source} has none; it can be drawn "
            f"as {', '.join(k for k, what in KINDS.items() if content.has(what))}.",
            value=kind,
        )
    from gonio.plotting import save

    figure = _drawn(kind, content)
    if kind == "summary" and inches is not None:
        _check_page(inches, tuple(figure.get_size_inches()))
    save(figure, output, size=inches, dpi=dpi)
    click.echo(f"written to {output}", err=True)


def _check(source: Path | None, output: Path, kind: str | None, items: tuple[str, ...]) -> None:
    """Refuse what cannot be drawn or written before matplotlib is loaded."""
    from gonio.cli.options import check_target
    from gonio.plotting.style import format_of

    if kind is not None and kind not in KINDS:
        raise unknown_name("kind of picture", kind, KINDS)
    if source is not None:
        if not source.exists():
            raise DataError(
                f"{source}: no such file; give a fit, BRDF samples, a session or model:NAME.",
                value=source,
            )
        if items:
            raise ConfigurationError(
                f"-p goes with model:NAME or material:NAME, and {source} has its own values.",
                value=items,
            )
    format_of(output)
    check_target(output)


def _inches(size: str | None, dpi: float | None) -> tuple[float, float] | None:
    """Width and height in inches; what no picture can have is refused before it is drawn."""
    from gonio.plotting.style import check_size, parse_size

    inches = None if size is None else parse_size(size)
    check_size(inches, dpi)
    return inches


def _check_page(size: tuple[float, float], own: tuple[float, float]) -> None:
    """Refuse a page on which the panels would run into each other."""
    least = SMALLEST_PAGE * own[0], SMALLEST_PAGE * own[1]
    if size[0] < least[0] or size[1] < least[1]:
        raise ConfigurationError(
            f"the whole page needs {least[0]:.3g} x {least[1]:.3g} inches at least and --size is "
            f"{size[0]:.3g} x {size[1]:.3g} inches; draw one picture of it with --kind slices, "
            "for instance.",
            value=size,
        )


def _named(source: str, items: tuple[str, ...]) -> _Content:
    """A model or a material by its name, with the parameters that were given."""
    import gonio.materials as materials
    import gonio.models as models
    from gonio.cli.options import parse_parameters

    sign, _, name = source.partition(":")
    known: dict[str, float] = {}
    if sign == "material":
        material = materials.get(name)
        name, known = material.model, dict(material.parameters)
    model = models.get(name)
    return _Content(model=model, parameters=known | parse_parameters(model, items))


def _read(source: Path, selections: tuple[str, ...]) -> _Content:
    from gonio.cli.measured import pairs

    if source.suffix == ".json":
        return _fitted(source, selections)
    samples, session = _measured(source, pairs(selections))
    return _Content(samples=_one_channel(source, samples), session=session)


def _fitted(source: Path, selections: tuple[str, ...]) -> _Content:
    """A fit with what belongs to it; the samples must be there, the rest may be missing."""
    import gonio.models as models
    from gonio.cli.joint import part_chooser
    from gonio.reporting.inputs import gather

    found = gather(source, _reduced, part_chooser(source, selections, middle=True))
    if found.samples is None:
        why = next(line for line in found.absent if line.startswith("The samples: "))
        raise DataError(
            f"{source}: {why.removeprefix('The samples: ')} Change to the folder in which "
            "'gonio fit' was run, or make the fit again.",
            value=source,
        )
    for line in found.absent:
        click.echo(f"Left out of the picture: {line}", err=True)
    fit = found.fit
    session = found.session or _session(source, found.samples)
    model = models.get(fit.model)
    return _Content(fit, found.samples, session, found.draws, model, fit.values())


def _measured(path: Path, select: Mapping[str, str]) -> tuple[BRDFSamples, Session | None]:
    """Samples from a file or a session, and the session where it is there."""
    from gonio.cli.progress import stages
    from gonio.reading import load_with_session

    with stages() as callback:
        samples, session = load_with_session(path, select, progress=callback)
    return samples, session or _session(path, samples)


def _reduced(session: Session) -> BRDFSamples:
    from gonio.calibration.reduction.reduce import reduce
    from gonio.cli.progress import progress

    with progress(f"reducing {session.path.name or session.path}", "images") as callback:
        return reduce(session, progress=callback)


def _session(path: Path, samples: BRDFSamples) -> Session | None:
    """The session that the samples came from; without it the frames are left out."""
    from gonio.session import Session

    name = samples.metadata.get("session")
    if not name:
        return None
    found = _find(str(name), path)
    if found is None:
        click.echo(
            f"the session {name} is not there: its frames are left out of the picture.", err=True
        )
        return None
    return Session.open(found)


def _one_channel(source: Path, samples: BRDFSamples) -> BRDFSamples:
    """One BRDF at a time: of several wavelengths or channels the middle one, and says which."""
    import gonio.formats as formats

    for key, column in (("wavelength", samples.wavelength_nm), ("channel", samples.channel)):
        values = [] if column is None else sorted(set(column.tolist()))
        if len(values) > 1:
            middle = str(values[len(values) // 2])
            click.echo(f"{source} holds {len(values)} {key}s: drawn is {key} {middle}.", err=True)
            samples = formats.choose(samples, {key: middle})
    return samples


def _find(name: str, beside: Path) -> Path | None:
    """A file by the name it had: from the current folder, or beside another file."""
    candidates = (Path(name), beside.parent / name, beside.parent / Path(name).name)
    return next((path for path in candidates if path.exists()), None)


def _drawn(kind: str, content: _Content) -> Figure:
    """The figure of one kind; `content` has what the kind is made of."""
    import gonio.plotting as plotting

    fit, samples, session = content.fit, content.samples, content.session
    model, values = content.model, content.parameters
    figures: dict[str, Callable[[], Figure]] = {}
    if samples is not None:
        figures["summary"] = lambda: plotting.summary(fit, samples, session, content.draws)
        figures["slices"] = lambda: _figure(plotting.slices(samples, fit))
        figures["hemisphere"] = lambda: _figure(*plotting.hemisphere_samples(samples))
        if fit is not None:
            figures["residuals"] = lambda: _figure(*plotting.residual_map(samples, fit))
    if session is not None:
        figures["frames"] = lambda: _figure(*plotting.frames(session))
    if model is not None:
        figures["lobe"] = lambda: _figure(*plotting.model_lobes(model, values))
        figures["solid"] = lambda: _figure(plotting.lobe_solid(model, values))
        figures["albedo"] = lambda: _figure(plotting.albedo_curve(model, values))
        figures.setdefault("hemisphere", lambda: _figure(*plotting.hemisphere_map(model, values)))
    return figures[kind]()


def _figure(*axes: Axes) -> Figure:
    """The figure on which these axes stand."""
    figure = axes[0].get_figure(root=True)
    assert figure is not None
    return figure
