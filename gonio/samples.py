"""BRDF samples: what calibration makes, what files hold, what fitting takes.

Samples of a surface seen in transmission (BTDF) are the same but for their incident direction:
it lies below the surface and is stored mirrored in the plane of the sample, so that both polar
angles are at most 90 deg. Light that goes straight through then leaves where a mirror would send
it, at (theta_i, phi_i + 180 deg), and the models of reflection fit lobes of transmission as they
stand.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from gonio.errors import DataError
from gonio.files import atomic_path
from gonio.geometry import HORIZON, Directions, FloatArray
from gonio.shared_term import COLUMNS
from gonio.shared_term import SharedTerm as SharedTerm

SCHEMA = "gonio.samples/1"
Quantity = Literal["BRDF", "BTDF"]
QUANTITIES = {kind: f"{kind} in sr^-1, cosine not included" for kind in get_args(Quantity)}
CONVENTION = (
    "radians; both directions leave the surface; theta from the normal; phi from +x, "
    "counter-clockwise seen from outside"
)
MIRRORED = "; the incident direction, below the surface, is mirrored in the plane of the sample"
FLAG_PARTIAL = 1  # some pixels of the cell were masked
FLAG_ENTRY = 2  # seen through the patch of the dome where the lamp's beam enters
MAX_SAMPLES = 50_000_000


@dataclass(frozen=True)
class Cells:
    """Members over which the model is integrated for each sample.

    Parameters
    ----------
    w_r : ndarray, shape (M, 3)
        Unit vectors towards the viewer, frame of the sample.
    weight : ndarray, shape (M,)
        Weights that sum to 1 within a cell.
    offsets : ndarray of int64, shape (N + 1,)
        Sample k owns the members offsets[k] to offsets[k + 1].
    """

    w_r: FloatArray
    weight: FloatArray
    offsets: NDArray[np.int64]

    def select(self, keep: NDArray[np.int64]) -> Cells:
        """The cells with these indices, in this order."""
        counts = np.diff(self.offsets)[keep]
        offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        within = np.arange(offsets[-1]) - np.repeat(offsets[:-1], counts)
        members = np.repeat(self.offsets[:-1][keep], counts) + within
        return Cells(self.w_r[members], self.weight[members], offsets)


@dataclass(frozen=True)
class BRDFSamples:
    """Measured or simulated BRDF values with their directions and uncertainties.

    Parameters
    ----------
    directions : Directions
        N pairs, radians, frame of the sample; for cells the weighted centroid.
    value : ndarray, shape (N,)
        BRDF in sr^-1. Negative values are noise around zero and are kept.
    u_independent : ndarray, shape (N,), optional
        Standard uncertainty of the errors that are independent from sample to sample, sr^-1.
    noise_slope : ndarray, shape (N,), optional
        d(u_independent^2)/d(value), sr^-1: shot noise grows with the signal, and a fit that takes
        it from the model instead of the noisy value is unbiased.
    u_reference : ndarray, shape (N,), optional
        Part of `u_independent` that comes from the standard and background frames, sr^-1.
    reference_sharing : int
        How many images use the same standard and background frames.
    shared : tuple of SharedTerm
        Errors common to many samples.
    solid_angle : ndarray, shape (N,), optional
        Solid angle of the cell, sr.
    flags : ndarray of uint8, shape (N,), optional
        Bit `FLAG_PARTIAL`: part of the cell was masked. Bit `FLAG_ENTRY`: seen through the patch
        where the lamp's beam enters the dome, that is close to the retro direction.
    image : ndarray of int64, shape (N,), optional
        Index of the image (incidence and rotation) the sample comes from.
    wavelength_nm : ndarray, shape (N,), optional
    channel : ndarray of str, shape (N,), optional
    cells : Cells, optional
        Members for a model integrated over the cell; the model is taken at `directions` if None.
    history : tuple of str
        One line a processing step.
    metadata : mapping
        Anything else worth keeping, JSON-serialisable.
    quantity : {"BRDF", "BTDF"}
        What the values are; the incident directions of a BTDF are mirrored in the plane of the
        sample.
    """

    directions: Directions
    value: FloatArray
    u_independent: FloatArray | None = None
    noise_slope: FloatArray | None = None
    u_reference: FloatArray | None = None
    reference_sharing: int = 1
    shared: tuple[SharedTerm, ...] = ()
    solid_angle: FloatArray | None = None
    flags: NDArray[np.uint8] | None = None
    image: NDArray[np.int64] | None = None
    wavelength_nm: FloatArray | None = None
    channel: NDArray[np.str_] | None = None
    cells: Cells | None = None
    history: tuple[str, ...] = ()
    metadata: Mapping[str, Any] = field(default_factory=dict)
    quantity: Quantity = "BRDF"

    def __post_init__(self) -> None:
        n = len(self)
        if self.value.ndim != 1 or self.directions.shape != (n,):
            raise DataError(
                f"samples need one list of directions for one list of values; got directions of "
                f"shape {self.directions.shape} and values of shape {self.value.shape}."
            )
        if not np.all(np.isfinite(self.value)):
            raise DataError("a BRDF value is not finite; remove the sample.", value=self.value)
        for name in ("theta_i", "theta_r"):
            theta = getattr(self.directions, name)
            if n and theta.max() > HORIZON + 1e-9:
                raise DataError(
                    f"{name} = {np.degrees(theta.max()):.6g} deg is beyond the horizon; "
                    "BRDF samples lie at 0 to 90 deg from the normal.",
                    value=float(theta.max()),
                )
        for name in _PER_SAMPLE:
            column = getattr(self, name)
            if column is not None and column.shape != (n,):
                raise DataError(f"{name} has shape {column.shape}, not ({n},).")
        if self.u_independent is not None and not np.all(self.u_independent > 0):
            raise DataError("u_brdf must be positive; leave the column out where unknown.")

    def __len__(self) -> int:
        return len(self.value)

    @property
    def n_negative(self) -> int:
        """How many values are below zero: noise, kept and counted."""
        return int(np.count_nonzero(self.value < 0))

    def select(self, keep: NDArray[Any], why: str) -> BRDFSamples:
        """The samples for which `keep` (a mask or indices) holds, with a line in the history."""
        index = np.flatnonzero(keep) if keep.dtype == bool else np.asarray(keep, np.int64)
        d = self.directions
        angles = [np.broadcast_to(getattr(d, a), (len(self),))[index] for a in _ANGLES]
        columns: dict[str, Any] = {
            name: None if (column := getattr(self, name)) is None else column[index]
            for name in _PER_SAMPLE
        }
        return replace(
            self,
            directions=Directions(*angles),
            value=self.value[index],
            shared=tuple(term.select(index) for term in self.shared),
            cells=None if self.cells is None else self.cells.select(index),
            history=(*self.history, f"{why}: {len(index)} of {len(self)} samples kept"),
            **columns,
        )

    def limited(
        self, *, max_theta_i: float | None = None, max_theta_r: float | None = None
    ) -> BRDFSamples:
        """Samples with polar angles up to the limits, radians.

        Raises
        ------
        DataError
            If no sample is left.
        """
        result = self
        for name, limit in (("theta_i", max_theta_i), ("theta_r", max_theta_r)):
            if limit is None:
                continue
            theta = np.broadcast_to(getattr(result.directions, name), (len(result),))
            result = result.select(theta <= limit + 1e-9, f"{name} <= {np.degrees(limit):.6g} deg")
            if len(result) == 0:
                raise DataError(
                    f"no sample has {name} <= {np.degrees(limit):.6g} deg; "
                    f"the smallest is {np.degrees(theta.min()):.6g} deg."
                )
        return result

    def save(self, path: str | Path) -> None:
        """Write the samples as netCDF, whole or not at all.

        Raises
        ------
        DataError
            If the file cannot be written.
        """
        dataset = _to_dataset(self)
        with atomic_path(Path(path)) as temporary:
            dataset.to_netcdf(temporary, engine="h5netcdf")

    @classmethod
    def load(cls, path: str | Path) -> BRDFSamples:
        """Read samples that `save` wrote.

        Raises
        ------
        DataError
            If the file is missing, truncated, or not a samples file.
        """
        import xarray as xr

        path = Path(path)
        if not path.is_file():
            raise DataError(f"{path}: no such file; give a samples file (.nc).", value=path)
        try:
            with xr.open_dataset(path, engine="h5netcdf") as dataset:
                _check_schema(path, dataset)
                return _from_dataset(dataset.load())
        except (OSError, KeyError, ValueError, TypeError, json.JSONDecodeError) as error:
            raise DataError(
                f"{path}: not a readable samples file ({type(error).__name__}: {error}); "
                "it may be truncated, make it again with 'gonio reduce'.",
                value=path,
            ) from error


_ANGLES = ("theta_i", "phi_i", "theta_r", "phi_r")
_PER_SAMPLE = (
    "u_independent",
    "noise_slope",
    "u_reference",
    "solid_angle",
    "flags",
    "image",
    "wavelength_nm",
    "channel",
)
_UNITS = {
    "value": "sr-1",
    "u_independent": "sr-1",
    "noise_slope": "sr-1",
    "u_reference": "sr-1",
    "solid_angle": "sr",
    "wavelength_nm": "nm",
}


def _to_dataset(samples: BRDFSamples) -> Any:
    import xarray as xr

    n = len(samples)
    variables: dict[str, Any] = {}
    for name in _ANGLES:
        angle = np.broadcast_to(getattr(samples.directions, name), (n,)).copy()
        variables[name] = ("sample", angle, {"units": "rad"})
    for name in ("value", *_PER_SAMPLE):
        column = getattr(samples, name)
        if column is not None:
            if name == "channel":
                column = column.astype(object)
            variables[name] = ("sample", column, {"units": _UNITS.get(name, "1")})
    if samples.cells is not None:
        variables["member_w_r"] = (("member", "xyz"), samples.cells.w_r)
        variables["member_weight"] = ("member", samples.cells.weight)
        variables["member_offset"] = ("bound", samples.cells.offsets)
    for k, term in enumerate(samples.shared):
        for name, unit in COLUMNS.items():
            column = getattr(term, name)
            if column is not None:
                where = ("sample", "xyz") if column.ndim == 2 else "sample"
                variables[f"shared_{k}_{name}"] = (where, column, {"units": unit})
    return xr.Dataset(
        variables,
        attrs={
            "schema": SCHEMA,
            "quantity": QUANTITIES[samples.quantity],
            "convention": CONVENTION + (MIRRORED if samples.quantity == "BTDF" else ""),
            "reference_sharing": samples.reference_sharing,
            "shared": json.dumps([term.record() for term in samples.shared]),
            "history": json.dumps(samples.history),
            "metadata": json.dumps(samples.metadata),
        },
    )


def _check_schema(path: Path, dataset: Any) -> None:
    if dataset.attrs.get("schema") != SCHEMA:
        raise DataError(
            f"{path}: the schema is {dataset.attrs.get('schema')!r}, not {SCHEMA!r}; "
            "this is not a samples file of this version.",
            value=path,
        )
    sizes = {name: int(dataset.sizes.get(name, 0)) for name in ("sample", "member")}
    if sizes["sample"] > MAX_SAMPLES or sizes["member"] > 16 * MAX_SAMPLES:
        raise DataError(f"{path}: {sizes} is more than a samples file may hold ({MAX_SAMPLES}).")


def _from_dataset(dataset: Any) -> BRDFSamples:
    def column(name: str) -> Any:
        return dataset[name].values if name in dataset else None

    channel = column("channel")
    cells = None
    if "member_w_r" in dataset:
        cells = Cells(column("member_w_r"), column("member_weight"), column("member_offset"))
        offsets = cells.offsets
        if offsets[0] != 0 or offsets[-1] != len(cells.weight) or np.any(np.diff(offsets) < 1):
            raise ValueError("the cells' member offsets are inconsistent")
    terms = tuple(
        SharedTerm.from_record(item, {c: column(f"shared_{k}_{c}") for c in COLUMNS})
        for k, item in enumerate(json.loads(dataset.attrs["shared"]))
    )
    columns = {name: column(name) for name in _PER_SAMPLE if name != "channel"}
    quantity = {text: kind for kind, text in QUANTITIES.items()}.get(dataset.attrs["quantity"])
    if quantity is None:
        raise ValueError(f"the quantity is {dataset.attrs['quantity']!r}")
    return BRDFSamples(
        directions=Directions(*(column(name) for name in _ANGLES)),
        value=column("value"),
        channel=None if channel is None else channel.astype(str),
        reference_sharing=int(dataset.attrs["reference_sharing"]),
        shared=terms,
        cells=cells,
        history=tuple(json.loads(dataset.attrs["history"])),
        metadata=json.loads(dataset.attrs["metadata"]),
        quantity=quantity,
        **columns,
    )
