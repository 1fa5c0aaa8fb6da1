"""Background and standard: Ward's eq. (2), with its variance.

f = (M - B) / (S - B) f_std with M, B, S the rates of sample, background and standard. Everything
that multiplies sample and standard alike cancels: quantum efficiency, lens, pixel area, dome
reflectance by position, PRNU, gain, and at equal incidence the lamp's irradiance and footprint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from gonio.calibration.exposure import Rate
from gonio.geometry import FloatArray
from gonio.metadata import Certificate

ENTRY_SHARE = 0.1  # background above this share of the standard's signal marks the entry patch
MIN_SIGNAL = 25.0  # standard deviations that the standard must stand above the background


@dataclass(frozen=True)
class Reference:
    """Standard and background of one incidence, in the form in which eq. (2) uses them.

    Parameters
    ----------
    background : Rate
    f_per_rate : ndarray, shape (rows, columns)
        f_std / (S - B): sr^-1 for each e-/s above the background; 0 where masked.
    standard_variance : ndarray
        Relative variance of S - B from the standard's own noise.
    background_variance : ndarray
        Variance of B, (e-/s)^2.
    usable : ndarray of bool
        Not saturated, bright enough, and outside the lamp's entry patch.
    """

    background: Rate
    f_per_rate: FloatArray
    standard_variance: FloatArray
    background_variance: FloatArray
    usable: NDArray[np.bool_]


def standard_brdf(certificate: Certificate, theta_r: FloatArray) -> FloatArray:
    """f_std in sr^-1; rho/pi, the factor of eq. (2), for a Lambertian standard.

    Examples
    --------
    >>> flat = Certificate(reflectance=0.99, uncertainty=0.005)
    >>> round(float(standard_brdf(flat, np.array(0.3))), 6)
    0.315127
    """
    t = theta_r / np.radians(75)
    return np.asarray(certificate.reflectance / np.pi * (1 - certificate.rolloff * t**4))


def reference(
    background: Rate,
    standard: Rate,
    certificate: Certificate,
    theta_r: FloatArray,
    *,
    dark_e_per_s: float,
) -> Reference:
    """Combine the background and standard images of one incidence.

    Parameters
    ----------
    background, standard : Rate
        Merged images.
    certificate : Certificate
        The standard's certificate.
    theta_r : ndarray, shape (rows, columns)
        Reflected polar angle of every pixel, radians; NaN outside the image circle.
    dark_e_per_s : float
        Dark current, which is part of the background but not light.
    """
    signal = standard.value - background.value
    # Neighbours decide: choosing pixels by their own noise would bias what is left.
    near_b, near_s = _neighbours(background.value), _neighbours(standard.value)
    noise = np.sqrt(background.variance(near_b) + standard.variance(near_s))
    bright = near_s - near_b > MIN_SIGNAL * noise
    entry = near_b - dark_e_per_s > ENTRY_SHARE * (near_s - near_b)
    usable = (
        bright
        & (signal > 0)
        & ~entry
        & ~background.saturated
        & ~standard.saturated
        & np.isfinite(theta_r)
    )
    safe = np.where(usable, signal, 1.0)
    return Reference(
        background,
        np.where(usable, standard_brdf(certificate, theta_r) / safe, 0.0),
        standard.variance(standard.value) / safe**2,
        background.variance(background.value),
        usable,
    )


def _neighbours(image: FloatArray) -> FloatArray:
    """Mean of the 24 pixels around each, the pixel itself left out."""
    return np.asarray((25 * uniform_filter(image, size=5, mode="nearest") - image) / 24)


def brdf(measured: Rate, ref: Reference) -> FloatArray:
    """f of every pixel by eq. (2), sr^-1; 0 where the reference is masked."""
    return (measured.value - ref.background.value) * ref.f_per_rate


def variances(
    measured: Rate, ref: Reference, expected: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Variance of f from the sample's frames, and from the standard's and background's, sr^-2.

    var(f) = c^2 var(M) + f^2 var(S)/(S-B)^2 + var(B) (c - f/(S-B))^2 with c = f_std/(S-B): the
    background enters numerator and denominator with opposite effect, so where the sample is as
    bright as the standard it cancels.

    Parameters
    ----------
    expected : ndarray
        A smooth estimate of f: a pixel's own noise must not decide its weight.
    """
    c = ref.f_per_rate
    safe = np.where(c > 0, c, 1.0)
    rate = expected / safe + ref.background.value
    own = c**2 * measured.variance(rate)
    # f/(S-B) = expected c / f_std; f_std varies by a few per cent only and 1/pi stands for it.
    leverage = c * (1 - expected * np.pi)
    shared = expected**2 * ref.standard_variance + leverage**2 * ref.background_variance
    return own, shared
