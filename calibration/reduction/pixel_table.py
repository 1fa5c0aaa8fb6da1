"""The pixels that a reduction uses and their directions, in the order in which cells are made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.reduction import cells
from gonio.dome_map import DomeMap
from gonio.errors import DataError
from gonio.geometry import FloatArray, angles, equal_area
from gonio.metadata import Metadata


@dataclass(frozen=True)
class PixelTable:
    """Pixels of the usable hemisphere in Morton order, laboratory frame.

    Parameters
    ----------
    index : ndarray of int64, shape (n,)
        Flat index in the frame.
    keys : ndarray of int64, shape (n,)
        Morton keys of the positions in an equal-area map.
    at : ndarray, shape (n, 2)
        Column and row.
    w_r : ndarray, shape (n, 3)
        Directions of the centres.
    points : ndarray, shape (n, 4, 3)
        Directions of the Gauss points of each pixel's area.
    solid_angle : ndarray, shape (n,)
        On the side of the sample, sr.
    theta_r, phi_r : ndarray, shape (rows, columns)
        Of all pixels, radians; NaN outside the image circle.
    """

    index: NDArray[np.int64]
    keys: NDArray[np.int64]
    at: FloatArray
    w_r: FloatArray
    points: FloatArray
    solid_angle: FloatArray
    theta_r: FloatArray
    phi_r: FloatArray

    @classmethod
    def of(cls, metadata: Metadata, pixel_map: PixelMap, dome: DomeMap | None = None) -> PixelTable:
        """The pixels of a session; a map of the dome corrects where they look.

        Raises
        ------
        DataError
            If no pixel lies inside the usable hemisphere.
        """
        camera, geometry = metadata.camera, metadata.geometry
        columns, rows = np.meshgrid(np.arange(camera.columns), np.arange(camera.rows))

        def directions(columns: ArrayLike, rows: ArrayLike) -> FloatArray:
            mapped = pixel_map.directions(columns, rows)
            return mapped if dome is None else dome.corrected(mapped)

        w_r = directions(columns, rows)
        theta_r, phi_r = angles(w_r)
        index = np.flatnonzero(theta_r <= np.radians(geometry.usable_theta_r_deg))
        if len(index) == 0:
            raise DataError(
                f"no pixel lies inside theta_r <= {geometry.usable_theta_r_deg:g} deg; "
                "check the lens calibration and the pixel pitch in session.json."
            )
        x, y = equal_area(w_r.reshape(-1, 3)[index])
        keys = cells.morton_keys(x, y)
        order = np.argsort(keys, kind="stable")
        index = index[order]
        columns, rows = columns.ravel()[index], rows.ravel()[index]
        # Gauss-Legendre points of order 2 in each direction integrate over the pixel's area.
        half = 0.5 / np.sqrt(3)
        points = np.stack(
            [directions(columns + dx, rows + dy) for dx in (-half, half) for dy in (-half, half)],
            axis=1,
        )
        return cls(
            index=index,
            keys=keys[order],
            at=np.stack([columns, rows], axis=1).astype(float),
            w_r=np.ascontiguousarray(w_r.reshape(-1, 3)[index]),
            points=np.ascontiguousarray(points),
            solid_angle=pixel_map.solid_angles(columns, rows),
            theta_r=theta_r,
            phi_r=phi_r,
        )
