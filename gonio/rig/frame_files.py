"""The file of each frame, by a pattern of names or by a table."""

from __future__ import annotations

import csv
import re
import string
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

from gonio.errors import ConfigurationError, DataError, unknown_name
from gonio.metadata import Plan
from gonio.rig.headers import KINDS
from gonio.rig.paths import inside
from gonio.rig.raw import RAW_ENDINGS
from gonio.rig.session_file import RigFile
from gonio.rig.tables import FramesTable
from gonio.session import MAX_FRAMES

FIELDS = (
    "role", "theta_i", "rotation", "exposure_s", "exposure_ms", "exposure_us", "take", "channel",
)  # fmt: skip
COLUMNS = ("file", "role", "theta_i_deg", "rotation_deg", "exposure_s", "channel", "take")
OWN_BACKGROUND = "background_of_standard"
_SPEC = re.compile(r"[ +-]?0?\d{0,2}(\.\d{1,2})?[dfg]?")
_SHOWN = 5
_MOST_STRANGERS = 100_000


class FrameIndex(NamedTuple):
    """A frame by its indices in the plan."""

    role: str
    take: int
    incidence: int
    exposure: int
    channel: int


@dataclass(frozen=True)
class FrameFiles:
    """The files of a session.

    Parameters
    ----------
    names : dict of FrameIndex to str
        File of each frame, relative to the rig's folder, in the plan's order.
    strangers : tuple of str
        Pictures in the folder that are not of the plan.
    """

    names: dict[FrameIndex, str]
    strangers: tuple[str, ...]


def frame_indices(plan: Plan) -> Iterator[FrameIndex]:
    """All frames of a plan in the order in which they are taken."""
    for role, take, incidence in plan.images():
        for channel in range(len(plan.channels)):
            for exposure in range(len(plan.exposures_s)):
                yield FrameIndex(role, take, incidence, exposure, channel)


def find(rig: RigFile) -> FrameFiles:
    """The file of every frame of the plan.

    Raises
    ------
    ConfigurationError
        If the pattern cannot be used, gives one name to two frames, or leads out of the folder.
    DataError
        If files are missing, or the table names a frame that is not of the plan.
    """
    frames, plan = rig.table.frames, rig.table.plan
    if plan.n_frames > MAX_FRAMES:
        raise ConfigurationError(
            f"{rig.path}: the plan has {plan.n_frames} frames; at most {MAX_FRAMES} are allowed.",
            value=plan.n_frames,
        )
    if frames.csv is not None:
        names = _of_table(rig, frames.csv)
    else:
        names = {index: _name(rig, index) for index in frame_indices(plan)}
        _check_distinct(rig, names)
    for name in names.values():
        _check_ending(rig, name)
        inside(rig.folder, name, f"{rig.path}: frames")
    strangers = tuple(_strangers(rig.folder, set(names.values())))
    _check_there(rig, names, strangers)
    return FrameFiles(names, strangers)


# ---------------------------------------------------------------- by a pattern


def _name(rig: RigFile, index: FrameIndex) -> str:
    """Name of a frame's file by the pattern."""
    frames, plan = rig.table.frames, rig.table.plan
    assert frames.pattern is not None
    own = {"background": frames.pattern_of_background, "standard": frames.pattern_of_standard}
    is_sample = index.role == "sample"
    seconds = plan.exposures_s[index.exposure]
    values = {
        "role": _role_name(frames, plan, index),
        "theta_i": plan.incidences(index.role)[index.incidence],
        "rotation": plan.rotations_deg[index.take] if is_sample else 0.0,
        "take": 1 if is_sample else index.take + 1,
        "exposure_s": seconds,
        "exposure_ms": seconds * 1e3,
        "exposure_us": seconds * 1e6,
        "channel": plan.channels[index.channel].name,
    }
    return formatted(own.get(index.role) or frames.pattern, values, str(rig.path))


def _role_name(frames: FramesTable, plan: Plan, index: FrameIndex) -> str:
    roles = frames.roles
    alone = plan.standard_theta_i_deg is not None and index.incidence == len(plan.theta_i_deg)
    if index.role == "background" and alone:
        return roles.background_of_standard or roles.background
    return str(getattr(roles, index.role))


def formatted(pattern: str, values: dict[str, Any], where: str = "frames") -> str:
    """A pattern with its fields filled in.

    Parameters
    ----------
    pattern : str
        Such as "{role}/{theta_i:g}_{exposure_ms:g}.tif": names of fields and, for numbers, width,
        decimals and d, f or g; g where nothing is said.
    values : dict
        By field.
    where : str
        What a message begins with.

    Raises
    ------
    ConfigurationError
        For an unknown field or format.

    Examples
    --------
    >>> formatted("{role}/{theta_i:03.0f}_{exposure_ms}.png",
    ...           {"role": "white", "theta_i": 5.0, "exposure_ms": 0.25})
    'white/005_0.25.png'
    """
    try:
        pieces = list(string.Formatter().parse(pattern))
    except ValueError as error:
        raise ConfigurationError(
            f"{where}: the pattern {pattern!r} cannot be read ({error}).", value=pattern
        ) from None
    name = ""
    for text, field, spec, conversion in pieces:
        name += text
        if field is None:
            continue
        if field not in FIELDS:
            raise ConfigurationError(
                f"{where}: in the pattern {pattern!r}: {unknown_name('field', field, FIELDS)}",
                value=field,
            )
        name += _formatted(field, values[field], spec or "", conversion, where)
    return name


def _formatted(field: str, value: Any, spec: str, conversion: str | None, where: str) -> str:
    is_text = field in ("role", "channel")
    if conversion or not (spec == "" if is_text else _SPEC.fullmatch(spec)):
        allowed = "none" if is_text else "width, decimals and d, f or g, such as g, 03d or .1f"
        raise ConfigurationError(
            f"{where}: the format {spec or conversion!r} of {{{field}}} is not allowed; "
            f"allowed is {allowed}.",
            value=spec,
        )
    if is_text:
        return str(value)
    if not spec.endswith("d"):
        return format(float(value), spec if spec[-1:] in ("f", "g") else f"{spec}g")
    number = round(float(value), 9)
    if not number.is_integer():
        raise ConfigurationError(
            f"{where}: {field} = {number:g} is no whole number and cannot be written with d; "
            f"write {{{field}:g}}.",
            value=value,
        )
    return format(int(number), spec)


def _check_distinct(rig: RigFile, names: dict[FrameIndex, str]) -> None:
    first: dict[str, FrameIndex] = {}
    for index, name in names.items():
        if name in first:
            one, other = (describe(rig.table.plan, p) for p in (first[name], index))
            raise ConfigurationError(
                f"{rig.path}: the pattern gives the name {name!r} to two frames, {one} and "
                f"{other}; {_hint(rig.table.plan, first[name], index)}.",
                value=name,
            )
        first[name] = index


def _hint(plan: Plan, one: FrameIndex, other: FrameIndex) -> str:
    """What the pattern lacks to tell two frames apart."""
    if one.role != other.role:
        return "put {role} into it"
    if one.channel != other.channel:
        return "put {channel} into it"
    if one.exposure != other.exposure:
        return "put {exposure_ms:g} into it, with enough digits"
    if one.take != other.take:
        return "put {rotation:g} into it" if one.role == "sample" else "put {take} into it"
    own = plan.standard_theta_i_deg
    if one.role == "background" and own is not None and own in plan.theta_i_deg:
        return (
            f"the standard needs a background of its own: name it by frames.roles.{OWN_BACKGROUND}"
        )
    return "put {theta_i:g} into it, with enough digits"


# ---------------------------------------------------------------- by a table


def _of_table(rig: RigFile, table: str) -> dict[FrameIndex, str]:
    """Files by a CSV with a row for each frame."""
    path = inside(rig.folder, table, f"{rig.path}: frames.csv")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(islice(csv.reader(file), MAX_FRAMES + 2))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise DataError(f"{path}: cannot be read as a CSV ({error}).", value=path) from None
    header = [word.strip() for word in rows[0]] if rows else []
    for name in header:
        if name not in COLUMNS:
            raise DataError(f"{path}: {unknown_name('column', name, COLUMNS)}", value=name)
    for name in ("file", "role", "theta_i_deg", "exposure_s"):
        if name not in header:
            raise DataError(
                f"{path}: the column {name} is missing; the first line must name the columns: "
                f"{', '.join(COLUMNS)}.",
                value=path,
            )
    if len(set(header)) < len(header):
        raise DataError(f"{path}: a column is named twice.", value=path)
    names: dict[FrameIndex, str] = {}
    users: dict[str, int] = {}
    for number, row in enumerate(rows[1:], start=2):
        if not any(word.strip() for word in row):
            continue
        where = f"{path}, line {number}"
        if len(row) != len(header):
            raise DataError(
                f"{where}: has {len(row)} fields and the first line names {len(header)}.",
                value=row,
            )
        record = {name: word.strip() for name, word in zip(header, row, strict=True)}
        index, name = _index_of_row(rig.table.plan, record, where), record["file"]
        if index in names:
            raise DataError(
                f"{where}: {describe(rig.table.plan, index)} is {name!r}, and was "
                f"{names[index]!r} above; a frame has one file.",
                value=name,
            )
        if name in users:
            raise DataError(
                f"{where}: {name!r} is the file of another frame in line {users[name]}; each frame "
                "has a file of its own.",
                value=name,
            )
        names[index], users[name] = name, number
    absent = [index for index in frame_indices(rig.table.plan) if index not in names]
    if absent:
        listed = "; ".join(describe(rig.table.plan, index) for index in absent[:_SHOWN])
        raise DataError(
            f"{path}: {len(absent)} of {rig.table.plan.n_frames} frames of the plan have no row: "
            f"{listed}{_more(len(absent))}.",
            value=absent,
        )
    return {index: names[index] for index in frame_indices(rig.table.plan)}


def _index_of_row(plan: Plan, record: dict[str, str], where: str) -> FrameIndex:
    """The frame of a row."""
    role = record["role"]
    roles = [*plan.roles, *([OWN_BACKGROUND] if plan.standard_theta_i_deg is not None else [])]
    if role not in roles:
        raise DataError(f"{where}: {unknown_name('role', role, roles)}", value=role)
    theta_i = _number(record, "theta_i_deg", where)
    own = role == OWN_BACKGROUND
    role = "background" if own else role
    angles = list(plan.incidences(role))
    incidence = _position_in(theta_i, angles, f"{where}: theta_i_deg", "plan.theta_i_deg")
    if own:
        incidence = len(angles) - 1
    exposure = _position_in(
        _number(record, "exposure_s", where), plan.exposures_s,
        f"{where}: exposure_s", "plan.exposures_s",
    )  # fmt: skip
    return FrameIndex(
        role, _take(plan, role, record, where), incidence, exposure, _channel(plan, record, where)
    )


def _take(plan: Plan, role: str, record: dict[str, str], where: str) -> int:
    if role == "sample":
        if not record.get("rotation_deg") and len(plan.rotations_deg) == 1:
            return 0
        return _position_in(
            _number(record, "rotation_deg", where), plan.rotations_deg,
            f"{where}: rotation_deg", "plan.rotations_deg",
        )  # fmt: skip
    if not record.get("take") and plan.repeats == 1:
        return 0
    takes = range(1, plan.repeats + 1)
    return _position_in(
        _number(record, "take", where), takes, f"{where}: take", "1 to plan.repeats"
    )


def _channel(plan: Plan, record: dict[str, str], where: str) -> int:
    names = [channel.name for channel in plan.channels]
    given = record.get("channel", "")
    if given in names:
        return names.index(given)
    if not given and len(names) == 1:
        return 0
    raise DataError(f"{where}: {unknown_name('channel', given, names)}", value=given)


def _number(record: dict[str, str], column: str, where: str) -> float:
    text = record.get(column, "")
    try:
        return float(text)
    except ValueError:
        raise DataError(f"{where}: {column} = {text!r} is not a number.", value=text) from None


def _position_in(value: float, allowed: Sequence[float], what: str, where: str) -> int:
    for k, each in enumerate(allowed):
        if abs(value - each) <= 1e-6 * max(abs(each), 1e-6):
            return k
    listed = ", ".join(f"{each:g}" for each in allowed)
    raise DataError(f"{what} = {value:g} is not of the plan; {where} holds {listed}.", value=value)


# ---------------------------------------------------------------- both


def describe(plan: Plan, index: FrameIndex) -> str:
    """A frame in words.

    Examples
    --------
    >>> plan = Plan(theta_i_deg=(0, 30), rotations_deg=(0, 90), exposures_s=(0.004,), repeats=2)
    >>> describe(plan, FrameIndex("sample", 1, 1, 0, 0))
    'sample at 30 deg, rotation 90 deg, 4 ms'
    """
    text = f"{index.role} at {plan.incidences(index.role)[index.incidence]:g} deg"
    if index.role == "sample" and len(plan.rotations_deg) > 1:
        text += f", rotation {plan.rotations_deg[index.take]:g} deg"
    elif index.role != "sample" and plan.repeats > 1:
        text += f", take {index.take + 1}"
    text += f", {plan.exposures_s[index.exposure] * 1e3:g} ms"
    if len(plan.channels) > 1:
        text += f", channel {plan.channels[index.channel].name}"
    return text


def _check_ending(rig: RigFile, name: str) -> None:
    ending = Path(name).suffix.lower()
    if ending not in KINDS and ending not in RAW_ENDINGS:
        raise ConfigurationError(
            f"{rig.path}: {name!r} ends in {ending or 'nothing'!r}; frames are read from .tif, "
            ".tiff, .png, .exr and cameras' raw files such as .dng, .cr3, .nef or .arw.",
            value=name,
        )


def _strangers(folder: Path, used: set[str]) -> Iterator[str]:
    """Pictures in the folder that no frame is read from."""
    endings = {Path(name).suffix.lower() for name in used}
    for path in islice(sorted(folder.rglob("*")), _MOST_STRANGERS):
        name = path.relative_to(folder).as_posix()
        if path.suffix.lower() in endings and name not in used and path.is_file():
            yield name


def _check_there(rig: RigFile, names: dict[FrameIndex, str], strangers: Sequence[str]) -> None:
    missing = [name for name in names.values() if not (rig.folder / name).is_file()]
    if not missing:
        return
    hint = ""
    if strangers:
        one = len(strangers) == 1
        hint = (
            f" {len(strangers)} picture{'' if one else 's'} in the folder "
            f"{'is' if one else 'are'} not of the plan, such as {strangers[0]}: check plan and "
            "frames of session.toml."
        )
    raise DataError(
        f"{rig.folder}: {len(missing)} of {len(names)} frames are missing: "
        f"{', '.join(missing[:_SHOWN])}{_more(len(missing))}.{hint}",
        value=missing,
    )


def _more(count: int) -> str:
    return f" and {count - _SHOWN} more" if count > _SHOWN else ""
