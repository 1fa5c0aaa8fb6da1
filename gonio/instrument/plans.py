"""Default plans of an instrument: reflection, transmission, a mirror."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from gonio.instrument import Instrument
from gonio.metadata import Plan
from gonio.models import Model

N_INCIDENCES = 21  # as the paper: "measured at 21 incident angles" (Ward 1992, section 4.2)
ANISOTROPIC_ROTATIONS_DEG = (0.0, 45.0, 90.0)
STANDARD_AT_DEG = 45.0  # in transmission, away from directly transmitted light
MIRROR_STEP_DEG = 15.0
WEDGE_ROTATIONS_DEG = tuple(45.0 * k for k in range(8))
_SPOT_SHARE = 0.6  # of the range of counts, for the brightest pixel of a mirror image
Values = float | Sequence[float]


def default_plan(instrument: Instrument, *, anisotropic: bool) -> Plan:
    """21 incidence angles from 0 to the limit of the arm; three rotations if anisotropic."""
    from gonio.instrument.records import channels

    angles = np.linspace(0, instrument.theta_i_max_deg, N_INCIDENCES)
    return Plan(
        theta_i_deg=tuple(float(a) for a in angles),
        rotations_deg=ANISOTROPIC_ROTATIONS_DEG if anisotropic else (0.0,),
        exposures_s=instrument.sensor.exposures_s,
        channels=channels(instrument),
    )


def transmission_plan(
    instrument: Instrument, *, anisotropic: bool, standard_theta_i_deg: float | None = None
) -> Plan:
    """The default plan with the lamp below; the standard is taken once, in reflection."""
    plan = default_plan(instrument, anisotropic=anisotropic)
    at = min(STANDARD_AT_DEG, instrument.theta_i_max_deg)
    given = at if standard_theta_i_deg is None else standard_theta_i_deg
    return Plan.model_validate(
        plan.model_dump() | {"mode": "transmission", "standard_theta_i_deg": given}
    )


def mirror_plan(instrument: Instrument, *, wedge_deg: float = 0.0) -> Plan:
    """The plan for an alignment: a mirror, the lamp on both sides, exposures without saturation.

    A level mirror reflects the lamp only within the plane of the arm. A wedge of some degrees,
    rotated with the holder, distributes the spots over the dome.

    Parameters
    ----------
    instrument : Instrument
    wedge_deg : float
        Tilt of the mirror's normal, degrees.
    """
    from gonio.instrument import imaging, mirror
    from gonio.instrument.records import channels

    steps = int(instrument.theta_i_max_deg // MIRROR_STEP_DEG)
    sensor = instrument.sensor
    # One ray per pixel gives the largest possible signal of a pixel.
    coarse = instrument.model_copy(update={"rays_per_pixel": 1})
    rate = mirror.brightest_rate(coarse, imaging.trace_rays(coarse, 0))
    rate *= max(channel.relative_rate for channel in instrument.channels)
    range_dn = sensor.saturation_dn - sensor.binned_black_dn
    full_e = min(sensor.binned_full_well_e, range_dn / sensor.binned_gain_dn_per_e)
    longest = float(f"{_SPOT_SHARE * full_e / rate:.2g}")
    return Plan(
        theta_i_deg=tuple(MIRROR_STEP_DEG * k for k in range(-steps, steps + 1)),
        rotations_deg=WEDGE_ROTATIONS_DEG if wedge_deg else (0.0,),
        exposures_s=(longest / 4, longest),
        channels=channels(instrument),
        mode="mirror",
        wedge_deg=wedge_deg,
    )


def is_anisotropic(model: Model, parameters: Mapping[str, Values]) -> bool:
    """Whether the reflection depends on the rotation of the surface about its normal.

    False if the model claims isotropy, or if alpha_x = alpha_y.

    Parameters
    ----------
    model : Model
    parameters : mapping
        All parameters of the model, with one value or one per channel.

    Examples
    --------
    >>> from gonio.models import get as get_model
    >>> is_anisotropic(get_model("ward"), {"alpha_x": 0.1, "alpha_y": 0.1})
    False
    """
    if model.claims.isotropic:
        return False
    if not {"alpha_x", "alpha_y"} <= set(parameters):
        return True
    x, y = (np.atleast_1d(parameters[name]) for name in ("alpha_x", "alpha_y"))
    return bool(np.any(x != y))
