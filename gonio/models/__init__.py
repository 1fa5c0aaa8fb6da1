"""Reflectance models: one file of this folder is one model.

A file that defines `MODEL = Model(...)` is a model; no other file lists it. Names joined
by "+" are a model too, the sum of theirs. Models from outside the package come as objects, from a
file that the user names (`load`), or from an installed package that announces them
(`gonio.models.external`).
"""

from __future__ import annotations

from functools import cache
from typing import Any

from gonio.discovery import records_in
from gonio.errors import ConfigurationError, unknown_name
from gonio.models import external
from gonio.models._sums import SIGN, added, term_names
from gonio.models.base import Claims, Model, Parameter
from gonio.models.sampling import Cosine, Draws, Lobe
from gonio.models.source import Fitted, check_source, source_of, unknown_source

__all__ = [
    "Claims",
    "Cosine",
    "Draws",
    "Lobe",
    "Model",
    "Parameter",
    "get",
    "load",
    "names",
    "of_fit",
    "origin",
    "resolve",
    "source_of",
]

# Models from outside that were used in this process, so that a result's name leads to them.
_used: dict[str, Model] = {}
_sums: dict[tuple[tuple[str, Any], ...], Model] = {}


@cache
def _all() -> dict[str, Model]:
    models = {model.name: model for model in records_in(__name__, "MODEL", Model)}
    return dict(sorted(models.items()))


@cache
def _installed() -> dict[str, Model]:
    """Models that installed packages announce, under names that gonio does not use itself."""
    models = {}
    for name, entry in external.announced().items():
        if name in _all():
            external.log.warning(
                "the package %s announces a model named %r, which is a model of gonio; it is left "
                "out.", external.package(entry), name,
            )  # fmt: skip
        elif (model := external.installed(name)) is not None:
            models[name] = model
    return models


def names() -> list[str]:
    """Names of the single models, sorted, with those of installed packages; any may be joined by
    "+".

    Examples
    --------
    >>> "ward" in names()
    True
    """
    return sorted({*_all(), *_installed()})


def origin(name: str) -> str:
    """Where the model with this name comes from: "gonio", a package with its version, or a file.

    Examples
    --------
    >>> origin("ward")
    'gonio'
    """
    if name in _all():
        return "gonio"
    if name in _used:
        return str((source_of(_used[name]) or {}).get("file") or "this session")
    entry = external.announced().get(name)
    return external.package(entry) if entry is not None else "gonio"


def get(name: str | Model) -> Model:
    """The model with this name.

    Parameters
    ----------
    name : str or Model
        One of `names()`, or several joined by "+" for their sum. A parameter's name that occurs
        in several terms then ends in the number of its term: rho_s_1, rho_s_2. A `Model` is given
        back, and from then on found by its name unless gonio has a model of that name itself.

    Raises
    ------
    ConfigurationError
        If there is no such model, with the nearest name, a sum lacks a term, or what is given is
        neither a name nor a `Model`.

    Examples
    --------
    >>> from gonio.geometry import Directions
    >>> f = get("lambert")(Directions(0.1, 0.0, 0.2, 0.0), rho=0.5)
    >>> round(float(f), 6)
    0.159155
    >>> get("lambert+ward_duer").names
    ('rho', 'rho_d', 'rho_s', 'alpha_x', 'alpha_y')
    """
    if isinstance(name, Model):
        for term in name.terms:
            get(term)
        if not name.terms and name.name not in _all():
            _used[name.name] = name
        return name
    if not isinstance(name, str):
        raise ConfigurationError(
            f"a model is given by its name or as a gonio.Model, not as {type(name).__name__}; a "
            "function of arrays becomes one by Model.from_function(function, parameters)."
        )
    if name in _used:
        return _used[name]
    if SIGN in name:
        return _sum(tuple(get(term) for term in term_names(name)))
    if name in _all():
        return _all()[name]
    if name in external.announced() and name in _installed():
        return _installed()[name]
    raise unknown_name("model", name, [*names(), *_used])


def load(file: str) -> Model:
    """The model that a file of Python defines; the file is run.

    Parameters
    ----------
    file : str
        `path/to/file.py`, which defines `MODEL`, or `path/to/file.py:NAME`.

    Returns
    -------
    Model
        Found by `get` under its name from then on.

    Raises
    ------
    DataError
        If there is no such file.
    ConfigurationError
        If the file cannot be run or does not define a `Model`, or its name is one of gonio's.
    """
    model = external.from_file(str(file))
    if model.name in _all():
        raise ConfigurationError(
            f"{file}: its model is named {model.name!r}, which is a model of gonio; give it "
            "another name.",
            value=model.name,
        )
    return get(model)


def resolve(text: str) -> Model:
    """The model that `--model` means: a name, a file, or several of them joined by "+".

    Parameters
    ----------
    text : str
        As `get` takes it, or `path/to/file.py`, or `file.py:NAME`.

    Raises
    ------
    DataError, ConfigurationError
        As `get` and `load`.
    """
    if external.is_file(text) and SIGN not in text:
        return load(text)
    terms = term_names(text) if SIGN in text else [text]
    return get(SIGN.join(load(t).name if external.is_file(t) else t for t in terms))


def of_fit(fit: Fitted) -> Model:
    """The model that a fit was made with.

    Parameters
    ----------
    fit : FitResult
        Names its model, and keeps the hash of its source where that is not part of gonio.

    Raises
    ------
    ConfigurationError
        If the model comes from outside and was not given, or is another one now.
    """
    try:
        model = get(fit.model)
    except ConfigurationError:
        if fit.model_source is None:
            raise
        raise unknown_source(fit) from None
    return check_source(model, fit)


def _sum(terms: tuple[Model, ...]) -> Model:
    """Made once for the same kernels, so that its loops are compiled once."""
    key = tuple((term.name, term.kernel) for term in terms)
    if key not in _sums:
        _sums[key] = added(terms)
    return _sums[key]
