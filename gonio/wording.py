"""Counts, lists and paragraphs of English text."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

WIDTH = 80  # columns of a page of text


def counted(n: int, noun: str, plural: str = "") -> str:
    """A number with its noun, which is singular for 1.

    Parameters
    ----------
    n : int
    noun : str
        In the singular.
    plural : str
        Where it is not the noun with an s.

    Examples
    --------
    >>> counted(1, "warning"), counted(2, "warning"), counted(0, "frequency", "frequencies")
    ('1 warning', '2 warnings', '0 frequencies')
    """
    return f"{n} {noun}" if n == 1 else f"{n} {plural or noun + 's'}"


def listed(words: Sequence[str]) -> str:
    """Words with commas and an "and" before the last.

    Examples
    --------
    >>> listed(["a", "b", "c"]), listed(["a"])
    ('a, b and c', 'a')
    """
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def paragraph(text: str, start: str = "", indent: int | None = None) -> str:
    """A text folded into lines of 80 columns.

    Parameters
    ----------
    text : str
    start : str
        What stands before the text in the first line.
    indent : int, optional
        Blanks before the other lines; as many as `start` has where not given.

    Examples
    --------
    >>> paragraph("Energy is conserved.", "- ")
    '- Energy is conserved.'
    """
    return textwrap.fill(
        text,
        WIDTH,
        initial_indent=start,
        subsequent_indent=" " * (len(start) if indent is None else indent),
        break_on_hyphens=False,
        break_long_words=False,
    )
