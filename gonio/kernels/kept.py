"""Repeated evaluation at the same directions: their numbers are kept (`gonio.kernels.split`).

`kept_around` is a template (`gonio.kernels.template`) in front of the loops that
evaluate a model at the same directions with many parameters.
"""
# mypy: allow-untyped-defs, allow-untyped-calls

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Kept:
    """The two loops, see `kept_around`."""

    keep_geometry: Callable[..., bool]
    kept_gradient: Callable[..., None]


def kept_around(
    geometry: Callable[..., Any],
    keep: Callable[..., Any],
    shape: Callable[..., Any],
    store: Callable[..., Any],
) -> Kept:
    """Loops over the two parts of a model's kernel.

    Parameters
    ----------
    geometry : callable
        `geometry(xi, yi, zi, xr, yr, zr)`: n_kept numbers of the directions of a pair.
    keep : callable
        `keep(kept, rows, k)`: put these numbers into column k of `rows` (n_kept, n).
    shape : callable
        `shape(rows, k, q)`: (f, df/dp_0, ...) of column k with the parameters q.
    store : callable
        As for `gonio.kernels.pairs.pairs_around`.
    """

    def keep_geometry(s, first, last, rows, lit):
        """Numbers (n_kept, n) of the pairs first to last, and whether all are above the horizon.

        s (6, N) holds x, y, z of the directions of incidence, then of reflection. Pairs at or below
        the horizon are taken at z = 1; lit (n,) is 0 for them and 1 for the others.
        """
        xi, yi, zi = s[0, first:last], s[1, first:last], s[2, first:last]
        xr, yr, zr = s[3, first:last], s[4, first:last], s[5, first:last]
        count = 0.0
        for k in range(xi.shape[0]):
            above = zi[k] > 0.0 and zr[k] > 0.0
            a = zi[k] if above else 1.0
            b = zr[k] if above else 1.0
            keep(geometry(xi[k], yi[k], a, xr[k], yr[k], b), rows, k)
            lit[k] = 1.0 if above else 0.0
            count += lit[k]
        return count == xi.shape[0]

    def kept_gradient(rows, lit, all_lit, q, out, gradient):
        """f of n pairs, and its derivatives, as in `evaluate_gradient`."""
        for k in range(out.shape[0]):
            both = shape(rows, k, q)
            out[k] = both[0]
            store(both, True, gradient, k)
        if not all_lit:
            for k in range(out.shape[0]):
                out[k] = out[k] if lit[k] > 0.0 else 0.0
                for j in range(gradient.shape[0]):
                    gradient[j, k] = gradient[j, k] if lit[k] > 0.0 else 0.0

    return Kept(
        keep_geometry=keep_geometry,
        kept_gradient=kept_gradient,
    )
