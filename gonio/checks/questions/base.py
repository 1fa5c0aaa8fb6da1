"""The record of a question to BRDF samples. Everything that is said about it derives from this.

A file of this folder that defines `QUESTION = Question(...)` is a question. `check`, `fit`,
`compare` and `load` ask it of the samples. The manual lists it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gonio.checks.questions.evidence import Evidence

Level = Literal["note", "warning", "refuse"]
LEVELS: tuple[Level, ...] = ("refuse", "warning", "note")
LISTED = 100  # samples or lines that the plain data of a finding list


@dataclass(frozen=True)
class Finding:
    """Something implausible in BRDF samples.

    Parameters
    ----------
    code : str
        Name of what was found, the same in every file.
    level : {"note", "warning", "refuse"}
        By consequence. A note is for the reader of `check`; a fit prints a warning and goes on;
        a fit refuses samples that cannot be what they claim.
    text : str
        The evidence in numbers, and the cure.
    samples : tuple of int
        Indices of the samples concerned; empty where it is the whole file.
    lines : tuple of int
        Their lines in the file, where known.
    left_out : bool
        The samples are no measurements, and a fit leaves them out.
    """

    code: str
    level: Level
    text: str
    samples: tuple[int, ...] = ()
    lines: tuple[int, ...] = ()
    left_out: bool = False

    def describe(self) -> dict[str, Any]:
        """The finding as plain data; of long lists the first hundred and `n_samples`."""
        record = asdict(self)
        record["n_samples"] = len(self.samples)
        for name in ("samples", "lines"):
            record[name] = list(record[name][:LISTED])
        return record

    @classmethod
    def described(cls, record: Mapping[str, Any]) -> Finding:
        """The finding that `describe` wrote."""
        fields = {name: value for name, value in record.items() if name != "n_samples"}
        return cls(**{**fields, **{name: tuple(record[name]) for name in ("samples", "lines")}})

    @classmethod
    def without_reading(
        cls, code: str, evidence: Evidence, index: NDArray[np.int64], values: str, why: str
    ) -> Finding:
        """Samples that hold no reading: left out, or refused where they are most of them.

        Parameters
        ----------
        code : str
        evidence : Evidence
        index : ndarray of int64
            The samples.
        values : str
            What their values are, as in "-9999, which stands for a missing reading".
        why : str
            What is said behind that where they are left out.
        """
        many = 2 * len(index) >= evidence.n
        ending = ": too few measurements are left. Remove these lines." if many else why
        return cls(
            code,
            "refuse" if many else "warning",
            f"{len(index)} of {evidence.n} values are {values} ({evidence.where(index)}){ending}",
            tuple(index.tolist()),
            evidence.lines(index),
            left_out=not many,
        )


@dataclass(frozen=True)
class Question:
    """A question to BRDF samples.

    Parameters
    ----------
    key : str
        Name of its file.
    order : int
        Position among the questions; findings of one level are listed in this order.
    asks : str
        The question in words.
    compares : str
        What is compared with what.
    codes : tuple of str
        Codes of the findings that it may lead to.
    ask : callable
        Called with the evidence. Yields what is implausible.
    of_values : bool
        Whether it looks for values that are no measurements. These are asked first, and the others
        see the samples that are left.
    of_file : bool
        Whether it is asked of all samples at once, not of each wavelength and channel.
    """

    key: str
    order: int
    asks: str
    compares: str
    codes: tuple[str, ...]
    ask: Callable[[Evidence], Iterator[Finding]]
    of_values: bool = False
    of_file: bool = False
