"""gonio's samples file: netCDF-4 as `BRDFSamples.save` writes it, found by HDF5's signature."""

from __future__ import annotations

from pathlib import Path

from gonio.samples import BRDFSamples

NAME = "samples_nc"
TITLE = "gonio samples file (netCDF-4)"

_HDF5 = b"\x89HDF\r\n\x1a\n"


def mismatch(path: Path, head: bytes) -> str | None:
    """Why the file is not in this format, or None where it is."""
    if head.startswith(_HDF5):
        return None
    return "it does not begin with the signature of HDF5"


def read(path: str | Path) -> BRDFSamples:
    """Samples that `BRDFSamples.save` wrote.

    Raises
    ------
    DataError
        If the file is truncated or holds something else.
    """
    return BRDFSamples.load(path)
