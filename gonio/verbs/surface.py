"""A surface by name: a model with parameters, or a material."""

from __future__ import annotations

from collections.abc import Mapping

import gonio.materials as materials
import gonio.models as models
from gonio.errors import ConfigurationError
from gonio.models import Model


def named_surface(
    model: Model | str | None,
    material: str | None,
    parameters: Mapping[str, float] | None,
) -> tuple[Model, dict[str, float]]:
    """A model and all of its parameters; those left out have their defaults.

    Raises
    ------
    ConfigurationError
        For an unknown name, or where not exactly one of model and material is given.

    Examples
    --------
    >>> chosen, values = named_surface("lambert", None, {"rho": 0.3})
    >>> chosen.name, values
    ('lambert', {'rho': 0.3})
    """
    if (model is None) == (material is None):
        given = "both were given" if model is not None else "neither was given"
        raise ConfigurationError(f"give a model or a material; {given}.")
    own: dict[str, float] = {}
    if material is not None:
        named = materials.get(material)
        model, own = named.model, dict(named.parameters)
    chosen = models.get(model) if isinstance(model, Model) else models.resolve(str(model))
    for name in parameters or {}:
        chosen.parameter(name)
    return chosen, {p.name: p.default for p in chosen.parameters} | own | dict(parameters or {})
