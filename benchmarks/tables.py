"""Tables of campaigns as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from gonio.files import atomic_path


def write_rows(
    path: Path, fields: Sequence[str], rows: Iterable[Mapping[str, Any]], ends: str = "\n"
) -> None:
    """Write a table whole, so that an interrupted campaign leaves the one before.

    Parameters
    ----------
    path : Path
        Its folder is made where it is absent.
    fields : sequence of str
        Names of the columns.
    rows : iterable of mapping
    ends : str
        What ends a line; tables of version 0.1 end theirs with "\\r\\n".
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        atomic_path(path) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, fields, lineterminator=ends)
        writer.writeheader()
        writer.writerows(rows)
