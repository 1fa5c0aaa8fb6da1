"""FIT.json: a fit's result as a JSON document, angles in degrees."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from gonio.errors import DataError
from gonio.fitting.result.estimates import (
    Estimate,
    NuisanceEstimate,
    PartFit,
    PosteriorSummary,
    Sharing,
)
from gonio.fitting.result.record import FitRecord
from gonio.fitting.result.verdict import Verdict

SCHEMA = "gonio.fit/1"
PLAIN = frozenset((bool, int, float, str))
Record = TypeVar("Record", bound=FitRecord)
Matrix = list[list[float]]


def to_dict(record: FitRecord) -> dict[str, Any]:
    """The result as plain data of schema gonio.fit/1, angles in degrees."""
    shown = in_file_units(record)
    data = {each.name: plain(getattr(shown, each.name)) for each in fields(FitRecord)}
    if record.verdict is not None:
        data["verdict"] = record.verdict.to_dict()
    for entry in data["parameters"].values():
        # Only parameters that are fixed or tied say so.
        for key in ("fixed", "tied_to"):
            if not entry[key]:
                del entry[key]
    return {"schema": SCHEMA, **data}


def to_json(record: FitRecord) -> str:
    """The result as a JSON document."""
    return json.dumps(to_dict(record), indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def load(path: Path, kind: type[Record]) -> Record:
    """Read a document into a record of this kind.

    Raises
    ------
    DataError
        If the file is missing or not a fit of this schema.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data.pop("schema") != SCHEMA:
            raise ValueError(f"the schema is not {SCHEMA}")
        data["parameters"] = {
            name: Estimate(**_with_tuples(entry)) for name, entry in data["parameters"].items()
        }
        if data["posterior"] is not None:
            data["posterior"] = PosteriorSummary(**data["posterior"])
        data["warnings"] = tuple(data["warnings"])
        _rename_keys_of_0_1(data.get("diagnostics", {}).get("identifiability"))
        data["parts"] = tuple(_part(entry) for entry in data.get("parts", ()))
        if data.get("sharing") is not None:
            data["sharing"] = Sharing(**_with_tuple(data["sharing"], "parameters"))
        if data.get("verdict") is not None:
            data["verdict"] = Verdict.from_dict(data["verdict"])
        data["nuisance"] = tuple(NuisanceEstimate(**e) for e in data.get("nuisance", ()))
        return in_python_units(kind(**data))
    except FileNotFoundError:
        raise DataError(
            f"{path}: no such file; give a fit that 'gonio fit -o' wrote.", value=path
        ) from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DataError(
            f"{path}: not a readable fit ({type(error).__name__}: {error}).", value=path
        ) from None


def in_file_units(record: Record) -> Record:
    """The record with angles in degrees, as the document holds it."""
    shown = {name: e.in_file_units() for name, e in record.parameters.items()}
    parts = [
        replace(part, alone={
            q: _pair(record.parameters[part.parameters[q]], pair, to_file=True)
            for q, pair in part.alone.items()
        })
        for part in record.parts
    ]  # fmt: skip
    covariance = record.covariance
    if covariance is not None:
        unit = _units(record)
        covariance = _listed(np.asarray(covariance) * np.outer(unit, unit))
    return replace(record, parameters=shown, covariance=covariance, parts=tuple(parts))


def in_python_units(record: Record) -> Record:
    """The record of a document with its angles in radians."""
    parts = [
        replace(part, alone={
            q: _pair(record.parameters[part.parameters[q]], pair, to_file=False)
            for q, pair in part.alone.items()
        })
        for part in record.parts
    ]  # fmt: skip
    inside = {name: e.in_python_units() for name, e in record.parameters.items()}
    covariance = record.covariance
    if covariance is not None:
        unit = _units(replace(record, parameters=inside))
        covariance = _listed(_quotient(np.asarray(covariance), np.outer(unit, unit)))
    return replace(record, parameters=inside, covariance=covariance, parts=tuple(parts))


def _units(record: FitRecord) -> np.ndarray[Any, np.dtype[np.float64]]:
    """What a 1 in Python is in a file, parameter by parameter."""
    degree = math.degrees(1.0)
    return np.array([degree if e.unit == "rad" else 1.0 for e in record.parameters.values()])


def _quotient(product: Any, factor: Any) -> Any:
    """Numbers that multiplied by the factor are the product again, where there are any."""
    near = product / factor
    for other in (np.nextafter(near, np.inf), np.nextafter(near, -np.inf)):
        near = np.where((near * factor != product) & (other * factor == product), other, near)
    return near


def _listed(matrix: Any) -> Matrix:
    return [[float(v) for v in row] for row in matrix]


def _pair(
    estimate: Estimate, pair: tuple[float, float | None], *, to_file: bool
) -> tuple[float, float | None]:
    """Value and standard uncertainty in the other unit; `estimate` tells which it is now."""
    one = replace(estimate, value=pair[0], stderr=pair[1])
    one = one.in_file_units() if to_file else one.in_python_units()
    return one.value, one.stderr


def _rename_keys_of_0_1(identifiability: dict[str, Any] | None) -> None:
    """The suggested measurement stood under "mending" in files of 0.1."""
    if identifiability and "mending" in identifiability:
        identifiability["suggested_measurement"] = identifiability.pop("mending")


def _part(entry: dict[str, Any]) -> PartFit:
    alone = {name: tuple(pair) for name, pair in entry["alone"].items()}
    return PartFit(**{**entry, "alone": alone})


def _with_tuple(entry: dict[str, Any], key: str) -> dict[str, Any]:
    return {**entry, key: tuple(entry[key])}


def _with_tuples(entry: dict[str, Any]) -> dict[str, Any]:
    for key in ("interval_68", "interval_95"):
        if entry[key] is not None:
            entry[key] = tuple(entry[key])
    return entry


def plain(value: Any) -> Any:
    """Dataclasses, mappings and tuples as JSON-ready data."""
    if value is None or type(value) in PLAIN:
        return value
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value
