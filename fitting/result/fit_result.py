"""What a fit gives back: a record a person can read, with a JSON form."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gonio.files import write_text
from gonio.fitting.result import document, parts
from gonio.fitting.result.record import FitRecord


@dataclass(frozen=True)
class FitResult(FitRecord):
    """A fitted model; angles in radians. `FitRecord` says what its fields are."""

    def part(self, name: str) -> FitResult:
        """One part of a joint fit as a fit of its own, its parameters by the model's names.

        Raises
        ------
        ConfigurationError
            If the fit has no part of this name, with the nearest one.
        """
        return parts.part(self, name)

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data of schema gonio.fit/1, angles in degrees."""
        return document.to_dict(self)

    def to_json(self) -> str:
        """The result as a JSON document, angles in degrees."""
        return document.to_json(self)

    def save(self, path: str | Path) -> None:
        """Write the JSON document, whole or not at all; angles in it are degrees."""
        write_text(Path(path), self.to_json())

    @classmethod
    def load(cls, path: str | Path) -> FitResult:
        """Read what `save` wrote, also by earlier versions; angles become radians.

        Raises
        ------
        DataError
            If the file is missing or not a fit of this schema.
        """
        return document.load(Path(path), cls)
