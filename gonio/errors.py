"""The few kinds of error that gonio raises, each with the exit code that the command line returns.

Every message is one sentence or two: what was given, what is allowed, what to do next.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any

SHORT_LIST = 12  # names that a message may list beside a hint


class GonioError(Exception):
    """Base of all errors that gonio raises on purpose.

    Parameters
    ----------
    message : str
        One clear sentence for the person at the terminal.
    value : object, optional
        The offending value, for programs that handle the error.
    """

    exit_code = 2

    def __init__(self, message: str, *, value: Any = None) -> None:
        super().__init__(message)
        self.value = value


class ConfigurationError(GonioError):
    """A name, a parameter or a setting that is not allowed (exit code 2)."""

    exit_code = 2


class DataError(GonioError):
    """A file or an array whose content cannot be used (exit code 3)."""

    exit_code = 3


class SessionInterruptedError(GonioError):
    """Work stopped before its end and can be resumed by the same command (exit code 4)."""

    exit_code = 4


class IncompleteFileWarning(UserWarning):
    """A file was written whose format cannot hold all that the object holds."""


def unknown_name(
    kind: str, name: str, allowed: Iterable[str], *, of: str = ""
) -> ConfigurationError:
    """Error for a name that is not in a list, with the nearest name that is.

    The whole list follows where it is short or nothing is near.

    Parameters
    ----------
    kind : str
        What the name should be.
    name : str
        As it was given.
    allowed : iterable of str
    of : str
        Whose name it would be.

    Examples
    --------
    >>> str(unknown_name("model", "wrd", ["ward", "lambert"]))
    "unknown model 'wrd': did you mean 'ward'? Choose from lambert, ward."
    """
    names = sorted(allowed)
    near = get_close_matches(name, names, n=1, cutoff=0.5)
    choice = f"choose from {', '.join(names)}."
    if len(names) < 2:
        choice = f"the only one is {names[0]}." if names else "there is none."
    hint = f"did you mean {near[0]!r}?" if near else choice
    if near and len(names) <= SHORT_LIST:
        hint += f" {choice[0].upper()}{choice[1:]}"
    owner = f" of {of}" if of else ""
    return ConfigurationError(
        f"unknown {kind} {name!r}{owner}{':' if near else ';'} {hint}", value=name
    )
