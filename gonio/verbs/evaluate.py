"""A reflectance model at given directions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gonio.formats.gonio_csv import read_directions
from gonio.geometry import Directions, FloatArray
from gonio.models import Model
from gonio.verbs.surface import named_surface


def evaluate(
    model: Model | str | None = None,
    directions: Directions | str | Path | None = None,
    parameters: Mapping[str, float] | None = None,
    *,
    material: str | None = None,
) -> FloatArray:
    """BRDF of a model or a material, sr^-1, cosine not included.

    Parameters
    ----------
    model : Model or str, optional
        A model; or give `material`.
    directions : Directions or path
        Directions in radians, or a CSV file with columns theta_i, phi_i, theta_r, phi_r in degrees.
    parameters : mapping of str to float, optional
        Parameters by name, radians for angles. The others have the defaults of the model, or the
        values of the material.
    material : str, optional
        A named material.

    Returns
    -------
    ndarray
        Array of the shape of the directions.

    Raises
    ------
    ConfigurationError
        For unknown names, a parameter out of range, or neither a model nor a material.
    DataError
        If the file of directions cannot be read.

    Examples
    --------
    >>> directions = Directions(0.5, 0.0, 0.5, np.pi)
    >>> bool(abs(evaluate("lambert", directions, {"rho": 0.5}) - 0.5 / np.pi) < 1e-15)
    True
    >>> bool(evaluate(directions=directions, material="rolled_brass") > 1)
    True
    """
    chosen, values = named_surface(model, material, parameters)
    if directions is None:
        raise TypeError("evaluate() needs directions: a Directions or the path of a CSV file")
    where = directions if isinstance(directions, Directions) else read_directions(Path(directions))
    return np.asarray(chosen(where, **values))
