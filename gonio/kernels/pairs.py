"""f of many direction pairs, and its derivatives, for one parameter vector.

`pairs_around` is a template (`gonio.kernels.template`) in front of the loops that call it. The
loops hold no branch: a pair at or below the horizon is evaluated at z = 1 and its value replaced
by 0.
"""
# mypy: allow-untyped-defs, allow-untyped-calls

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class PairLoops:
    """The two loops, see `pairs_around`."""

    evaluate: Callable[..., None]
    evaluate_gradient: Callable[..., None]


def pairs_around(
    unpack: Callable[..., Any], call: Callable[..., Any], store: Callable[..., Any]
) -> PairLoops:
    """The loops around one model.

    Parameters
    ----------
    unpack : callable
        `unpack(p)`: the parameter vector as a tuple of scalars, for `call`.
    call : callable
        `call(xi, yi, zi, xr, yr, zr, q)`: the model's kernel, (f, df/dp_0, ...).
    store : callable
        `store(both, above, gradient, k)`: put the derivatives of pair k into its column, 0 where
        it is not above the horizon. It keeps those by all parameters, or by some.
    """

    def evaluate(xi, yi, zi, xr, yr, zr, p, out):
        """f of n direction pairs, given by their components."""
        q = unpack(p)
        for k in range(out.shape[0]):
            above = zi[k] > 0.0 and zr[k] > 0.0
            a = zi[k] if above else 1.0
            b = zr[k] if above else 1.0
            f = call(xi[k], yi[k], a, xr[k], yr[k], b, q)[0]
            out[k] = f if above else 0.0

    def evaluate_gradient(xi, yi, zi, xr, yr, zr, p, out, gradient):
        """f, and its derivative by every parameter that `store` keeps, (parameters, n)."""
        q = unpack(p)
        for k in range(out.shape[0]):
            above = zi[k] > 0.0 and zr[k] > 0.0
            a = zi[k] if above else 1.0
            b = zr[k] if above else 1.0
            both = call(xi[k], yi[k], a, xr[k], yr[k], b, q)
            out[k] = both[0] if above else 0.0
            store(both, above, gradient, k)

    return PairLoops(evaluate=evaluate, evaluate_gradient=evaluate_gradient)
