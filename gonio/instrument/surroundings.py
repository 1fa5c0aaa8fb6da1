"""Light at the camera other than the first reflection of the lamp's light by the sample."""

from __future__ import annotations

from pydantic import Field

from gonio.instrument.part import Part


class Surroundings(Part):
    """Stray light, the entry patch of the lamp, ambient light and multiple reflections."""

    stray: float = Field(
        default=0.0,
        ge=0,
        description="lamp light scattered to every pixel, as a fraction of the white "
        "standard at normal incidence",
    )
    entry_patch: float = Field(
        default=0.0,
        ge=0,
        description="the same, inside the patch of the dome where the beam enters",
    )
    ambient: float = Field(
        default=0.0, ge=0, description="room light, in the same unit; it does not drift"
    )
    ambient_reflected: float = Field(
        default=0.0,
        ge=0,
        description="room light that falls on the sample, as a fraction of the lamp's irradiance "
        "at normal incidence; without a sample it is not seen",
    )
    multibounce: float = Field(
        default=0.0,
        ge=0,
        lt=0.5,
        description="g: the irradiance of the sample increases by the factor 1 + g albedo, by "
        "light that the lens front and the dome reflect back",
    )
    multibounce_uncertainty: float | None = Field(
        default=None,
        ge=0,
        lt=0.5,
        description="relative standard uncertainty of g; the true value is drawn. Without it, g is "
        "unknown to the operator and the reduction does not correct for it",
    )
