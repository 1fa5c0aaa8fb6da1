"""Weighted sums of products over a block of samples, for the loops of all models.

Imported only where loops are compiled; it needs numba.
"""
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

from numba import njit

from gonio.kernels.generated import generated_module

# A sum over SIMD lanes is another order of additions, which only these flags allow. The order is
# that of the machine code, the same for every number of threads.
_SUMS = {"reassoc", "contract", "nsz"}
_HEADER = f"""from numba import njit

SUMS = {sorted(_SUMS)!r}
"""
# Rows for which all sums are made in one pass: those of more do not fit the registers.
_FUSED = range(2, 8)


def _fused(n: int) -> str:
    """Text of `products_n(columns, rows, weight, out)`: the sums of n rows in one pass."""
    columns = [f"    c_{a} = columns[rows[{a}]]" for a in range(n)]
    pairs = [(a, b) for a in range(n) for b in range(a + 1)]
    lines = [
        "",
        '@njit(nogil=True, cache=True, error_model="numpy", fastmath=set(SUMS))',
        f"def products_{n}(columns, rows, weight, out):",
        *columns,
        *(f"    s_{a}_{b} = 0.0" for a, b in pairs),
        "    for t in range(weight.shape[0]):",
    ]
    for a in range(n):
        lines += [f"        x_{a} = c_{a}[t]", f"        w_{a} = weight[t] * x_{a}"]
        lines += [f"        s_{a}_{b} += w_{a} * x_{b}" for b in range(a + 1)]
    lines += [f"    out[{a}, {b}] += s_{a}_{b}" for a, b in pairs]
    return "\n".join(lines) + "\n"


_module = generated_module("gonio_products", _HEADER + "\n".join(map(_fused, _FUSED)))
products = {n: getattr(_module, f"products_{n}") for n in _FUSED}  # compiled where they are used


def dispatch(sizes: tuple[int, ...]) -> str:
    """Text of an `add_products` that makes the sums of these numbers of rows in one pass.

    Every number costs compilation; the general `add_products`, as `any_products`, does the others.
    """
    chosen = sorted(set(sizes) & set(_FUSED))
    lines = ["from gonio.kernels.sums import add_products as any_products, products", ""]
    lines += [f"products_{n} = products[{n}]" for n in chosen]
    lines += ["", "", '@njit(nogil=True, error_model="numpy")']
    lines += ["def add_products(columns, rows, weight, work, out):", "    n = rows.shape[0]"]
    for n in chosen:
        lines += [f"    if n == {n}:", f"        products_{n}(columns, rows, weight, out)"]
        lines += ["        return"]
    lines += ["    any_products(columns, rows, weight, work, out)", ""]
    return "\n".join(lines)


@njit(nogil=True, error_model="numpy", fastmath=_SUMS)
def add_products(columns, rows, weight, work, out):
    """Add sum_t weight[t] columns[rows[a], t] columns[rows[b], t] to out[a, b], for b <= a."""
    n = weight.shape[0]
    for a in range(rows.shape[0]):
        left = columns[rows[a]]
        for t in range(n):
            work[t] = weight[t] * left[t]
        for b in range(a + 1):
            right = columns[rows[b]]
            total = 0.0
            for t in range(n):
                total += work[t] * right[t]
            out[a, b] += total


@njit(nogil=True, error_model="numpy")
def mirror(out):
    """Copy the lower triangle of each matrix out[k] to its upper one."""
    for k in range(out.shape[0]):
        for a in range(out.shape[1]):
            for b in range(a):
                out[k, b, a] = out[k, a, b]


@njit(nogil=True, error_model="numpy", fastmath=_SUMS)
def sum_of_squares(value, f, weight):
    """sum_t weight[t] (value[t] - f[t])^2."""
    total = 0.0
    for t in range(f.shape[0]):
        r = value[t] - f[t]
        total += weight[t] * r * r
    return total
