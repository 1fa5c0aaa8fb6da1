"""What a fit makes small: chi-squared, two distances between transformed values, Student's t.

chi-squared, sum of w r^2 with r = y - f, is right where the noise is normal and the model true. The
others are for other cases: `log` and `cube_root` measure residuals as the eye sees them, so that a
bright lobe does not decide alone where no model is true, and `student_t` gives way to outliers.

Their uncertainties are those of an M-estimator (Huber 1967): bread^-1 meat bread^-1, in which the
scatter of the residuals themselves stands for the noise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gonio.errors import ConfigurationError, DataError, unknown_name
from gonio.geometry import FloatArray

NU = 4.0  # degrees of freedom of Student's t
MAD_TO_SD = 1.482602218505602  # of normal noise


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
    """

    name: str
    meaning: str
    likelihood: bool = True
    scaled: bool = False

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

    def bread(self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray) -> FloatArray:
        """Half the second derivative of the loss by f, as it is expected at the minimum."""
        return self.linearised(y, f, w, cos_r)[1]

    def scale(self, r: FloatArray) -> float:
        """Size of the noise from weighted residuals."""
        return 1.0


class _Transformed(Loss):
    """Least squares of t(y cos theta_r) - t(f cos theta_r)."""

    def t(self, x: FloatArray) -> FloatArray:
        raise NotImplementedError

    def slope(self, x: FloatArray) -> FloatArray:
        """dt/dx, 0 where it is not finite."""
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
        return float(np.sum(w * (self.t(y * cos_r) - self.t(f * cos_r)) ** 2))

    def linearised(
        self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        slope = self.slope(f * cos_r) * cos_r
        safe = np.where(slope > 0, slope, 1.0)
        r = np.where(slope > 0, (self.t(y * cos_r) - self.t(f * cos_r)) / safe, 0.0)
        return r, w * slope**2


class _Log(_Transformed):
    def check_values(self, y: FloatArray, cos_r: FloatArray) -> None:
        worst = float(np.min(y * cos_r))
        if worst <= -1:
            raise DataError(
                f"a value times cos theta_r is {worst:.4g}: loss 'log' takes ln(1 + f cos theta_r) "
                "and needs more than -1; use loss chi2 or student_t, or remove the sample.",
                value=worst,
            )

    def t(self, x: FloatArray) -> FloatArray:
        return np.log1p(x)

    def slope(self, x: FloatArray) -> FloatArray:
        return 1 / (1 + x)


class _CubeRoot(_Transformed):
    def t(self, x: FloatArray) -> FloatArray:
        return np.cbrt(x)

    def slope(self, x: FloatArray) -> FloatArray:
        root = np.cbrt(x) ** 2
        return np.where(root > 0, 1 / (3 * np.where(root > 0, root, 1.0)), 0.0)


class _StudentT(Loss):
    def total(self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray) -> float:
        return float((NU + 1) * np.sum(np.log1p(w * (y - f) ** 2 / NU)))

    def linearised(
        self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        r = y - f
        return r, w * (NU + 1) / (NU + w * r * r)

    def bread(self, y: FloatArray, f: FloatArray, w: FloatArray, cos_r: FloatArray) -> FloatArray:
        z2 = w * (y - f) ** 2
        return w * (NU + 1) * (NU - z2) / (NU + z2) ** 2

    def scale(self, r: FloatArray) -> float:
        size = MAD_TO_SD * float(np.median(np.abs(r)))
        return size if size > 0 else max(float(np.sqrt(np.mean(r * r))), 1e-300)


CHI2 = Loss("chi2", "squares of weighted residuals")
LOSSES: dict[str, Loss] = {
    loss.name: loss
    for loss in (
        CHI2,
        _Log("log", "ln(1 + f cos theta_r)", likelihood=False),
        _CubeRoot("cube_root", "(f cos theta_r)^(1/3)", likelihood=False),
        _StudentT("student_t", "Student's t of 4 degrees of freedom", scaled=True),
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
