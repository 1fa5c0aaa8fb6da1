"""What a source of error is: one record, from which everything that is said of it derives.

A file of this folder that defines `EFFECT = Effect(...)` is a source of error. The reduction takes
its shared terms and its correction, the list of unknowns and the history its words, the budget and
the report its names and figures, the manual all of it, and planning its properties. Nothing else
has to be told of it, and nothing else knows it by name.
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
        Image and incidence of every sample, channel by channel counted on.
    """

    metadata: Metadata
    pixel_map: PixelMap
    images: Sequence[ImageCells]
    image: NDArray[np.int64]
    incidence: NDArray[np.int64]

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

    def in_sample_frame(self, shift: FloatArray) -> FloatArray:
        """Shifts (N, 3) from the laboratory to the frame of the sample, across the directions."""
        ends = np.cumsum([len(image.at) for image in self.images])[:-1]
        pieces = zip(np.split(shift, ends), self.images, strict=True)
        return np.concatenate([across(rotated(s, i.psi), i.centroid) for s, i in pieces])


@dataclass(frozen=True)
class TermRecord:
    """Words and properties of one of the shared terms of an effect.

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
        Whether a few typical patterns stand for a field of errors that nobody knows.
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
            In place of the record's, where it stands for several terms.
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
    """Something that nobody may have stated, and that no uncertainty holds then.

    Parameters
    ----------
    words : str
        What is unknown.
    key : str
        Where it is stated in session.json; empty where it cannot be stated.
    holds : callable, optional
        Called with metadata and pixel map: whether it is unknown. Without it, it is unknown where
        the key has no value.
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
class Figure:
    """A figure of the metadata by which the size of an effect is stated.

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
        Place among the effects: their terms follow each other by it.
    title : str
        A few words for tables.
    text : str
        What it is and what is done about it, sentences for the manual.
    records : tuple of TermRecord
        Its shared terms, or kinds of them.
    terms : callable
        Called with `Measured`: the shared terms of a session, as far as the metadata tell of them.
    unknown : tuple of Unknown
        What may be unknown of it.
    figures : tuple of Figure
        What states its size.
    notes : callable
        Called with the metadata: lines of the history about what was assumed or done.
    corrected : callable, optional
        Called with the metadata and the images' cells: cells from which the effect is taken away,
        as far as it is known.
    """

    key: str
    order: int
    title: str
    text: str
    records: tuple[TermRecord, ...]
    terms: Callable[[Measured], Iterable[SharedTerm]]
    unknown: tuple[Unknown, ...] = ()
    figures: tuple[Figure, ...] = ()
    notes: Callable[[Metadata], tuple[str, ...]] = _nothing
    corrected: Callable[[Metadata, list[ImageCells]], list[ImageCells]] | None = None


def value_at(metadata: Metadata, key: str) -> Any:
    """Value of the metadata at a key such as lamp.drift."""
    return reduce(getattr, key.split("."), metadata)
