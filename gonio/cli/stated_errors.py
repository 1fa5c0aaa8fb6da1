"""Options for errors that all samples of a file share, as its owner states them."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import rich_click as click

from gonio.errors import ConfigurationError

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS = (
    click.option(
        "--u-scale",
        metavar="FRACTION",
        help="Standard uncertainty of one factor on all values, for instance 1% or 0.01.",
    ),
    click.option(
        "--u-angle",
        type=click.FloatRange(0, 10, min_open=True),
        metavar="DEG",
        help="Standard uncertainty of the alignment: one turn of the viewing directions within the "
        "plane of incidence, one out of it, and one of the sample about its normal.",
    ),
)


def stated_error_options(command: F) -> F:
    """Options --u-scale and --u-angle, in this order."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def read_stated_errors(u_scale: str | None, u_angle: float | None) -> dict[str, float | None]:
    """Keyword arguments of `fit` and `compare`: a fraction, and radians.

    Raises
    ------
    ConfigurationError
        If the scale is no fraction or percentage.

    Examples
    --------
    >>> read_stated_errors("1 %", None)
    {'u_scale': 0.01, 'u_angle': None}
    """
    scale = None
    if u_scale is not None:
        text = u_scale.strip()
        try:
            number = float(text.removesuffix("%"))
        except ValueError:
            raise ConfigurationError(
                f"--u-scale {u_scale!r}: give a fraction or a percentage, for instance 1%.",
                value=u_scale,
            ) from None
        scale = number / 100 if text.endswith("%") else number
    return {"u_scale": scale, "u_angle": None if u_angle is None else math.radians(u_angle)}
