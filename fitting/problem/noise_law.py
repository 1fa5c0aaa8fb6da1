"""Stated noise that was computed from the readings themselves, such as 2 % of each.

A reading that is low by chance then has a small uncertainty and too much weight: a fit is biased by
about -2 r^2 of f where the noise is r f, and its residuals look like an error of the model. Where
u_brdf follows the readings, weights are taken from the same law at the fitted values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.geometry import FloatArray, golden_fractions

LEAST = 12  # samples from which a law can be told
EXPLAINS = 0.02  # rms deviation, beyond rounding, up to which a law is that of u_brdf
FAR = 0.1  # deviation of a reading at a floor or a limit
BETTER = 3.0  # times that the law in the readings fits better than the same law in f
NOTICEABLE = 0.003  # rms deviation of the law in f below which the two are the same
MOST_OUTSIDE = 0.1  # share of readings, at a floor or a limit, that may not follow the law
TINY = 1e-100  # sr^-1: values whose squares would vanish
SAME = 1e-4  # rms deviation below which laws are equally good
ROUNDS = 20  # in which the place of u within its rounding follows the law
TERMS = [[0], [2], [1], [0, 2], [0, 1], [1, 2], [0, 1, 2]]  # simplest laws first
FEW = 500  # samples of many in which a law is looked for before it is in all
FIRST = 64  # uncertainties that are looked at before all others
MOST_DIGITS = 4  # digits of u_brdf that are looked for; more are no rounding


@dataclass(frozen=True)
class NoiseLaw:
    """Variance of a reading whose expectation is f: constant + linear |f| + square f^2.

    Parameters
    ----------
    constant, linear, square : float
        Not negative; sr^-2, sr^-1 and 1.
    """

    constant: float
    linear: float
    square: float

    def variance(self, f: FloatArray) -> FloatArray:
        """Variance where expectations are f, (N,)."""
        f = np.abs(f)
        return np.asarray(self.constant + self.linear * f + self.square * f**2)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a JSON document."""
        return {**asdict(self), "text": self.text}

    @property
    def text(self) -> str:
        """The law in words.

        Examples
        --------
        >>> NoiseLaw(0.0, 0.0, 0.0004).text
        '2 % of each reading'
        """
        parts = []
        if self.square > 0:
            parts.append(f"{100 * self.square**0.5:.2g} % of each reading")
        if self.linear > 0:
            parts.append(f"{self.linear**0.5:.2g} times the root of each reading")
        if self.constant > 0:
            parts.append(f"{self.constant**0.5:.2g} sr^-1")
        return " and ".join(parts)


def laws_in_words(laws: Sequence[NoiseLaw | None]) -> list[str]:
    """A sentence where stated uncertainties follow the readings, of one part or more.

    Examples
    --------
    >>> print(laws_in_words([NoiseLaw(0.0, 0.0, 0.0004)])[0])
    u_brdf was computed from the readings (2 % of each reading), which would give low readings too much weight: the weights follow the fitted values.
    """  # noqa: E501
    known = [law for law in laws if law is not None]
    if not known:
        return []
    where = "" if len(laws) == 1 else f"in {len(known)} of {len(laws)} parts "
    first = "" if len(laws) == 1 else "first: "
    return [
        f"{where}u_brdf was computed from the readings ({first}{known[0].text}), which would give "
        "low readings too much weight: the weights follow the fitted values."
    ]


def noise_law(value: FloatArray, u: FloatArray, f: FloatArray) -> NoiseLaw | None:
    """The law by which the stated uncertainty was computed from the readings, or None.

    It is a non-negative fit of u^2 on 1, |y| and y^2. The readings it is that u follows where that
    law gives u to within 2 % beyond its rounding, and the same law in f gives it three times worse.

    Parameters
    ----------
    value, u, f : ndarray, shape (N,)
        Readings, stated uncertainties and fitted values.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> f = np.linspace(0.1, 1, 50)
    >>> y = f * (1 + 0.05 * rng.standard_normal(50))
    >>> noise_law(y, 0.05 * y, f).text
    '5 % of each reading'
    >>> noise_law(y, 0.05 * f, f) is None
    True
    """
    if len(value) < LEAST or not np.all(u > 0) or not np.any(value):
        return None
    if len(value) > 2 * FEW:
        some = (golden_fractions(FEW) * len(value)).astype(np.int64)
        if noise_law(value[some], u[some], f[some]) is None:
            return None
    quantum = rounding(u)
    # Of laws in f twice the best deviation is accepted: this one leaves no room for the readings.
    constant = np.ptp(u[:FIRST]) < EXPLAINS * u[0]
    simple = [[0], [2]] if constant else [[2], [0]]
    if any(_least_squares(f, u, quantum, terms)[1] < NOTICEABLE / 2 for terms in simple):
        return None
    law, by_reading = _fitted(value, u, quantum)
    _, by_model = _fitted(f, u, quantum)
    if by_reading > EXPLAINS or by_model < max(BETTER * by_reading, NOTICEABLE):
        return None
    return law if law.linear + law.square > 0 else None


def rounding(u: FloatArray) -> FloatArray:
    """Step in which each uncertainty was rounded, (N,): to digits or decimals; 0 where to neither.

    Examples
    --------
    >>> rounding(np.array([0.02, 0.3])).tolist(), rounding(np.array([0.021, 0.3])).tolist()
    ([0.01, 0.1], [0.001, 0.01])
    """
    first = u[:FIRST]
    largest = np.floor(np.log10(np.max(u)) + 1e-9)
    for digits in range(1, MOST_DIGITS + 1):
        for step_of in (_of_digits, _of_decimals):
            if _multiples(first, step_of(first, largest, digits)):
                step = step_of(u, largest, digits)
                if _multiples(u, step):
                    return step
    return np.zeros(len(u))


def _of_digits(u: FloatArray, largest: float, digits: int) -> FloatArray:
    """Step of so many digits of each number."""
    return np.asarray(10.0 ** (np.floor(np.log10(u) + 1e-9) - digits + 1))


def _of_decimals(u: FloatArray, largest: float, digits: int) -> FloatArray:
    """Step of so many digits of the largest number, of which the power of ten is given."""
    return np.full(len(u), 10.0 ** (largest - digits + 1))


def _multiples(u: FloatArray, step: FloatArray) -> bool:
    """Whether numbers are multiples of their steps."""
    ratio = u / step
    return bool(np.all(np.abs(ratio - np.round(ratio)) < 1e-6 * np.maximum(ratio, 1.0)))


def _fitted(x: FloatArray, u: FloatArray, quantum: FloatArray) -> tuple[NoiseLaw, float]:
    """The simplest law in x, and its rms deviation from u relative to u, beyond rounding."""
    laws = [_least_squares(x, u, quantum, terms) for terms in TERMS]
    best = min(rms for _, rms in laws)
    return next(found for found in laws if found[1] <= max(2 * best, SAME))


def _least_squares(
    x: FloatArray, u: FloatArray, quantum: FloatArray, terms: list[int]
) -> tuple[NoiseLaw, float]:
    """The law of these terms by relative least squares, u anywhere within its rounding."""
    from scipy.optimize import nnls

    x = np.abs(x)
    largest = float(np.max(x))
    unit = largest if largest > TINY else 1.0
    design = np.column_stack([np.ones(len(x)), x / unit, (x / unit) ** 2])[:, terms]
    kept: NDArray[np.bool_] = np.ones(len(x), bool)
    target, off, solution = u, np.zeros(len(x)), np.zeros(len(terms))
    for _ in range(ROUNDS if quantum.any() else 3):
        relative = design[kept] / (target[kept] ** 2)[:, None]
        if len(terms) == 1:
            column = relative[:, 0]
            solution = np.array([np.sum(column) / max(float(column @ column), 1e-300)])
        else:
            solution, _ = nnls(relative, np.ones(len(relative)))
        by_law = np.sqrt(design @ solution)
        target = np.clip(by_law, u - 0.51 * quantum, u + 0.51 * quantum)
        off = np.abs(by_law - target) / u
        # A few readings at a floor or a limit do not hide the law.
        kept = off <= max(5 * float(np.median(off)), FAR)
    if np.mean(kept) < 1 - MOST_OUTSIDE:
        return NoiseLaw(0.0, 0.0, 0.0), np.inf
    coefficients = np.zeros(3)
    coefficients[terms] = solution / np.array([1.0, unit, unit**2])[terms]
    law = NoiseLaw(*(float(c) for c in coefficients))
    return law, float(np.sqrt(np.mean(off[kept] ** 2)))
