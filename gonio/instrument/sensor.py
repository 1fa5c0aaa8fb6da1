"""The sensor: photo-electrons to counts, in the order in which a camera does it.

photo-electrons -> PRNU -> shot noise -> full well (dark current adds its electrons before the
clip) -> read noise -> gain -> black level -> ADC -> clip. Binned pixels are summed after the ADC,
as a computer sums them.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from gonio.geometry import FloatArray
from gonio.instrument.part import Part


class Sensor(Part):
    """A monochrome sensor read in a window and binned by summing counts.

    All electron and count figures are of one pixel; the binned figures are properties.
    """

    rows: int = Field(gt=0, description="rows of the readout window, unbinned")
    columns: int = Field(gt=0, description="columns of the readout window, unbinned")
    pitch_um: tuple[float, float] = Field(description="pixel pitch in x and y")
    binning: int = Field(
        default=1, ge=1, description="side of the block of pixels whose counts are summed"
    )
    full_well_e: float = Field(gt=0)
    read_noise_e: float = Field(ge=0)
    dark_e_per_s: float = Field(ge=0)
    prnu: float = Field(ge=0, lt=0.5, description="relative sd of the pixels' response")
    bits: int = Field(ge=8, le=16)
    gain_dn_per_e: float = Field(gt=0)
    black_dn: float = Field(ge=0)
    exposures_s: tuple[float, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _possible(self) -> Sensor:
        if self.rows % self.binning or self.columns % self.binning:
            raise ValueError(
                f"binning {self.binning} must divide rows {self.rows} and columns {self.columns}"
            )
        if self.saturation_dn > 65535:
            raise ValueError(
                f"{self.bits} bits binned {self.binning} x {self.binning} exceed 16 bits a frame"
            )
        if any(b <= a for a, b in zip(self.exposures_s, self.exposures_s[1:], strict=False)):
            raise ValueError("exposures_s must grow")
        if min(self.exposures_s) <= 0:
            raise ValueError("exposures_s must be positive")
        return self

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a binned frame."""
        return self.rows // self.binning, self.columns // self.binning

    @property
    def n_summed(self) -> int:
        """Pixels in a bin."""
        return self.binning**2

    @property
    def saturation_dn(self) -> int:
        """Largest count of a binned pixel."""
        return self.n_summed * ((1 << self.bits) - 1)

    @property
    def binned_black_dn(self) -> float:
        """Black level of a binned pixel."""
        return self.n_summed * self.black_dn

    @property
    def binned_full_well_e(self) -> float:
        """Full well of a binned pixel."""
        return self.n_summed * self.full_well_e

    @property
    def binned_noise_dn(self) -> float:
        """Read noise of a binned pixel in counts, rounding by the ADC of all but one included.

        The sum of n rounded counts carries n/12 of rounding variance; the final rounding of the
        simulated sum brings one twelfth itself.
        """
        n = self.n_summed
        return float(np.sqrt(n * (self.gain_dn_per_e * self.read_noise_e) ** 2 + (n - 1) / 12))

    def positions_mm(self) -> tuple[FloatArray, FloatArray]:
        """x of the binned columns and y of the binned rows, mm from the image's centre."""
        pitch_x, pitch_y = (p * 1e-3 * self.binning for p in self.pitch_um)
        rows, columns = self.shape
        x = (np.arange(columns, dtype=np.float64) - (columns - 1) / 2) * pitch_x
        y = (np.arange(rows, dtype=np.float64) - (rows - 1) / 2) * pitch_y
        return np.asarray(x), np.asarray(y)

    def response(self, seed: int) -> FloatArray:
        """Relative response 1 + PRNU of every binned pixel, a fixed pattern of the camera."""
        rng = np.random.Generator(np.random.Philox(key=seed))
        return 1 + self.prnu / self.binning * rng.standard_normal(self.shape)
