"""What a check of a model found, as data and as a page of text."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from html import escape
from typing import Any

from gonio.models import Parameter
from gonio.models.albedo import Albedo
from gonio.wording import paragraph

SAME = 1e-9  # relative difference up to which two values of a formula are equal
_ANGLES = ("theta_i", "phi_i", "theta_r", "phi_r")


@dataclass(frozen=True)
class Finding:
    """One property of a model: the claim and the result of its test.

    Parameters
    ----------
    name : str
        The property.
    claimed : bool
        Whether the model claims it.
    holds : bool
        Whether the property holds.
    worst : float
        Largest violation, smallest value or largest albedo; `text` says which.
    where : tuple of float or None
        theta_i, phi_i, theta_r, phi_r in degrees of the worst case; two angles for an albedo.
    text : str
        The result in words and numbers.
    """

    name: str
    claimed: bool
    holds: bool
    worst: float
    where: tuple[float, ...] | None
    text: str

    @property
    def passed(self) -> bool:
        """False only where a claim does not hold."""
        return self.holds or not self.claimed


@dataclass(frozen=True)
class ModelReport:
    """Result of `check_model`.

    Parameters
    ----------
    model : str
    parameters : mapping
        All parameters, angles in radians.
    findings : tuple of Finding
        Reciprocity, positivity, energy, isotropy, seams.
    albedos : mapping
        `Albedo` by angle of incidence in degrees, phi_i = 0.
    bihemispherical : Albedo
        Albedo for uniform light from the whole hemisphere.
    records : tuple of Parameter
        Of the model: the units in which the page shows the values.

    Notes
    -----
    `print` shows the page that `gonio check` prints.
    """

    model: str
    parameters: Mapping[str, float]
    findings: tuple[Finding, ...]
    albedos: Mapping[float, Albedo]
    bihemispherical: Albedo
    records: tuple[Parameter, ...] = ()

    def __str__(self) -> str:
        return "\n".join(_page(self))

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"

    @property
    def conserves_energy(self) -> bool:
        """Whether no directional albedo exceeds 1 with these parameters."""
        return not above_bound(1.0, self.albedos)

    @property
    def passed(self) -> bool:
        """Whether everything that the model claims holds."""
        return all(finding.passed for finding in self.findings)

    def finding(self, name: str) -> Finding:
        """The finding with this name."""
        return next(finding for finding in self.findings if finding.name == name)

    def describe(self) -> dict[str, Any]:
        """The report as plain data, for --json."""
        return {
            "schema": "gonio.check_model/1",
            "model": self.model,
            "parameters": dict(self.parameters),
            "passed": self.passed,
            "findings": [
                {**_json_values(finding), "passed": finding.passed} for finding in self.findings
            ],
            "albedo": [
                {"theta_i_deg": theta, **_json_values(albedo)}
                for theta, albedo in self.albedos.items()
            ],
            "bihemispherical_albedo": _json_values(self.bihemispherical),
            "conserves_energy": self.conserves_energy,
        }


def _json_values(record: Finding | Albedo) -> dict[str, Any]:
    """A record for JSON: numbers that are not finite become None."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in asdict(record).items()
    }


def above_bound(bound: float, albedos: Mapping[float, Albedo]) -> list[float]:
    """Angles of incidence at which the albedo is larger than a bound, or no number."""
    return [t for t, a in albedos.items() if not a.value - a.error <= bound + SAME]


def _page(report: ModelReport) -> Iterator[str]:
    values = (q.file_text(report.parameters[q.name]) for q in report.records)
    named = (f"{q.name} = {text}" for q, text in zip(report.records, values, strict=True))
    yield paragraph(f"{report.model}: {', '.join(named)}")
    yield ""
    yield f"{'property':<12} {'claimed':<8} {'result':<8} measured"
    for finding in report.findings:
        yield from _finding_lines(finding)
    yield ""
    yield f"{'theta_i':>8} {'albedo':>10} {'error':>9}   (phi_i = 0)"
    for theta, albedo in report.albedos.items():
        yield f"{theta:>8g} {albedo.value:>10.5f} {albedo.error:>9.1g}"
    uniform = report.bihemispherical
    yield (
        f"{'uniform':>8} {uniform.value:>10.5f} {uniform.error:>9.1g}   (from the whole hemisphere)"
    )
    yield ""
    broken = [finding.name for finding in report.findings if not finding.passed]
    if broken:
        yield paragraph(f"The model does not keep what it claims: {', '.join(broken)}.")
    else:
        yield "The model keeps what it claims."
    if not report.conserves_energy:
        yield "With these parameters it reflects more light than falls on it."


def _finding_lines(finding: Finding) -> Iterator[str]:
    failed = "FAILS" if finding.claimed else "no"
    result = "ok" if finding.holds else failed
    start = f"{finding.name:<12} {'yes' if finding.claimed else 'no':<8} {result:<8} "
    yield paragraph(finding.text, start)
    if not finding.holds and finding.where is not None:
        where = (f"{n} {a:.5g}" for n, a in zip(_ANGLES, finding.where, strict=False))
        yield paragraph(f"at {', '.join(where)} deg", " " * len(start))
