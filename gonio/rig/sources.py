"""From which file each frame of an imported session came: `sources.jsonl` in its folder.

A line is written after the frame is safely in the session. A frame is imported when its line is
there and the file is still the one that the line tells of, byte for byte.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

from gonio.errors import DataError
from gonio.rig.frame_files import FrameIndex

NAME = "sources.jsonl"


@dataclass(frozen=True)
class Source:
    """The file of a frame.

    Parameters
    ----------
    file : str
        Relative to the rig's folder.
    sha256 : str
        Of its content.
    low, high : int
        Smallest and largest count of its pixels.
    at_high : int
        Pixels that have the largest count.
    """

    file: str
    sha256: str
    low: int
    high: int
    at_high: int

    @property
    def empty(self) -> bool:
        """Every pixel has the same count."""
        return self.low == self.high


def read(session: Path) -> dict[FrameIndex, Source]:
    """The sources that a session knows; what was not written to the end is left out."""
    path = session / NAME
    sources: dict[FrameIndex, Source] = {}
    if not path.is_file():
        return sources
    for line in path.read_bytes().splitlines():
        try:
            record = json.loads(line)
            index = FrameIndex(*(record.pop(name) for name in FrameIndex._fields))
            sources[index] = Source(**record)
        except (ValueError, KeyError, TypeError, AttributeError):
            continue  # a line that a crash cut off: its frame is read again
    return sources


def append(session: Path, index: FrameIndex, source: Source) -> None:
    """Note the source of a frame."""
    line = json.dumps({**index._asdict(), **asdict(source)}, ensure_ascii=False)
    try:
        with (session / NAME).open("a", encoding="utf-8") as file:
            # A line that a crash cut off must not swallow this one.
            file.write(f"{line}\n" if _at_line_start(session / NAME) else f"\n{line}\n")
    except OSError as error:
        raise DataError(
            f"{session / NAME}: cannot be written ({error.strerror or error}); free space and run "
            "the same command again.",
            value=session,
        ) from error


def _at_line_start(path: Path) -> bool:
    with path.open("rb") as file:
        size = file.seek(0, 2)
        if size == 0:
            return True
        file.seek(size - 1)
        return file.read(1) == b"\n"
