"""A colour filter before the lamp or the camera: one channel of a session."""

from __future__ import annotations

from pydantic import Field

from gonio.instrument.part import Part


class Filter(Part):
    """A channel and its transmitted signal."""

    name: str = Field(default="", description="name of the channel")
    wavelength_nm: float | None = Field(
        default=None, gt=0, description="wavelength at which it transmits"
    )
    relative_rate: float = Field(
        default=1.0, gt=0, description="photo-electrons relative to white_rate_e_per_s"
    )
