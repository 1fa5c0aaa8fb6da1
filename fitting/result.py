"""What a fit gives back: a record a person can read, with a JSON form. Unknown is None."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from gonio.errors import DataError
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
class PosteriorSummary:
    """How the posterior was sampled.

    Parameters
    ----------
    ess : float
        Smallest effective number of draws over the parameters.
    r_hat : float
        Largest split R-hat.
    tau : float
        Longest integrated autocorrelation time, steps.
    acceptance : float
        Share of accepted proposals.
    converged : bool
        Chain longer than 50 tau and R-hat below 1.01.
    draws : str or None
        Path of the netCDF file with the draws.
    """

    ess: float
    r_hat: float
    tau: float
    acceptance: float
    converged: bool
    draws: str | None = None


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

    @property
    def ok(self) -> bool:
        """True when the optimum, and the posterior where there is one, passed their checks."""
        return self.status == "converged" and (self.posterior is None or self.posterior.converged)

    def values(self) -> dict[str, float]:
        """Parameter values by name, in the unit of files."""
        return {name: estimate.value for name, estimate in self.parameters.items()}

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data of schema gonio.fit/1."""
        return {"schema": SCHEMA, **_plain(self)}

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
            return cls(**data)
        except FileNotFoundError:
            raise DataError(
                f"{path}: no such file; give a fit that 'gonio fit -o' wrote.", value=path
            ) from None
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise DataError(
                f"{path}: not a readable fit ({type(error).__name__}: {error}).", value=path
            ) from None


def _with_tuples(entry: dict[str, Any]) -> dict[str, Any]:
    for key in ("interval_68", "interval_95"):
        if entry[key] is not None:
            entry[key] = tuple(entry[key])
    return entry


def _plain(value: Any) -> Any:
    """Dataclasses, mappings and tuples as JSON-ready data."""
    if hasattr(value, "__dataclass_fields__"):
        return {name: _plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
