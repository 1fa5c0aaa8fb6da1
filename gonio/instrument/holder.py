"""The holder: the sample's size."""

from __future__ import annotations

from pydantic import Field

from gonio.instrument.part import Part


class Holder(Part):
    """Carries the sample at the target point and turns it by hand about its normal."""

    sample_diameter_mm: float = Field(gt=0, description="diameter of the sample")
