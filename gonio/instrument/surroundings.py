"""What the camera sees besides the lamp's light from the sample's first reflection."""

from __future__ import annotations

from pydantic import Field

from gonio.instrument.part import Part


class Surroundings(Part):
    """Stray light, the lamp's entry patch, ambient light and light that goes round twice."""

    stray: float = Field(
        default=0.0,
        ge=0,
        description="lamp light scattered to every pixel, as a fraction of the white "
        "standard at normal incidence",
    )
    entry_patch: float = Field(
        default=0.0, ge=0, description="the same inside the patch of the dome where the beam enters"
    )
    ambient: float = Field(
        default=0.0, ge=0, description="room light, same unit; it does not drift"
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
        description="g: the irradiance of the sample grows by 1 + g albedo, "
        "light thrown back by the lens front and the dome",
    )
    multibounce_uncertainty: float | None = Field(
        default=None,
        ge=0,
        lt=0.5,
        description="relative standard uncertainty of g, the true one is drawn; not given, the "
        "operator has no measure of it and the reduction does not correct",
    )
