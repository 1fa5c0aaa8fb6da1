"""Samples as netCDF with all their data; angles in radians."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from gonio.errors import DataError
from gonio.files import atomic_path
from gonio.geometry import Directions
from gonio.samples.record import (
    ANGLES,
    CONVENTION,
    MAX_SAMPLES,
    MIRRORED,
    PER_SAMPLE,
    QUANTITIES,
    SCHEMA,
    Cells,
    SampleRecord,
)
from gonio.shared_term import COLUMNS, SharedTerm

if TYPE_CHECKING:
    import xarray as xr

Record = TypeVar("Record", bound=SampleRecord)
_UNITS = {
    "value": "sr-1",
    "u_independent": "sr-1",
    "noise_slope": "sr-1",
    "u_reference": "sr-1",
    "solid_angle": "sr",
    "wavelength_nm": "nm",
}


def save(path: Path, samples: SampleRecord) -> None:
    """Write the samples; an error leaves no partial file."""
    dataset = to_dataset(samples)
    with atomic_path(path) as temporary:
        dataset.to_netcdf(temporary, engine="h5netcdf")


def load(path: Path, kind: type[Record]) -> Record:
    """Read samples that `save` wrote.

    Raises
    ------
    DataError
        If the file is missing, truncated, or not a samples file.
    """
    import xarray as xr

    if not path.is_file():
        raise DataError(f"{path}: no such file; give a samples file (.nc).", value=path)
    try:
        with xr.open_dataset(path, engine="h5netcdf") as dataset:
            _check_schema(path, dataset)
            return from_dataset(dataset.load(), kind)
    except (OSError, KeyError, ValueError, TypeError, json.JSONDecodeError) as error:
        raise DataError(
            f"{path}: not a readable samples file ({type(error).__name__}: {error}); "
            "it may be truncated, make it again with 'gonio reduce'.",
            value=path,
        ) from error


def to_dataset(samples: SampleRecord) -> xr.Dataset:
    """The samples as a labelled dataset in radians, with all data of a file."""
    import xarray as xr

    n = len(samples)
    variables: dict[str, Any] = {}
    for name in ANGLES:
        angle = np.broadcast_to(getattr(samples.directions, name), (n,)).copy()
        variables[name] = ("sample", angle, {"units": "rad"})
    for name in ("value", *PER_SAMPLE):
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


def from_dataset(dataset: xr.Dataset, kind: type[Record]) -> Record:
    """The samples of a dataset that `to_dataset` made."""

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
    columns = {name: column(name) for name in PER_SAMPLE if name != "channel"}
    quantity = {text: kind for kind, text in QUANTITIES.items()}.get(dataset.attrs["quantity"])
    if quantity is None:
        raise ValueError(f"the quantity is {dataset.attrs['quantity']!r}")
    return kind(
        directions=Directions(*(column(name) for name in ANGLES)),
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
