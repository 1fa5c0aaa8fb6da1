"""How compiled loops are written: the contract between templates and the files made of them.

A template is a plain Python function:

    def doubled(call, n_p):                   # names that each generated file binds anew
        '''What the parameters stand for.'''

        def evaluate(x, p, out):              # inner functions: what numba compiles
            ...

        return Loops(evaluate=evaluate)       # the record that callers get

Called as it stands, with plain functions, it gives plain functions that the interpreter runs and a
debugger follows. `module_text` writes its inner functions to the top level of a generated file,
behind the text that defines the template's parameters for one model. Nothing is replaced in them.

1. The body of a template is a docstring, inner functions and one return of a record by keywords.
2. Every parameter is a name that the text above it in the generated file defines.
3. An inner function uses its own names, the parameters, its siblings, builtins, and such names of
   the template's module as are numbers or modules.
4. Its only decorator may be `any_order`: its sums may be taken in any order, as SIMD code does.

A template that breaks a rule is refused; the message names the template and the rule.
"""

from __future__ import annotations

import ast
import builtins
import dis
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from types import CodeType, FunctionType, MappingProxyType, ModuleType, SimpleNamespace
from typing import Any, TypeVar

DECORATOR = '@njit(cache=True, nogil=True, error_model="numpy")\n'
_ANY_ORDER = (
    '@njit(cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})\n'
)

Function = TypeVar("Function", bound=Callable[..., Any])


def any_order(function: Function) -> Function:
    """Mark an inner function of a template: its sums may be taken in any order."""
    return function


@dataclass(frozen=True)
class Template:
    """A template that follows the rules, read once.

    Parameters
    ----------
    name : str
    parameters : tuple of str
        Names that a generated file must define above it.
    functions : mapping of str to str
        Text of each inner function, without indentation and decorator.
    any_order : frozenset of str
        Those of them whose sums may be taken in any order.
    constants : mapping of str to str
        Line that defines each name of the template's module that they use.
    """

    name: str
    parameters: tuple[str, ...]
    functions: Mapping[str, str]
    any_order: frozenset[str]
    constants: Mapping[str, str]

    def text(self, above: str) -> str:
        """The inner functions with their decorators, for a file that begins with `above`."""
        missing = set(self.parameters) - _defined(above)
        if missing:
            raise self.broken(2, f"nothing above defines {', '.join(sorted(missing))}")
        decorated = (
            (_ANY_ORDER if name in self.any_order else DECORATOR) + text
            for name, text in self.functions.items()
        )
        return self.header() + "\n\n\n" + "\n\n\n".join(decorated) + "\n"

    def header(self) -> str:
        """The lines that define what the functions take from the template's module."""
        return "\n".join(self.constants.values())

    def broken(self, rule: int, problem: str) -> ValueError:
        """The error of a template that breaks a rule."""
        return ValueError(
            f"template {self.name}: {problem}; rule {rule} of gonio.kernels.template."
        )


def module_text(*pieces: str | Callable[..., Any]) -> str:
    """Text of a generated file: texts as they are, templates by their inner functions.

    Raises
    ------
    ValueError
        If a template breaks a rule, or a parameter of it is not defined above it.

    Examples
    --------
    >>> print(module_text("from numba import njit\\nn_p = 2\\n", _example))
    from numba import njit
    n_p = 2
    <BLANKLINE>
    STEP = 0.5
    <BLANKLINE>
    <BLANKLINE>
    @njit(cache=True, nogil=True, error_model="numpy")
    def shifted(x):  # type: ignore[no-untyped-def]
        return x + n_p * STEP
    <BLANKLINE>
    """
    text = ""
    for piece in pieces:
        text += piece if isinstance(piece, str) else "\n" + read(piece).text(text)
    return text


@cache
def read(template: Callable[..., Any]) -> Template:
    """Read a template and check the rules.

    Raises
    ------
    ValueError
        If it breaks one.
    """
    assert isinstance(template, FunctionType)
    source = inspect.getsource(template)
    (definition,) = ast.parse(source).body
    assert isinstance(definition, ast.FunctionDef)
    parameters = tuple(a.arg for a in [*definition.args.args, *definition.args.kwonlyargs])
    bare = Template(
        f"{template.__module__}.{template.__name__}",
        parameters,
        MappingProxyType({}),
        frozenset(),
        MappingProxyType({}),
    )
    inner = list(_inner(definition, bare))
    marked = {node.name for node in inner if _marked(node, bare)}
    return Template(
        bare.name,
        parameters,
        {node.name: _lines(source, node) for node in inner},
        frozenset(marked),
        dict(_constants(template, bare)),
    )


def _inner(definition: ast.FunctionDef, template: Template) -> Iterator[ast.FunctionDef]:
    """The inner functions, of a body that holds nothing else but a docstring and a return."""
    body = definition.body[1:] if ast.get_docstring(definition) is not None else definition.body
    for statement in body[:-1]:
        if not isinstance(statement, ast.FunctionDef):
            line = ast.unparse(statement).splitlines()[0]
            raise template.broken(1, f"{line!r} is neither an inner function nor the last return")
        yield statement
    if not (
        isinstance(body[-1], ast.Return)
        and isinstance(body[-1].value, ast.Call)
        and not body[-1].value.args
    ):
        raise template.broken(1, "it does not end in the return of a record by keywords")


def _marked(node: ast.FunctionDef, template: Template) -> bool:
    """Whether an inner function has the one decorator that is allowed."""
    names = [ast.unparse(decorator) for decorator in node.decorator_list]
    if names not in ([], [any_order.__name__]):
        raise template.broken(4, f"{node.name} is decorated by {', '.join(names)}")
    return bool(names)


def _lines(source: str, node: ast.FunctionDef) -> str:
    """Text of an inner function as it stands in the source, moved to the left margin."""
    lines = source.splitlines()[node.lineno - 1 : node.end_lineno]
    return "\n".join(line[node.col_offset :] for line in lines)


def _constants(template: FunctionType, found: Template) -> Iterator[tuple[str, str]]:
    """Names that the inner functions take from the module of the template, and their lines."""
    for name in sorted({name for code in _codes(template.__code__) for name in _globals(code)}):
        value = template.__globals__.get(name)
        if isinstance(value, ModuleType):
            yield name, f"import {value.__name__} as {name}"
        elif type(value) in (int, float):
            yield name, f"{name} = {value!r}"
        elif name in template.__globals__ or not hasattr(builtins, name):
            raise found.broken(3, f"{name} is no parameter, no number and no module")


def _codes(outer: CodeType) -> Iterator[CodeType]:
    """The code of all functions inside one."""
    for constant in outer.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from _codes(constant)


def _globals(code: CodeType) -> set[str]:
    return {i.argval for i in dis.get_instructions(code) if i.opname == "LOAD_GLOBAL"}


def _defined(text: str) -> set[str]:
    """The names that stand at the top level of a text."""
    names: set[str] = set()
    for node in ast.parse(text).body:
        match node:
            case ast.FunctionDef(name=name):
                names.add(name)
            case ast.Import(names=aliases) | ast.ImportFrom(names=aliases):
                names |= {a.asname or a.name for a in aliases}
            case ast.Assign(targets=targets):
                parts = (n for target in targets for n in ast.walk(target))
                names |= {n.id for n in parts if isinstance(n, ast.Name)}
    return names


STEP = 0.5


def _example(n_p: int) -> SimpleNamespace:
    """The example of `module_text`."""

    def shifted(x):  # type: ignore[no-untyped-def]
        return x + n_p * STEP

    return SimpleNamespace(shifted=shifted)
