"""Samples that a fit can use: numbers that can be squared, and no exact copies."""

from __future__ import annotations

import numpy as np

from gonio.errors import DataError
from gonio.kernels.copies import suspects
from gonio.samples import BRDFSamples

SMALLEST = 1e-100  # sr^-1: squares of values from here
LARGEST = 1e100  # to here are numbers
_COPIES = "copies of other samples count once"


def usable(samples: BRDFSamples) -> BRDFSamples:
    """The samples without copies, if their numbers can be squared and summed.

    Raises
    ------
    DataError
        If a value or uncertainty is too large or too small to compute with.
    """
    columns = {"a BRDF value": np.max(np.abs(samples.value), initial=0.0)}
    if samples.u_independent is not None and len(samples):
        columns |= {"the smallest u_brdf": np.min(samples.u_independent),
                    "the largest u_brdf": np.max(samples.u_independent)}  # fmt: skip
    for what, size in columns.items():
        if size > 0 and not SMALLEST <= size <= LARGEST:
            raise DataError(
                f"{what} is {size:.3g} sr^-1; a fit can work with {SMALLEST:g} to {LARGEST:g}. "
                "Check the unit and the scale of the data.",
                value=float(size),
            )
    return without_copies(samples)


def without_copies(samples: BRDFSamples) -> BRDFSamples:
    """The samples without exact copies: the same directions, value and uncertainty twice.

    Noise makes no value twice, so that a copy is a row that was written twice and tells nothing
    new; counted again it would make every uncertainty too small.
    """
    suspect = samples.value[suspects(np.ascontiguousarray(samples.value))]
    if len(np.unique(suspect)) == len(suspect):
        return samples
    d = samples.directions
    columns = [np.broadcast_to(a, (len(samples),)) for a in
               (d.theta_i, d.phi_i, d.theta_r, d.phi_r, samples.value)]  # fmt: skip
    columns += [c for c in (samples.u_independent, samples.wavelength_nm) if c is not None]
    first = np.unique(np.column_stack(columns), axis=0, return_index=True)[1]
    if len(first) == len(samples):
        return samples
    return samples.select(np.sort(first), _COPIES)


def copies_warning(samples: BRDFSamples) -> list[str]:
    """A warning where `without_copies` took some away."""
    lines = [line for line in samples.history if line.startswith(_COPIES)]
    if not lines:
        return []
    kept, total = (int(word) for word in lines[0].split(": ")[1].split() if word.isdigit())
    return [
        f"{total - kept} of {total} samples are exact copies of others (same directions and "
        "value); they add no information and were counted once."
    ]
