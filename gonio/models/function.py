"""A model from a plain function of numpy arrays, with derivatives that are found for it.

The function is asked for pairs of directions above the horizon, as one-dimensional arrays. Its
derivative by a parameter is the imaginary part of a complex step, exact to rounding, where the
function carries complex numbers through; otherwise it is a central difference, good to about ten
digits. Which it is is decided once, by trying both at the default parameters.
"""

from __future__ import annotations

import inspect
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from gonio.errors import ConfigurationError, DataError, GonioError
from gonio.geometry import Directions, FloatArray, angles
from gonio.kernels.arrays import ArrayKernel
from gonio.models.parameter import Parameter

Given = Sequence[str | Parameter] | Mapping[str, tuple[float, float, float]] | None

COMPLEX_STEP = 1e-20  # of the parameter's size: no difference is taken, so nothing is rounded off
STEP = float(np.finfo(float).eps ** (1 / 3))  # best for a central difference
_BY_NAME = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
AGREE = 1e-5  # of the largest derivative: what differences may be off by
# Pairs of directions at which a function is tried: anywhere, and about the mirror direction.
_THETA = np.linspace(0.05, 1.3, 12)
_TRIED = Directions(
    np.tile(_THETA, 2),
    0.0,
    np.concatenate([_THETA[::-1], _THETA + 0.02]),
    np.concatenate([np.linspace(0.1, 6.0, 12), np.full(12, np.pi + 0.01)]),
)


def array_kernel(
    function: Callable[..., Any], parameters: tuple[Parameter, ...], name: str
) -> ArrayKernel:
    """The kernel that a function makes, tried at its default parameters.

    Raises
    ------
    ConfigurationError
        If what the function returns there is not one real number for each pair.
    DataError
        If the function raises an exception there.
    """
    real = _Function(function, parameters, name, complex_step=False)
    w_i, w_r = _TRIED.vectors()
    p = np.array([q.default for q in parameters])
    f = real.values(w_i, w_r, p)
    if not np.all(np.isfinite(f)):
        raise ConfigurationError(
            f"{name}: the function gives {int(np.sum(~np.isfinite(f)))} values of {len(f)} that "
            "are no finite numbers at the default parameters; give defaults at which it is finite "
            "for all directions above the horizon.",
            value=name,
        )
    by_differences = real.gradient(w_i, w_r, p)[1]
    exact = _Function(function, parameters, name, complex_step=True)
    complex_step = _agree(exact, w_i, w_r, p, by_differences)
    chosen = exact if complex_step else real
    how = (
        "by a complex step"
        if complex_step
        else "by differences, because the function does not carry complex numbers through"
    )
    return ArrayKernel(
        function,
        chosen.values,
        chosen.gradient,
        len(parameters),
        f"{name} is a function of arrays: its derivatives are found {how}, and nothing of it is "
        "compiled; a scalar kernel with derivatives is many times quicker.",
    )


def _agree(
    exact: _Function, w_i: FloatArray, w_r: FloatArray, p: FloatArray, differences: FloatArray
) -> bool:
    """Whether complex steps give the derivatives that differences give."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # numpy warns if an imaginary part is discarded
            f, jac = exact.gradient(w_i, w_r, p)
    except Exception:  # whatever a function that takes no complex numbers raises
        return False
    scale = np.abs(differences).max(axis=0) + 1e-300
    return bool(np.isfinite(f).all() and np.all(np.abs(jac - differences) <= AGREE * scale))


@dataclass(frozen=True, eq=False)
class _Function:
    """A function of arrays and its derivatives, by unit vectors and a parameter vector."""

    function: Callable[..., Any]
    parameters: tuple[Parameter, ...]
    name: str
    complex_step: bool

    def values(self, w_i: FloatArray, w_r: FloatArray, p: FloatArray) -> FloatArray:
        """f (n,) of pairs above the horizon."""
        return self._real(self._called(_directions(w_i, w_r), p))

    def gradient(
        self, w_i: FloatArray, w_r: FloatArray, p: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """f (n,) and its derivatives (n, parameters)."""
        where = _directions(w_i, w_r)
        f = self._real(self._called(where, p))
        columns = [self._derivative(where, p, j, f) for j in range(len(p))]
        return f, np.stack(columns, axis=1) if columns else np.empty((len(f), 0))

    def _derivative(self, where: Directions, p: FloatArray, j: int, f: FloatArray) -> FloatArray:
        if self.complex_step:
            h = COMPLEX_STEP * max(abs(float(p[j])), 1.0)
            moved = p.astype(complex)
            moved[j] += 1j * h
            return np.asarray(np.imag(self._called(where, moved)) / h)
        q = self.parameters[j]
        h = STEP * max(abs(float(p[j])), 0.1 * min(q.upper - q.lower, 1.0))

        def at(value: float) -> FloatArray:
            moved = p.copy()
            moved[j] = value
            return self._real(self._called(where, moved))

        low, high = p[j] - h, p[j] + h
        if q.lower <= low and high <= q.upper:
            return np.asarray((at(high) - at(low)) / (high - low))
        # At a bound: a parabola through this point and two on the inner side.
        h = h if high <= q.upper else -h
        return np.asarray((4 * at(p[j] + h) - at(p[j] + 2 * h) - 3 * f) / (2 * h))

    def _called(self, where: Directions, p: Any) -> Any:
        """What the function returns, one number for each pair."""
        named = {q.name: value for q, value in zip(self.parameters, p.tolist(), strict=True)}
        try:
            values = np.asarray(self.function(where, **named))
        except GonioError:
            raise
        except Exception as error:  # whatever the function of a user raises
            raise DataError(
                f"{self.name}: the function raises {type(error).__name__}: {error}{_line(error)}. "
                "It is called with gonio.Directions, arrays of theta_i, phi_i, theta_r and phi_r "
                "in radians, and with its parameters by name.",
                value=named,
            ) from error
        if values.shape == ():
            values = np.broadcast_to(values, where.shape)
        if values.shape != where.shape:
            raise ConfigurationError(
                f"{self.name}: the function returns an array of shape {values.shape} for "
                f"{where.shape[0]} pairs of directions; it must return one value for each pair.",
                value=values.shape,
            )
        return values

    def _real(self, values: Any) -> FloatArray:
        if values.dtype.kind not in "fiu":
            raise ConfigurationError(
                f"{self.name}: the function returns {values.dtype} for real parameters; it must "
                "return real numbers, f in sr^-1.",
                value=str(values.dtype),
            )
        return np.asarray(values, float)


def _line(error: BaseException) -> str:
    """Where an error was raised, if in a file of lines."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f" (line {last.lineno} of {last.filename})"


class _WithVectors(Directions):
    """Directions that keep their unit vectors: each derivative asks for the same ones again."""

    @cached_property
    def _vectors(self) -> tuple[FloatArray, FloatArray]:
        return super().vectors()

    def vectors(self) -> tuple[FloatArray, FloatArray]:
        return self._vectors


def _directions(w_i: FloatArray, w_r: FloatArray) -> Directions:
    """Pairs of unit vectors as the angles that the function takes."""
    (theta_i, phi_i), (theta_r, phi_r) = angles(w_i), angles(w_r)
    return _WithVectors(theta_i, phi_i, theta_r, phi_r)


def declared(function: Callable[..., Any], given: Given) -> tuple[Parameter, ...]:
    """Parameter records from what the caller gave, or from the function's signature.

    Raises
    ------
    ConfigurationError
        If a range or a default cannot be used, or the function does not take a parameter.
    """
    taken = _signature(function)
    records = _records(function, given, taken)
    _check_names(function, [q.name for q in records])
    return records


def _records(
    function: Callable[..., Any], given: Given, taken: Mapping[str, Any]
) -> tuple[Parameter, ...]:
    """The records, whatever the function takes."""
    if given is None:
        given = list(taken)
    if isinstance(given, str):
        given = [word.strip() for word in given.split(",")]
    if isinstance(given, Mapping):
        return tuple(_ranged(name, value) for name, value in given.items())
    if not given:
        raise ConfigurationError(
            f"{function!r} takes no parameters by name; give parameters=[...], the names with "
            "which it is called after the directions.",
            value=function,
        )
    return tuple(
        each if isinstance(each, Parameter) else _named(each, taken.get(each)) for each in given
    )


def _check_names(function: Callable[..., Any], names: Sequence[str]) -> None:
    """Refuse parameters that the function does not take, and arguments that nothing sets."""
    try:
        arguments = list(inspect.signature(function).parameters.values())[1:]
    except (TypeError, ValueError):
        return
    called = getattr(function, "__name__", "the function")
    own = [q.name for q in arguments if q.kind in _BY_NAME]
    extra = [] if any(q.kind is q.VAR_KEYWORD for q in arguments) else set(names) - set(own)
    missing = {q.name for q in arguments if q.kind in _BY_NAME and q.default is q.empty}
    missing -= set(names)
    if extra or missing:
        wrong = f"takes no {' and no '.join(sorted(extra))}" if extra else ""
        lacking = f"needs {' and '.join(sorted(missing))}" if missing else ""
        raise ConfigurationError(
            f"{called} {' and '.join(filter(None, [wrong, lacking]))}; its arguments after the "
            f"directions are {', '.join(own) or 'none'}, and the parameters given are "
            f"{', '.join(names)}. Give the parameters the names of the arguments.",
            value=list(names),
        )


def _signature(function: Callable[..., Any]) -> dict[str, Any]:
    """Names that a function takes after the directions, with their defaults."""
    try:
        arguments = list(inspect.signature(function).parameters.values())[1:]
    except (TypeError, ValueError):
        return {}
    return {q.name: q.default for q in arguments if q.kind in _BY_NAME}


def _ranged(name: str, value: Any) -> Parameter:
    try:
        default, lower, upper = (float(number) for number in value)
    except (TypeError, ValueError):
        raise ConfigurationError(
            f"parameter {name}: {value!r} is not (default, lower, upper), three numbers.",
            value=value,
        ) from None
    if not lower <= default <= upper or not lower < upper:
        raise ConfigurationError(
            f"parameter {name}: (default, lower, upper) = ({default:g}, {lower:g}, {upper:g}) is "
            "not in order; lower <= default <= upper is wanted.",
            value=value,
        )
    return Parameter(name, name, name, default, lower, upper)


def _named(name: str, default: Any) -> Parameter:
    """A parameter of which only the name is given: 0 to 1, from the function's default or 0.5."""
    number = default if isinstance(default, int | float) else 0.5
    if not 0 <= number <= 1:
        raise ConfigurationError(
            f"parameter {name} has the default {number:g}, and a name alone means the range 0 to "
            f"1; give parameters={{{name!r}: (default, lower, upper)}}.",
            value=number,
        )
    return Parameter(name, name, name, float(number), 0.0, 1.0)
