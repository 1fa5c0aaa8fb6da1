"""Background and standard: Ward's eq. (2), with its variance.

f = (M - B) / (S - B) f_std with M, B, S the rates of sample, background and standard. Everything
that multiplies both sample and standard cancels: quantum efficiency, lens, pixel area, dome
reflectance by position, PRNU, gain, and at equal incidence the lamp's irradiance and footprint.

Where the standard was taken at another incidence, or in reflection for a sample in transmission,
it has a background B_0 of its own and the irradiance does not cancel:
f = (M - B) / (S - B_0) f_std E_std/E.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter

from gonio.calibration.frames import certified
from gonio.calibration.frames.certified import estimate
from gonio.calibration.frames.exposure import Rate
from gonio.certificate import Certificate
from gonio.errors import ConfigurationError
from gonio.geometry import FloatArray
from gonio.metadata import Metadata

# Stray light that is so much more of the standard's signal than elsewhere marks the entry patch.
ENTRY_SHARE = 0.1
MIN_SIGNAL = 25.0  # standard deviations that the standard must stand above the background
DEAD_SHARE = 0.2  # of the neighbours' signal, below which a pixel counts as dead
HOT_SHARE = 0.05  # of the neighbours' signal, above which a pixel's own dark signal is too much
HOT_SIGMAS = 7.0  # that it must stand out besides


@dataclass(frozen=True)
class Reference:
    """Standard and background of one incidence, in the form in which eq. (2) uses them.

    Parameters
    ----------
    background : Rate
        B.
    stray : ndarray, shape (rows, columns)
        Light in the background, without its dark current, in the unit of f: what f would be off
        by if it were not subtracted, sr^-1.
    standard_stray : ndarray
        The same in the standard's own background, as a fraction of the standard's signal.
    f_per_rate : ndarray
        f_std E_std/E / (S - B_0): sr^-1 for each e-/s above the background; 0 where the standard
        has no usable signal.
    f_standard : ndarray
        f_std E_std/E: f of a sample whose signal is that of the standard, sr^-1.
    standard_variance : ndarray
        Relative variance of S - B_0 from noise that it does not share with the sample's signal.
    background_variance : ndarray
        Variance of B, (e-/s)^2.
    one_background : bool
        B_0 is B: the background's noise is in both signals.
    signal : tuple of Rate
        S and B_0.
    usable : ndarray of bool
        Not saturated, bright enough, neither dead nor hot, and outside the lamp's entry patch.
    entry : ndarray of bool
        The same inside the lamp's entry patch, without the pixels beside it that `usable` leaves
        out as well.
    dead, hot : ndarray of bool
        Pixels that see less than a fifth of what their neighbours see of the standard, and pixels
        whose background stands out from their neighbours'.
    """

    background: Rate
    stray: FloatArray
    standard_stray: FloatArray
    f_per_rate: FloatArray
    f_standard: FloatArray
    standard_variance: FloatArray
    background_variance: FloatArray
    one_background: bool
    signal: tuple[Rate, Rate]
    usable: NDArray[np.bool_]
    entry: NDArray[np.bool_]
    dead: NDArray[np.bool_]
    hot: NDArray[np.bool_]


def standard_brdf(
    certificate: Certificate, theta_i: float, theta_r: ArrayLike, dphi: ArrayLike
) -> FloatArray:
    """f_std in sr^-1; rho/pi, the factor of eq. (2), for a Lambertian standard.

    Parameters
    ----------
    certificate : Certificate
        What is certified, and the shape by which it becomes f.
    theta_i : float
        Incidence at which the standard was taken, radians.
    theta_r, dphi : array_like
        Viewing direction: polar angle and phi_r - phi_i, radians. NaN stays NaN.

    Examples
    --------
    >>> flat = Certificate(reflectance=0.99, uncertainty=0.005)
    >>> round(float(standard_brdf(flat, 0.5, 0.3, 0.0)), 6)
    0.315127
    """
    return estimate(certificate).brdf(theta_i, theta_r, dphi)


def irradiance_ratio(metadata: Metadata, theta_i: float) -> float:
    """E_std/E: irradiance of the standard over that of the sample, as the metadata give it.

    Parameters
    ----------
    metadata : Metadata
    theta_i : float
        Incidence of the sample, radians.

    Returns
    -------
    float
        1 where the standard was taken at every incidence; cos(theta_std)/cos(theta_i) where at
        one; times T_d in transmission, where the lamp lights the standard through the dome and
        the sample directly.

    Raises
    ------
    ConfigurationError
        In transmission without T_d, or where the lamp grazes the surface.

    Notes
    -----
    The dome's T_d by position, the lamp's spot and the share of the pupil that sees it are taken to
    be the same at both incidences. `Plan.u_irradiance` is the uncertainty of that.
    """
    plan = metadata.plan
    if plan.standard_theta_i_deg is None:
        return 1.0
    if np.cos(theta_i) < 1e-6:
        raise ConfigurationError(
            f"theta_i = {np.degrees(theta_i):g} deg: the lamp grazes the sample, whose irradiance "
            "cannot be computed from that of the standard at another incidence; leave it out.",
            value=theta_i,
        )
    ratio = float(np.cos(np.radians(plan.standard_theta_i_deg)) / np.cos(theta_i))
    if plan.mode != "transmission":
        return ratio
    if metadata.limits.transmittance is None:
        raise ConfigurationError(
            "transmission needs T_d, the dome's transmittance: the standard is lit through the "
            "dome and the sample is not. Measure it with a detector at the sample's place, with "
            "and without the dome, and give limits.transmittance in session.json."
        )
    return ratio * metadata.limits.transmittance


def describe(metadata: Metadata) -> str:
    """One line of the history: which standard eq. (2) used."""
    plan = metadata.plan
    text = f"eq. (2) with a standard of {certified.describe(metadata.standard)}"
    if plan.standard_theta_i_deg is None:
        return text
    way = " in reflection" if plan.mode == "transmission" else ""
    factor = f"cos({plan.standard_theta_i_deg:g} deg)/cos(theta_i)"
    if plan.mode == "transmission":
        factor = f"T_d {factor} with T_d = {metadata.limits.transmittance:g}"
    price = "unknown, not included" if plan.u_irradiance is None else f"{plan.u_irradiance:.2g}"
    return (
        f"{text}, taken{way} at {plan.standard_theta_i_deg:g} deg: irradiance by {factor}, lamp "
        f"spot and dome taken as equal; relative uncertainty: {price}"
    )


def reference(
    background: Rate,
    standard: Rate,
    f_std: FloatArray,
    *,
    dark_e_per_s: float,
    irradiance: float = 1.0,
    standard_background: Rate | None = None,
) -> Reference:
    """Combine the background and standard images of one incidence.

    Parameters
    ----------
    background, standard : Rate
        Merged images.
    f_std : ndarray, shape (rows, columns)
        From `standard_brdf`, sr^-1; NaN outside the image circle.
    dark_e_per_s : float
        Dark current, which is part of the background but not light.
    irradiance : float
        E_std/E of `irradiance_ratio`.
    standard_background : Rate, optional
        B_0, where it is not `background`.
    """
    own = background if standard_background is None else standard_background
    signal = standard.value - own.value
    # Neighbours decide: a choice of pixels by their own noise would bias the rest.
    near_b, near_0, near_s = (_neighbours(r.value) for r in (background, own, standard))
    near = near_s - near_0
    noise = np.sqrt(own.variance(near_0) + standard.variance(near_s))
    bright = near > MIN_SIGNAL * noise
    # Room light is all over the image, and no reason to leave it out.
    limit_b = _entry_limit(near_b - dark_e_per_s, near / irradiance, bright)
    limit_0 = _entry_limit(near_0 - dark_e_per_s, near, bright)
    entry = (near_b - dark_e_per_s > limit_b) | (near_0 - dark_e_per_s > limit_0)
    limit = np.maximum(HOT_SHARE * near, HOT_SIGMAS * np.sqrt(background.variance(near_b)))
    hot = bright & ~entry & (background.value - near_b > limit)
    hot[hot] = (background.value - limit)[hot] > _beside(background.value, hot)[:, -2]
    hot |= bright & ~entry & background.saturated
    saturated = background.saturated | own.saturated | standard.saturated
    dead = bright & ~saturated & (signal < DEAD_SHARE * near)
    dead[dead] = signal[dead] < DEAD_SHARE * _beside(signal, dead)[:, 1]
    good = bright & (signal > 0) & (f_std > 0) & ~(saturated | dead | hot)
    safe = np.where(good, signal, 1.0)
    f_standard = np.where(good, f_std * irradiance, 1.0)
    noise_of_signal = standard.variance(standard.value)
    if standard_background is not None:
        noise_of_signal = noise_of_signal + own.variance(own.value)
    f_per_rate = np.where(good, f_standard / safe, 0.0)
    return Reference(
        background=background,
        stray=(background.value - dark_e_per_s) * f_per_rate,
        standard_stray=(own.value - dark_e_per_s) / safe,
        f_per_rate=f_per_rate,
        f_standard=f_standard,
        standard_variance=noise_of_signal / safe**2,
        background_variance=background.variance(background.value),
        one_background=standard_background is None,
        signal=(standard, own),
        usable=good & ~entry,
        entry=good & (background.value - dark_e_per_s > limit_b),
        dead=dead,
        hot=hot,
    )


def _neighbours(image: FloatArray) -> FloatArray:
    """Mean of the 24 pixels around each, the pixel itself left out."""
    return np.asarray((25 * uniform_filter(image, size=5, mode="nearest") - image) / 24)


def _entry_limit(stray: FloatArray, signal: FloatArray, bright: NDArray[np.bool_]) -> FloatArray:
    """Stray light from which on a pixel looks into the lamp's entry patch, e-/s."""
    usual = float(np.median(stray[bright] / signal[bright])) if bright.any() else 0.0
    return (usual + ENTRY_SHARE) * signal


def _beside(image: FloatArray, where: NDArray[np.bool_]) -> FloatArray:
    """The eight neighbours of some pixels in growing order, (n, 8).

    A pixel that stands alone, or with one other, differs from nearly all of them; one on the edge
    of the lit spot or of the lamp's entry patch does not.
    """
    rows, columns = np.nonzero(where)
    steps = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    last = np.array(image.shape) - 1
    near = [
        image[np.clip(rows + i, 0, last[0]), np.clip(columns + j, 0, last[1])] for i, j in steps
    ]
    return np.sort(np.stack(near, axis=1), axis=1)


def brdf(measured: Rate, ref: Reference) -> FloatArray:
    """f of every pixel by eq. (2), sr^-1; 0 where the standard has no usable signal."""
    return (measured.value - ref.background.value) * ref.f_per_rate


def variances(
    measured: Rate, ref: Reference, expected: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Variance of f from the sample's frames, and from the standard's and background's, sr^-2.

    var(f) = c^2 var(M) + f^2 var(S)/(S-B)^2 + var(B) (c - f/(S-B))^2 with c = f_std/(S-B): the
    background enters numerator and denominator with opposite effect, so where the sample is as
    bright as the standard it cancels. With a background of its own, the standard brings
    f^2 var(B_0)/(S-B_0)^2 in its place.

    Parameters
    ----------
    expected : ndarray
        A smooth estimate of f: a pixel's own noise must not decide its weight.
    """
    c = ref.f_per_rate
    safe = np.where(c > 0, c, 1.0)
    rate = expected / safe + ref.background.value
    own = c**2 * measured.variance(rate)
    leverage = c * (1 - expected / ref.f_standard) if ref.one_background else c
    shared = expected**2 * ref.standard_variance + leverage**2 * ref.background_variance
    return own, shared
