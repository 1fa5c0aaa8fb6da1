"""What the terms of a samples file of version 0.1 are, which has nothing but their names.

This is the one place that knows a shared term by its name: for files that were written before
terms said what they are. Terms of one's own are not in the table and stay unknown.
"""

from __future__ import annotations

import re
from typing import Any

_RIG: dict[str, Any] = {
    "evaluation": "B",
    "averages": False,
    "constant": False,
    "belongs_to": "rig",
}
_SAME = {**_RIG, "constant": True}
_FITTED = {**_RIG, "evaluation": "A"}
_SESSION = {**_RIG, "belongs_to": "session"}
_AVERAGED = {**_SESSION, "averages": True}

_TERMS: dict[str, dict[str, Any]] = {
    "mapping": {"effect": "mapping", **_SAME},
    "geometry, mode N": {"effect": "calibrated_geometry", **_FITTED},
    "lens, mode N": {"effect": "calibrated_geometry", **_FITTED},
    "source cone": {"effect": "source_cone", **_SAME},
    "dome slope, shift": {"effect": "dome_slope", **_RIG},
    "dome slope, in plane": {"effect": "dome_slope", **_RIG},
    "dome slope, across": {"effect": "dome_slope", **_RIG},
    "dome slope, shear in plane": {"effect": "dome_slope", **_RIG},
    "dome slope, shear across": {"effect": "dome_slope", **_RIG},
    "azimuth": {"effect": "azimuth", **_RIG},
    "standard": {"effect": "standard_certificate", **_RIG},
    "standard, shape": {"effect": "standard_certificate", **_SAME},
    "irradiance": {"effect": "irradiance", **_RIG},
    "irradiance, incidence": {"effect": "irradiance", **_SESSION},
    "lamp, sample": {"effect": "lamp_drift", **_SESSION},
    "lamp, standard": {"effect": "lamp_drift", **_AVERAGED},
    "lamp, background": {"effect": "lamp_drift", **_AVERAGED},
    "lamp, background 2": {"effect": "lamp_drift", **_AVERAGED},
    "multi-bounce": {"effect": "multibounce", **_SAME},
    "room light": {"effect": "room_light", **_SAME},
}


def properties(name: str) -> dict[str, Any]:
    """Fields of `gonio.shared_term.SharedTerm` that a file of version 0.1 does not hold.

    Parameters
    ----------
    name : str
        As `gonio reduce` of that version named the term.

    Returns
    -------
    dict
        Empty for a name that it did not use.

    Examples
    --------
    >>> properties("geometry, mode 3")["effect"], properties("tilt of my sample")
    ('calibrated_geometry', {})
    """
    return dict(_TERMS.get(re.sub(r"mode \d+$", "mode N", name), {}))
