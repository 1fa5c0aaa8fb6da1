"""A folder of flat and dark frames with one flats.toml, read as an import reads frames."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from gonio.errors import ConfigurationError, DataError
from gonio.metadata import Camera
from gonio.rig.frame_files import formatted
from gonio.rig.headers import KINDS, Header, check_bytes, read_header
from gonio.rig.paths import inside
from gonio.rig.pictures import Sampling, opencv_silent, read_pixels
from gonio.rig.raw import RAW_ENDINGS, read_raw_header
from gonio.rig.tables import FramesTable

NAME = "flats.toml"
Role = Literal["flat", "dark"]
ROLES: tuple[Role, Role] = ("flat", "dark")


class FlatsTable(BaseModel):
    """Which frames there are: flats and darks, `takes` of each at every exposure."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    exposures_s: tuple[float, ...] = Field(min_length=1, description="growing, s")
    takes: int = Field(default=2, ge=2, description="frames of a kind at an exposure")

    @model_validator(mode="after")
    def _growing(self) -> FlatsTable:
        if min(self.exposures_s) <= 0 or any(b <= a for a, b in pairwise(self.exposures_s)):
            raise ValueError("exposures_s must be positive and grow")
        return self


class _File(BaseModel):
    """The whole of flats.toml."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    flats: FlatsTable
    frames: FramesTable

    @model_validator(mode="after")
    def _by_pattern(self) -> _File:
        if self.frames.pattern is None:
            raise ValueError("frames.pattern names the files; a csv is not for flats")
        return self


@dataclass(frozen=True)
class FlatsFolder:
    """A folder of flat and dark frames.

    Parameters
    ----------
    folder : Path
    table : FlatsTable
    frames : FramesTable
        Of its fields only role, exposure and take stand in a name: {role} is flat or dark.
    """

    folder: Path
    table: FlatsTable
    frames: FramesTable

    def name(self, role: str, exposure: int, take: int) -> str:
        """File of a frame by the pattern, relative to the folder."""
        seconds = self.table.exposures_s[exposure]
        values = {
            "role": role, "exposure_s": seconds, "exposure_ms": 1e3 * seconds,
            "exposure_us": 1e6 * seconds, "take": take + 1, "theta_i": 0.0, "rotation": 0.0,
            "channel": "",
        }  # fmt: skip
        return formatted(self.frames.pattern or "", values, str(self.folder / NAME))

    @cached_property
    def sampling(self) -> Sampling:
        """Which pixels of a file make a pixel of a frame."""
        name = self.name("flat", 0, 0)
        return Sampling.of(self._header(name), self.frames, name)

    def frame(self, role: Role, exposure: int, take: int) -> NDArray[np.uint16]:
        """Counts of a frame, as the import makes them of a file.

        Raises
        ------
        DataError
            If the file is missing, damaged, or of another size than the others.
        """
        name = self.name(role, exposure, take)
        header, path, sampling = self._header(name), self.folder / name, self.sampling
        if (header.rows, header.columns) != (sampling.rows, sampling.columns):
            raise DataError(
                f"{name}: has {header.columns} x {header.rows} pixels and the first flat frame "
                f"{sampling.columns} x {sampling.rows}; all frames have one size.",
                value=name,
            )
        with opencv_silent():
            pixels = read_pixels(path, name, header, self.frames, path.read_bytes())
        return sampling.sampled(pixels, self._range(header))

    def _range(self, header: Header) -> Camera:
        """A camera that saturates at the end of the files' counts: nobody knows more yet."""
        n, rows, columns = self.sampling.n_summed, *self.sampling.shape
        top = min(n * (((1 << min(header.bits, 16)) - 1) // self.frames.divide_by), 65535)
        return Camera(
            rows=rows, columns=columns, pitch_mm=(1.0, 1.0), gain_dn_per_e=1.0, black_dn=0.0,
            saturation_dn=top, full_well_e=float(top), noise_dn=0.0, dark_e_per_s=0.0,
        )  # fmt: skip

    def _header(self, name: str) -> Header:
        path = inside(self.folder, name, f"{self.folder / NAME}: frames")
        ending = path.suffix.lower()
        if ending not in KINDS and ending not in RAW_ENDINGS:
            raise ConfigurationError(
                f"{self.folder / NAME}: {name!r} ends in {ending or 'nothing'!r}; frames are read "
                "from .tif, .tiff, .png, .exr and cameras' raw files such as .dng or .nef.",
                value=name,
            )
        if not path.is_file():
            raise DataError(
                f"{self.folder}: {name} is missing; {self.table.takes} frames of each role, flat "
                "and dark, are needed at every exposure.",
                value=name,
            )
        header = read_raw_header(path, name) if ending in RAW_ENDINGS else read_header(path, name)
        check_bytes(path, header, name)
        return header


def read_flats(folder: str | Path) -> FlatsFolder:
    """The frames of a folder with a flats.toml.

    Raises
    ------
    ConfigurationError
        If folder or flats.toml is missing, or the file cannot be used.
    """
    folder = Path(folder)
    path = folder / NAME
    if not path.is_file():
        raise ConfigurationError(
            f"{path}: no such file; it says which exposures were taken and how the files are "
            "named. 'gonio flats -o FOLDER' writes a folder to look at.",
            value=path,
        )
    try:
        content = _File.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigurationError(f"{path}: not valid TOML: {error}.", value=path) from None
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        message = first["msg"].removeprefix("Value error, ")
        raise ConfigurationError(
            f"{path}: {f'{key}: ' if key else ''}{message}.", value=path
        ) from None
    return FlatsFolder(folder, content.flats, content.frames)
