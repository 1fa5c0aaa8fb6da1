"""Channels, wavelengths and materials of samples, each for itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.samples import BRDFSamples

Source = BRDFSamples | Sequence[BRDFSamples] | Mapping[str, BRDFSamples]


@dataclass(frozen=True)
class Channel:
    """The samples of one part of a joint fit: one BRDF.

    Parameters
    ----------
    label : str
        "red", "650 nm", "paint_a", or "paint_a, red".
    material : str
        Name of the source, empty where there is one source only.
    source : int
        Which of the sources the samples are of.
    select : mapping of str to str
        Takes these samples out of their source, as `gonio.formats.choose` understands it.
    samples : BRDFSamples
    """

    label: str
    material: str
    source: int
    select: Mapping[str, str]
    samples: BRDFSamples


def split(samples: Source) -> list[Channel]:
    """Channels, wavelengths and materials, each for itself.

    Parameters
    ----------
    samples : BRDFSamples, or a sequence or mapping of them
        Several are several materials, named by the keys of the mapping, or else by their sample
        or file.

    Returns
    -------
    list of Channel
        Material by material; by wavelength where it is known, else in the order of the samples.

    Examples
    --------
    >>> from gonio.geometry import Directions
    >>> theta = np.array([0.1, 0.2, 0.3])
    >>> two = BRDFSamples(
    ...     Directions(theta, 0.0, theta, 0.0), theta, wavelength_nm=np.array([650.0, 450.0, 650.0])
    ... )
    >>> [(c.label, c.samples.value.tolist()) for c in split(two)]
    [('450 nm', [0.2]), ('650 nm', [0.1, 0.3])]
    """
    named = _named(samples)
    channels = []
    for k, (name, one) in enumerate(named.items()):
        material = name if len(named) > 1 else ""
        for label, select, keep in _channels_of(one):
            part = one if keep is None else one.select(keep, ", ".join(select.values()))
            both = ", ".join(word for word in (material, label) if word) or name
            channels.append(Channel(both, material, k, select, part))
    return channels


def _named(samples: Source) -> dict[str, BRDFSamples]:
    """The sources by name; names that occur twice are numbered."""
    if isinstance(samples, BRDFSamples):
        return {_own_name(samples) or "all": samples}
    if isinstance(samples, Mapping):
        return dict(samples)
    named: dict[str, BRDFSamples] = {}
    for k, one in enumerate(samples, 1):
        name = _own_name(one) or str(k)
        named[name if name not in named else f"{name} ({k})"] = one
    return named


def _own_name(samples: BRDFSamples) -> str:
    metadata = samples.metadata
    return str(metadata.get("sample") or Path(str(metadata.get("path") or "")).stem)


def _channels_of(
    samples: BRDFSamples,
) -> list[tuple[str, dict[str, str], NDArray[np.bool_] | None]]:
    """Label, selection and mask of every channel or wavelength; the mask is None where one is."""
    names, of_name = _distinct(samples.channel, len(samples))
    lengths, of_length = _distinct(samples.wavelength_nm, len(samples))
    pairs, first, part = np.unique(
        np.stack([of_name, of_length]), axis=1, return_index=True, return_inverse=True
    )
    n = pairs.shape[1]
    if n == 1:
        return [("", {}, None)]
    # A channel of one wavelength is called by its name alone, a wavelength of one channel by nm.
    by_name = len(names) == n or len(lengths) < n
    by_length = len(names) < n
    channels = []
    for k in sorted(range(n), key=lambda k: (pairs[1, k], first[k])):
        select, words = {}, []
        if by_name:
            select["channel"] = str(names[pairs[0, k]])
            words.append(select["channel"])
        if by_length:
            select["wavelength"] = f"{lengths[pairs[1, k]]:.9g}"
            words.append(f"{select['wavelength']} nm")
        channels.append((", ".join(words), select, part.ravel() == k))
    return channels


def _distinct(column: NDArray[Any] | None, n: int) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Distinct values, and which of them each sample has."""
    values, index = np.unique(np.zeros(n) if column is None else column, return_inverse=True)
    return values, index.astype(np.int64)
