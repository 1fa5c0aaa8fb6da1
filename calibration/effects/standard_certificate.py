"""The uncertainty of what the white standard's certificate states: its number and its rolloff."""

from __future__ import annotations

from collections.abc import Iterator

from gonio.calibration.effects.base import Effect, Measured, StatedQuantity, TermRecord
from gonio.calibration.effects.standard_shape import standard_directions
from gonio.calibration.frames.certified import rolloff_profile
from gonio.shared_term import SharedTerm

SCALE = TermRecord("standard", "reflectance of the white standard")
SHAPE = TermRecord(
    "standard, shape",
    "departure of the standard from a Lambertian one at high angles",
    constant=True,
)


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """One factor on all values, and one that grows with the polar angles."""
    certificate = measured.metadata.standard
    if certificate.uncertainty:
        yield SCALE.shared(certificate.uncertainty)
    if certificate.rolloff_uncertainty:
        theta_i, theta_r, _ = standard_directions(measured)
        profile = rolloff_profile(certificate, theta_i, theta_r)
        yield SHAPE.shared(certificate.rolloff_uncertainty, profile=profile)


EFFECT = Effect(
    key="standard_certificate",
    order=60,
    title="white standard",
    text="All values are proportional to the certified number of the standard: pi f(0 deg), the "
    "total reflectance, the factor 0/45, or a list of f. The shape of f turns it into f in other "
    "directions. A certified rolloff may be off within its uncertainty.",
    records=(SCALE, SHAPE),
    terms=terms,
    quantities=(
        StatedQuantity(
            "relative uncertainty of the standard's certificate", "standard.uncertainty"
        ),
        StatedQuantity(
            "uncertainty of the standard's rolloff, at 75°", "standard.rolloff_uncertainty"
        ),
    ),
)
