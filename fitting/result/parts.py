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
    chosen = next((part for part in record.parts if part.name == name), None)
    if chosen is None:
        raise unknown_name("part", name, [part.name for part in record.parts], of="the fit")
    order = list(record.parameters)
    at = [order.index(own) for own in chosen.parameters.values()]
    c = record.covariance
    names = {own: q for q, own in chosen.parameters.items()}
    source = {
        # What the source says of the parameters goes by the model's names as well.
        **{key: _of_part(value, record.parameters, names) for key, value in record.source.items()},
        "joint": {
            "part": name,
            "parameters": dict(chosen.parameters),
            "share": [q for q, own in chosen.parameters.items() if q == own],
            "select": dict(record.cuts.get("select") or {}),
            "input": record.source.get("input"),
        },
    }
    if chosen.input is not None:
        source["input"] = chosen.input
    return replace(
        record,
        parameters={name: record.parameters[own] for name, own in chosen.parameters.items()},
        covariance=None if c is None else [[c[j][k] for k in at] for j in at],
        chi2=chosen.chi2,
        dof=chosen.dof,
        noise_scale=chosen.noise_scale,
        n_samples=chosen.n_samples,
        n_negative=chosen.n_negative,
        cuts={**record.cuts, "select": {**(record.cuts.get("select") or {}), **chosen.select}},
        source=source,
        diagnostics=_part_diagnostics(record.diagnostics, chosen, record.parts.index(chosen)),
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
    report = whole.get("identifiability")
    if report:
        order = [j for j, name in enumerate(report["parameters"]) if name in names]
        axes = [_renamed(axis["change"], names) for axis in report["axes"]]
        part_diagnostics["identifiability"] = {
            **report,
            "parameters": [names[report["parameters"][j]] for j in order],
            "correlation": [[report["correlation"][j][m] for m in order] for j in order],
            "bound": _renamed(report["bound"], names),
            "alone": _renamed(report["alone"], names),
            "axes": [
                {**axis, "change": change}
                for axis, change in zip(report["axes"], axes, strict=True)
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
