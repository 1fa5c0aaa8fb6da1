"""The fields of BRDF samples, and their selection."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.errors import ConfigurationError, DataError
from gonio.geometry import HORIZON, Directions, FloatArray
from gonio.shared_term import SharedTerm

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
ANGLES = ("theta_i", "phi_i", "theta_r", "phi_r")
PER_SAMPLE = (
    "u_independent",
    "noise_slope",
    "u_reference",
    "solid_angle",
    "flags",
    "image",
    "wavelength_nm",
    "channel",
)
_KINDS = {
    **dict.fromkeys(PER_SAMPLE, float),
    "flags": np.uint8,
    "image": np.int64,
    "channel": np.str_,
}


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
        """The cells at these indices, in this order."""
        counts = np.diff(self.offsets)[keep]
        offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        within = np.arange(offsets[-1]) - np.repeat(offsets[:-1], counts)
        members = np.repeat(self.offsets[:-1][keep], counts) + within
        return Cells(self.w_r[members], self.weight[members], offsets)


@dataclass(frozen=True)
class SampleRecord:
    """BRDF values with directions and uncertainties, the fields of `BRDFSamples`.

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
        Index of the image (incidence and rotation) of the sample.
    wavelength_nm : ndarray, shape (N,), optional
    channel : ndarray of str, shape (N,), optional
    line : ndarray of int64, shape (N,), optional
        Line of the text file that a sample was read from. Messages name it; no file keeps it.
    cells : Cells, optional
        Members for a model integrated over the cell; the model is taken at `directions` if None.
    history : tuple of str
        One line per processing step.
    metadata : mapping
        Any further data, JSON-serialisable.
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
    line: NDArray[np.int64] | None = None
    cells: Cells | None = None
    history: tuple[str, ...] = ()
    metadata: Mapping[str, Any] = field(default_factory=dict)
    quantity: Quantity = "BRDF"

    def __post_init__(self) -> None:
        for name, kind in {"value": float, **_KINDS}.items():
            column = getattr(self, name)
            if column is not None and not isinstance(column, np.ndarray):
                object.__setattr__(self, name, np.asarray(column, kind))
        n = len(self)
        if self.u_independent is not None and self.u_independent.shape == ():
            object.__setattr__(self, "u_independent", np.full(n, float(self.u_independent)))
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
        for name in (*PER_SAMPLE, "line"):
            column = getattr(self, name)
            if column is not None and column.shape != (n,):
                called = "the uncertainty (u_independent)" if name == "u_independent" else name
                raise DataError(f"{called} has shape {column.shape}, not ({n},).")
        if self.u_independent is not None and not np.all(self.u_independent > 0):
            worst = float(np.min(self.u_independent))
            raise DataError(
                f"the uncertainty (u_independent, in files u_brdf) must be positive, and one is "
                f"{worst:.6g}; leave it out where unknown.",
                value=worst,
            )

    def __len__(self) -> int:
        return len(self.value)

    @property
    def n_negative(self) -> int:
        """Number of values below zero; they are noise and are kept."""
        return int(np.count_nonzero(self.value < 0))

    def __getitem__(self, keep: ArrayLike | slice) -> Self:
        """The samples at a mask, indices or a slice: ``samples[samples.value > 0]``."""
        if isinstance(keep, slice):
            keep = np.arange(len(self))[keep]
        return self.select(np.atleast_1d(np.asarray(keep)))

    def select(
        self,
        keep: ArrayLike | None = None,
        why: str = "selected",
        *,
        channel: str | None = None,
        wavelength_nm: float | None = None,
    ) -> Self:
        """The samples for which `keep` holds, with a line in the history.

        Parameters
        ----------
        keep : array_like of bool, shape (N,), or of int, optional
            A mask, or indices.
        why : str
            What was selected, for the history.
        channel : str, optional
            Name of the channel to keep.
        wavelength_nm : float, optional
            Wavelength to keep, to a millionth of a nanometre.

        Raises
        ------
        ConfigurationError
            If there is no such channel or wavelength; the message lists the existing ones.
        DataError
            If a mask does not have one value for each sample, or an index is out of range.
        """
        result = self
        if channel is not None:
            result = result._of("channel", result.channel == channel, channel)
        if wavelength_nm is not None:
            nm = np.nan if result.wavelength_nm is None else result.wavelength_nm
            result = result._of("wavelength_nm", np.abs(nm - wavelength_nm) < 1e-6, wavelength_nm)
        return result if keep is None else result._at(np.asarray(keep), why)

    def _of(self, name: str, keep: Any, wanted: object) -> Self:
        """The samples of one channel or wavelength."""
        column = getattr(self, name)
        if column is None or not np.any(keep):
            choices = "they have none" if column is None else ", ".join(map(str, np.unique(column)))
            raise ConfigurationError(
                f"no sample has {name} {wanted!r}; known: {choices}.", value=wanted
            )
        return self._at(keep, f"{name} = {wanted}")

    def _at(self, keep: NDArray[Any], why: str) -> Self:
        n = len(self)
        if keep.dtype == bool:
            if keep.shape != (n,):
                raise DataError(f"a mask of shape {keep.shape} does not fit {n} samples.")
            index = np.flatnonzero(keep)
        else:
            index = np.asarray(keep, np.int64)
            if index.size and not -n <= index.min() <= index.max() < n:
                raise DataError(f"an index is beyond the {n} samples; the last is {n - 1}.")
            index = np.where(index < 0, index + n, index)
        d = self.directions
        angles = [np.broadcast_to(getattr(d, a), (n,))[index] for a in ANGLES]
        columns: dict[str, Any] = {
            name: None if (column := getattr(self, name)) is None else column[index]
            for name in (*PER_SAMPLE, "line")
        }
        return replace(
            self,
            directions=Directions(*angles),
            value=self.value[index],
            shared=tuple(term.select(index) for term in self.shared),
            cells=None if self.cells is None else self.cells.select(index),
            history=(*self.history, f"{why}: {len(index)} of {n} samples kept"),
            **columns,
        )

    def limited(
        self, *, max_theta_i: float | None = None, max_theta_r: float | None = None
    ) -> Self:
        """Samples with polar angles up to the limits, radians.

        Raises
        ------
        DataError
            If no sample remains.
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
