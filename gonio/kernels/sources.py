"""Source and identity of Python functions, on which a compiled kernel depends.

Source is read where Python has it: files, cells of a notebook, and whatever else `linecache`
holds. A function typed at a prompt or passed to `python -c` has none; its bytecode is
used then.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

from gonio.errors import ConfigurationError


def plain(function: Callable[..., Any]) -> FunctionType:
    """The Python function inside its decorators.

    Raises
    ------
    ConfigurationError
        If it is no Python function.
    """
    unwrapped = inspect.unwrap(getattr(function, "py_func", function))
    if not isinstance(unwrapped, FunctionType):
        raise ConfigurationError(
            f"the kernel {function!r} is no plain Python function; write it with def, of scalars "
            "and math, or give a function of arrays to Model.from_function.",
            value=function,
        )
    return unwrapped


def definition(function: FunctionType) -> ast.FunctionDef | None:
    """The `def` statement of a function; None where no source can be had."""
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    except (OSError, TypeError, SyntaxError):
        return None
    match tree.body:
        case [ast.FunctionDef(name=name) as node] if name == function.__name__:
            return node
    return None


def bound_names(function: FunctionType) -> dict[str, Any]:
    """The objects that the code of a function takes by name from its module or from a closure."""
    globals_ = {
        name: function.__globals__[name]
        for name in function.__code__.co_names
        if name in function.__globals__
    }
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    return globals_ | {name: cell.cell_contents for name, cell in cells}


def reached(function: Callable[..., Any]) -> list[FunctionType]:
    """The function and all Python functions that it calls by name, directly or indirectly."""
    functions = [plain(function)]
    for caller in functions:
        for callee in bound_names(caller).values():
            if is_python(callee) and plain(callee) not in functions:
                functions.append(plain(callee))
    return functions


def is_python(value: object) -> bool:
    """Whether this is a Python function, or one that numba has compiled already."""
    return isinstance(value, FunctionType) or isinstance(
        getattr(value, "py_func", None), FunctionType
    )


def importable(function: FunctionType) -> bool:
    """Whether the function lives in the file of an imported module, which can be hashed."""
    name = function.__module__
    return name != "__main__" and file_of(function) is not None


@cache
def file_of(function: FunctionType) -> Path | None:
    """The file of an imported module in which a function is defined."""
    try:
        path = Path(inspect.getsourcefile(function) or "")
    except TypeError:
        return None
    return path if path.is_file() else None


def ingredients(functions: list[FunctionType]) -> tuple[list[str], bool]:
    """Texts on which the code of functions depends, and whether they are complete.

    A file is read whole. A function without a file gives its source, or its bytecode, and the
    constants that it uses.
    """
    files = sorted({file_of(f) for f in functions if importable(f)} - {None})  # type: ignore[type-var]
    read = [path.read_text(encoding="utf-8") for path in files]  # type: ignore[union-attr]
    complete = True
    for function in functions:
        if importable(function):
            continue
        node = definition(function)
        read.append(ast.dump(node) if node is not None else "".join(_bytecode(function.__code__)))
        for name, value in sorted(bound_names(function).items()):
            text = _constant(value)
            complete &= text is not None
            read.append(f"{name} = {text}")
        read.append(repr(function.__defaults__))
    return read, complete


def _bytecode(code: CodeType) -> Iterator[str]:
    """The instructions and constants of a function that has no source."""
    yield code.co_code.hex()
    yield repr((code.co_names, code.co_varnames, code.co_freevars))
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _bytecode(constant)
        else:
            yield repr(constant)


def _constant(value: object) -> str | None:
    """A text that differs between values; None for a value without one."""
    if isinstance(value, ModuleType):
        return value.__name__
    if is_python(value):
        return "function"  # its own ingredients are read too
    if isinstance(value, (type, BuiltinFunctionType, np.ufunc)):
        return f"{getattr(value, '__module__', '')}.{value.__name__}"
    if isinstance(value, np.ndarray) and value.dtype.kind in "biufc":
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, tuple):
        parts = [_constant(item) for item in value]
        return None if None in parts else f"({', '.join(map(str, parts))})"
    if value is None or isinstance(value, (bool, int, float, complex, str, np.generic)):
        return repr(value)
    return None
