"""The shape of the white standard where nobody certified it: how f changes with direction."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.effects.base import Effect, Measured, StatedQuantity, TermRecord, Unknown
from gonio.calibration.frames.certified import estimate
from gonio.geometry import FloatArray, angles
from gonio.metadata import Metadata
from gonio.shared_term import SharedTerm

RECORD = TermRecord(
    "standard, shape mode N",
    "shape of the standard that nobody certified",
    constant=True,
    typical=True,
)


def standard_directions(measured: Measured) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Directions at which every sample used f of the standard: theta_i, theta_r, dphi, radians.

    The standard is not turned with the sample: dphi is that of the laboratory.
    """
    counts = [len(image.centroid) for image in measured.images]
    at_one = measured.metadata.plan.standard_theta_i_deg
    own = [
        image.theta_i if at_one is None else float(np.radians(at_one)) for image in measured.images
    ]
    theta_r, phi_r = angles(measured.centroid)
    turn = np.repeat([image.psi for image in measured.images], counts)
    return np.repeat(own, counts), theta_r, np.asarray(phi_r + turn)


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """Independent modes of a smooth, reciprocal shape with the stated standard uncertainty."""
    found = estimate(measured.metadata.standard)
    if found.covariance is None:
        return
    for number, mode in enumerate(found.modes(*standard_directions(measured)), start=1):
        largest = float(np.abs(mode).max(initial=0.0))
        if largest:
            name = RECORD.name.replace("N", str(number))
            yield RECORD.shared(largest, name=name, profile=mode / largest)


def _shape_unknown(metadata: Metadata, pixel_map: PixelMap) -> bool:
    certificate = metadata.standard
    stated = certificate.shape_is_certified or certificate.brdf is not None
    return not stated and certificate.u_shape is None


def _between_unknown(metadata: Metadata, pixel_map: PixelMap) -> bool:
    return metadata.standard.brdf is not None and metadata.standard.u_shape is None


def _incidence_unknown(metadata: Metadata, pixel_map: PixelMap) -> bool:
    certificate = metadata.standard
    return bool(certificate.rolloff) and certificate.reciprocal is None and not certificate.u_shape


EFFECT = Effect(
    key="standard_shape",
    order=65,
    title="shape of the white standard",
    text="No real standard is Lambertian. A shape that nobody certified is unknown, and so is the "
    "dependence on theta_i if only a rolloff in theta_r is stated. If its typical size is stated "
    "(u_shape, f at 75° against f at the normal), it becomes independent modes of a smooth shape "
    "that is the same when the directions are exchanged. The certified number holds in every mode.",
    records=(RECORD,),
    terms=terms,
    unknown=(
        Unknown(
            "shape of the white standard, which nobody certified",
            "standard.u_shape",
            _shape_unknown,
        ),
        Unknown(
            "white standard between the listed geometries",
            "standard.u_shape",
            _between_unknown,
        ),
        Unknown(
            "change of the white standard with theta_i",
            "standard.reciprocal",
            _incidence_unknown,
        ),
    ),
    quantities=(StatedQuantity("uncertainty of the standard's shape, at 75°", "standard.u_shape"),),
)
