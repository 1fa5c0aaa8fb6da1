"""Single precision from the source that is written for double: constants become float32.

numba computes float32 with a float64 constant, or with an integer, in float64. So a kernel is
read again from its file, and every number in it that takes part in real arithmetic is written as
`_float32(number)`: literals, `math.pi`, constants of the module, constant terms (folded in double
and rounded once), and whole numbers that meet real ones. Indices, ranges and whole powers stay.

What is a whole number is inferred from literals, `range`, `len`, `int`, shapes, and from
parameters and results that are annotated `int`; a name is one if all its values are.
"""

from __future__ import annotations

import ast
import inspect
import operator
import textwrap
from collections.abc import Iterator, Mapping
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

# Functions, or modules full of them, that single precision would ruin, and why. A kernel that
# calls one is computed in double, whatever the type of its directions, and f is rounded.
DOUBLE = {
    "gonio.models._vcavity": "where light and viewer nearly coincide, pieces of azimuth get lost "
    "between ends that are equal to rounding: f is up to 18 % off, derivatives are no numbers",
    "gonio.models.phong.kernel": "c^n: the rounding of c near 1, 6e-8, grows n times, to 6e-4 of "
    "the lobe at n = 10^4",
}

_NAMES: dict[str, Any] = {"_float32": np.float32, "_complex64": np.complex64}
_FOLDED = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


def must_be_double(function: FunctionType) -> bool:
    """Whether `DOUBLE` names this function."""
    return function.__module__ in DOUBLE or f"{function.__module__}.{function.__name__}" in DOUBLE


def in_single(function: FunctionType) -> FunctionType:
    """The function with its constants, and those of its module, as float32.

    Parameters
    ----------
    function : function
        Plain Python whose source can be read.

    Returns
    -------
    function
        To be compiled for float32 arguments; it then computes nothing in double.
    """
    names = {name: _rounded(value) for name, value in function.__globals__.items()} | _NAMES
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    (definition,) = tree.body
    assert isinstance(definition, ast.FunctionDef)
    tree.body = [_converted(definition, function.__globals__)]
    exec(compile(ast.fix_missing_locations(tree), f"<{function.__qualname__}>", "exec"), names)
    twin = names[function.__name__]
    assert isinstance(twin, FunctionType)
    return twin


def text_in_single(text: str, names: tuple[str, ...]) -> str:
    """The named functions of a module, in their order there, with their constants as float32."""
    definitions = [
        _converted(node, {})
        for node in ast.parse(text).body
        if isinstance(node, ast.FunctionDef) and node.name in names
    ]
    return (
        "\n\n\n".join(ast.unparse(ast.fix_missing_locations(node)) for node in definitions) + "\n"
    )


def _rounded(value: object) -> object:
    """A constant of a module, and those in tuples, as float32."""
    if isinstance(value, float):
        return np.float32(value)
    if type(value) is tuple:
        return tuple(_rounded(item) for item in value)
    return value


def _converted(definition: ast.FunctionDef, names: Mapping[str, Any]) -> ast.FunctionDef:
    converter = _Converter(definition, names)
    definition.body = [converter.visit(statement) for statement in definition.body]
    definition.decorator_list = []
    definition.returns = None
    for argument in definition.args.args:
        argument.annotation = None
    return definition


def _is_int(annotation: object) -> bool:
    return (annotation.id if isinstance(annotation, ast.Name) else annotation) in (int, "int")


def _all_int(value: object) -> bool:
    """Whether a constant of a module is a whole number, or a tuple of nothing else."""
    return all(map(_all_int, value)) if type(value) is tuple else type(value) is int


class _Whole:
    """Which expressions of a function are whole numbers."""

    def __init__(self, definition: ast.FunctionDef, names: Mapping[str, Any]) -> None:
        self.globals = names
        arguments = definition.args.args
        bindings = list(_bindings(definition))
        self.local = {a.arg for a in arguments} | {name for name, _ in bindings}
        self.names = {a.arg for a in arguments if _is_int(a.annotation)}
        self.names |= {name for name, _ in bindings} - {a.arg for a in arguments}
        # A name is whole until it is bound to something that is not.
        while lost := {name for name, value in bindings if not self(value)} & self.names:
            self.names -= lost

    def __call__(self, node: ast.expr | None) -> bool:
        match node:
            case ast.Constant(value=value):
                return type(value) is int
            case ast.Name(id=name) if name in self.local:
                return name in self.names
            case ast.Name(id=name):
                return _all_int(self.globals.get(name))
            case ast.UnaryOp(operand=operand) if not isinstance(node.op, ast.Not):
                return self(operand)
            case ast.BinOp(left=left, right=right) if not isinstance(node.op, ast.Div):
                return self(left) and self(right)
            case ast.IfExp(body=body, orelse=orelse):
                return self(body) and self(orelse)
            case ast.Subscript(value=ast.Attribute(attr="shape")):
                return True
            case ast.Subscript(value=value):
                return self(value)
            case ast.Call(func=ast.Name(id="range" | "len" | "int")):
                return True
            case ast.Call(func=ast.Attribute(attr="floor" | "ceil")):
                return True
            case ast.Call(func=ast.Name(id="min" | "max" | "abs"), args=arguments):
                return all(self(argument) for argument in arguments)
            case ast.Call(func=ast.Name(id=name)):
                function = self.globals.get(name)
                return isinstance(function, FunctionType) and _is_int(
                    function.__annotations__.get("return")
                )
            case ast.Tuple(elts=items):
                return all(self(item) for item in items)
        return False


def _bindings(definition: ast.FunctionDef) -> Iterator[tuple[str, ast.expr | None]]:
    """Every name that is bound in a function, with the expression, or None if it is a part."""
    for node in ast.walk(definition):
        match node:
            case ast.Assign(targets=targets, value=value):
                for target in targets:
                    yield from _bound(target, value)
            case ast.AnnAssign(target=target, value=value):
                yield from _bound(target, value)
            case ast.AugAssign(target=ast.Name(id=name) as target, op=op, value=value):
                yield name, ast.BinOp(ast.Name(name, ast.Load()), op, value)
            case ast.For(target=target, iter=source):
                yield from _bound(target, source)


def _bound(target: ast.expr, value: ast.expr | None) -> Iterator[tuple[str, ast.expr | None]]:
    match target, value:
        case ast.Name(id=name), _:
            yield name, value
        case ast.Tuple(elts=parts), ast.Tuple(elts=values) if len(parts) == len(values):
            for part, each in zip(parts, values, strict=True):
                yield from _bound(part, each)
        case ast.Tuple(elts=parts), _:
            for part in parts:
                yield from _bound(part, None)


class _Converter(ast.NodeTransformer):
    """Write the constants of a function as float32."""

    def __init__(self, definition: ast.FunctionDef, names: Mapping[str, Any]) -> None:
        self.whole = _Whole(definition, names)
        self.globals = names
        self.returns_int = "int" in ast.unparse(definition.returns or ast.Name("None"))

    def real(self, node: ast.expr) -> ast.expr:
        """The expression where a real number is needed."""
        if isinstance(node, ast.Tuple):
            node.elts = [self.real(item) for item in node.elts]
            return node
        value = self.value(node)
        if value is not None:
            return _call(value, ast.Constant(value))
        done: ast.expr = self.visit(node)
        return _call(0.0, done) if self.whole(node) else done

    def value(self, node: ast.expr) -> float | complex | None:
        """Value of a constant expression; None for any other."""
        match node:
            case ast.Constant(value=value):
                return _number(value)
            case ast.Name(id=name) if name not in self.whole.local:
                return _number(self.globals.get(name))
            case ast.Attribute(value=ast.Name(id=name), attr=attribute):
                module = None if name in self.whole.local else self.globals.get(name)
                constant = getattr(module, attribute, None) if type(module) is ModuleType else None
                return _number(constant)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                value = self.value(operand)
                return None if value is None else -value
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _FOLDED:
                pair = self.value(left), self.value(right)
                return None if None in pair else _FOLDED[type(op)](*pair)
        return None

    def visit(self, node: ast.AST) -> Any:
        if isinstance(node, ast.expr) and not self.whole(node):
            value = self.value(node)
            if value is not None:
                return _call(value, ast.Constant(value))
        return super().visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        if self.whole(node) or isinstance(node.left, ast.List):
            self.generic_visit(node)
        else:
            node.left = self.real(node.left)
            power = isinstance(node.op, ast.Pow) and self.whole(node.right)
            node.right = node.right if power else self.real(node.right)
        return node

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        sides = [node.left, *node.comparators]
        if all(self.whole(side) for side in sides):
            self.generic_visit(node)
        else:
            node.left, *node.comparators = (self.real(side) for side in sides)
        return node

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        if self.whole(node):
            self.generic_visit(node)
        else:
            node.test = self.visit(node.test)
            node.body, node.orelse = self.real(node.body), self.real(node.orelse)
        return node

    def visit_Call(self, node: ast.Call) -> ast.expr:
        name = node.func.id if isinstance(node.func, ast.Name) else None
        if name == "float":
            return self.real(node.args[0])
        if self.whole(node) or name not in {None, "min", "max", "abs", "complex", *self.globals}:
            self.generic_visit(node)
            return node
        whole = self.whole_parameters(node.func)
        node.func = self.visit(node.func)
        node.args = [
            self.visit(argument) if k in whole else self.real(argument)
            for k, argument in enumerate(node.args)
        ]
        for keyword in node.keywords:
            argument = keyword.value
            keyword.value = self.visit(argument) if keyword.arg in whole else self.real(argument)
        return node

    def whole_parameters(self, called: ast.expr) -> set[int | str | None]:
        """Positions and names of the parameters of a function that are annotated `int`."""
        function = self.globals.get(called.id) if isinstance(called, ast.Name) else None
        if not isinstance(function, FunctionType):
            return set()
        parameters = enumerate(inspect.signature(function).parameters.values())
        return {key for k, p in parameters if _is_int(p.annotation) for key in (k, p.name)}

    def visit_Tuple(self, node: ast.Tuple) -> ast.expr:
        if isinstance(node.ctx, ast.Load) and not self.whole(node):
            return self.real(node)
        return node

    def visit_Assign(self, node: ast.Assign) -> ast.stmt:
        node.value = self.assigned(node.targets[0], node.value)
        return node

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.stmt:
        power = isinstance(node.op, ast.Pow) and self.whole(node.value)
        if not power:
            node.value = self.assigned(node.target, node.value)
        return node

    def assigned(self, target: ast.expr, value: ast.expr) -> ast.expr:
        """A value for this target: a whole number stays one where the name is whole."""
        match target, value:
            case ast.Name(id=name), _ if name in self.whole.names:
                done: ast.expr = self.visit(value)
                return done
            case ast.Tuple(elts=parts), ast.Tuple(elts=values) if len(parts) == len(values):
                value.elts = [self.assigned(*each) for each in zip(parts, values, strict=True)]
                return value
        return self.real(value)

    def visit_Return(self, node: ast.Return) -> ast.stmt:
        if node.value is not None:
            node.value = self.visit(node.value) if self.returns_int else self.real(node.value)
        return node


def _number(value: object) -> float | complex | None:
    """The value if it is a number, and no truth value."""
    return value if type(value) in (int, float, complex) else None  # type: ignore[return-value]


def _call(value: float | complex, argument: ast.expr) -> ast.expr:
    name = "_complex64" if isinstance(value, complex) else "_float32"
    return ast.Call(ast.Name(name, ast.Load()), [argument], [])
