"""The loops that are compiled around each model's scalar kernel.

`gonio.kernels.build` copies this text behind a header that binds `call` to one model's kernel and
compiles it with numba; here `call` is a constant surface, so that the file can be read, checked
and run as it stands. All loops release the GIL, write to slices of their outputs and keep no
state: threads may run them on disjoint slices, and the result does not depend on how many do.

Directions are unit vectors (..., 3) in the frame of the sample, `w_i` towards the light and `w_r`
towards the viewer; `p` is the parameter vector; f is in sr^-1 and 0 at or below the horizon.
"""
# mypy: allow-untyped-defs, allow-untyped-calls
# HEADER ENDS


def evaluate(w_i, w_r, p, out):
    """f of n direction pairs."""
    for k in range(out.shape[0]):
        if w_i[k, 2] > 0.0 and w_r[k, 2] > 0.0:
            out[k] = call(w_i[k, 0], w_i[k, 1], w_i[k, 2], w_r[k, 0], w_r[k, 1], w_r[k, 2], p)[0]
        else:
            out[k] = 0.0


def evaluate_gradient(w_i, w_r, p, out, gradient):
    """f and its derivative by every parameter for n direction pairs, in one pass."""
    for k in range(out.shape[0]):
        out[k] = 0.0
        gradient[k, :] = 0.0
        if w_i[k, 2] > 0.0 and w_r[k, 2] > 0.0:
            both = call(w_i[k, 0], w_i[k, 1], w_i[k, 2], w_r[k, 0], w_r[k, 1], w_r[k, 2], p)
            out[k] = both[0]
            for j in range(gradient.shape[1]):
                gradient[k, j] = both[j + 1]


def cell_values(w_i, w_r, weight, offsets, first, p, out):
    """f integrated over cells: sample `first + k` owns the members offsets[k] to offsets[k + 1]."""
    for k in range(out.shape[0]):
        s = first + k
        total = 0.0
        if w_i[s, 2] > 0.0:
            for m in range(offsets[s], offsets[s + 1]):
                if w_r[m, 2] > 0.0:
                    f = call(w_i[s, 0], w_i[s, 1], w_i[s, 2], w_r[m, 0], w_r[m, 1], w_r[m, 2], p)
                    total += weight[m] * f[0]
        out[k] = total


def cell_gradient(w_i, w_r, weight, offsets, first, p, out, gradient):
    """`cell_values` and the derivative by every parameter, in one pass."""
    for k in range(out.shape[0]):
        s = first + k
        total = 0.0
        gradient[k, :] = 0.0
        if w_i[s, 2] > 0.0:
            for m in range(offsets[s], offsets[s + 1]):
                if w_r[m, 2] > 0.0:
                    both = call(w_i[s, 0], w_i[s, 1], w_i[s, 2], w_r[m, 0], w_r[m, 1], w_r[m, 2], p)
                    total += weight[m] * both[0]
                    for j in range(gradient.shape[1]):
                        gradient[k, j] += weight[m] * both[j + 1]
        out[k] = total


def batch_chi2(w_i, w_r, factor, mode, value, inverse_variance, batch, out):
    """Sum of squared weighted residuals for each parameter vector of a batch.

    One direction a sample; factor[k, 0] + factor[k, 1:] (p - mode) turns f there into f integrated
    over the sample's cell.
    """
    out[:] = 0.0
    for k in range(value.shape[0]):
        above = w_i[k, 2] > 0.0 and w_r[k, 2] > 0.0
        for b in range(batch.shape[0]):
            f = 0.0
            if above:
                f = call(
                    w_i[k, 0], w_i[k, 1], w_i[k, 2], w_r[k, 0], w_r[k, 1], w_r[k, 2], batch[b]
                )[0]
            integrate = factor[k, 0]
            for j in range(mode.shape[0]):
                integrate += factor[k, j + 1] * (batch[b, j] - mode[j])
            r = value[k] - integrate * f
            out[b] += r * r * inverse_variance[k]


def image(w_i, w_r, ray_weight, p, out):
    """f averaged over the rays of each pixel.

    Ray k of every pixel pairs the incident direction w_i[k] (a point of the lamp) with its own
    traced direction w_r[pixel, k]; `ray_weight` is 0 where the ray misses the lit sample.
    """
    for pixel in range(out.shape[0]):
        total = 0.0
        for k in range(w_i.shape[0]):
            g = ray_weight[pixel, k]
            if g > 0.0 and w_i[k, 2] > 0.0 and w_r[pixel, k, 2] > 0.0:
                xr, yr, zr = w_r[pixel, k, 0], w_r[pixel, k, 1], w_r[pixel, k, 2]
                total += g * call(w_i[k, 0], w_i[k, 1], w_i[k, 2], xr, yr, zr, p)[0]
        out[pixel] = total


def call(xi, yi, zi, xr, yr, zr, p):
    """Stands for a model's kernel: (f, df/dp_0, ...); replaced when the loops are compiled."""
    return (p[0], 1.0)
