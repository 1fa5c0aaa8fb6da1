"""The sensor: photo-electrons to counts, in the order of a camera.

photo-electrons -> PRNU, dead pixels -> dark current of every pixel -> shot noise -> full well ->
response -> gain -> read noise -> black level -> ADC -> clip. Pixels of a bin are summed after the
ADC, as software does. This file holds the properties and the fixed patterns of a camera; the
noise is drawn in `noise.py`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from gonio.geometry import FloatArray
from gonio.instrument.part import Part


class Sensor(Part):
    """A monochrome sensor read in a window and binned by summing counts.

    Electrons and counts are those of one pixel; properties named `binned` belong to a binned one.
    """

    rows: int = Field(gt=0, description="rows of the readout window, unbinned")
    columns: int = Field(gt=0, description="columns of the readout window, unbinned")
    pitch_um: tuple[float, float] = Field(description="pixel pitch in x and y")
    centre_offset_px: tuple[float, float] = Field(
        default=(0.0, 0.0),
        description="column and row of the lens axis from the middle of the window, unbinned",
    )
    binning: int = Field(
        default=1, ge=1, description="side of the block of pixels whose counts are summed"
    )
    binned_divisor: int = Field(
        default=1, ge=1, description="divisor of the sum, so that it fits into 16 bits"
    )
    full_well_e: float = Field(gt=0, description="full well of a pixel")
    read_noise_e: float = Field(ge=0, description="sd of the read noise")
    dark_e_per_s: float = Field(ge=0, description="mean dark current")
    dsnu_e_per_s: float = Field(
        default=0.0, ge=0, description="sd of the dark current from pixel to pixel"
    )
    prnu: float = Field(ge=0, lt=0.5, description="relative sd of the pixels' response")
    dead_fraction: float = Field(
        default=0.0, ge=0, le=0.1, description="share of pixels without any response"
    )
    hot_fraction: float = Field(
        default=0.0, ge=0, le=0.1, description="share of pixels with a large dark current"
    )
    hot_e_per_s: float = Field(
        default=0.0, ge=0, description="mean dark current of hot pixels on top of the others'"
    )
    bits: int = Field(ge=8, le=16, description="bits of the converter")
    gain_dn_per_e: float = Field(gt=0, description="gain: counts per electron")
    gamma: float = Field(
        default=1.0,
        gt=0.2,
        le=2,
        description="response: counts above black are gain full_well (e-/full_well)^gamma",
    )
    nonlinearity_per_decade: float = Field(
        default=0.0,
        ge=-0.05,
        le=0.05,
        description="what is left of a nonlinearity: counts above black are further "
        "times 1 + nonlinearity_per_decade log10(e-/full_well)",
    )
    u_nonlinearity_per_decade: float | None = Field(
        default=None,
        ge=0,
        le=0.05,
        description="what the laboratory takes for its standard uncertainty about 0; left out, it "
        "is unknown, but for a sensor that is linear",
    )
    black_dn: float = Field(ge=0, description="black level: counts without light")
    exposures_s: tuple[float, ...] = Field(
        min_length=1, description="exposure times, in increasing order"
    )

    @model_validator(mode="after")
    def _possible(self) -> Sensor:
        if self.rows % self.binning or self.columns % self.binning:
            raise ValueError(
                f"binning {self.binning} must divide rows {self.rows} and columns {self.columns}"
            )
        if self.saturation_dn > 65535:
            least = -(-self.n_summed * ((1 << self.bits) - 1) // 65535)
            raise ValueError(
                f"{self.bits} bits binned {self.binning} x {self.binning} exceed 16 bits a frame; "
                f"a binned_divisor of {least} or more makes them fit"
            )
        if any(b <= a for a, b in zip(self.exposures_s, self.exposures_s[1:], strict=False)):
            raise ValueError("exposures_s must grow")
        if min(self.exposures_s) <= 0:
            raise ValueError("exposures_s must be positive")
        if self.dsnu_e_per_s and not self.dark_e_per_s:
            raise ValueError("dsnu_e_per_s needs a dark current that varies, dark_e_per_s > 0")
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
        return self.n_summed * ((1 << self.bits) - 1) // self.binned_divisor

    @property
    def binned_gain_dn_per_e(self) -> float:
        """Counts of a binned pixel for an electron."""
        return self.gain_dn_per_e / self.binned_divisor

    @property
    def binned_black_dn(self) -> float:
        """Black level of a binned pixel."""
        return self.n_summed * self.black_dn / self.binned_divisor

    @property
    def binned_full_well_e(self) -> float:
        """Full well of a binned pixel."""
        return self.n_summed * self.full_well_e

    @property
    def binned_noise_dn(self) -> float:
        """Read noise of a binned pixel in counts, rounding by the ADC of all but one included.

        The sum of n rounded counts carries n/12 of rounding variance; the final rounding of the
        simulated sum brings one twelfth itself. Where the sum is divided by d and rounded again,
        the two make (n + d^2 - 1)/12 d^2, and the same is left after that twelfth: (n - 1)/12 d^2.
        """
        n = self.n_summed
        sum_dn = float(np.sqrt(n * (self.gain_dn_per_e * self.read_noise_e) ** 2 + (n - 1) / 12))
        return sum_dn / self.binned_divisor

    def readout(self) -> dict[str, Any]:
        """Properties of a binned pixel for the conversion to counts, for `noise.expose`."""
        return {
            "full_well_e": self.binned_full_well_e,
            "gain_dn_per_e": self.binned_gain_dn_per_e,
            "noise_dn": self.binned_noise_dn,
            "black_dn": self.binned_black_dn,
            "saturation_dn": self.saturation_dn,
            "gamma": self.gamma,
            "nonlinearity_per_decade": self.nonlinearity_per_decade,
        }

    def centre_px(self) -> tuple[float, float]:
        """Column and row of the lens axis in a binned frame; whole numbers are pixels' centres."""
        rows, columns = self.shape
        x, y = (offset / self.binning for offset in self.centre_offset_px)
        return (columns - 1) / 2 + x, (rows - 1) / 2 + y

    def positions_mm(self) -> tuple[FloatArray, FloatArray]:
        """x of the binned columns and y of the binned rows, mm from the image's centre."""
        pitch_x, pitch_y = (p * 1e-3 * self.binning for p in self.pitch_um)
        rows, columns = self.shape
        centre_x, centre_y = self.centre_px()
        x = (np.arange(columns, dtype=np.float64) - centre_x) * pitch_x
        y = (np.arange(rows, dtype=np.float64) - centre_y) * pitch_y
        return np.asarray(x), np.asarray(y)

    def response(self, seed: int) -> FloatArray:
        """Relative response of every binned pixel, a fixed pattern of the camera.

        1 + PRNU, less the share of its pixels that are dead.
        """
        pattern = 1 + self.prnu / self.binning * _rng(seed, 0).standard_normal(self.shape)
        if not self.dead_fraction:
            return pattern
        dead, _ = self.bad_pixels(seed)
        return pattern * (1 - dead / self.n_summed)

    def bad_pixels(self, seed: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """How many pixels of every bin are dead, and how many are hot: a fixed map.

        Returns
        -------
        dead, hot : ndarray of int64, shape (rows, columns)
        """
        rng = _rng(seed, 1)
        dead = rng.binomial(self.n_summed, self.dead_fraction, self.shape)
        return dead, rng.binomial(self.n_summed - dead, self.hot_fraction)

    def dark_current(self, seed: int) -> FloatArray:
        """Dark current of every binned pixel, e-/s: a fixed pattern.

        Pixels follow the gamma distribution of mean `dark_e_per_s` and sd `dsnu_e_per_s`, which
        is never negative and whose sums over bins are gamma numbers again; a hot pixel adds an
        exponential number of mean `hot_e_per_s`.
        """
        dead, hot = self.bad_pixels(seed)
        alive = (self.n_summed - dead).astype(float)
        rng = _rng(seed, 2)
        current = self.dark_e_per_s * alive
        if self.dsnu_e_per_s:
            spread = self.dsnu_e_per_s**2 / self.dark_e_per_s
            current = rng.gamma(current / spread, spread)
        return np.asarray(current + rng.gamma(hot.astype(float), self.hot_e_per_s))


def _rng(seed: int, pattern: int) -> np.random.Generator:
    """One generator for each fixed pattern of a camera, independent of the others."""
    # 2^192 numbers lie between the counters.
    return np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, 0, pattern]))
