"""How long work says how far it is: a callback that the caller may show or ignore."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

Progress = Callable[[int, int], None]  # (done, total)

# Takes a line about code that is being compiled for the first time; the command line sets it.
on_compiling: Callable[[str], None] | None = None


class Stage(NamedTuple):
    """One of several pieces of work that follow each other.

    Parameters
    ----------
    doing : str
        What is done, as a line begins: "leaving out exposures".
    unit : str
        What is counted, in the plural.
    """

    doing: str
    unit: str


# (stage, done, total); the total is 0 when the stage begins and it is not known yet.
StagedProgress = Callable[[Stage, int, int], None]


def begin(progress: StagedProgress | None, doing: str, unit: str) -> Progress | None:
    """Announce a stage and return the callback (done, total) for the work in it.

    Examples
    --------
    >>> callback = begin(lambda stage, done, total: print(stage.doing, done, total), "a", "images")
    a 0 0
    >>> callback(1, 2)
    a 1 2
    >>> begin(None, "a", "images") is None
    True
    """
    if progress is None:
        return None
    stage = Stage(doing, unit)
    progress(stage, 0, 0)
    return lambda done, total: progress(stage, done, total)
