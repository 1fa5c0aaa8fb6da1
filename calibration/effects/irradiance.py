"""The irradiance where it was computed from that of the standard at another incidence."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.effects.base import Effect, Figure, Measured, TermRecord, Unknown
from gonio.metadata import Metadata
from gonio.shared_term import SharedTerm

_MEANING = "irradiance computed for another incidence than the standard's"
ALIKE = TermRecord("irradiance", _MEANING)
EACH = TermRecord("irradiance, incidence", f"{_MEANING}, each for itself", belongs_to="session")


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """In transmission the dome's T_d carries it, one number for all.

    In reflection nobody knows how far the errors of two incidences are alike: half of the variance
    is taken to be.
    """
    plan = measured.metadata.plan
    u = plan.u_irradiance
    if not u or plan.standard_theta_i_deg is None:
        return
    if plan.mode == "transmission":
        yield ALIKE.shared(u)
        return
    half = u / np.sqrt(2)
    yield ALIKE.shared(half, meaning=f"{_MEANING}, alike at all")
    yield EACH.shared(half, group=measured.incidence)


def _not_stated(metadata: Metadata, pixel_map: PixelMap) -> bool:
    plan = metadata.plan
    return plan.standard_theta_i_deg is not None and plan.u_irradiance is None


EFFECT = Effect(
    key="irradiance",
    order=70,
    title="irradiance at another incidence",
    text="Where the standard was taken at one incidence only, the irradiance at the others is "
    "computed: by the cosine and, in transmission, by the dome's transmittance.",
    records=(ALIKE, EACH),
    terms=terms,
    unknown=(
        Unknown(
            "irradiance at another incidence than the standard's",
            "plan.u_irradiance",
            _not_stated,
        ),
    ),
    figures=(Figure("relative uncertainty of a computed irradiance", "plan.u_irradiance"),),
)
