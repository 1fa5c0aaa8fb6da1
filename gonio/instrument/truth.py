"""True values of each pixel of a simulated session: for comparison, never for calibration.

`truth/images.zarr` holds

- `brdf` (channel, take, incidence, row, column): f of the surface in sr^-1 between the middle of
  the lamp and the mean direction that the pixel really sees, slope errors and misplaced pupil
  included; NaN outside the image circle. Float32 rounded to 14 significant bits, 3e-5 of the value;
- `weight` (incidence, row, column): m_p, the share of the pixel's rays that land on lit sample;
- `dead_pixels`, `hot_pixels` (row, column): how many pixels of each bin are bad;
- `slope_error` (row, column, axis): slope errors of the dome where the pixel looks, radians;
- `dome_reflectance` (row, column): R_d there over its nominal value.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray, unit_vectors
from gonio.instrument import imaging
from gonio.instrument.images import Images
from gonio.metadata import Plan

SHARE = 0.2  # of the space of the frames that the images may take by default
# Bytes relative to one compressed frame: an image of f, a map of weights, and all maps of the
# instrument.
_BRDF, _WEIGHT, _MAPS = 0.5, 0.3, 3.0
_DROPPED_BITS = 10  # of the 24 of a float32's significand


def economical(plan: Plan) -> bool:
    """Whether images of the truth would take at most a fifth of the frames' space."""
    incidences = len(plan.theta_i_deg)
    images = 0 if plan.mode == "mirror" else plan.takes("sample") * incidences * len(plan.channels)
    return _BRDF * images + _WEIGHT * incidences + _MAPS <= SHARE * plan.n_frames


class TruthImages:
    """The arrays of one session, written as its images are taken.

    Parameters
    ----------
    folder : Path
        The session's folder `truth`.
    images : Images
    """

    def __init__(self, folder: Path, images: Images) -> None:
        import zarr

        self._images = images
        self._group = zarr.open_group(folder / "images.zarr", mode="a", zarr_format=3)
        self._brdf: Any = None

    def write_maps(self) -> None:
        """Write the maps of the instrument."""
        instrument, rays, fixed = self._images.instrument, self._images.rays, self._images.fixed
        dome = instrument.dome
        dead, hot = instrument.sensor.bad_pixels(fixed.pattern_seed)
        self._put("dead_pixels", dead.astype(np.uint16), "row", "column")
        self._put("hot_pixels", hot.astype(np.uint16), "row", "column")
        slope = dome.slope_errors(rays.point, np.random.default_rng(fixed.dome_seed))
        self._put("slope_error", _rounded(self._in_frame(slope)), "row", "column", "axis")
        coating = imaging.coating_reflectance(instrument, rays.point, fixed.dome_seed)
        self._put("dome_reflectance", self._in_frame(coating), "row", "column")
        weight = [self._weight(np.radians(theta)) for theta in self._images.plan.theta_i_deg]
        self._put("weight", np.stack(weight), "incidence", "row", "column")

    def write_brdf(self, take: int, incidence: int) -> None:
        """Write f of every pixel in one image of the sample, for all channels; not of a mirror."""
        images, surface = self._images, self._images.surface
        if surface.model is None:
            return
        plan, instrument = images.plan, images.instrument
        rows, columns = instrument.sensor.shape
        if self._brdf is None:
            self._brdf = self._brdf_array(
                (len(plan.channels), plan.takes("sample"), len(plan.theta_i_deg), rows, columns)
            )
        psi = images.rotation(take)
        w_i = imaging.in_sample_frame(
            instrument, unit_vectors(np.radians(plan.theta_i_deg[incidence]), 0.0), psi
        )
        w_r = imaging.in_sample_frame(instrument, images.mean_directions, psi)
        for channel, p in enumerate(surface.p):
            f = surface.model.evaluate(w_i, w_r, p, threads=images.threads)
            self._brdf[channel, take, incidence] = _rounded(self._in_frame(f))

    def _weight(self, theta_i: float) -> NDArray[np.float32]:
        lit = imaging.lit_weights(self._images.instrument, self._images.rays, theta_i)
        return self._in_frame(np.mean(lit > 0, axis=1))

    def _in_frame(self, values: FloatArray) -> NDArray[np.float32]:
        """Values (n, ...) of the pixels in the image circle, put into the frame; NaN elsewhere."""
        rows, columns = self._images.instrument.sensor.shape
        frame = np.full((rows * columns, *values.shape[1:]), np.nan, np.float32)
        frame[self._images.rays.pixel] = values
        return frame.reshape(rows, columns, *values.shape[1:])

    def _put(self, name: str, values: NDArray[Any], *dimensions: str) -> None:
        self._group.create_array(
            name,
            data=values,
            chunks=((1, *values.shape[1:]) if dimensions[0] == "incidence" else values.shape),
            compressors=_codecs(),
            dimension_names=list(dimensions),
            overwrite=True,
        )

    def _brdf_array(self, shape: tuple[int, ...]) -> Any:
        """The array of f: that of an interrupted session, or a new one."""
        if "brdf" in self._group:
            return self._group["brdf"]
        return self._group.create_array(
            "brdf",
            shape=shape,
            chunks=(1, 1, 1, *shape[3:]),
            dtype="float32",
            fill_value=np.nan,
            compressors=_codecs(),
            dimension_names=["channel", "take", "incidence", "row", "column"],
        )


def _codecs() -> list[Any]:
    from zarr.codecs import BloscCodec

    return [BloscCodec(cname="zstd", clevel=3, shuffle="bitshuffle")]


def _rounded(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Round to 14 significant bits; the zeros that follow compress to nothing."""
    half, kept = np.int32(1 << (_DROPPED_BITS - 1)), np.int32(-1 << _DROPPED_BITS)
    bits = values.view(np.int32)
    return np.where(np.isnan(values), values, ((bits + half) & kept).view(np.float32))
