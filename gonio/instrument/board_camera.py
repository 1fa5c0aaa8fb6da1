"""The camera of an instrument without its dome, for photographs of a calibration board."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from gonio.errors import ConfigurationError
from gonio.geometry import FloatArray, angles
from gonio.instrument.lens import Lens
from gonio.instrument.sensor import Sensor

if TYPE_CHECKING:
    from gonio.instrument import Instrument


@dataclass(frozen=True)
class BoardCamera:
    """The camera of an instrument without its dome: lens and sensor, in the frame of the lens.

    Parameters
    ----------
    lens : Lens
        Its field may exceed 180 deg, because there is no dome.
    sensor : Sensor
        The sensor, with the binning of the photographs.

    Raises
    ------
    ConfigurationError
        If the image radius does not increase with theta up to the edge of the field.
    """

    lens: Lens
    sensor: Sensor

    def __post_init__(self) -> None:
        if np.any(self.lens.slope(np.linspace(0, self.half_field, 1001)) <= 0):
            raise ConfigurationError(
                f"the lens's image stops growing before its edge at {self.lens.field_deg / 2:g} "
                "deg; give a smaller field or other coefficients.",
                value=self.lens.k,
            )

    @classmethod
    def of(
        cls,
        instrument: Instrument,
        *,
        binning: int = 1,
        centre_offset_px: tuple[float, float] | None = None,
        psf_px: float | None = None,
        field_deg: float | None = None,
    ) -> BoardCamera:
        """The camera of an instrument, with the given values in place of its own.

        Parameters
        ----------
        instrument : Instrument
        binning : int
            Side of the block of pixels whose counts are summed; default: full resolution.
        centre_offset_px : tuple of float, optional
            Column and row of the lens axis from the middle of the window, unbinned pixels.
        psf_px : float, optional
            Standard deviation of the lens's blur, unbinned pixels.
        field_deg : float, optional
            Full field, up to 300 deg.

        Raises
        ------
        ConfigurationError
            If a value is out of range or the binning does not divide the window.
        """
        sensor = instrument.sensor
        if binning < 1 or sensor.rows % binning or sensor.columns % binning:
            raise ConfigurationError(
                f"binning {binning} does not divide the {sensor.columns} x {sensor.rows} pixels "
                f"of {instrument.name}.",
                value=binning,
            )
        for name, value, most in (("psf_px", psf_px, 50.0), ("field_deg", field_deg, 300.0)):
            if value is not None and not 0 <= value <= most:
                raise ConfigurationError(
                    f"{name} = {value:g} is out of range; allowed is 0 to {most:g}.", value=value
                )
        sum_dn = binning**2 * ((1 << sensor.bits) - 1)
        change: dict[str, Any] = {
            "binning": binning,
            "binned_divisor": max(sensor.binned_divisor, -(-sum_dn // 65535)),
        }
        if centre_offset_px is not None:
            change["centre_offset_px"] = centre_offset_px
        given = {"psf_px": psf_px, "field_deg": field_deg}
        return cls(
            instrument.lens.model_copy(update={k: v for k, v in given.items() if v is not None}),
            sensor.model_copy(update=change),
        )

    @property
    def half_field(self) -> float:
        """Polar angle of the field's edge, radians."""
        return float(np.radians(self.lens.field_deg / 2))

    @property
    def pitch_mm(self) -> FloatArray:
        """Pitch of the photograph's pixels in x and y."""
        return np.array(self.sensor.pitch_um) * 1e-3 * self.sensor.binning

    @property
    def centre_px(self) -> FloatArray:
        """Column and row of the axis; whole numbers are pixels' centres."""
        return np.array(self.sensor.centre_px())

    def project(self, points: FloatArray) -> FloatArray:
        """Column and row (..., 2) of points (..., 3) before the camera; NaN outside the field."""
        theta, phi = angles(points)
        radius = np.where(theta <= self.half_field, self.lens.radius(theta), np.nan)
        at = np.stack([radius * np.cos(phi), radius * np.sin(phi)], -1)
        return np.asarray(at / self.pitch_mm + self.centre_px)
