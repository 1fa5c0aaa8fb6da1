"""Charts as plain data for plotly.js: views to choose from, numbers with few digits."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Trace = dict[str, Any]
DIGITS = 4


@dataclass(frozen=True)
class View:
    """Traces and layout of one state of a chart, as plotly names them."""

    label: str
    data: list[Trace]
    layout: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Chart:
    """A chart of a report.

    Parameters
    ----------
    ident : str
        Its name in the page.
    chooses : str
        Label of the menu: the property by which the views differ.
    views : tuple of View
    caption : str
    height : int
        Pixels on a screen.
    first : int
        The view that is shown first.
    min_width : int
        Smallest width in pixels; on a narrower screen the chart scrolls sideways.
    print_height : int
        Largest height on paper, pixels. Three charts of the usual height fit on a page of A4, so
        that none leaves half a page empty.
    """

    ident: str
    chooses: str
    views: tuple[View, ...]
    caption: str
    height: int = 420
    first: int = 0
    min_width: int = 0
    print_height: int = 225


def short(values: ArrayLike, digits: int = DIGITS) -> list[Any]:
    """Numbers rounded to `digits` significant digits, nested as the array is.

    Examples
    --------
    >>> short([1.23456, 1e-9 / 3], 3)
    [1.23, 3.33e-10]
    """
    array = np.asarray(values, float)
    if array.ndim > 1:
        return [short(row, digits) for row in array]
    return [float(f"{x:.{digits}g}") if np.isfinite(x) else None for x in array.tolist()]


def axis(title: str, **more: Any) -> dict[str, Any]:
    """A plotly axis with its title."""
    return {"title": {"text": title}, **more}


def faded(colour: str, alpha: float) -> str:
    """A colour #rrggbb with an opacity.

    Examples
    --------
    >>> faded("#0072B2", 0.25)
    'rgba(0, 114, 178, 0.25)'
    """
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return f"rgba({red}, {green}, {blue}, {alpha:g})"


def spread(items: Iterable[Any], n: int) -> list[Any]:
    """At most n of the items, evenly spread, first and last among them.

    Examples
    --------
    >>> spread(range(10), 4)
    [0, 3, 6, 9]
    """
    items = list(items)
    if len(items) <= n:
        return items
    return [items[k] for k in np.linspace(0, len(items) - 1, n).round().astype(int)]
