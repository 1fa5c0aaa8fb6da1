"""exp, acos, sine and cosine that a compiler can vectorise: polynomials instead of calls into libm.

A call of libm in a compiled loop is a call for each element; written out as polynomials, with
selects in place of branches, the functions become SIMD code, several times faster. They are Python
functions that the interpreter runs too, except for `muladd` and `pow2`, whose compiled
twins are single instructions.

Two hooks serve `gonio.kernels.build.compiled`. `function.compiled_twin()` gives the compiled form
of a function that differs in machine code. `function.single_twin` replaces the function in single
precision: shorter polynomials, and the range that float32 has.
"""

from __future__ import annotations

import math
from typing import Any

_LOG2_E = 1.4426950408889634
# ln 2 in two parts: the first has zeros at its end, so that n times it is exact.
_LN2_HIGH = 6.93147180369123816490e-01
_LN2_LOW = 1.90821492927058770002e-10
_TWO_OVER_PI = 0.6366197723675814
_HALF_PI_1 = 1.57079632673412561417e00
_HALF_PI_2 = 6.07710050630396597660e-11
_HALF_PI_3 = 2.02226624879595063154e-21
_LN2_HIGH_SINGLE = 0.693359375
_LN2_LOW_SINGLE = -2.12194440e-4
# Numbers of this size have no digits behind the point: adding one rounds to a whole number. That
# is arithmetic, while the conversion to an integer is no SIMD instruction on most processors.
_ROUNDER = 1.5 * 2**52
_ROUNDER_SINGLE = 1.5 * 2**23


def muladd(a: float, b: float, c: float) -> float:
    """a b + c; in machine code one operation, rounded once.

    Examples
    --------
    >>> muladd(2.0, 3.0, 1.0)
    7.0
    """
    return a * b + c


def pow2(n: float) -> float:
    """2 to the power n, for whole n in [-1022, 1023]; in single precision in [-126, 127]."""
    return math.ldexp(1.0, int(n))


def exp(x: float) -> float:
    """e to the power x for x in [-708, 709]; constant beyond these ends.

    x = n ln 2 + r with |r| <= ln(2)/2, exp(r) by the polynomial of least maximum relative error
    there, 3e-18.

    Examples
    --------
    >>> abs(exp(-1.5) / math.exp(-1.5) - 1) < 4e-16
    True
    """
    x = min(max(x, -708.0), 709.0)
    n = muladd(x, _LOG2_E, _ROUNDER) - _ROUNDER
    r = muladd(-n, _LN2_LOW, muladd(-n, _LN2_HIGH, x))
    q = 2.4994327835277447e-08
    q = muladd(q, r, 2.763229359124913e-07)
    q = muladd(q, r, 2.755762243653946e-06)
    q = muladd(q, r, 2.4801486520299652e-05)
    q = muladd(q, r, 0.00019841269432820113)
    q = muladd(q, r, 0.001388888895122547)
    q = muladd(q, r, 0.008333333333559179)
    q = muladd(q, r, 0.04166666666649276)
    q = muladd(q, r, 0.1666666666666617)
    q = muladd(q, r, 0.5000000000000018)
    q = muladd(q, r, 1.0)
    q = muladd(q, r, 1.0)
    return q * pow2(n)


def _exp_single(x: float) -> float:
    """`exp` in single precision, for x in [-87, 88]; the polynomial's error is 2e-9."""
    x = min(max(x, -87.0), 88.0)
    n = muladd(x, _LOG2_E, _ROUNDER_SINGLE) - _ROUNDER_SINGLE
    r = muladd(-n, _LN2_LOW_SINGLE, muladd(-n, _LN2_HIGH_SINGLE, x))
    q = 0.00138368247
    q = muladd(q, r, 0.00837481636)
    q = muladd(q, r, 0.0416682261)
    q = muladd(q, r, 0.166664202)
    q = muladd(q, r, 0.499999921)
    q = muladd(q, r, 1.00000004)
    q = muladd(q, r, 1.0)
    return q * pow2(n)


def acos(z: float) -> float:
    """Arc cosine for z in [-1, 1], radians; 0 or pi beyond.

    Examples
    --------
    >>> abs(acos(0.3) / math.acos(0.3) - 1) < 4e-16
    True
    """
    theta = arcvers(max(1.0 - abs(z), 0.0))
    return theta if z >= 0.0 else math.pi - theta


def arcvers(w: float) -> float:
    """The angle from 0 to pi/2, radians, whose versine 1 - cos is w, for w in [0, 1].

    sqrt(w) P(w), P being the polynomial of least maximum relative error, 1.5e-17. With powers of
    w, not of the cosine, all important terms are positive; so a small angle is as exact as its
    versine.

    Examples
    --------
    >>> abs(arcvers(1e-20) / math.sqrt(2e-20) - 1) < 4e-16
    True
    """
    p = 5.006629240216513e-06
    p = muladd(p, w, -3.7254426056508195e-05)
    p = muladd(p, w, 0.00013196564710047366)
    p = muladd(p, w, -0.00028810484616562137)
    p = muladd(p, w, 0.0004332951987777609)
    p = muladd(p, w, -0.000469617812335962)
    p = muladd(p, w, 0.00038371210733598567)
    p = muladd(p, w, -0.0002291054497368492)
    p = muladd(p, w, 0.00012108530380758759)
    p = muladd(p, w, -1.199939149524242e-05)
    p = muladd(p, w, 7.427959847118854e-05)
    p = muladd(p, w, 0.00015220229217762974)
    p = muladd(p, w, 0.0003837480387378)
    p = muladd(p, w, 0.000988688442866549)
    p = muladd(p, w, 0.0026854119247711134)
    p = muladd(p, w, 0.00789181667025535)
    p = muladd(p, w, 0.02651650429630761)
    p = muladd(p, w, 0.11785113019774245)
    p = muladd(p, w, 1.4142135623730951)
    return math.sqrt(w) * p


def _arcvers_single(w: float) -> float:
    """`arcvers` in single precision: seven powers of w leave 1.5e-8."""
    p = 0.0012534249
    p = muladd(p, w, -0.00213546729)
    p = muladd(p, w, 0.00353583221)
    p = muladd(p, w, 0.00134562804)
    p = muladd(p, w, 0.00826279478)
    p = muladd(p, w, 0.0264669187)
    p = muladd(p, w, 0.117853631)
    p = muladd(p, w, 1.41421354)
    return math.sqrt(w) * p


def sincos(x: float) -> tuple[float, float]:
    """Sine and cosine of an angle of up to 1e5 radians.

    x = n pi/2 + r with |r| <= pi/4, pi/2 in three parts of which n times the first two is exact;
    polynomials in r^2 (those of fdlibm, 2e-18), and the quadrant by selects.

    Examples
    --------
    >>> sine, cosine = sincos(2.0)
    >>> abs(sine - math.sin(2.0)) < 3e-16, abs(cosine - math.cos(2.0)) < 3e-16
    (True, True)
    """
    n = muladd(x, _TWO_OVER_PI, _ROUNDER) - _ROUNDER
    r = muladd(-n, _HALF_PI_3, muladd(-n, _HALF_PI_2, muladd(-n, _HALF_PI_1, x)))
    z = r * r
    p = 1.58969099521155010221e-10
    p = muladd(p, z, -2.50507602534068634195e-08)
    p = muladd(p, z, 2.75573137070700676789e-06)
    p = muladd(p, z, -1.98412698298579493134e-04)
    p = muladd(p, z, 8.33333333332248946124e-03)
    p = muladd(p, z, -1.66666666666666324348e-01)
    s = muladd(r * z, p, r)
    q = -1.13596475577881948265e-11
    q = muladd(q, z, 2.08757232129817482790e-09)
    q = muladd(q, z, -2.75573143513906633035e-07)
    q = muladd(q, z, 2.48015872894767294178e-05)
    q = muladd(q, z, -1.38888888888741095749e-03)
    q = muladd(q, z, 4.16666666666666019037e-02)
    c = muladd(z * z, q, muladd(-0.5, z, 1.0))
    # n modulo 4, in -2 to 2: a whole number plus the rounder loses what is behind the point.
    quadrant = muladd(-4.0, muladd(n, 0.25, _ROUNDER) - _ROUNDER, n)
    odd = abs(quadrant) == 1.0
    sine = c if odd else s
    cosine = s if odd else c
    return (
        sine * (-1.0 if (quadrant < 0.0) | (quadrant > 1.5) else 1.0),
        cosine * (-1.0 if (quadrant > 0.0) | (quadrant < -1.5) else 1.0),
    )


def _compiled_muladd() -> Any:
    from gonio.kernels import intrinsics

    return intrinsics.muladd


def _compiled_pow2() -> Any:
    from gonio.kernels import intrinsics

    return intrinsics.pow2


muladd.compiled_twin = _compiled_muladd  # type: ignore[attr-defined]
pow2.compiled_twin = _compiled_pow2  # type: ignore[attr-defined]
exp.single_twin = _exp_single  # type: ignore[attr-defined]
arcvers.single_twin = _arcvers_single  # type: ignore[attr-defined]
