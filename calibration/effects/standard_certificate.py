"""The uncertainty of the white standard's certificate: reflectance and angular shape."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.effects.base import Effect, Measured, StatedQuantity, TermRecord
from gonio.geometry import angles
from gonio.shared_term import SharedTerm

SCALE = TermRecord("standard", "reflectance of the white standard")
SHAPE = TermRecord(
    "standard, shape",
    "departure of the standard from a Lambertian one at high angles",
    constant=True,
)


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """One factor on all values, and one that grows with theta_r."""
    certificate = measured.metadata.standard
    if certificate.uncertainty:
        yield SCALE.shared(certificate.uncertainty)
    if certificate.rolloff_uncertainty:
        theta_r = angles(measured.centroid)[0]
        yield SHAPE.shared(certificate.rolloff_uncertainty, profile=(theta_r / np.radians(75)) ** 4)


EFFECT = Effect(
    key="standard_certificate",
    order=60,
    title="white standard",
    text="All values are proportional to the certified reflectance of the standard. At high "
    "theta_r the standard may depart from a Lambertian one, within the certificate's uncertainty.",
    records=(SCALE, SHAPE),
    terms=terms,
    quantities=(
        StatedQuantity(
            "relative uncertainty of the standard's reflectance", "standard.uncertainty"
        ),
        StatedQuantity(
            "uncertainty of the standard's shape, at 75°", "standard.rolloff_uncertainty"
        ),
    ),
)
