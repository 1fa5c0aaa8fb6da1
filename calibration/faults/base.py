"""The record of a question to a session. Everything that is said about it derives from this.

A file of this folder that defines `QUESTION = Question(...)` is a question. Every reduction and
every import asks it of the statistics of the images. The manual lists it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

from gonio.calibration.faults.evidence import Evidence

Severity = Literal["error", "warning"]


@dataclass(frozen=True)
class Finding:
    """Something wrong with a session.

    Parameters
    ----------
    code : str
        Name of the fault, the same in every session.
    severity : {"error", "warning"}
        An error stops the reduction.
    text : str
        One sentence that names the frame and gives the value.
    """

    code: str
    severity: Severity
    text: str

    @property
    def line(self) -> str:
        """Severity and text, as the history has them."""
        return f"{self.severity}: {self.text}"


@dataclass(frozen=True)
class Question:
    """A question to a session.

    Parameters
    ----------
    key : str
        Name of its file.
    order : int
        Position among the questions; findings of one severity are listed in this order.
    asks : str
        The question in words.
    compares : str
        What is compared with what.
    codes : tuple of str
        Codes of the findings that it may lead to.
    ask : callable
        Called with the evidence of one channel. Yields what is wrong.
    """

    key: str
    order: int
    asks: str
    compares: str
    codes: tuple[str, ...]
    ask: Callable[[Evidence], Iterator[Finding]]
