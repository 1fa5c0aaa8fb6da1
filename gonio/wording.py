"""Counts and lists as parts of an English sentence."""

from __future__ import annotations

from collections.abc import Sequence


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
