"""Style of the pictures and their files; no setting outlives its `with` block."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gonio.errors import ConfigurationError, DataError
from gonio.files import atomic_path
from gonio.models import Parameter

# Okabe and Ito's colours, which the colour-blind can tell apart, darkest first.
BLACK, BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY = COLOURS = (
    "#000000",
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#E69F00",
    "#56B4E9",
)
GREY = "#666666"
FORMATS = ("png", "pdf", "svg")
DPI = 160
UNITS = {"in": 1.0, "cm": 2.54, "mm": 25.4}  # in an inch
EDGES = (2.0, 60.0)  # shortest and longest edge of a picture, inches
DOTS = (30.0, 2400.0)  # dots an inch
PIXELS = 30_000  # most along an edge

_SETTINGS: Any = {
    "font.family": "DejaVu Sans",  # comes with matplotlib and has every symbol of the models
    "font.size": 8.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.prop_cycle": cycler(color=list(COLOURS)),
    "axes.formatter.useoffset": False,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "savefig.dpi": DPI,
    "svg.fonttype": "none",
    "svg.hashsalt": "gonio",
    "pdf.fonttype": 42,
}
# The same figure gives the same file, whenever it is written.
_UNDATED: dict[str, dict[str, Any]] = {
    "png": {},
    "pdf": {"CreationDate": None},
    "svg": {"Date": None},
}


@contextmanager
def style() -> Iterator[None]:
    """Matplotlib settings of these pictures for the length of a `with` block.

    The pictures can be read in print, 9 to 10 inches wide, and by the colour-blind.

    Examples
    --------
    >>> import matplotlib
    >>> before = matplotlib.rcParams["font.size"]
    >>> with style():
    ...     inside = matplotlib.rcParams["font.size"]
    >>> inside, matplotlib.rcParams["font.size"] == before
    (8.0, True)
    """
    with mpl.rc_context(_SETTINGS):
        yield


def new_axes(width: float = 6.4, height: float = 4.0) -> Axes:
    """Axes on a figure of their own, size in inches.

    pyplot owns the figure, so that it appears in a notebook; without a display pyplot falls back
    to the Agg backend by itself.
    """
    return _new_figure(width, height).add_subplot()


def _new_figure(width: float, height: float) -> Figure:
    import matplotlib.pyplot as plt

    return plt.figure(figsize=(width, height), layout="constrained")


def format_of(path: str | Path) -> str:
    """File format that the suffix of `path` asks for.

    Raises
    ------
    ConfigurationError
        If it is none of png, pdf and svg.

    Examples
    --------
    >>> format_of("lobe.PDF")
    'pdf'
    """
    suffix = Path(path).suffix.lower().removeprefix(".")
    if suffix not in FORMATS:
        allowed = ", ".join(f".{name}" for name in FORMATS)
        raise ConfigurationError(
            f"{path}: pictures are written as {allowed}; give a name that ends so.", value=path
        )
    return suffix


def save(
    figure: Figure,
    path: str | Path,
    *,
    size: tuple[float, float] | None = None,
    dpi: float | None = None,
) -> None:
    """Write a figure as PNG, PDF or SVG, whole or not at all.

    Parameters
    ----------
    figure : Figure
        The figure; it has the same size afterwards.
    path : path
        The suffix, .png, .pdf or .svg, decides the format.
    size : tuple of float, optional
        Width and height of the picture in inches; those of the figure where not given. Letters
        and lines keep their size in print.
    dpi : float, optional
        Dots an inch of a PNG, and of the pictures inside a PDF or SVG; 160 where not given.

    Raises
    ------
    ConfigurationError
        For another suffix, a size or a resolution out of range, or if `path` is a folder.
    DataError
        If the file cannot be written.
    """
    path = Path(path)
    kind = format_of(path)
    check_size(size, dpi)
    if path.is_dir():
        raise ConfigurationError(f"{path}: is a folder; give the name of a file.", value=path)
    width, height = figure.get_size_inches()
    with style(), atomic_path(path) as temporary, warnings.catch_warnings():
        if size is not None:
            figure.set_size_inches(size)
            for ax in figure.axes:
                ax.xaxis.label.set_wrap(True)
            warnings.filterwarnings("error", "constrained_layout not applied", UserWarning)
        try:
            figure.savefig(temporary, format=kind, dpi=dpi or DPI, metadata=_UNDATED[kind])
        except UserWarning:
            raise ConfigurationError(
                f"the picture's labels leave no room for its panels at {_inches(figure)}; give a "
                f"larger --size (drawn for {width:.3g} x {height:.3g} inches).",
                value=size,
            ) from None
        finally:
            figure.set_size_inches(width, height)


def _inches(figure: Figure) -> str:
    wide, high = figure.get_size_inches()
    return f"{wide:.3g} x {high:.3g} inches"


def parse_size(text: str) -> tuple[float, float]:
    """Width and height in inches from a text such as 6.4x4, 6.4x4in or 160x100mm.

    Raises
    ------
    ConfigurationError
        If the text is not a size, or one that no picture can have.

    Examples
    --------
    >>> parse_size("6.4x4"), parse_size("254x127mm")
    ((6.4, 4.0), (10.0, 5.0))
    """
    match = re.fullmatch(r"\s*([\d.]+)\s*x\s*([\d.]+)\s*(in|mm|cm)?\s*", text.lower())
    try:
        edges = [float(edge) for edge in match.groups()[:2]] if match else []
    except ValueError:
        edges = []
    if match is None or not edges:
        raise ConfigurationError(
            f"--size {text!r} is not WIDTHxHEIGHT; write it in inches as 6.4x4, or with a unit as "
            "160x100mm.",
            value=text,
        )
    scale = UNITS[match[3] or "in"]
    size = edges[0] / scale, edges[1] / scale
    check_size(size)
    return size


def check_size(size: tuple[float, float] | None, dpi: float | None = None) -> None:
    """Refuse a size in inches or a resolution that no picture can have.

    Raises
    ------
    ConfigurationError
        If an edge or the resolution is out of range, or both together make too many pixels.
    """
    if size is not None and not all(EDGES[0] <= edge <= EDGES[1] for edge in size):
        raise ConfigurationError(
            f"the size {size[0]:.4g} x {size[1]:.4g} inches is out of range; each edge is "
            f"{EDGES[0]:g} to {EDGES[1]:g} inches ({25.4 * EDGES[0]:.0f} to "
            f"{25.4 * EDGES[1]:.0f} mm).",
            value=size,
        )
    if dpi is not None and not DOTS[0] <= dpi <= DOTS[1]:
        raise ConfigurationError(
            f"{dpi:g} dots an inch are out of range; allowed are {DOTS[0]:g} to {DOTS[1]:g}.",
            value=dpi,
        )
    if size is not None and max(size) * (dpi or DPI) > PIXELS:
        raise ConfigurationError(
            f"{size[0]:.4g} x {size[1]:.4g} inches at {dpi or DPI:g} dots an inch are more than "
            f"{PIXELS} pixels along an edge; give a smaller --size or --dpi.",
            value=size,
        )


def symbol(parameter: Parameter, *, unit: bool = False) -> str:
    r"""A parameter's symbol in matplotlib's mathematical notation, on request with its unit.

    Examples
    --------
    >>> from gonio import models
    >>> symbol(models.get("ward").parameter("alpha_x"))
    '$α_{\\mathrm{x}}$'
    >>> symbol(models.get("oren_nayar").parameter("sigma"), unit=True)
    '$σ$ (°)'
    """
    text = re.sub(r"_(\w+)", r"_{\\mathrm{\1}}", parameter.symbol)
    suffix = f" ({unit_text(parameter.file_unit)})" if unit and parameter.file_unit else ""
    return f"${text}${suffix}"


def unit_text(unit: str) -> str:
    """A unit of files as it stands on an axis: ° for degrees."""
    return "°" if unit == "deg" else unit


def nothing_to_draw(reason: str) -> DataError:
    """The error of a panel that has no content."""
    return DataError(f"there is nothing to draw: {reason}.")
