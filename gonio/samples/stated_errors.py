"""Errors that all samples of a file share, as its owner states them."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from gonio.errors import ConfigurationError
from gonio.geometry import FloatArray, unit_vectors
from gonio.samples.record import SampleRecord
from gonio.shared_term import SharedTerm

Samples = TypeVar("Samples", bound=SampleRecord)
MOST_ANGLE = np.radians(10.0)  # larger ones are degrees given as radians


def with_shared_errors(
    samples: Samples, *, u_scale: float | None = None, u_angle: float | None = None
) -> Samples:
    """The samples with shared errors of their scale and of their angles added.

    Parameters
    ----------
    samples : BRDFSamples
    u_scale : float, optional
        Standard uncertainty of one factor on all values, as a fraction: of the reference standard,
        say.
    u_angle : float, optional
        Standard uncertainty of the alignment, radians. It adds three errors, each one draw for all
        samples: the viewing directions turned within the plane of incidence, and out of it, and the
        sample turned about its normal.

    Raises
    ------
    ConfigurationError
        For an uncertainty that is not positive, a scale above 1 or an angle above 10 degrees.

    Notes
    -----
    A zero error of an arm turns directions within the plane of incidence. A tilt of the sample
    moves half vectors by as much as a turn of the viewing directions by twice its angle. Errors of
    single readings are noise, and belong to u_brdf.

    Examples
    --------
    >>> from gonio.geometry import Directions
    >>> from gonio.samples import BRDFSamples
    >>> samples = BRDFSamples(Directions(0.5, 0.0, [0.1, 0.6], np.pi), [0.2, 0.3])
    >>> [term.name for term in with_shared_errors(samples, u_scale=0.01, u_angle=0.002).shared]
    ['scale', 'angles, in plane', 'angles, across', 'angles, azimuth']
    """
    terms: list[SharedTerm] = []
    if u_scale is not None:
        _check("u_scale", u_scale, 1.0, "a fraction, such as 0.01 for 1 %")
        text = "one factor on all values, as stated"
        terms.append(SharedTerm("scale", text, relative=u_scale, belongs_to="session"))
    if u_angle is not None:
        _check("u_angle", u_angle, float(MOST_ANGLE), "radians, such as 0.0017 for 0.1 deg")
        terms += _angle_terms(samples, u_angle)
    return replace(samples, shared=(*samples.shared, *terms)) if terms else samples


def _check(name: str, value: float, most: float, kind: str) -> None:
    if not 0 < value <= most:
        raise ConfigurationError(
            f"{name} is {value:g}; it is {kind}, above 0 and at most {most:.3g}.", value=value
        )


def _angle_terms(samples: SampleRecord, u_angle: float) -> list[SharedTerm]:
    """Two turns of the viewing directions and one of the sample."""
    d, n = samples.directions, len(samples.value)
    phi_i = np.broadcast_to(d.phi_i, (n,))
    w_r = np.broadcast_to(d.vectors()[1], (n, 3))
    level = np.full(n, np.pi / 2)
    axes: dict[str, FloatArray] = {
        "in plane": unit_vectors(level, phi_i + np.pi / 2),
        "across": unit_vectors(level, phi_i),
    }
    turned = [
        SharedTerm(
            f"angles, {name}",
            f"viewing directions turned {name} of incidence, as stated"
            if name == "in plane"
            else "viewing directions turned out of the plane of incidence, as stated",
            shift=u_angle * np.cross(axis, w_r),
            belongs_to="session",
        )
        for name, axis in axes.items()
    ]
    about_normal = SharedTerm(
        "angles, azimuth",
        "the sample turned about its normal, as stated",
        turn=u_angle,
        belongs_to="session",
    )
    return [*turned, about_normal]
