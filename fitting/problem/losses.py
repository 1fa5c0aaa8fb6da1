"""What a fit makes small: chi-squared, distances between transformed values, Student's t.

chi-squared, sum of w r^2 with r = y - f, is right where the noise is normal and the model true. The
others are for other cases: `log` and `cube_root` measure residuals as the eye sees them, so that a
bright lobe does not decide alone where no model is true, `relative` compares logarithms, so that
every decade of f counts alike, and `student_t` gives way to outliers.

No loss has a slope that is infinite, and none but chi-squared has one that is 0 where f is: a
transformed value continues smoothly below a floor that is far below the data.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gonio.errors import ConfigurationError, DataError, unknown_name
from gonio.geometry import FloatArray

NU = 4.0  # degrees of freedom of Student's t
MOST_ZEROS = NU / (NU + 1)  # share of residuals that are 0 beyond which Student's t has no scale
NORMAL_SCORE = 0.8171832  # root mean square of Student's score of standard normal residuals
NO_RESIDUAL = 1e-12  # of the largest residual: one that is smaller is 0
DARK = 1e-6  # of the largest value: f below has no cube root of its own
FAR_BELOW = 1e-3  # of its value: f below has no logarithm of its own


@dataclass(frozen=True)
class Loss:
    """Chi-squared, and what another loss overrides.

    All methods take the values y, the model's values f, the weights w (squares of the factors on
    residuals) and the cosines of theta_r, each of shape (N,).

    Parameters
    ----------
    name : str
        As `fit(loss=...)` and `gonio fit --loss` take it.
    meaning : str
        What is summed.
    likelihood : bool
        Whether the loss is minus twice the logarithm of a likelihood.
    scaled : bool
        Whether it needs the size of the noise, not the weights alone.
    relative : bool
        Whether its residuals are equally noisy where the noise is a fixed part of f.
    robust : bool
        Whether large residuals count little.
    """

    name: str
    meaning: str
    likelihood: bool = True
    scaled: bool = False
    relative: bool = False
    robust: bool = False

    def check_weights(self, weights: Any, *, has_u: bool) -> Any:
        """The weights, "sd" by default where the samples have uncertainties."""
        return ("sd" if has_u else "none") if weights is None else weights

    def check_values(self, y: FloatArray, cos_r: FloatArray) -> None:
        """Refuse values for which the loss is not defined."""

    def total(self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray) -> float:
        """The loss."""
        return float(np.sum(w * (y - f) ** 2))

    def linearised(
        self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Residuals r and weights v of the chi-squared that has the same slope.

        The slope of the loss by f is -2 v r, and v stands for half its second derivative, which
        must not be negative.
        """
        return y - f, w

    def expected_curvature(
        self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray
    ) -> FloatArray:
        """Half the second derivative of the loss by f, as it is expected at the minimum."""
        return self.linearised(y, f, w, cos_r)[1]

    def pseudo_residuals(
        self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Residuals as the loss sees them, in the unit of f, and their weights.

        Least squares with them have their minimum where the loss has its own, and what is known of
        residuals of least squares holds for them.
        """
        return self.linearised(y, f, w, cos_r)

    def scale(self, r: FloatArray) -> float:
        """Size of the noise from weighted residuals."""
        return 1.0

    def has_no_scale(self, r: FloatArray) -> bool:
        """Whether the residuals do not tell the size of the noise that the loss needs."""
        return False


class _Transformed(Loss):
    """Least squares of t(y cos theta_r) - t(f cos theta_r)."""

    def t(self, x: FloatArray, floor: FloatArray) -> FloatArray:
        raise NotImplementedError

    def slope(self, x: FloatArray, floor: FloatArray) -> FloatArray:
        """dt/dx, positive."""
        raise NotImplementedError

    def floor(self, x: FloatArray) -> FloatArray:
        """Where the values x have their floors, which no fit moves."""
        raise NotImplementedError

    def check_weights(self, weights: Any, *, has_u: bool) -> Any:
        if weights not in (None, "none"):
            raise ConfigurationError(
                f"loss {self.name!r} compares {self.meaning} with equal weights; leave the "
                f"weights {weights!r} out, or use loss chi2 with them.",
                value=weights,
            )
        return "none"

    def total(self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray) -> float:
        x = y * cos_r
        floor = self.floor(x)
        return float(np.sum(w * (self.t(x, floor) - self.t(f * cos_r, floor)) ** 2))

    def linearised(
        self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        x = y * cos_r
        floor = self.floor(x)
        slope = self.slope(f * cos_r, floor) * cos_r
        return (self.t(x, floor) - self.t(f * cos_r, floor)) / slope, w * slope**2


class _Log(_Transformed):
    """ln(1 + x), a straight line below the floor."""

    def check_values(self, y: FloatArray, cos_r: FloatArray) -> None:
        worst = float(np.min(y * cos_r))
        if worst <= -1:
            raise DataError(
                f"a value times cos theta_r is {worst:.4g}: loss 'log' takes ln(1 + f cos theta_r) "
                "and needs more than -1; use loss chi2 or student_t, or remove the sample.",
                value=worst,
            )

    def floor(self, x: FloatArray) -> FloatArray:
        return np.asarray(FAR_BELOW * min(1.0, 1 + float(np.min(x))) - 1)

    def t(self, x: FloatArray, floor: FloatArray) -> FloatArray:
        above = np.maximum(x, floor)
        return np.asarray(np.log1p(above) + (x - above) / (1 + floor))

    def slope(self, x: FloatArray, floor: FloatArray) -> FloatArray:
        return 1 / (1 + np.maximum(x, floor))


class _Relative(_Transformed):
    """ln x, a straight line below the floor."""

    def check_values(self, y: FloatArray, cos_r: FloatArray) -> None:
        bad = np.flatnonzero(~(y > 0))
        if len(bad):
            raise DataError(
                f"{len(bad)} of {len(y)} values are not above 0 (the first is sample "
                f"{bad[0] + 1}, {y[bad[0]]:.4g}): loss 'relative' compares logarithms. Use weights "
                "relative, which follow the fitted value and take any reading; or remove these "
                "samples, which makes dark places seem brighter.",
                value=float(y[bad[0]]),
            )

    def floor(self, x: FloatArray) -> FloatArray:
        return FAR_BELOW * x

    def t(self, x: FloatArray, floor: FloatArray) -> FloatArray:
        above = np.maximum(x, floor)
        return np.asarray(np.log(above) + (x - above) / floor)

    def slope(self, x: FloatArray, floor: FloatArray) -> FloatArray:
        return 1 / np.maximum(x, floor)


class _CubeRoot(_Transformed):
    """x^(1/3) with the sign of x; an odd cubic with the same value and slope below the floor."""

    def floor(self, x: FloatArray) -> FloatArray:
        return np.asarray(DARK * (float(np.max(np.abs(x))) or 1.0))

    def t(self, x: FloatArray, floor: FloatArray) -> FloatArray:
        inside = np.clip(x / floor, -1, 1)
        near = np.cbrt(floor) * inside * (4 - inside**2) / 3
        return np.where(np.abs(x) > floor, np.cbrt(x), near)

    def slope(self, x: FloatArray, floor: FloatArray) -> FloatArray:
        inside = np.clip(x / floor, -1, 1)
        near = (4 - 3 * inside**2) / 3
        far = np.cbrt(np.maximum(np.abs(x), floor) / floor) ** -2 / 3
        return np.where(np.abs(x) > floor, far, near) * np.cbrt(floor) / floor


class _StudentT(Loss):
    def total(self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray) -> float:
        return float((NU + 1) * np.sum(np.log1p(w * (y - f) ** 2 / NU)))

    def linearised(
        self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        r = y - f
        return r, w * (NU + 1) / (NU + w * r * r)

    def expected_curvature(
        self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray
    ) -> FloatArray:
        return w * (NU + 1) / (NU + 3)

    def pseudo_residuals(
        self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """The score, with the variance of the residual where the noise is normal.

        It is the residual near 0 and falls for outliers. Huber 1981, Robust Statistics, sec. 7.6.
        """
        r, v = self.linearised(y, f, w, cos_r)
        return v / w * r / NORMAL_SCORE, w

    def scale(self, r: FloatArray) -> float:
        """Maximum-likelihood scale s: the mean of (nu + 1) x^2/(nu + x^2) is 1 for x = r/s.

        It cannot collapse unless four residuals of five are 0, where their root mean square
        stands for it. 0 where all are.
        """
        from scipy.optimize import brentq

        largest = float(np.max(np.abs(r), initial=0.0))
        if largest == 0:
            return 0.0
        x2 = (r / largest) ** 2
        if self.has_no_scale(r):
            return largest * float(np.sqrt(np.mean(x2)))

        def excess(log_s: float) -> float:
            z2 = x2 * np.exp(-2 * log_s)
            return float(np.mean((NU + 1) * z2 / (NU + z2))) - 1

        least = float(np.log(NO_RESIDUAL))
        if excess(least) <= 0:
            return largest * NO_RESIDUAL
        return largest * float(np.exp(brentq(excess, least, 1.0, xtol=1e-12)))

    def has_no_scale(self, r: FloatArray) -> bool:
        size = np.abs(r)
        none = size <= NO_RESIDUAL * float(np.max(size, initial=0.0))
        return bool(np.mean(none) >= MOST_ZEROS and not none.all())


CHI2 = Loss("chi2", "squares of weighted residuals")
LOSSES: dict[str, Loss] = {
    loss.name: loss
    for loss in (
        CHI2,
        _Log("log", "ln(1 + f cos theta_r)", likelihood=False),
        _CubeRoot("cube_root", "(f cos theta_r)^(1/3)", likelihood=False),
        _Relative("relative", "ln f", likelihood=False, relative=True),
        _StudentT("student_t", "Student's t of 4 degrees of freedom", scaled=True, robust=True),
    )
}


def get(name: str) -> Loss:
    """The loss with this name.

    Raises
    ------
    ConfigurationError
        If there is none, with the nearest name.
    """
    try:
        return LOSSES[name]
    except KeyError:
        raise unknown_name("loss", name, LOSSES) from None
