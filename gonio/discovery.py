"""Models, sources of error, questions and formats are found by looking into their folder."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator
from types import ModuleType
from typing import TypeVar

Record = TypeVar("Record")


def modules_in(package: str, *, private: bool = True) -> Iterator[ModuleType]:
    """The modules in the folder of a package, each imported as its turn comes.

    Parameters
    ----------
    package : str
        Import name of the package, which is imported already or is being imported.
    private : bool
        Whether to import the files whose name begins with an underscore, too.

    Yields
    ------
    module
        In the order of their names.

    Raises
    ------
    Exception
        Whatever the import of a module raises.

    Examples
    --------
    >>> [module.__name__.rpartition(".")[2] for module in modules_in("gonio.formats")]
    ['_header', '_signed_angles', '_text', 'cornell', 'gonio_csv', 'nist_ptfe', 'samples_nc']
    """
    for info in pkgutil.iter_modules(importlib.import_module(package).__path__):
        if private or not info.name.startswith("_"):
            yield importlib.import_module(f"{package}.{info.name}")


def records_in(package: str, name: str, kind: type[Record]) -> list[Record]:
    """What the modules in the folder of a package define under one name.

    A module without that name, or with something else under it, is passed over.

    Parameters
    ----------
    package : str
        As for `modules_in`.
    name : str
        Name of the record in each module: ``"MODEL"``, ``"EFFECT"``, ``"QUESTION"``.
    kind : type
        Type of the record.

    Returns
    -------
    list
        In the order of the modules' names.

    Examples
    --------
    >>> from gonio.models import Model
    >>> records_in("gonio.models", "MODEL", Model)[0].name
    'abg'
    """
    found = (getattr(module, name, None) for module in modules_in(package))
    return [record for record in found if isinstance(record, kind)]
