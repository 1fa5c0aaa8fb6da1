"""Reflectance models: one file is one model, found by looking into this folder.

A file that defines `MODEL = Model(...)` is a model; nothing else has to be told of it. Names joined
by "+" are a model too, the sum of theirs.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from gonio.errors import unknown_name
from gonio.models._sums import SIGN, added, term_names
from gonio.models.base import Claims, Model, Parameter
from gonio.models.sampling import Cosine, Draws, Lobe

__all__ = ["Claims", "Cosine", "Draws", "Lobe", "Model", "Parameter", "get", "names"]


@cache
def _all() -> dict[str, Model]:
    found = {}
    for info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{info.name}")
        model = getattr(module, "MODEL", None)
        if isinstance(model, Model):
            found[model.name] = model
    return dict(sorted(found.items()))


def names() -> list[str]:
    """Names of the single models, sorted; any of them may be joined by "+".

    Examples
    --------
    >>> "ward" in names()
    True
    """
    return list(_all())


def get(name: str) -> Model:
    """The model with this name.

    Parameters
    ----------
    name : str
        One of `names()`, or several joined by "+" for their sum. A parameter's name that occurs
        in several terms then ends in the number of its term: rho_s_1, rho_s_2.

    Raises
    ------
    ConfigurationError
        If there is no such model, with the nearest name, or a sum lacks a term.

    Examples
    --------
    >>> from gonio.geometry import Directions
    >>> f = get("lambert")(Directions(0.1, 0.0, 0.2, 0.0), rho=0.5)
    >>> round(float(f), 6)
    0.159155
    >>> get("lambert+ward_duer").names
    ('rho', 'rho_d', 'rho_s', 'alpha_x', 'alpha_y')
    """
    if SIGN in name:
        return _sum(*term_names(name))
    try:
        return _all()[name]
    except KeyError:
        raise unknown_name("model", name, _all()) from None


@cache
def _sum(*terms: str) -> Model:
    """Made once, so that its loops are compiled once."""
    return added([get(term) for term in terms])
