"""What a fit keeps in memory beside its record, and what a result says without it."""

from __future__ import annotations

from typing import Any, Protocol

from gonio.errors import DataError
from gonio.geometry import FloatArray
from gonio.models import Model
from gonio.samples import BRDFSamples


class Memory(Protocol):
    """The model, the samples and the draws of a fit that was made in this process."""

    @property
    def model(self) -> Model:
        """The fitted model."""

    @property
    def samples(self) -> BRDFSamples:
        """What it was fitted to, exact copies left out."""

    def fitted(self) -> FloatArray:
        """The model's value of each sample, over its cell, (N,), sr^-1."""

    def part(self, index: int) -> Memory:
        """The memory of one part of a joint fit."""

    def inference_data(self, *, log_likelihood: bool) -> Any:
        """The draws as arviz takes them; None where no posterior was sampled."""


def forgotten(what: str, instead: str) -> DataError:
    """What a result that was read from a file, or made by hand, cannot give."""
    return DataError(
        f"this result does not hold {what}: it was read from a file, which holds the "
        f"parameters only; {instead}."
    )
