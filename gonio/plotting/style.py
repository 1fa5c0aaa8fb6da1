"""How the pictures look, and how they are written: no setting outlives its `with` block."""

from __future__ import annotations

import re
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

    Readable in print at 9 to 10 inches width and by the colour-blind.

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


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG (160 dots an inch), PDF or SVG, whole or not at all.

    Parameters
    ----------
    figure : Figure
    path : path
        The suffix, .png, .pdf or .svg, decides the format.

    Raises
    ------
    ConfigurationError
        For another suffix, or if `path` is a folder.
    DataError
        If the file cannot be written.
    """
    path = Path(path)
    kind = format_of(path)
    if path.is_dir():
        raise ConfigurationError(f"{path}: is a folder; give the name of a file.", value=path)
    with style(), atomic_path(path) as temporary:
        figure.savefig(temporary, format=kind, metadata=_UNDATED[kind])


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


def nothing_to_draw(what: str) -> DataError:
    """The error of a panel that has no content."""
    return DataError(f"there is nothing to draw: {what}.")
