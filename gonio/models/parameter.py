"""A parameter of a model: name, symbol, unit, default, range and meaning, declared once."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from gonio.errors import ConfigurationError


@dataclass(frozen=True)
class Parameter:
    """One parameter of a model, declared once and read by CLI, fit, plots, docs and tests.

    Parameters
    ----------
    name, symbol, meaning : str
        The paper's letter spelled out, as a formula shows it, and what it stands for.
    default, lower, upper : float
        Default value and the closed range that is allowed, in radians where `unit` is "rad".
    unit : {"", "rad"}
        Unit in Python. Files and the command line use degrees for "rad".
    scale : {"linear", "log"}
        How a grid of starting values is spaced over the range `start`.
    linear : bool
        True where f is linear in this parameter and in all others so marked at once, while the
        rest is held: a fit solves for these together.
    start : tuple of float, optional
        Range that a fit searches for its start; the whole range where not given.
    prior : str
        Prior of a posterior, as `gonio.fitting.posterior.priors` reads it, in the unit of files.
    """

    name: str
    symbol: str
    meaning: str
    default: float
    lower: float
    upper: float
    unit: Literal["", "rad"] = ""
    scale: Literal["linear", "log"] = "linear"
    linear: bool = False
    start: tuple[float, float] | None = None
    prior: str = "flat"

    @property
    def file_unit(self) -> str:
        """Unit on the command line and in files."""
        return "deg" if self.unit == "rad" else self.unit

    def to_file(self, value: float) -> float:
        """Value in the unit of files (degrees for angles)."""
        return math.degrees(value) if self.unit == "rad" else value

    def from_file(self, value: float) -> float:
        """Value in the unit of Python, from the unit of files."""
        return math.radians(value) if self.unit == "rad" else value

    def file_text(self, value: float) -> str:
        """A value in the unit of files, with that unit.

        Examples
        --------
        >>> Parameter("sigma", "sigma", "slope angle", 0.3, 0.0, 1.5, "rad").file_text(0.5)
        '28.6479 deg'
        """
        unit = f" {self.file_unit}" if self.file_unit else ""
        return f"{self.to_file(value):.6g}{unit}"

    def check(self, value: float) -> float:
        """The value as a float if it lies in the range.

        Raises
        ------
        ConfigurationError
            If it is not a finite number in [lower, upper].
        """
        try:
            number = float(value)
        except (TypeError, ValueError):
            raise ConfigurationError(
                f"{self.name} = {value!r} is not a number; {self._allowed()}.", value=value
            ) from None
        # Degrees in, radians out and back may miss the bound by an ulp.
        slack = 1e-12 * max(abs(self.lower), abs(self.upper))
        if not self.lower - slack <= number <= self.upper + slack:
            text = f"{self.name} = {self._show(number)} is out of range; {self._allowed()}."
            raise ConfigurationError(text + self._in_degrees(number), value=number)
        return min(max(number, self.lower), self.upper)

    def _in_degrees(self, number: float) -> str:
        """What to write where an angle beyond its bound would be one in degrees."""
        radians = math.radians(number)
        if self.unit != "rad" or number < self.upper or not self.lower <= radians <= self.upper:
            return ""
        return (
            f" It looks like degrees; angles in Python are radians: write {self.name}="
            f"{radians:.6g} for {number:.6g} deg."
        )

    def _show(self, value: float) -> str:
        if self.unit == "rad":
            return f"{value:.6g} rad ({math.degrees(value):.6g} deg)"
        return f"{value:.6g}"

    def _allowed(self) -> str:
        return f"allowed is {self._show(self.lower)} to {self._show(self.upper)}"
