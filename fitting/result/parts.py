"""One part of a joint fit as a fit of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

from gonio.errors import unknown_name
from gonio.fitting.result.estimates import PartFit
from gonio.fitting.result.record import FitRecord

Record = TypeVar("Record", bound=FitRecord)


def part(record: Record, name: str) -> Record:
    """One part of a joint fit as a fit of its own, its parameters by the model's names.

    Raises
    ------
    ConfigurationError
        If the fit has no part of this name, with the nearest one.
    """
    found = next((part for part in record.parts if part.name == name), None)
    if found is None:
        raise unknown_name("part of the fit", name, [part.name for part in record.parts])
    order = list(record.parameters)
    at = [order.index(own) for own in found.parameters.values()]
    c = record.covariance
    names = {own: q for q, own in found.parameters.items()}
    source = {
        # What the source says of the parameters goes by the model's names as well.
        **{key: _of_part(value, record.parameters, names) for key, value in record.source.items()},
        "joint": {
            "part": name,
            "parameters": dict(found.parameters),
            "share": [q for q, own in found.parameters.items() if q == own],
            "select": dict(record.cuts.get("select") or {}),
            "input": record.source.get("input"),
        },
    }
    if found.input is not None:
        source["input"] = found.input
    return replace(
        record,
        parameters={name: record.parameters[own] for name, own in found.parameters.items()},
        covariance=None if c is None else [[c[j][k] for k in at] for j in at],
        chi2=found.chi2,
        dof=found.dof,
        noise_scale=found.noise_scale,
        n_samples=found.n_samples,
        n_negative=found.n_negative,
        cuts={**record.cuts, "select": {**(record.cuts.get("select") or {}), **found.select}},
        source=source,
        diagnostics=_part_diagnostics(record.diagnostics, found, record.parts.index(found)),
        parts=(),
        sharing=None,
    )


def _part_diagnostics(whole: Mapping[str, Any], part: PartFit, k: int) -> dict[str, Any]:
    """What the diagnostics of a joint fit say of one part, by the model's names."""
    part_diagnostics = dict(whole)
    names = {own: q for q, own in part.parameters.items()}
    residuals = whole.get("residuals") or {}
    if "parts" in residuals:
        part_diagnostics["residuals"] = residuals["parts"][k]
    if whole.get("priors"):
        part_diagnostics["priors"] = {names[n]: v for n, v in whole["priors"].items() if n in names}
    found = whole.get("identifiability")
    if found:
        order = [j for j, name in enumerate(found["parameters"]) if name in names]
        axes = [_renamed(axis["change"], names) for axis in found["axes"]]
        part_diagnostics["identifiability"] = {
            **found,
            "parameters": [names[found["parameters"][j]] for j in order],
            "correlation": [[found["correlation"][j][m] for m in order] for j in order],
            "bound": _renamed(found["bound"], names),
            "alone": _renamed(found["alone"], names),
            "axes": [
                {**axis, "change": change}
                for axis, change in zip(found["axes"], axes, strict=True)
                if change
            ],
        }
    return part_diagnostics


def _of_part(value: Any, whole: Mapping[str, Any], names: Mapping[str, str]) -> Any:
    """The part's share of a mapping of parameters; anything else as it is."""
    if not (isinstance(value, Mapping) and value and set(value) <= set(whole)):
        return value
    return _renamed(value, names) or None


def _renamed(values: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    return {names[name]: value for name, value in values.items() if name in names}
