"""Reflectance models: one file is one model, found by looking into this folder.

A file that defines `MODEL = Model(...)` is a model; nothing else has to be told of it.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from gonio.errors import unknown_name
from gonio.models.base import Claims, Model, Parameter

__all__ = ["Claims", "Model", "Parameter", "get", "names"]


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
    """Names of all models, sorted.

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
        One of `names()`.

    Raises
    ------
    ConfigurationError
        If there is no such model, with the nearest name.

    Examples
    --------
    >>> from gonio.geometry import Directions
    >>> f = get("lambert")(Directions(0.1, 0.0, 0.2, 0.0), rho=0.5)
    >>> round(float(f), 6)
    0.159155
    """
    try:
        return _all()[name]
    except KeyError:
        raise unknown_name("model", name, _all()) from None
