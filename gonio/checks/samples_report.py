"""What a check of samples found, as data and as a page of text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from html import escape
from typing import Any

from gonio.checks.pairs import Pairing
from gonio.checks.quantity import BRDF, UNDECIDED
from gonio.checks.questions import Finding
from gonio.wording import counted, paragraph

LEVELS = {"refuse": "REFUSED by a fit", "warning": "Warning", "note": "Note"}


@dataclass(frozen=True)
class SamplesReport:
    """Result of `check_samples`.

    Parameters
    ----------
    n_samples, n_negative : int
        Number of samples that are measurements, and of samples below zero.
    tolerance_deg : float
        Largest allowed angle between each direction of a pair and its exact partner.
    reciprocity : Pairing
        Values with light and viewer exchanged.
    mirror : Pairing
        Values at phi_r - phi_i = +x and -x, equal on an isotropic surface.
    assumed_isotropic : bool
        Whether reciprocal partners were searched at any azimuth of the sample and on both sides of
        the plane of incidence, because the data contain too few others.
    quantity : str
        One of the names in `candidates`, or "undecided".
    candidates : mapping
        Median disagreement of reciprocal pairs if the file holds this quantity; empty without pairs
        that distinguish the quantities.
    n_telling : int
        Number of pairs that distinguish the quantities.
    power, u_power : float or None
        Power of cos(theta_r) by which reciprocal pairs differ, with its standard uncertainty: 0 for
        a BRDF, 1 for BRDF*cos(theta_r), -1 for BRDF*cos(theta_i).
    albedo : float or None
        Largest directional albedo by a rough sum over nearest samples, after the quantity's cosine
        is removed; None if the data cover too little of the hemisphere.
    findings : tuple of Finding
        What is implausible, refusals first.
    notes : tuple of str
        What the numbers mean, and what they cannot decide.

    Notes
    -----
    `print` shows the page that `gonio check` prints.
    """

    n_samples: int
    n_negative: int
    tolerance_deg: float
    reciprocity: Pairing
    mirror: Pairing
    assumed_isotropic: bool
    quantity: str
    candidates: Mapping[str, float]
    n_telling: int
    power: float | None
    u_power: float | None
    albedo: float | None
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join(_page(self))

    def _repr_html_(self) -> str:
        return f"<pre>{escape(str(self))}</pre>"

    @property
    def passed(self) -> bool:
        """False if the data are no BRDF, or hold something that a fit warns of or refuses."""
        return self.quantity in (BRDF, UNDECIDED) and all(
            finding.level == "note" for finding in self.findings
        )

    def describe(self) -> dict[str, Any]:
        """The report as plain data, for --json."""
        return {
            "schema": "gonio.check_samples/1",
            "passed": self.passed,
            **asdict(self),
            "findings": [finding.describe() for finding in self.findings],
        }


def _page(report: SamplesReport) -> Iterator[str]:
    yield f"{counted(report.n_samples, 'sample')}, {report.n_negative} of them negative."
    yield ""
    for finding in report.findings:
        yield paragraph(f"{LEVELS[finding.level]} ({finding.code}): {finding.text}")
        yield ""
    within = f"partners within {report.tolerance_deg:g} deg"
    yield f"{within:<28} {'pairs':>7} {'median':>8} {'rms':>8}"
    yield _pairing_line("light and viewer exchanged", report.reciprocity)
    yield _pairing_line("phi_r - phi_i = +x and -x", report.mirror)
    yield ""
    yield f"{'if the values are':<28} {'pairs':>7} {'median':>8}   of reciprocal pairs"
    for name, median in report.candidates.items():
        yield f"{name:<28} {report.n_telling:>7} {median:>8.1%}"
    if not report.candidates:
        yield "no pair distinguishes BRDF and BRDF*cos"
    yield ""
    yield f"Quantity: {report.quantity}"
    for note in report.notes:
        yield paragraph(note, "- ")


def _pairing_line(name: str, pairing: Pairing) -> str:
    median, rms = (
        "-" if fraction is None else f"{fraction:.1%}" for fraction in (pairing.median, pairing.rms)
    )
    return f"{name:<28} {pairing.n_pairs:>7} {median:>8} {rms:>8}"
