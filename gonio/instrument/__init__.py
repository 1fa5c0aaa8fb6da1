"""The virtual instrument: lamp, filters, holder, dome, lens, sensor, standard, surroundings."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from pydantic import Field, ValidationError, model_validator

from gonio.errors import ConfigurationError, unknown_name
from gonio.instrument.dome import Dome
from gonio.instrument.filter import Filter
from gonio.instrument.holder import Holder
from gonio.instrument.lamp import Lamp
from gonio.instrument.lens import Lens
from gonio.instrument.part import Part
from gonio.instrument.sensor import Sensor
from gonio.instrument.standard import Standard
from gonio.instrument.surroundings import Surroundings

__all__ = [
    "Dome",
    "Filter",
    "Holder",
    "Instrument",
    "Lamp",
    "Lens",
    "Sensor",
    "Standard",
    "Surroundings",
    "load",
    "preset",
    "preset_names",
]


class Instrument(Part):
    """An imaging gonioreflectometer, composed of its parts.

    Examples
    --------
    >>> preset("modern12").dome.D
    15.0
    """

    name: str = Field(description="name, written into every session")
    description: str = Field(default="", description="one line for 'gonio instruments'")
    usable_theta_r_deg: float = Field(gt=0, le=90, description="rim mask of the reduction")
    theta_i_max_deg: float = Field(
        default=75.0, gt=0, lt=90, description="largest angle of incidence of the lamp arm"
    )
    rays_per_pixel: Literal[1, 8, 16, 32, 64, 128, 256] = Field(
        default=16, description="rays traced for each pixel, pupil and source; 1 is the chief ray"
    )
    lamp: Lamp
    holder: Holder
    dome: Dome
    lens: Lens
    sensor: Sensor
    standard: Standard
    surroundings: Surroundings
    channels: tuple[Filter, ...] = Field(
        default=(Filter(),), min_length=1, max_length=100, description="filters, one per channel"
    )

    @model_validator(mode="after")
    def _possible(self) -> Instrument:
        names = [channel.name for channel in self.channels]
        if len(set(names)) < len(names):
            raise ValueError("channels must have different names")
        x, y, z = np.abs(self.lens.pupil_centre(0.0, self.dome.D)).tolist()
        highest = float(np.linalg.norm([x, y, z + abs(self.lens.pupil_walk_mm)]))
        if highest >= self.dome.R:
            raise ValueError(
                f"the lens's pupil lies up to {highest:.4g} mm from the dome's centre and must "
                f"stay inside R = {self.dome.R} mm"
            )
        return self

    def altered(self, **parts: Mapping[str, Any]) -> Instrument:
        """The instrument with changed values of some parts; the new values are not validated.

        Examples
        --------
        >>> preset("ideal12").altered(lamp={"half_angle_deg": 1.0}).lamp.half_angle_deg
        1.0
        """
        changed = {
            name: getattr(self, name).model_copy(update=dict(values))
            for name, values in parts.items()
        }
        return self.model_copy(update=changed)

    def with_pixels(self, n: int) -> Instrument:
        """The instrument with n x n pixels, each of 2 x 2 of a sensor of the same height.

        Examples
        --------
        >>> preset("ideal12").with_pixels(104).sensor.rows
        208
        """
        pitch = self.sensor.rows * self.sensor.pitch_um[0] / (2 * n)
        return self.altered(
            sensor={
                "rows": 2 * n,
                "columns": 2 * n,
                "pitch_um": (pitch, pitch),
                "binning": 2,
                "binned_divisor": 1,
            }
        )


def preset_names() -> list[str]:
    """Names of the instruments that come with gonio."""
    return sorted(
        entry.name.removesuffix(".toml")
        for entry in (resources.files("gonio.data") / "instruments").iterdir()
        if entry.name.endswith(".toml")
    )


def preset(name: str) -> Instrument:
    """An instrument that comes with gonio.

    Raises
    ------
    ConfigurationError
        If there is no preset of this name; the message suggests the nearest name.
    """
    if name not in preset_names():
        raise unknown_name("instrument", name, preset_names())
    text = (resources.files("gonio.data") / "instruments" / f"{name}.toml").read_text("utf-8")
    return _parse(text, name)


def load(name_or_path: str) -> Instrument:
    """A preset by its name, or an instrument from a TOML file.

    Raises
    ------
    ConfigurationError
        If there is no such preset or file, or the file is not a valid instrument.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        return preset(name_or_path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path}: cannot be read as text ({error}).", value=path) from None
    return _parse(text, str(path))


def _parse(text: str, where: str) -> Instrument:
    try:
        return Instrument.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"{where}: not valid TOML: {error}.", value=where) from None
    except ValidationError as error:
        raise ConfigurationError(_sentence(where, error), value=where) from None


def _sentence(where: str, error: ValidationError) -> str:
    """An error of pydantic as a sentence, with the nearest name for a wrong key."""
    # A misspelt key is reported before the key that is then missing.
    complaints: list[Any] = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = complaints[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        owner: Any = Instrument
        for part in first["loc"][:-1]:
            if not isinstance(part, int):  # an index of a list, whose items are of one kind
                owner = owner.model_fields[part].annotation
                owner = next(iter(get_args(owner)), owner)
        hint = unknown_name("key", str(first["loc"][-1]), owner.model_fields)
        return f"{where}: {key}: {hint}"
    given = "" if first["type"] == "missing" else f" (given: {first['input']!r})"
    return f"{where}: {key or 'instrument'}: {first['msg']}{given}."
