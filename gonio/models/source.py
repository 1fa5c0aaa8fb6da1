"""Where a model comes from: what a result keeps of a model that is not part of gonio."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

from gonio.errors import ConfigurationError
from gonio.kernels.sources import file_of, importable, ingredients, plain, reached
from gonio.models.base import Model

OWN = "gonio."


class Fitted(Protocol):
    """A result that names a model, such as `gonio.fitting.result.FitResult`."""

    @property
    def model(self) -> str:
        """Name of the model."""

    @property
    def model_source(self) -> Mapping[str, Any] | None:
        """What `source_of` said of it."""


def source_of(model: Model) -> dict[str, str | None] | None:
    """File and SHA-256 of a model from outside the package; None for gonio's own.

    Parameters
    ----------
    model : Model

    Returns
    -------
    dict or None
        "file": where its function stands, None if in no file; "sha256": of that file, as
        `sha256sum` prints it, or of the source of the function where it stands in a script or a
        notebook. Of a sum: those of its terms from outside.

    Examples
    --------
    >>> from gonio import models
    >>> source_of(models.get("ward"))
    """
    records = [_of_function(f) for f in map(plain, model.functions) if not _own(f)]
    if len(records) < 2:
        return dict(records[0]) if records else None
    files = "; ".join(str(each["file"]) for each in records)
    return {"file": files, "sha256": _sha256("".join(str(each["sha256"]) for each in records))}


def check_source(model: Model, fit: Fitted) -> Model:
    """The model, if it is the one that a fit was made with.

    Raises
    ------
    ConfigurationError
        If its source is another one.
    """
    recorded, own = fit.model_source, source_of(model)
    if (recorded or {}).get("sha256") == (own or {}).get("sha256"):
        return model
    raise ConfigurationError(
        f"the fit was made with the model {fit.model!r} {_described(recorded)}, and this one is "
        f"{_described(own)}: it is another model; give the file that the fit was made with, or fit "
        "again.",
        value=fit.model,
    )


def unknown_source(fit: Fitted) -> ConfigurationError:
    """The error for a fit of a model from outside that nobody gave."""
    return ConfigurationError(
        f"the fit was made with the model {fit.model!r} {_described(fit.model_source)}, which is "
        "not part of gonio, and no code is run because a file names it; give it with --model "
        "FILE.py, or in Python by gonio.models.load(FILE).",
        value=fit.model,
    )


def _own(function: Any) -> bool:
    return f"{function.__module__}.".startswith(OWN)


def _of_function(function: Any) -> dict[str, str | None]:
    path = file_of(function) if importable(function) else None
    if path is not None:
        return {"file": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    script: Path | None = file_of(function)
    read, _ = ingredients([f for f in reached(function) if not _own(f)])
    return {"file": script.name if script else None, "sha256": _sha256("\0".join(read))}


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _described(source: Mapping[str, Any] | None) -> str:
    """A source in words."""
    if source is None:
        return "of gonio"
    return f"of {source['file'] or 'a notebook'} (sha256 {str(source['sha256'])[:12]})"
