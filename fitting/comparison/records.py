"""The result of a comparison of models."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from gonio.files import write_text
from gonio.fitting.result.verdict import Verdict

SCHEMA = "gonio.compare/1"


@dataclass(frozen=True)
class Score:
    """Sum of log predictive densities; larger is better.

    Parameters
    ----------
    value, stderr : float
        The sum and its standard error, from the scatter between its terms.
    difference, difference_stderr : float
        This model less the first of the table, and its standard error, from the scatter of the
        differences term by term. Both are 0 for the first.
    terms, worse : int
        How many terms the sum has, and in how many of them the first scores higher.
    told_apart : bool
        Whether the data tell the model from the first of the table; `compare` says by what rule.
    """

    value: float
    stderr: float
    difference: float
    difference_stderr: float
    terms: int
    worse: int
    told_apart: bool


@dataclass(frozen=True)
class Entry:
    """One model of a comparison.

    Parameters
    ----------
    model : str
    status : {"converged", "not_converged"}
    n_parameters : int
    chi2, dof : float, int
        Of the model's own fit.
    values : mapping of str to float
        Fitted parameters, angles in radians.
    at_bound, undetermined : tuple of str
        Parameters on a bound, or in a sum that is, and others about which the data say nothing.
    priors : mapping of str to tuple of float
        Bounds between which the prior of the evidence is flat, angles in radians.
    held_out : Score or None
        Over groups of samples of one incidence, each predicted from all others.
    held_out_by_group : tuple of float, or None
        Its terms, in the order of the comparison's groups.
    loo : Score or None
        Over samples, each predicted from all others by Pareto-smoothed importance sampling.
    loo_k_hat : float or None
        Largest k-hat; above 0.7 the score cannot be trusted.
    log_evidence, log_evidence_stderr : float or None
        Natural logarithm, with its error from the sampling.
    notes : tuple of str
        Why something is None, and what to mistrust.
    units : mapping of str to str
        "rad" for angles.
    verdict : Verdict
        Whether the model, with its own weights, describes the samples.
    """

    model: str
    status: Literal["converged", "not_converged"]
    n_parameters: int
    chi2: float
    dof: int
    values: Mapping[str, float]
    at_bound: tuple[str, ...]
    undetermined: tuple[str, ...]
    priors: Mapping[str, tuple[float, float]]
    held_out: Score | None
    held_out_by_group: tuple[float, ...] | None
    loo: Score | None
    loo_k_hat: float | None
    log_evidence: float | None
    log_evidence_stderr: float | None
    notes: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    verdict: Verdict | None = None

    def to_dict(self) -> dict[str, Any]:
        """The entry as plain data, angles in degrees."""
        data = asdict(self)
        data["verdict"] = None if self.verdict is None else self.verdict.to_dict()
        for name, unit in data.pop("units").items():
            if unit == "rad":
                data["values"][name] = math.degrees(data["values"][name])
                if name in data["priors"]:
                    data["priors"][name] = tuple(map(math.degrees, data["priors"][name]))
        return data


@dataclass(frozen=True)
class Comparison:
    """Several models on the same samples, the best first.

    Parameters
    ----------
    entries : tuple of Entry
        By held-out score; by the leave-one-out score where nothing could be held out.
    conclusion : str
        Which models the data cannot tell apart.
    noise_scale, noise_model : float, str
        Factor on the weights' standard deviations, the same for all models, and the model whose
        residuals set it.
    n_samples, weights, seed : int, str, int
    groups : tuple of mapping
        The incidences that were held out: mean `theta_i_deg` and `n_samples`.
    cuts : mapping
        Selections and angle limits that were applied.
    notes : tuple of str
        What the criteria hold and do not hold.
    fixed : mapping of str to float
        Parameters that were fixed in the models that have them, in the unit of files.
    tied : mapping of str to str
        Parameters that took the value of another one.
    versions, source : mapping
    """

    entries: tuple[Entry, ...]
    conclusion: str
    noise_scale: float
    noise_model: str
    n_samples: int
    weights: str
    seed: int
    groups: tuple[Mapping[str, float], ...]
    cuts: Mapping[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    source: Mapping[str, Any] = field(default_factory=dict)
    fixed: Mapping[str, float] = field(default_factory=dict)
    tied: Mapping[str, str] = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        """True when every fit passed its checks."""
        return all(entry.status == "converged" for entry in self.entries)

    @property
    def best(self) -> Entry:
        """The first of the table."""
        return self.entries[0]

    def entry(self, model: str) -> Entry:
        """The entry of a model by its name."""
        return next(e for e in self.entries if e.model == model)

    def to_dict(self) -> dict[str, Any]:
        """The comparison as plain data of schema gonio.compare/1, angles in degrees."""
        data = {"schema": SCHEMA, **asdict(self)}
        data["entries"] = tuple(entry.to_dict() for entry in self.entries)
        # Only a comparison with constraints says so.
        return {k: v for k, v in data.items() if v or k not in ("fixed", "tied")}

    def to_json(self) -> str:
        """The comparison as a JSON document."""
        return json.dumps(self.to_dict(), indent=1, allow_nan=False, ensure_ascii=False) + "\n"

    def save(self, path: str | Path) -> None:
        """Write the JSON document, whole or not at all."""
        write_text(Path(path), self.to_json())
