"""What a user reads whose kernel numba cannot compile: one sentence in place of numba's page."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any

from gonio.errors import ConfigurationError
from gonio.kernels.sources import file_of

LONGEST = 200  # letters of what numba says that are repeated


def guarded(loop: Callable[..., Any], kernel: FunctionType) -> Callable[..., Any]:
    """`loop`, which numba compiles around `kernel` at its first call, with a readable error.

    Only for kernels from outside the package: the call costs a little more.
    """

    @functools.wraps(loop)
    def run(*arguments: Any) -> Any:
        try:
            return loop(*arguments)
        except Exception as error:
            # What the compiled code raises itself, such as ZeroDivisionError, is none of numba's.
            if not type(error).__module__.startswith("numba."):
                raise
            raise _refused(error, kernel) from error

    return run


def _refused(error: Exception, kernel: FunctionType) -> ConfigurationError:
    path = file_of(kernel)
    where = f" of {path.name}" if path is not None else ""
    return ConfigurationError(
        f"numba cannot compile the kernel {kernel.__name__}(){where}: {_reason(str(error), path)}. "
        "Write it in plain arithmetic and math of floats that returns the tuple (f, df/dp_1, ..., "
        "df/dp_n), or make the model by Model.from_function, which takes any function of arrays.",
        value=kernel.__name__,
    )


def _reason(text: str, path: Path | None) -> str:
    """The first line of numba's text that tells something, with the line of the kernel's file."""
    lines = [line.strip() for line in text.replace(" Raised from None", "").splitlines()]
    telling = [line for line in lines if line and not line.startswith("Failed in ")]
    first = (telling[0] if telling else "no reason given").rstrip(".")[:LONGEST]
    file, sign, line = text.partition('File "')[2].partition('", line ')
    own = sign and path is not None and Path(file).name == path.name
    return f"{first} (line {int(line.partition(':')[0])})" if own else first
