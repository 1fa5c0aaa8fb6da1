"""Evaluation at directions that come again: what they alone say is kept (`gonio.kernels.split`).

`gonio.kernels.build` puts this text in front of those loops that evaluate a model at the same
directions with many parameters.
"""
# mypy: allow-untyped-defs, allow-untyped-calls

# HEADER ENDS


def keep_geometry(xi, yi, zi, xr, yr, zr, rows, lit):
    """What n direction pairs say to the model, (KEPT, n); whether all are above the horizon.

    Pairs at or below the horizon are taken at z = 1; lit (n,) is 0 for them and 1 for the others.
    """
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
    """f of n pairs, and its derivatives, as `evaluate_gradient` has them."""
    for k in range(out.shape[0]):
        both = shape(rows, k, q)
        out[k] = both[0]
        store(both, True, gradient, k)
    if not all_lit:
        for k in range(out.shape[0]):
            out[k] = out[k] if lit[k] > 0.0 else 0.0
            for j in range(gradient.shape[0]):
                gradient[j, k] = gradient[j, k] if lit[k] > 0.0 else 0.0


# STAND-INS


KEPT = 1  # numbers that are kept of a pair


def keep(kept, rows, k):
    """Keep what the directions of pair k say; replaced, one line a number."""
    rows[0, k] = kept[0]


def geometry(xi, yi, zi, xr, yr, zr):
    """Stands for the first part of a model's kernel."""
    return (zi,)


def shape(rows, k, q):
    """Stands for the second part of a model's kernel: (f, df/dp_0, ...)."""
    return (q[0], 1.0)


def store(both, above, gradient, k):
    """Derivatives of pair k; replaced, one line a parameter."""
    gradient[0, k] = both[1]
