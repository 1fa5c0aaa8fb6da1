"""The papers' named materials: models with the parameters that the papers print.

The numbers stand in `materials.toml` of `gonio.data`, in the units of files. That file is read at
first use.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import gonio.models as models
from gonio.errors import unknown_name


@dataclass(frozen=True)
class Material:
    """A named material.

    Parameters
    ----------
    name, title : str
        Name on the command line and name for people.
    model : str
        Name of the reflectance model.
    parameters : mapping
        Parameters of that model by name, angles in radians.
    paper, where : str
        The paper, and the table, figure or section that prints the numbers.
    note : str
        What one has to know to trust the numbers.
    """

    name: str
    title: str
    model: str
    parameters: Mapping[str, float]
    paper: str
    where: str
    note: str

    @property
    def anisotropic(self) -> bool:
        """True where the slopes in x and y differ.

        Examples
        --------
        >>> get("rolled_brass").anisotropic, get("plastic_laminate").anisotropic
        (True, False)
        """
        return self.parameters.get("alpha_x") != self.parameters.get("alpha_y")

    def describe(self) -> dict[str, Any]:
        """The material as plain data in the units of files, for --json.

        Returns
        -------
        dict
            The fields; `parameters` are degrees where `units` says "deg".
        """
        model = models.get(self.model)
        declared = {name: model.parameter(name) for name in self.parameters}
        return {
            "name": self.name,
            "title": self.title,
            "model": self.model,
            # 15 digits take back the rounding of degrees to radians and show what was printed.
            "parameters": {
                name: float(f"{p.to_file(self.parameters[name]):.15g}")
                for name, p in declared.items()
            },
            "units": {name: p.file_unit for name, p in declared.items()},
            "anisotropic": self.anisotropic,
            "paper": self.paper,
            "where": self.where,
            "note": self.note,
        }


@cache
def _tables() -> dict[str, dict[str, Any]]:
    text = files("gonio.data").joinpath("materials.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def names() -> list[str]:
    """Names of all materials, in the order of the papers.

    Examples
    --------
    >>> len(names()), names()[0]
    (33, 'rolled_brass')
    """
    return list(_tables())


def get(name: str) -> Material:
    """The material with this name.

    Parameters
    ----------
    name : str
        One of `names()`.

    Raises
    ------
    ConfigurationError
        If there is no such material, with the nearest name.

    Examples
    --------
    >>> from gonio.geometry import Directions
    >>> brass = get("rolled_brass")
    >>> f = models.get(brass.model)(Directions(0.5, 0.0, 0.5, 3.0), **brass.parameters)
    >>> bool(f > 0)
    True
    """
    if name not in _tables():
        raise unknown_name("material", name, _tables())
    table = _tables()[name]
    model = models.get(table["model"])
    parameters = {
        key: model.parameter(key).from_file(float(value))
        for key, value in table["parameters"].items()
    }
    return Material(name=name, **{**table, "parameters": parameters})
