"""What a fit gives back: a record a person can read, with a JSON form. Unknown is None."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from gonio.errors import DataError, unknown_name
from gonio.files import write_text

SCHEMA = "gonio.fit/1"


@dataclass(frozen=True)
class Estimate:
    """One fitted parameter, in the unit of files (degrees for angles).

    Parameters
    ----------
    value : float
    stderr : float or None
        Standard uncertainty, shared terms included; None at a bound or where the data do not
        determine the parameter.
    unit : str
    at_bound : {"lower", "upper"} or None
    interval_68, interval_95 : tuple of float or None
        Posterior quantiles where there is a posterior; else from the standard uncertainty, or
        towards and at a bound from the growth of chi-squared by 1 and by 3.84.
    components : mapping of str to float
        Standard uncertainty by source: "independent" and the shared terms by name.
    """

    value: float
    stderr: float | None
    unit: str
    at_bound: Literal["lower", "upper"] | None
    interval_68: tuple[float, float] | None
    interval_95: tuple[float, float] | None
    components: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class NuisanceEstimate:
    """A shared error that the fit has learnt, in units of its prior's standard uncertainty.

    Parameters
    ----------
    name : str
        Of the shared term.
    group : int or None
        Which of its draws, by the number that its samples have in common; None where all have.
    estimate : float
        0 where the data do not speak against the statement of the budget.
    stderr : float
        1 where the data say nothing about it, 0 where they know it.
    """

    name: str
    group: int | None
    estimate: float
    stderr: float


@dataclass(frozen=True)
class PosteriorSummary:
    """How the posterior was sampled.

    Parameters
    ----------
    ess : float
        Smallest effective number of draws over the parameters.
    r_hat : float
        Largest rank-normalised split R-hat.
    tau : float
        Longest integrated autocorrelation time, steps.
    acceptance : float
        Share of accepted proposals.
    converged : bool
        Chain longer than 50 tau, R-hat below 1.01, and at least 400 effective draws for the bulk
        and for the tails.
    draws : str or None
        Path of the netCDF file with the draws.
    ess_bulk, ess_tail : float or None
        Smallest effective numbers of draws for the middle, which is `ess`, and for the 5 % and
        95 % quantiles.
    sampler : str or None
        "marginal" or "emcee".
    k_hat : float or None
        Shape of the tail of the marginal sampler's importance weights, also where its guard
        refused it; None where there was nothing to weigh.
    note : str
        Why the marginal sampler was not used; empty where it was.
    priors : mapping of str to str
        As `gonio.fitting.posterior.priors` writes them, file units.
    """

    ess: float
    r_hat: float
    tau: float
    acceptance: float
    converged: bool
    draws: str | None = None
    ess_bulk: float | None = None
    ess_tail: float | None = None
    sampler: str | None = None
    k_hat: float | None = None
    note: str = ""
    priors: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class PartFit:
    """One channel, wavelength or material of a joint fit.

    Parameters
    ----------
    name : str
        "red", "650 nm", "paint_a", or "paint_a, red".
    parameters : mapping of str to str
        The name of each of the model's parameters in the parameters of the fit.
    alone : mapping of str to tuple
        Value and standard uncertainty (None where unknown) of each shared parameter in a fit to
        this part alone, unit of files.
    chi2, dof, noise_scale : float, int, float
        Of this part: its residuals, its samples less the parameters that are its own, and the
        factor on its independent uncertainties.
    n_samples, n_negative : int
    select : mapping of str to str
        Takes the part out of its input.
    input : str or None
        The input that the part is of, where there are several.
    """

    name: str
    parameters: Mapping[str, str]
    alone: Mapping[str, tuple[float, float | None]]
    chi2: float
    dof: int
    noise_scale: float
    n_samples: int
    n_negative: int
    select: Mapping[str, str] = field(default_factory=dict)
    input: str | None = None


@dataclass(frozen=True)
class Sharing:
    """Whether the parts of a joint fit have their shared parameters in common: a test.

    Parameters
    ----------
    parameters : tuple of str
        What is shared.
    growth : float
        chi-squared of the joint fit less that of separate fits, in units of the noise.
    dof : int
        How many parameters the separate fits have more.
    p_value : float or None
        Chance of a growth as large where the parts do share; errors of the parts' own, such as a
        lamp that drifts, are allowed for. None where nothing can be tested.
    refused : bool
        The chance is below 1 %.
    """

    parameters: tuple[str, ...]
    growth: float
    dof: int
    p_value: float | None
    refused: bool


@dataclass(frozen=True)
class FitResult:
    """A fitted model.

    Parameters
    ----------
    model : str
    status : {"converged", "not_converged"}
        "converged" only when the optimum passed its checks: the next step is far below the
        uncertainties, chi-squared grows along every axis of the uncertainty ellipsoid, and the
        model's derivatives agree with difference quotients. It is the deepest of the minima
        that were found from several starts.
    parameters : mapping of str to Estimate
    covariance : list of lists, or None
        In the order of `parameters`, file units, shared terms included; None where a parameter
        has no standard uncertainty.
    chi2, dof : float, int
        Weighted sum of squares of the residuals, and samples less free parameters.
    noise_scale : float
        Factor on the independent uncertainties: sqrt(chi2/dof) where that exceeds 1 or where no
        uncertainty was given.
    n_samples, n_negative : int
    weights : str
    cuts : mapping
        Selections and angle limits that were applied.
    seed : int
    posterior : PosteriorSummary or None
    warnings : tuple of str
    diagnostics, versions, source : mapping
    parts : tuple of PartFit
        The channels, wavelengths or materials of a joint fit, else empty.
    sharing : Sharing or None
        The test of a joint fit's shared parameters.
    nuisance : tuple of NuisanceEstimate
        Shared errors that were learnt with the fit, else empty.
    engine : str
        What searched for the minimum before the Gauss-Newton steps
        (`gonio.fitting.minimum.engines`).
    loss : str
        What was made small (`gonio.fitting.problem.losses`); for another one than chi2 its value
        stands as `chi2`, and uncertainties come from the scatter of the residuals.
    """

    model: str
    status: Literal["converged", "not_converged"]
    parameters: Mapping[str, Estimate]
    covariance: list[list[float]] | None
    chi2: float
    dof: int
    noise_scale: float
    n_samples: int
    n_negative: int
    weights: str
    seed: int
    cuts: Mapping[str, Any] = field(default_factory=dict)
    posterior: PosteriorSummary | None = None
    warnings: tuple[str, ...] = ()
    diagnostics: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    source: Mapping[str, Any] = field(default_factory=dict)
    parts: tuple[PartFit, ...] = ()
    sharing: Sharing | None = None
    nuisance: tuple[NuisanceEstimate, ...] = ()
    engine: str = "gauss_newton"
    loss: str = "chi2"

    @property
    def ok(self) -> bool:
        """True when the optimum, and the posterior where there is one, passed their checks."""
        return self.status == "converged" and (self.posterior is None or self.posterior.converged)

    def values(self) -> dict[str, float]:
        """Parameter values by name, in the unit of files."""
        return {name: estimate.value for name, estimate in self.parameters.items()}

    def part(self, name: str) -> FitResult:
        """One part of a joint fit as a fit of its own, its parameters by the model's names.

        Raises
        ------
        ConfigurationError
            If the fit has no part of this name, with the nearest one.
        """
        found = next((part for part in self.parts if part.name == name), None)
        if found is None:
            raise unknown_name("part of the fit", name, [part.name for part in self.parts])
        order = list(self.parameters)
        at = [order.index(own) for own in found.parameters.values()]
        c = self.covariance
        names = {own: q for q, own in found.parameters.items()}
        source = {
            # What the source says of the parameters goes by the model's names as well.
            **{key: _of_part(value, self.parameters, names) for key, value in self.source.items()},
            "joint": {
                "part": name,
                "parameters": dict(found.parameters),
                "share": [q for q, own in found.parameters.items() if q == own],
                "select": dict(self.cuts.get("select") or {}),
                "input": self.source.get("input"),
            },
        }
        if found.input is not None:
            source["input"] = found.input
        return replace(
            self,
            parameters={name: self.parameters[own] for name, own in found.parameters.items()},
            covariance=None if c is None else [[c[j][k] for k in at] for j in at],
            chi2=found.chi2,
            dof=found.dof,
            noise_scale=found.noise_scale,
            n_samples=found.n_samples,
            n_negative=found.n_negative,
            cuts={**self.cuts, "select": {**(self.cuts.get("select") or {}), **found.select}},
            source=source,
            diagnostics=_part_diagnostics(self.diagnostics, found, self.parts.index(found)),
            parts=(),
            sharing=None,
        )

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data of schema gonio.fit/1."""
        return {"schema": SCHEMA, **plain(self)}

    def to_json(self) -> str:
        """The result as a JSON document."""
        return json.dumps(self.to_dict(), indent=1, allow_nan=False, ensure_ascii=False) + "\n"

    def save(self, path: str | Path) -> None:
        """Write the JSON document, whole or not at all."""
        write_text(Path(path), self.to_json())

    @classmethod
    def load(cls, path: str | Path) -> FitResult:
        """Read what `save` wrote.

        Raises
        ------
        DataError
            If the file is missing or not a fit of this schema.
        """
        path = Path(path)
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
            data["parts"] = tuple(_part(entry) for entry in data.get("parts", ()))
            if data.get("sharing") is not None:
                data["sharing"] = Sharing(**_with_tuple(data["sharing"], "parameters"))
            data["nuisance"] = tuple(NuisanceEstimate(**e) for e in data.get("nuisance", ()))
            return cls(**data)
        except FileNotFoundError:
            raise DataError(
                f"{path}: no such file; give a fit that 'gonio fit -o' wrote.", value=path
            ) from None
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise DataError(
                f"{path}: not a readable fit ({type(error).__name__}: {error}).", value=path
            ) from None


def _part_diagnostics(whole: Mapping[str, Any], part: PartFit, k: int) -> dict[str, Any]:
    """What the diagnostics of a joint fit say of one part, by the model's names."""
    told = dict(whole)
    names = {own: q for q, own in part.parameters.items()}
    residuals = whole.get("residuals") or {}
    if "parts" in residuals:
        told["residuals"] = residuals["parts"][k]
    if whole.get("priors"):
        told["priors"] = {names[n]: v for n, v in whole["priors"].items() if n in names}
    found = whole.get("identifiability")
    if found:
        order = [j for j, name in enumerate(found["parameters"]) if name in names]
        axes = [_renamed(axis["change"], names) for axis in found["axes"]]
        told["identifiability"] = {
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
    return told


def _of_part(value: Any, whole: Mapping[str, Any], names: Mapping[str, str]) -> Any:
    """The part's share of a mapping of parameters; anything else as it is."""
    if not (isinstance(value, Mapping) and value and set(value) <= set(whole)):
        return value
    return _renamed(value, names) or None


def _renamed(values: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    return {names[name]: value for name, value in values.items() if name in names}


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
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value
