"""BRDF samples with their methods: selection, files, tables."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from gonio.errors import ConfigurationError, IncompleteFileWarning
from gonio.samples import netcdf, table, text
from gonio.samples.csv_text import not_in_csv, write_csv
from gonio.samples.record import SampleRecord
from gonio.samples.table import AngleUnit

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


@dataclass(frozen=True, repr=False)
class BRDFSamples(SampleRecord):
    """Measured or simulated BRDF values with their directions and uncertainties.

    `SampleRecord` describes the fields. Lists are accepted in place of arrays.

    Examples
    --------
    >>> from gonio.geometry import Directions
    >>> samples = BRDFSamples(Directions(0.5, 0.0, [0.1, 0.6], [0.0, 3.1]), [0.2, 0.3], [0.01, 0.01])
    >>> samples
    <BRDFSamples BRDF: 2 values, 0.2 to 0.3 sr^-1; theta_i: 28.65 deg; theta_r: 5.73 to 34.38 deg; u_brdf: 0.01 sr^-1>
    >>> len(samples[samples.value > 0.25])
    1
    """  # noqa: E501

    def __repr__(self) -> str:
        return text.short(self)

    def _repr_html_(self) -> str:
        return text.html(self)

    def save(self, path: str | Path) -> None:
        """Write the samples, whole or not at all: as netCDF (.nc) or as gonio CSV (.csv).

        A netCDF file holds everything. A CSV holds directions (degrees), values, u_brdf, channel
        and wavelength; where the samples hold more, `gonio.errors.IncompleteFileWarning` lists what
        is left out.

        Raises
        ------
        ConfigurationError
            If the name has another suffix.
        DataError
            If the file cannot be written, or samples for a CSV are not a BRDF.
        """
        path = Path(path)
        if path.suffix.lower() == ".nc":
            netcdf.save(path, self)
        elif path.suffix.lower() == ".csv":
            write_csv(path, self)
            lost = not_in_csv(self)
            if lost:
                warnings.warn(
                    f"{path}: a CSV cannot hold {', '.join(lost)} of these samples; a fit to it "
                    "knows less. Save as .nc to keep them.",
                    IncompleteFileWarning,
                    stacklevel=2,
                )
        else:
            raise ConfigurationError(
                f"{path}: samples are saved as netCDF (.nc), with all that they hold, or as CSV "
                "(.csv), directions and values alone; give a name that ends in one of these.",
                value=path,
            )

    @classmethod
    def load(cls, path: str | Path) -> BRDFSamples:
        """Read a netCDF file that `save` wrote; `gonio.formats.read` reads all formats.

        Raises
        ------
        DataError
            If the file is missing, truncated, or not a samples file.
        """
        return netcdf.load(Path(path), cls)

    def to_xarray(self) -> xr.Dataset:
        """The samples as a labelled dataset with all their data; angles in radians."""
        return netcdf.to_dataset(self)

    def to_dataframe(self, *, angles: AngleUnit = "rad") -> pd.DataFrame:
        """One row per sample, with the column names of gonio's CSV.

        Cells, shared errors, history and metadata have no column; `to_xarray` has them.

        Parameters
        ----------
        angles : {"rad", "deg"}
            Unit of the four angles.
        """
        return table.to_frame(self, angles)

    @classmethod
    def from_dataframe(cls, frame: pd.DataFrame, *, angles: AngleUnit = "rad") -> BRDFSamples:
        """Samples from a table with the columns theta_i, phi_i, theta_r, phi_r and brdf.

        Parameters
        ----------
        frame : pandas.DataFrame
            Where known also u_brdf (sr^-1), channel, wavelength_nm and what `to_dataframe` gives.
        angles : {"rad", "deg"}
            Unit of the four angles.

        Raises
        ------
        DataError
            If a column is missing or unknown, or the angles are no angles of samples.

        Examples
        --------
        >>> import pandas as pd
        >>> frame = pd.DataFrame(
        ...     {"theta_i": [30.0], "phi_i": 0.0, "theta_r": [45.0], "phi_r": 180.0, "brdf": [0.25]}
        ... )
        >>> BRDFSamples.from_dataframe(frame, angles="deg").value
        array([0.25])
        """
        return cls(**table.from_frame(frame, angles))
