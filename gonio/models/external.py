"""Models from outside the package: files that the user names, and packages that are installed.

Code is run only where the user names a file, or has installed a package that announces a model in
the entry point group `gonio.models`. A name alone, such as that in a fit's file, runs none.
"""

from __future__ import annotations

import hashlib
import importlib.util
import logging
import os
import sys
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from gonio.errors import ConfigurationError, DataError
from gonio.models.base import Model

GROUP = "gonio.models"
DEFAULT_NAME = "MODEL"

log = logging.getLogger(__name__)


def is_file(text: str) -> bool:
    """Whether a text names a file, as `path/to/file.py` or `file.py:NAME`, and no model.

    Examples
    --------
    >>> is_file("ward"), is_file("mine.py"), is_file("lab/mine.py:PAINT")
    (False, True, True)
    """
    return _parts(text)[0].endswith(".py") or os.sep in text


def from_file(text: str) -> Model:
    """The model that a file of Python defines, which is run.

    Parameters
    ----------
    text : str
        `path/to/file.py`, which defines `MODEL`, or `path/to/file.py:NAME`.

    Raises
    ------
    DataError
        If there is no such file.
    ConfigurationError
        If it cannot be run, does not define the name, or that is no `Model`.
    """
    file, name = _parts(text)
    path = Path(file)
    if not path.is_file():
        raise DataError(
            f"{path}: no such file; give a file of Python that defines a model, as FILE.py or "
            "FILE.py:NAME.",
            value=text,
        )
    try:
        module = _module(path.resolve())
    except SyntaxError as error:
        raise ConfigurationError(
            f"{path}: line {error.lineno} is no Python ({error.msg}); correct it.", value=text
        ) from error
    except Exception as error:
        raise ConfigurationError(
            f"{path}: the file stops with {type(error).__name__}: {error}", value=text
        ) from error
    if name not in module:
        others = [key for key, value in module.items() if isinstance(value, Model)]
        hint = f"; it defines {', '.join(others)}: give FILE.py:NAME" if others else ""
        raise ConfigurationError(
            f"{path}: the file does not define {name}{hint or ', a gonio.models.Model'}.",
            value=text,
        )
    return _model(module[name], f"{path}: {name}")


def _parts(text: str) -> tuple[str, str]:
    """File and name."""
    file, sign, name = text.rpartition(":")
    return (file, name) if sign and name.isidentifier() and file else (text, DEFAULT_NAME)


def _model(value: object, what: str) -> Model:
    if not isinstance(value, Model):
        raise ConfigurationError(
            f"{what} is {type(value).__name__} and no Model; make one by gonio.models.Model(...) "
            "or Model.from_function(...).",
            value=value,
        )
    return value


def _module(path: Path) -> dict[str, object]:
    """The names of a file that is run, once for each content that it has."""
    return _run(path, hashlib.sha256(path.read_bytes()).hexdigest())


@cache
def _run(path: Path, digest: str) -> dict[str, object]:
    # Compiled code is found by the module's name, which must not be that of another file.
    name = f"gonio_model_{path.stem}_{digest[:12]}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return vars(module)


@cache
def announced() -> dict[str, EntryPoint]:
    """The entry points of installed packages by the name of their model; none is imported."""
    return {each.name: each for each in sorted(entry_points(group=GROUP))}


@cache
def installed(name: str) -> Model | None:
    """The model that an installed package announces; None, with a warning, if it cannot be had."""
    entry = announced().get(name)
    if entry is None:
        return None
    try:
        model = _model(entry.load(), f"{entry.value}, announced as the model {name!r},")
        if model.name != name:
            raise ConfigurationError(
                f"{entry.value} is announced as the model {name!r} and named {model.name!r}."
            )
    except Exception as error:
        log.warning(
            "the model %r of the package %s cannot be used (%s: %s); update or remove the package.",
            name, package(entry), type(error).__name__, error,
        )  # fmt: skip
        return None
    return model


def package(entry: EntryPoint) -> str:
    """Name and version of the package that announces a model."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else "?"
