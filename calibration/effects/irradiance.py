"""The irradiance, if it is computed from that of the standard at another incidence."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.effects.base import Effect, Measured, StatedQuantity, TermRecord, Unknown
from gonio.metadata import Metadata
from gonio.shared_term import SharedTerm

_MEANING = "irradiance computed for another incidence than the standard's"
COMMON = TermRecord("irradiance", _MEANING)
EACH = TermRecord("irradiance, incidence", f"{_MEANING}, each for itself", belongs_to="session")


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """In transmission the error is that of the dome's T_d: one factor for all incidences.

    In reflection the correlation between two incidences is unknown. Half of the variance is taken
    to be common to all.
    """
    plan = measured.metadata.plan
    u = plan.u_irradiance
    if not u or plan.standard_theta_i_deg is None:
        return
    if plan.mode == "transmission":
        yield COMMON.shared(u)
        return
    half = u / np.sqrt(2)
    yield COMMON.shared(half, meaning=f"{_MEANING}, common to all")
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
    records=(COMMON, EACH),
    terms=terms,
    unknown=(
        Unknown(
            "irradiance at another incidence than the standard's",
            "plan.u_irradiance",
            _not_stated,
        ),
    ),
    quantities=(
        StatedQuantity("relative uncertainty of a computed irradiance", "plan.u_irradiance"),
    ),
)
