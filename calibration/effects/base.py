"""The record of a source of error. Everything that is said about it derives from this record.

A file of this folder that defines `EFFECT = Effect(...)` is a source of error. The reduction uses
its shared terms and its correction. The list of unknowns and the history use its words. The budget
and the report use its names and stated quantities, planning its properties, and the manual all of
it. No other file lists it or knows its name.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gonio.calibration.dome.pixel_map import PixelMap, across
from gonio.calibration.image_cells import ImageCells
from gonio.dome_map import UNKNOWN, DomeMap
from gonio.geometry import FloatArray, rotated
from gonio.metadata import Metadata
from gonio.shared_term import BelongsTo, Evaluation, SharedTerm


@dataclass(frozen=True)
class Measured:
    """What an effect computes its shared terms from.

    Parameters
    ----------
    metadata : Metadata
    pixel_map : PixelMap
    images : sequence of ImageCells
        In the order of the samples.
    image, incidence : ndarray of int64, shape (N,)
        Numbers of the image and of the incidence of every sample. They count on from one channel
        to the next.
    dome : DomeMap, optional
        By which the directions were corrected.
    """

    metadata: Metadata
    pixel_map: PixelMap
    images: Sequence[ImageCells]
    image: NDArray[np.int64]
    incidence: NDArray[np.int64]
    dome: DomeMap | None = None

    @property
    def value(self) -> FloatArray:
        """f of every sample, shape (N,), sr^-1."""
        return np.concatenate([image.means[0] for image in self.images])

    @property
    def stray(self) -> FloatArray:
        """Stray light of every sample as f, and in the standard's image as a part of its signal.

        Shape (2, N).
        """
        return np.concatenate([image.stray for image in self.images]).T

    @property
    def centroid(self) -> FloatArray:
        """Direction of every sample, shape (N, 3), frame of the sample."""
        return np.concatenate([image.centroid for image in self.images])

    @property
    def pixels(self) -> tuple[FloatArray, FloatArray]:
        """Mean column and row of every sample, shape (N,) each."""
        columns, rows = np.concatenate([image.at.T for image in self.images], axis=1)
        return columns, rows

    def left_by_map(self, shift: FloatArray) -> FloatArray:
        """Shifts (N, 3) of directions, as far as the map of the dome did not remove them."""
        if self.dome is None:
            return shift
        lab = np.concatenate([rotated(image.centroid, -image.psi) for image in self.images])
        after, before = self.dome.sd(lab)
        left = np.sqrt(np.mean(after**2, axis=1)) / before
        return np.asarray(np.where(left > UNKNOWN, 1.0, left)[:, None] * shift)

    def in_sample_frame(self, shift: FloatArray) -> FloatArray:
        """Shifts (N, 3) from the laboratory to the frame of the sample, across the directions."""
        ends = np.cumsum([len(image.at) for image in self.images])[:-1]
        pieces = zip(np.split(shift, ends), self.images, strict=True)
        return np.concatenate([across(rotated(s, i.psi), i.centroid) for s, i in pieces])


@dataclass(frozen=True)
class TermRecord:
    """Words and properties of one shared term of an effect.

    Parameters
    ----------
    name, meaning : str
        As in the budget. A record that stands for several terms has the letter N in its name.
    evaluation : {"A", "B"}
        A: from a fit to calibration frames; B: stated by certificate or operator.
    averages : bool
        Whether more takes of standard and background make it smaller, by the root of their number.
    constant : bool
        Whether it is the same in every session that is simulated, whatever the seed: it biases
        the parameters and adds nothing to their scatter.
    belongs_to : {"rig", "session"}
        Whether two sessions on one rig have the same draw of it, or each has its own.
    typical : bool
        Whether a few typical patterns represent an unknown field of errors.
    """

    name: str
    meaning: str
    evaluation: Evaluation = "B"
    averages: bool = False
    constant: bool = False
    belongs_to: BelongsTo = "rig"
    typical: bool = False

    def shared(
        self,
        relative: float = 0.0,
        *,
        name: str | None = None,
        meaning: str | None = None,
        **size: Any,
    ) -> SharedTerm:
        """The term with its size.

        Parameters
        ----------
        relative : float
        name, meaning : str, optional
            Used instead of the record's, if the record stands for several terms.
        **size
            Further fields of `SharedTerm`.
        """
        properties = {
            "evaluation": self.evaluation,
            "averages": self.averages,
            "constant": self.constant,
            "belongs_to": self.belongs_to,
            "typical": self.typical,
        }
        return SharedTerm(
            name or self.name, meaning or self.meaning, relative, **{**properties, **size}
        )


class _IsUnknown(Protocol):
    def __call__(self, metadata: Metadata, pixel_map: PixelMap) -> bool: ...


@dataclass(frozen=True)
class Unknown:
    """A quantity that may not be stated. No uncertainty includes it then.

    Parameters
    ----------
    words : str
        What is unknown.
    key : str
        Where it is stated in session.json; empty where it cannot be stated.
    holds : callable, optional
        Called with metadata and pixel map. Returns whether it is unknown. By default it is unknown
        if the key has no value.
    """

    words: str
    key: str = ""
    holds: _IsUnknown | None = None

    def is_unknown(self, metadata: Metadata, pixel_map: PixelMap) -> bool:
        """Whether nobody stated it."""
        if self.holds is not None:
            return self.holds(metadata, pixel_map)
        return value_at(metadata, self.key) is None

    @property
    def text(self) -> str:
        """Words and key, as lists of unknowns have them.

        Examples
        --------
        >>> Unknown("lamp drift", "lamp.drift").text
        'lamp drift (lamp.drift)'
        """
        return f"{self.words} ({self.key})" if self.key else self.words


@dataclass(frozen=True)
class StatedQuantity:
    """A quantity of the metadata that states the size of an effect.

    Parameters
    ----------
    words : str
    key : str
        Where it stands in session.json.
    unit : str
        Symbol that follows the number in a report.
    """

    words: str
    key: str
    unit: str = ""

    def text(self, metadata: Metadata) -> str | None:
        """Number and unit, "stated" for a covariance, None where it is unknown."""
        value = value_at(metadata, self.key)
        if value is None:
            return None
        return f"{value:g}{self.unit}" if isinstance(value, int | float) else "stated"


def _nothing(metadata: Metadata) -> tuple[str, ...]:
    return ()


@dataclass(frozen=True)
class Effect:
    """A source of error.

    Parameters
    ----------
    key : str
        Name of its file.
    order : int
        Position among the effects; their terms are listed in this order.
    title : str
        A few words for tables.
    text : str
        What it is and what is done about it: sentences for the manual.
    records : tuple of TermRecord
        Its shared terms, or kinds of them.
    terms : callable
        Called with `Measured`. Returns the shared terms of a session that the metadata state.
    unknown : tuple of Unknown
        What may be unknown of it.
    quantities : tuple of StatedQuantity
        The quantities of the metadata that state its size.
    notes : callable
        Called with the metadata. Returns lines of the history: what was assumed or done.
    corrected : callable, optional
        Called with the metadata and the images' cells. Returns cells from which the effect is
        removed as far as it is known.
    """

    key: str
    order: int
    title: str
    text: str
    records: tuple[TermRecord, ...]
    terms: Callable[[Measured], Iterable[SharedTerm]]
    unknown: tuple[Unknown, ...] = ()
    quantities: tuple[StatedQuantity, ...] = ()
    notes: Callable[[Metadata], tuple[str, ...]] = _nothing
    corrected: Callable[[Metadata, list[ImageCells]], list[ImageCells]] | None = None


def value_at(metadata: Metadata, key: str) -> Any:
    """Value of the metadata at a key such as lamp.drift."""
    return reduce(getattr, key.split("."), metadata)
