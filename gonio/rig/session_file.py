"""Read session.toml, and say in one sentence what is wrong with it."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from gonio.errors import ConfigurationError, DataError, unknown_name
from gonio.metadata import LensCalibration
from gonio.rig.paths import inside
from gonio.rig.tables import HOW_TO_MEASURE, SessionTable

NAME = "session.toml"
TO_FILL_IN = "FILL IN"  # how names begin in the template
_LARGEST_BYTES = 1 << 26


@dataclass(frozen=True)
class LensFile:
    """Where the lens comes from, with the size of the frames that its centre belongs to."""

    name: str
    rows: int
    columns: int


@dataclass(frozen=True)
class RigFile:
    """A rig's folder with its checked description.

    Parameters
    ----------
    folder : Path
        Everything that belongs to the rig lies in it.
    table : SessionTable
        What session.toml says.
    lens_file : LensFile, optional
        Given where session.toml names a file of the lens.
    text : str
        session.toml as it stands.
    """

    folder: Path
    table: SessionTable
    lens_file: LensFile | None
    text: str

    @property
    def path(self) -> Path:
        """The description's file."""
        return self.folder / NAME


def read(folder: str | Path) -> RigFile:
    """The description of a rig from the session.toml of its folder.

    Raises
    ------
    ConfigurationError
        If the folder or session.toml is missing, it is no TOML, or a key is unknown, missing or
        out of range.
    DataError
        If the lens's file cannot be used.
    """
    folder = Path(folder)
    path = folder / NAME
    if not folder.is_dir():
        raise ConfigurationError(
            f"{folder}: no such folder; give the one that holds {NAME} and the frames.",
            value=folder,
        )
    if not path.is_file():
        raise ConfigurationError(
            f"{path}: no such file; 'gonio import --template -o {path}' writes one to fill in.",
            value=path,
        )
    text = _text_of(path)
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigurationError(f"{path}: not valid TOML: {error}.", value=path) from None
    lens_file = None
    lens = content.get("lens")
    if isinstance(lens, dict) and "file" in lens:
        lens_file, content["lens"] = _lens_of_file(folder, path, lens)
    camera = content.get("camera")
    if isinstance(camera, dict) and "file" in camera:
        content["camera"] = _camera_of_file(folder, path, camera)
    try:
        table = SessionTable.model_validate(content)
    except ValidationError as error:
        raise ConfigurationError(f"{path}: {sentence(error)}", value=path) from None
    for key, given in table.instrument.model_dump().items():
        if given.startswith(TO_FILL_IN):
            raise ConfigurationError(
                f"{path}: instrument.{key} is still {given!r}; go through the template line by "
                "line, every figure in it is an example.",
                value=given,
            )
    return RigFile(folder, table, lens_file, text)


def _text_of(path: Path) -> str:
    try:
        if path.stat().st_size > _LARGEST_BYTES:
            raise ConfigurationError(
                f"{path}: is larger than {_LARGEST_BYTES >> 20} MiB; it is not a {NAME}.",
                value=path,
            )
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"{path}: cannot be read as text ({error}).", value=path) from None


def _lens_of_file(
    folder: Path, path: Path, lens: dict[str, Any]
) -> tuple[LensFile, LensCalibration]:
    """The lens that [lens] names by `file`."""
    from gonio.calibration.lens import lens_file

    others = sorted(set(lens) - {"file"})
    if others:
        raise ConfigurationError(
            f"{path}: lens.file says all about the lens; leave {', '.join(others)} out, or leave "
            "file out.",
            value=others,
        )
    name = lens["file"]
    if not isinstance(name, str):
        raise ConfigurationError(
            f"{path}: lens.file must be the name of a file (given: {name!r}).", value=name
        )
    file = inside(folder, name, f"{path}: lens.file")
    if not file.is_file():
        raise DataError(
            f"{path}: lens.file = {name!r}: no such file beside it; 'gonio calibrate lens' writes "
            "one.",
            value=name,
        )
    calibrated = lens_file.read(file)
    return LensFile(name, calibrated.rows, calibrated.columns), calibrated.lens


def _camera_of_file(folder: Path, path: Path, camera: dict[str, Any]) -> dict[str, Any]:
    """The table [camera] with the figures of the file that it names, and those it adds."""
    from gonio.calibration.frames import camera_file

    name = camera["file"]
    if not isinstance(name, str):
        raise ConfigurationError(
            f"{path}: camera.file must be the name of a file (given: {name!r}).", value=name
        )
    file = inside(folder, name, f"{path}: camera.file")
    if not file.is_file():
        raise DataError(
            f"{path}: camera.file = {name!r}: no such file beside it; 'gonio calibrate camera' "
            "writes one.",
            value=name,
        )
    measured = camera_file.read(file)
    own = {key: value for key, value in camera.items() if key != "file"}
    twice = sorted(set(own) & set(measured))
    if twice:
        raise ConfigurationError(
            f"{path}: {name} says {', '.join(twice)} of the camera; leave it out, or leave "
            "camera.file out.",
            value=twice,
        )
    return measured | own


def sentence(error: ValidationError) -> str:
    """The first complaint of a validation that a reader should mend, as a sentence.

    A misspelt key comes before the key that is then missing.
    """
    order = {"extra_forbidden": 0, "missing": 1}
    complaints: list[Any] = sorted(error.errors(), key=lambda each: order.get(each["type"], 2))
    first = complaints[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        owner = _owner(first["loc"][:-1])
        kind = "table or key" if len(first["loc"]) == 1 else "key"
        return f"{key}: {unknown_name(kind, str(first['loc'][-1]), owner.model_fields)}"
    if first["type"] == "missing":
        if len(first["loc"]) == 1:
            return f"the table [{key}] is missing; 'gonio import --template' shows all tables."
        how = HOW_TO_MEASURE.get(key)
        field = _owner(first["loc"][:-1]).model_fields[str(first["loc"][-1])]
        meaning = f" ({field.description})" if field.description else ""
        return f"{key} is missing{meaning}{f'; {how}' if how else ''}."
    message = first["msg"].removeprefix("Value error, ")
    given = first["input"]
    shown = f" (given: {given!r})" if isinstance(given, str | int | float | list) else ""
    return f"{f'{key}: ' if key else ''}{message}{shown}."


def _owner(loc: tuple[int | str, ...]) -> type[BaseModel]:
    """The record that a key in session.toml belongs to."""
    owner: type[BaseModel] = SessionTable
    for part in loc:
        if isinstance(part, str) and part in owner.model_fields:
            owner = _record_in(owner.model_fields[part].annotation) or owner
    return owner


def _record_in(annotation: Any) -> type[BaseModel] | None:
    """The record that an annotation such as `tuple[Channel, ...]` or `Uncertain | None` holds."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((record for part in get_args(annotation) if (record := _record_in(part))), None)
