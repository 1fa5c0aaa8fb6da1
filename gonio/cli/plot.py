"""`gonio plot`: a model, BRDF samples or a fit as a picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import rich_click as click

from gonio.cli.options import given, model_of_fit, samples_of_fit
from gonio.errors import ConfigurationError, DataError, unknown_name
from gonio.verbs.plot import KINDS, SIGNS, plot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SMALLEST_PAGE = 0.85  # of the size that the page is made for


@click.command(name="plot")
@click.argument("source", metavar="INPUT")
@click.option(
    "--kind",
    metavar="|".join(KINDS),
    help="Draw a single plot instead of the page: the plane of incidence, the hemisphere of "
    "viewing directions, the residuals of a fit, raw frames, or the polar lobe, the "
    "lobe in space or the albedo of a model, or the map of a dome.",
)
@click.option(
    "-p",
    "--parameter",
    "items",
    multiple=True,
    metavar="NAME=VALUE",
    help="Value of a parameter of model:NAME or material:NAME, angles in degrees; repeat for "
    "each parameter.",
)
@click.option(
    "-o",
    "--output",
    metavar="OUT.png|.pdf|.svg",
    type=click.Path(path_type=Path),
    help="Image file to write; its suffix sets the format. Default: INPUT with the suffix .png.",
)
@click.option(
    "--size",
    metavar="WxH",
    help="Width and height of the image in inches, or with a unit, such as 160x100mm; the "
    "font size does not change.",
)
@click.option(
    "--dpi",
    type=float,
    metavar="N",
    help="Dots per inch of a PNG and of the images inside a PDF or SVG; default: 160.",
)
@click.option(
    "--select",
    "selections",
    multiple=True,
    metavar="KEY=VALUE",
    help="Part of a file or of a joint fit: wavelength=650, channel=NAME or part=NAME.",
)
@samples_of_fit
@model_of_fit
def command(
    source: str,
    kind: str | None,
    items: tuple[str, ...],
    output: Path | None,
    size: str | None,
    dpi: float | None,
    selections: tuple[str, ...],
    samples: Path | None,
    model: str | None,
) -> None:
    """Draw a model, BRDF samples, a fit or a map of a dome.

    INPUT is a FIT.json of 'gonio fit', a samples file, any BRDF file that gonio reads, a session,
    a DOME.nc of 'gonio calibrate dome', or model:NAME, model:FILE.py or material:NAME. Without
    --kind, one page shows several plots; of a model, the lobe is drawn. With a fit, its samples,
    posterior and raw frames are also drawn, if the files exist. They are searched by their names in
    the current folder and in the folder of INPUT.
    """
    named = source.startswith(SIGNS)
    given(model, Path(source))
    if output is None:
        name = source.partition(":")[2] if named else source
        output = Path(f"{name}.png") if named else Path(source).with_suffix(".png")
    _check(None if named else Path(source), output, kind, items)
    inches = _inches(size, dpi)
    kind = kind or ("lobe" if named else "summary")
    figure = _figure(source, kind, _parameters(source, items) if named else {}, selections, samples)
    if kind == "summary" and inches is not None:
        _check_page(inches, tuple(figure.get_size_inches()))
    from gonio.plotting import save

    save(figure, output, size=inches, dpi=dpi)
    click.echo(f"written to {output}", err=True)


def _check(source: Path | None, output: Path, kind: str | None, items: tuple[str, ...]) -> None:
    """Refuse invalid input and output before matplotlib is imported."""
    from gonio.cli.options import check_target

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
    from gonio.plotting.style import format_of

    format_of(output)
    check_target(output)


def _inches(size: str | None, dpi: float | None) -> tuple[float, float] | None:
    """Width and height in inches; impossible sizes are refused before drawing."""
    from gonio.plotting.style import check_size, parse_size

    inches = None if size is None else parse_size(size)
    check_size(inches, dpi)
    return inches


def _check_page(size: tuple[float, float], own: tuple[float, float]) -> None:
    """Refuse a page that is too small for its panels."""
    least = SMALLEST_PAGE * own[0], SMALLEST_PAGE * own[1]
    if size[0] < least[0] or size[1] < least[1]:
        raise ConfigurationError(
            f"the whole page needs at least {least[0]:.3g} x {least[1]:.3g} inches and --size is "
            f"{size[0]:.3g} x {size[1]:.3g} inches; draw one picture of it with --kind slices, "
            "for instance.",
            value=size,
        )


def _parameters(source: str, items: tuple[str, ...]) -> dict[str, float]:
    """The given parameters of a model or a material."""
    import gonio.materials as materials
    import gonio.models as models
    from gonio.cli.options import parse_parameters

    sign, _, name = source.partition(":")
    model = models.resolve(materials.get(name).model if sign == "material" else name)
    return parse_parameters(model, items)


def _figure(
    source: str,
    kind: str | None,
    parameters: dict[str, float],
    selections: tuple[str, ...],
    samples: Path | None,
) -> Figure:
    """The figure, with the options' names in the messages."""
    from gonio.cli.joint import chooser
    from gonio.cli.measured import pairs
    from gonio.cli.progress import stages

    fit = Path(source).suffix == ".json" and not source.startswith(SIGNS)
    try:
        with stages() as callback:
            return plot(
                source,
                kind,
                parameters=parameters,
                samples=samples,
                select=pairs(selections),
                choose=chooser(Path(source), selections, middle=True) if fit else None,
                note=lambda text: click.echo(text, err=True),
                progress=callback,
            )
    except ConfigurationError as error:
        text = str(error)
        if text.startswith("kind "):
            raise ConfigurationError(f"--{text}", value=error.value) from None
        raise
