"""The samples of a command: from a session or a file, of one channel, within limits of angles."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import rich_click as click

from gonio.errors import ConfigurationError
from gonio.fitting.result.lines import WEIGHTS

if TYPE_CHECKING:
    from gonio.samples import BRDFSamples

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS = (
    click.option(
        "--weights",
        type=click.Choice(list(WEIGHTS)),
        help="Weight of each residual: one over its standard uncertainty (sd, the default where "
        "uncertainties are stated), 1 (none), one over the fitted value (relative), cos theta_r, "
        "or cos theta_i cos theta_r.",
    ),
    click.option(
        "--select",
        "selections",
        multiple=True,
        metavar="KEY=VALUE",
        help="Use part of a file: wavelength=650 (nm) or channel=NAME. Several wavelengths: "
        "wavelength=450,650, wavelength=600..700 or wavelength=600.. .",
    ),
    click.option(
        "--max-theta-i",
        type=click.FloatRange(0, 90),
        metavar="DEG",
        help="Largest angle of incidence.",
    ),
    click.option(
        "--max-theta-r", type=click.FloatRange(0, 90), metavar="DEG", help="Largest viewing angle."
    ),
)


def sample_options(command: F) -> F:
    """Options --weights, --select, --max-theta-i and --max-theta-r, in this order."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def read_samples(
    source: Path,
    selections: tuple[str, ...],
    max_theta_i: float | None,
    max_theta_r: float | None,
    threads: int | None,
    *,
    several: bool = False,
    hint: str = "",
) -> tuple[BRDFSamples, dict[str, Any]]:
    """Samples within the angles (degrees), and the cuts in the form that a result stores.

    Parameters
    ----------
    several : bool
        Allow several channels or wavelengths.
    hint : str
        Further advice for the message that refuses them.

    Raises
    ------
    ConfigurationError
        If a selection is not KEY=VALUE, or several channels or wavelengths remain and are not
        allowed.
    DataError
        If the source cannot be read, or no sample remains.
    """
    select = pairs(selections)
    samples = read_source(source, select, threads)
    radians = [
        None if limit is None else math.radians(limit) for limit in (max_theta_i, max_theta_r)
    ]
    samples = samples.limited(max_theta_i=radians[0], max_theta_r=radians[1])
    if not several:
        _require_one_channel(source, samples, hint)
    cuts = {"select": select, "max_theta_i_deg": max_theta_i, "max_theta_r_deg": max_theta_r}
    return samples, cuts


def pairs(selections: tuple[str, ...]) -> dict[str, str]:
    """Selections by key; several values of one key select any of them.

    Raises
    ------
    ConfigurationError
        If one is not KEY=VALUE.

    Examples
    --------
    >>> pairs(("wavelength=450", "wavelength=600..700"))
    {'wavelength': '450,600..700'}
    """
    by_key: dict[str, str] = {}
    for item in selections:
        bound = re.fullmatch(r"\s*(\w+)\s*=?\s*([<>])[\s=]*(.*)", item)
        if bound:
            key, sign, value = bound[1], bound[2], bound[3].strip() or "600"
            text = f"{key}=..{value}" if sign == "<" else f"{key}={value}.."
            raise ConfigurationError(f"--select {item!r}: a range is written {text}", value=item)
        key, equals, value = (part.strip() for part in item.partition("="))
        if not (equals and key and value):
            raise ConfigurationError(
                f"--select {item!r}: give KEY=VALUE, for instance wavelength=650.", value=item
            )
        by_key[key] = f"{by_key[key]},{value}" if key in by_key else value
    return by_key


def read_source(source: Path, select: dict[str, str], threads: int | None) -> BRDFSamples:
    """The selected samples (see `pairs`) of a session folder or a file."""
    from gonio.cli.progress import stages
    from gonio.reading import load

    with stages() as callback:
        return load(source, select=select, threads=threads, progress=callback)


def _require_one_channel(source: Path, samples: BRDFSamples, hint: str) -> None:
    """Refuse samples of several wavelengths or channels."""
    from gonio.reading import several

    kinds = several(samples)
    if kinds is not None:
        key, values = kinds
        raise ConfigurationError(
            f"{source}: holds {len(values)} {key}s; choose one with --select {key}=VALUE, "
            f"of {', '.join(values[:40])}.{hint}",
            value=values,
        )
