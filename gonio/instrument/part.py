"""Base of all parts of an instrument: frozen, every unknown key an error."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Part(BaseModel):
    """A part of the instrument; lengths in mm, angles in degrees, as the field names say."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
