"""The file of a calibrated geometry: written by the alignment, read by the reduction. TOML."""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gonio.errors import ConfigurationError, DataError
from gonio.files import write_text
from gonio.metadata import GEOMETRY_QUANTITIES, LENS_QUANTITIES, Geometry, Metadata, Uncertain

if TYPE_CHECKING:
    from gonio.calibration.dome.alignment import Alignment

SCHEMA = "gonio.geometry/1"
_FIELDS = ("shape", "R", "D", "pupil_mm", "pupil_walk_mm", "camera_azimuth_deg")


class _Frame(BaseModel):
    model_config = ConfigDict(extra="forbid")
    rows: int
    columns: int
    centre_px: tuple[float, float]


class _Dome(BaseModel):
    model_config = ConfigDict(extra="forbid")
    shape: Literal["sphere", "ellipsoid"]
    R: float
    D: float
    pupil_mm: tuple[float, float, float]
    pupil_walk_mm: float
    camera_azimuth_deg: float


class _Lens(BaseModel):
    """The lens, where the fit moved it within the uncertainty of its calibration."""

    model_config = ConfigDict(extra="forbid")
    focal_length_mm: float
    k: tuple[float, float, float, float]


class _File(BaseModel):
    """The content that a reduction needs. `fit` is for people and free in form."""

    model_config = ConfigDict(extra="forbid")
    schema_: str = Field(alias="schema")
    instrument: str
    geometry: _Dome
    frame: _Frame
    lens: _Lens | None = None
    uncertain: Uncertain
    not_determined: dict[str, tuple[str, ...]] = {}
    fit: dict[str, Any] = {}


@dataclass(frozen=True)
class Calibrated:
    """A calibrated geometry for the sessions of an instrument.

    Parameters
    ----------
    path : Path
        Where it comes from.
    content : object
        The checked content of the file.
    """

    path: Path
    content: _File

    @property
    def uncertain(self) -> Uncertain:
        """Joint covariance of geometry and image centre."""
        return self.content.uncertain

    @property
    def held(self) -> tuple[str, ...]:
        """Quantities that the alignment did not determine and left as they were."""
        return tuple(self.content.not_determined)

    def applied(self, metadata: Metadata) -> Metadata:
        """The metadata of a session with the calibrated values.

        The session's covariance of the geometry is dropped; `uncertain` replaces it.

        Raises
        ------
        ConfigurationError
            If the instrument, the size of the frames or the shape of the dome is another.
        """
        if metadata.instrument != self.content.instrument:
            raise ConfigurationError(
                f"{self.path}: the geometry of {self.content.instrument}, and the session was "
                f"taken with {metadata.instrument}.",
                value=self.path,
            )
        camera, frame, dome = metadata.camera, self.content.frame, self.content.geometry
        if (camera.rows, camera.columns) != (frame.rows, frame.columns):
            raise ConfigurationError(
                f"{self.path}: calibrated with frames of {frame.columns} x {frame.rows} pixels and "
                f"the session has {camera.columns} x {camera.rows}; calibrate with frames of the "
                "same window and binning.",
                value=self.path,
            )
        if metadata.geometry.shape != dome.shape:
            raise ConfigurationError(
                f"{self.path}: belongs to a dome that is a {dome.shape}, the session to a "
                f"{metadata.geometry.shape}.",
                value=self.path,
            )
        own = metadata.geometry.model_dump() | dome.model_dump() | {"uncertain": None}
        lens = metadata.lens.model_dump() | {"centre_px": frame.centre_px}
        if self.content.lens is not None:
            lens |= self.content.lens.model_dump()
        lens["uncertain"] = _without(metadata.lens.uncertain, self.uncertain.names)
        return metadata.model_copy(
            update={
                "geometry": Geometry.model_validate(own),
                "lens": type(metadata.lens).model_validate(lens),
            }
        )


def read(path: str | Path) -> Calibrated:
    """A calibrated geometry from the file that `gonio calibrate alignment` wrote.

    Raises
    ------
    DataError
        If the file cannot be read or is not one.
    """
    path = Path(path)
    try:
        content = _File.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read as text ({error}).", value=path) from None
    except tomllib.TOMLDecodeError as error:
        raise DataError(f"{path}: not valid TOML: {error}.", value=path) from None
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"]) or "content"
        raise DataError(f"{path}: {key}: {first['msg']}.", value=path) from None
    if content.schema_ != SCHEMA:
        raise DataError(f"{path}: schema {content.schema_!r} is not {SCHEMA!r}.", value=path)
    strangers = set(content.uncertain.names) - {*GEOMETRY_QUANTITIES, *LENS_QUANTITIES}
    if strangers:
        raise DataError(f"{path}: uncertain names {', '.join(sorted(strangers))}.", value=path)
    return Calibrated(path, content)


def write(path: str | Path, alignment: Alignment, *, instrument: str, lost: dict[str, str]) -> None:
    """Write an alignment, whole or not at all.

    Parameters
    ----------
    path : path
    alignment : Alignment
    instrument : str
        Name of the instrument that it belongs to.
    lost : dict
        Images without a usable spot, and why.
    """
    from gonio.calibration.dome.spot_residuals import QUANTITIES

    pixel_map = alignment.pixel_map
    geometry = {name: getattr(pixel_map.geometry, name) for name in _FIELDS}
    wedge = {f"{n}_deg": v for n, v in alignment.values.items() if n.startswith("wedge")}
    tables: dict[str, dict[str, Any]] = {
        "geometry": geometry,
        "frame": {
            "rows": pixel_map.camera.rows,
            "columns": pixel_map.camera.columns,
            "centre_px": [alignment.values["centre_x"], alignment.values["centre_y"]],
        },
        "lens": {"focal_length_mm": pixel_map.lens.focal_length_mm, "k": pixel_map.lens.k},
        "uncertain": alignment.uncertain.model_dump(),
        "not_determined": dict(alignment.held_for),
        "fit": {
            "spots": len(alignment.names),
            "rms_px": alignment.rms_px,
            "chi2": alignment.chi2,
            "dof": alignment.dof,
            "scale": alignment.scale,
            **wedge,
        },
        "fit.not_used": lost | dict(alignment.dropped),
    }
    if not set(alignment.uncertain.names) - set(QUANTITIES):
        del tables["lens"]
    head = {"schema": SCHEMA, "instrument": instrument}
    blocks = [_lines(head)] + [f"[{name}]\n{_lines(table)}" for name, table in tables.items()]
    write_text(Path(path), "\n".join(blocks))


def _lines(table: dict[str, Any]) -> str:
    """A TOML table of numbers, texts and lists of them, which JSON writes in the same way."""
    return "".join(
        f"{name if name.isidentifier() else json.dumps(name)} = {json.dumps(value)}\n"
        for name, value in table.items()
    )


def _without(uncertain: Uncertain | None, names: tuple[str, ...]) -> Uncertain | None:
    """The covariance of the quantities that are not in `names`."""
    if uncertain is None:
        return None
    keep = [k for k, name in enumerate(uncertain.names) if name not in names]
    if not keep:
        return None
    return Uncertain(
        names=tuple(uncertain.names[k] for k in keep),
        covariance=tuple(tuple(uncertain.covariance[i][j] for j in keep) for i in keep),
    )
