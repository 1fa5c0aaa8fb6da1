"""A kernel in two parts: one of the directions alone, one of the parameters and its results.

Loops that evaluate a model at the same directions again and again, for a grid of starts, a batch of
walkers or the steps of a small fit, compute square roots and angles of directions once. The split
is made from the kernel's source: a statement that holds no parameter goes into the first part, and
so does the largest such term of any other statement. The results are those of the kernel to the
last bit, because the same operations act on the same numbers.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import dataclass
from types import FunctionType
from typing import Any

from gonio.kernels.sources import definition, plain

DIRECTIONS = 6  # leading arguments of a kernel
MOST = 8  # largest count of numbers to keep for a pair of directions


@dataclass(frozen=True)
class Split:
    """Two functions that together are a kernel.

    Parameters
    ----------
    geometry : callable
        Of the six direction cosines; returns a tuple of `n` numbers.
    shape : callable
        Of these numbers and the parameters; returns the kernel's result.
    n : int
    """

    geometry: Callable[..., Any]
    shape: Callable[..., Any]
    n: int


def split(kernel: Callable[..., Any]) -> Split:
    """Split a kernel.

    Parameters
    ----------
    kernel : callable
        Plain scalar Python. One that is more than assignments and a return, or whose source cannot
        be read, stays whole: the first part then returns the directions.

    Returns
    -------
    Split

    Examples
    --------
    >>> parts = split(_example)
    >>> parts.n, parts.geometry(0.3, 0, 0.8, -0.3, 0, 0.6)
    (1, (1.4,))
    >>> parts.shape(1.4, 0.5) == _example(0.3, 0, 0.8, -0.3, 0, 0.6, 0.5)
    True
    """
    function = plain(kernel)
    node = definition(function)
    if node is None or function.__closure__ or function.__defaults__:
        return _whole(function)
    names = [argument.arg for argument in node.args.args]
    parts = _Parts(names[:DIRECTIONS], names[DIRECTIONS:])
    body = node.body[1:] if ast.get_docstring(node) is not None else node.body
    if not all(map(parts.add, body)) or not 0 < len(parts.kept) <= MOST:
        return _whole(function)
    geometry = _function(parts.geometry(), function, "geometry")
    shape = _function(parts.shape(), function, "shape")
    return Split(geometry, shape, len(parts.kept))


def _whole(function: FunctionType) -> Split:
    """A kernel that stays whole: the first part returns the directions."""
    names = list(function.__code__.co_varnames[:DIRECTIONS])
    whole = _Parts(names, [])
    whole.kept = names
    return Split(_function(whole.geometry(), function, "geometry"), function, DIRECTIONS)


class _Parts(ast.NodeTransformer):
    """Statements of a kernel, sorted by whether a parameter takes part in them."""

    def __init__(self, directions: list[str], parameters: list[str]) -> None:
        self.directions, self.parameters = directions, parameters
        self.fixed = set(directions)
        self.bound = {name: name for name in directions + parameters}
        self.first: list[ast.stmt] = []
        self.second: list[ast.stmt] = []
        self.terms: dict[str, str] = {}
        self.kept: list[str] = []

    def add(self, statement: ast.stmt) -> bool:
        """Add a statement to its part; False for a kind of statement that cannot be split."""
        match statement:
            case ast.Assign(targets=[ast.Name() | ast.Tuple() as target], value=value):
                self._bind(target, self._renamed(value))
            case ast.AugAssign(target=ast.Name(id=name) as target, op=op, value=value):
                self._bind(target, self._renamed(ast.BinOp(ast.Name(name, ast.Load()), op, value)))
            case ast.Return(value=value) if value is not None:
                self.second.append(ast.Return(self.visit(self._renamed(value))))
            case _:
                return False
        return True

    def _renamed(self, value: ast.expr) -> ast.expr:
        """The expression with names as they are bound here: each is bound once."""
        for node in ast.walk(value):
            if isinstance(node, ast.Name) and node.id in self.bound:
                node.id = self.bound[node.id]
        return value

    def _bind(self, target: ast.expr, value: ast.expr) -> None:
        fixed = self._is_fixed(value)
        value = value if fixed else self.visit(value)
        for node in ast.walk(target):
            if isinstance(node, ast.Name):
                new = node.id if node.id not in self.bound else f"{self.bound[node.id]}_"
                self.bound[node.id] = node.id = new
                if fixed:
                    self.fixed.add(new)
        (self.first if fixed else self.second).append(ast.Assign([target], value))

    def _locals(self, node: ast.AST) -> set[str]:
        names = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
        return names & (self.fixed | set(self.bound.values()))

    def _is_fixed(self, node: ast.expr) -> bool:
        return self._locals(node) <= self.fixed

    def visit(self, node: ast.AST) -> Any:
        """An expression with parameters, in which kept numbers replace terms without them."""
        if isinstance(node, ast.expr) and self._locals(node) and self._is_fixed(node):
            if isinstance(node, ast.Name):
                name = node.id
            else:
                text = ast.unparse(node)
                name = self.terms.setdefault(text, f"term_{len(self.terms)}")
                self.first.append(ast.Assign([ast.Name(name, ast.Store())], node))
            if name not in self.kept:
                self.kept.append(name)
            return ast.Name(name, ast.Load())
        return self.generic_visit(node)

    def geometry(self) -> ast.FunctionDef:
        """The first part."""
        elements: list[ast.expr] = [ast.Name(name, ast.Load()) for name in self.kept]
        result = ast.Return(ast.Tuple(elements, ast.Load()))
        return _definition("geometry", self.directions, [*self.first, result])

    def shape(self) -> ast.FunctionDef:
        """The second part."""
        return _definition("shape", self.kept + self.parameters, self.second)


def _definition(name: str, arguments: list[str], body: list[ast.stmt]) -> ast.FunctionDef:
    tree = ast.parse(f"def {name}({', '.join(arguments)}): pass")
    (definition,) = tree.body
    assert isinstance(definition, ast.FunctionDef)
    definition.body = body
    return definition


def _function(definition: ast.FunctionDef, source: FunctionType, name: str) -> FunctionType:
    """The function that a definition gives in the module of another function."""
    module = ast.fix_missing_locations(ast.Module([definition], []))
    names = dict(source.__globals__)
    exec(compile(module, f"<{name} of {source.__qualname__}>", "exec"), names)
    result = names[name]
    assert isinstance(result, FunctionType)
    return result


def _example(
    xi: float, yi: float, zi: float, xr: float, yr: float, zr: float, rho: float
) -> tuple[float, float]:
    return rho * (zi + zr), zi + zr
