"""Faults that only images held against each other give away."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from itertools import combinations

import numpy as np
from scipy.ndimage import uniform_filter

from gonio.calibration.faults.evidence import Evidence, Finding, Image
from gonio.calibration.faults.frame_statistics import middle
from gonio.calibration.frames import standard as eq2
from gonio.geometry import FloatArray, angles, unit_vectors

SIGMAS = 5.0  # that a figure must stand out by
COSINE = 0.2  # by which the standard may fail to follow the cosine
SHAPE = 0.06  # by which its f may change over the hemisphere between incidences
ALBEDO = 1.1
ASSUMED_DRIFT = 0.005  # of a lamp that states none
PATCH_DEG = 6.0  # by which the lamp's entry patch may be off
OFF_CENTRE_PX, OFF_CENTRE_DEG = 0.5, 0.15
FEWEST = 3  # blocks of the coarse grid that count as a place


def _standard_signals(seen: Evidence) -> dict[int, FloatArray]:
    """Standard above its background over what f_std cos(theta_i) predicts, by incidence.

    NaN where it says nothing: outside the usable hemisphere, in the lamp's entry patch.
    """
    metadata, regions = seen.metadata, seen.regions
    theta_r, phi_r = angles(regions.w_r)
    signals = {}
    for incidence, theta_deg in enumerate(metadata.plan.incidences("standard")):
        own = incidence if metadata.plan.standard_theta_i_deg is None else -1
        own %= len(metadata.plan.incidences("background"))
        white, black = seen.mean("standard", incidence), seen.mean("background", own)
        if white is None or black is None:
            continue
        theta_i = np.radians(theta_deg)
        f_std = eq2.standard_brdf(metadata.standard, theta_i, theta_r, phi_r)
        signal = white - black
        stray = black - metadata.camera.dark_e_per_s
        use = (regions.cover > 0.99) & (stray < eq2.ENTRY_SHARE * signal) & (f_std > 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            signals[incidence] = np.where(use, signal / (f_std * np.cos(theta_i)), np.nan)
    return signals


def _standard_trend(seen: Evidence) -> Iterator[Finding]:
    """The standard against cos(theta_i): frames exchanged, another surface, a lamp that drifts."""
    signals = _standard_signals(seen)
    if len(signals) < 2:
        return
    common = _median(np.stack(list(signals.values())))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = {i: signal / common for i, signal in signals.items()}
    level = {i: middle(r) for i, r in ratio.items() if np.isfinite(r).sum() > FEWEST}
    if len(level) < 2:
        return  # hardly a pixel saw the standard unsaturated; other checks say so
    angle = {i: seen.theta_i(("standard", 0, i)) for i in level}
    exchanged = _exchanged(level, angle)
    if exchanged:
        a, b = (f"{np.degrees(angle[i]):g}" for i in exchanged)
        yield Finding(
            "exchanged_frames",
            "error",
            f"the standard's signals at {a} and {b} deg would follow cos(theta_i) if the frames of "
            "the two were exchanged.",
        )
        return
    i, off = max(((i, x - 1) for i, x in level.items()), key=lambda each: abs(each[1]))
    # An arm that is off by a degree and a half moves the cosine by its tangent.
    if abs(off) > COSINE + 0.026 * np.tan(angle[i]):
        yield Finding(
            "standard_off_cosine",
            "warning",
            f"{seen.name(('standard', 0, i))}: its signal is {1 + off:.3g} of what the others and "
            "cos(theta_i) predict: another surface, another angle, or a lit spot smaller than "
            "what the camera sees.",
        )
    yield from _shape(seen, ratio, level)
    yield from _drift(seen, level, angle)


def _median(stack: FloatArray) -> FloatArray:
    """Median over the first axis of what is known; NaN where nothing is."""
    known = np.isfinite(stack)
    ordered = np.sort(np.where(known, stack, np.inf), axis=0)
    n = known.sum(axis=0)
    low, high = (
        np.take_along_axis(ordered, np.maximum(k, 0)[None], axis=0)[0]
        for k in ((n - 1) // 2, n // 2 - (n == 0))
    )
    return np.where(n > 0, (low + high) / 2, np.nan)


def _exchanged(level: dict[int, float], angle: dict[int, float]) -> tuple[int, int] | None:
    """The two incidences whose exchange would put both on the cosine, if there are two."""
    for a, b in combinations(level, 2):
        cosines = np.cos(angle[a]) / np.cos(angle[b])
        both_off = min(abs(np.log(level[a])), abs(np.log(level[b]))) > 0.1
        mended = (abs(np.log(level[a] * cosines)), abs(np.log(level[b] / cosines)))
        others = [abs(np.log(x)) for i, x in level.items() if i not in (a, b)]
        if both_off and max(mended) < 0.08 and others and np.median(others) < 0.08:
            return a, b
    return None


def _shape(
    seen: Evidence, ratio: dict[int, FloatArray], level: dict[int, float]
) -> Iterator[Finding]:
    """f of the standard may not change over the hemisphere but as its certificate says."""
    spread = {}
    for i, x in level.items():
        relative = ratio[i] / x
        known = np.isfinite(relative)
        # Means of 3 x 3 blocks: noise must not pass for shape.
        share = uniform_filter(known.astype(float), 3)
        smooth = uniform_filter(np.where(known, relative, 0.0), 3) / np.where(known, share, 1.0)
        inner = smooth[known & (share > 0.99)]
        if len(inner) > FEWEST:
            low, high = np.percentile(inner, [5, 95])
            spread[i] = float(high - low) / 2
    if not spread:
        return
    i, most = max(spread.items(), key=lambda each: each[1])
    if most > SHAPE + seen.metadata.standard.rolloff_uncertainty:
        yield Finding(
            "wrong_standard",
            "warning",
            f"{seen.name(('standard', 0, i))}: against the other incidences its f changes by "
            f"+-{most:.0%} over the hemisphere, and the certificate has none of that: it is "
            "not the certified standard, or it is dirty or glossy.",
        )


def _drift(seen: Evidence, level: dict[int, float], angle: dict[int, float]) -> Iterator[Finding]:
    """Scatter of the lamp's output about a smooth trend with the incidence, and among repeats."""
    stated, plan = seen.metadata.lamp.drift, seen.metadata.plan
    allowed = ASSUMED_DRIFT if stated is None else stated
    said = "none is stated" if stated is None else f"{stated:.2g} is stated"
    scatter = None
    if len(level) >= 5:
        theta = np.array([angle[i] for i in level])
        x = np.log([level[i] for i in level])
        degree = min(len(x) - 3, 4)
        trend = np.polyval(np.polyfit(theta, x, degree), theta)
        scatter = float(np.sqrt(np.sum((x - trend) ** 2) / (len(x) - degree - 1)))
        allowed /= np.sqrt(plan.repeats)
        how = "about a smooth trend with the incidence"
    elif plan.repeats > 1:
        takes = defaultdict(list)
        for (_, _, i), figures in seen.of("standard"):
            takes[i].append(middle(figures.rate))
        scatter = float(np.sqrt(np.mean([np.var(np.log(x), ddof=1) for x in takes.values()])))
        how = "among its repeats"
    # With two degrees of freedom chance passes 3.5 times the sd once in 200 000.
    if scatter is not None and scatter > 3.5 * allowed + 3e-3:
        yield Finding(
            "lamp_drift",
            "warning",
            f"the standard's signals scatter by {scatter:.2g} {how} and {said} for the lamp: the "
            "lamp drifts and the samples' shared uncertainty is too small, unless it is the dome "
            "whose transmittance changes between incidences, which cancels. Let the lamp warm up, "
            "or correct lamp.drift.",
        )


def _darker_than_background(seen: Evidence) -> Iterator[Finding]:
    """Nothing may be darker than its background: the lamp stood elsewhere."""
    metadata = seen.metadata
    drift = 0.02 if metadata.lamp.drift is None else metadata.lamp.drift
    white = seen.mean("standard", 0)
    found: list[tuple[float, Image, int]] = []
    for image, figures in seen.of("standard", "sample"):
        alone = image[0] == "standard" and metadata.plan.standard_theta_i_deg is not None
        own = len(metadata.plan.theta_i_deg) if alone else image[2]
        black = seen.mean("background", own)
        if black is None or white is None:
            continue
        noise = seen.images["background", 0, own].sd
        stray = np.maximum(black - metadata.camera.dark_e_per_s, 0)
        floor = -8 * np.hypot(figures.sd, noise) - SIGMAS * drift * stray
        missing = (seen.regions.cover > 0) & (
            figures.rate - black < np.minimum(floor, -0.02 * white)
        )
        if missing.sum() >= FEWEST:
            most = float((black - figures.rate)[missing].max())
            found.append((most, image, int(missing.sum())))
    if found:
        most, image, n = max(found, key=lambda each: each[0])
        yield Finding(
            "darker_than_background",
            "error",
            f"{seen.name(image)}: in {n} places it is darker than its background, by up to "
            f"{most:.3g} e-/s, as in {len(found)} images: frames of two incidences are exchanged, "
            "or the lamp moved between the two.",
        )


def _entry_patch(seen: Evidence) -> Iterator[Finding]:
    """The patch where the beam enters the dome shows where the lamp stood."""
    metadata, regions = seen.metadata, seen.regions
    if metadata.plan.mode == "transmission":
        return
    for image, figures in seen.of("background"):
        known = (regions.cover > 0) & np.isfinite(figures.rate)
        light = np.where(known, figures.rate - metadata.camera.dark_e_per_s, 0.0)
        most, usual = float(light.max()), middle(light[known])
        if not most > 8 * max(usual, 0.0) + 10 * middle(figures.sd[known]):
            continue
        patch = light > most / 2
        centre = np.sum(regions.w_r[patch] * light[patch][:, None], axis=0)
        centre /= np.linalg.norm(centre)

        def away(theta_i_deg: float, centre: FloatArray = centre) -> float:
            lamp = unit_vectors(np.radians(theta_i_deg), 0.0)
            return float(np.degrees(np.arccos(np.clip(centre @ lamp, -1, 1))))

        planned = np.degrees(seen.theta_i(image))
        if away(float(planned)) <= PATCH_DEG:
            continue
        others = metadata.plan.incidences("background")
        nearest = min(others, key=away)
        if away(nearest) <= PATCH_DEG / 2:
            yield Finding(
                "exchanged_frames",
                "error",
                f"{seen.name(image)}: the lamp's entry patch lies at {nearest:g} deg; the frames "
                "of two incidences are exchanged.",
            )
            return


def _albedo(seen: Evidence) -> Iterator[Finding]:
    """A sample that reflects more than falls on it is the standard, or the standard is not."""
    metadata, regions = seen.metadata, seen.regions
    across = np.cross(np.gradient(regions.w_r, axis=0), np.gradient(regions.w_r, axis=1))
    weight = np.linalg.norm(across, axis=-1) * regions.w_r[..., 2] * (regions.cover > 0.99)
    signals = _standard_signals(seen)
    alone = metadata.plan.standard_theta_i_deg is not None
    albedos = []
    for image, figures in seen.of("sample"):
        black = seen.mean("background", image[2])
        white = signals.get(0 if alone else image[2])
        if black is None or white is None:
            continue
        scale = eq2.irradiance_ratio(metadata, seen.theta_i(image)) if alone else 1.0
        cosine = np.cos(seen.theta_i(("standard", 0, 0 if alone else image[2])))
        with np.errstate(divide="ignore", invalid="ignore"):
            f = (figures.rate - black) / (white * cosine) * scale
        known = np.isfinite(f)
        if known.any():
            albedos.append(np.pi * np.sum((weight * f)[known]) / np.sum(weight[known]))
    if albedos and np.median(albedos) > ALBEDO:
        yield Finding(
            "brighter_than_white",
            "warning",
            f"the sample would throw back {np.median(albedos):.2g} of the light that falls on it: "
            "sample and standard are exchanged, or the standard is not the certified one.",
        )


def _off_centre(seen: Evidence) -> Iterator[Finding]:
    """The image circle, as stray light fills it, against the calibrated one."""
    camera, rate = seen.metadata.camera, seen.background
    if rate is None or not seen.regions.dark.any():
        return
    light = uniform_filter(rate.value - float(np.median(rate.value[seen.regions.dark])), 3)
    rim = seen.circle & (light < 5 * np.median(light[seen.circle]))
    usual = float(np.median(light[rim])) if rim.any() else 0.0
    noise = float(np.median(np.sqrt(rate.variance(rate.value))[seen.circle])) / 3
    if usual < 8 * noise:
        return
    lit = light > 0.4 * usual
    if not 0.85 < lit.sum() / seen.circle.sum() < 1.15:
        return  # what fills the frame is not the image circle
    rows, columns = np.indices(lit.shape)
    off = [float(axis[lit].mean() - axis[seen.circle].mean()) for axis in (columns, rows)]
    size = float(np.hypot(off[0], off[1]))
    pitch_mm = float(np.mean(camera.pitch_mm))
    deg_per_px = float(np.degrees(pitch_mm / seen.metadata.lens.focal_length_mm))
    if size > max(OFF_CENTRE_PX, OFF_CENTRE_DEG / deg_per_px):
        yield Finding(
            "off_centre",
            "warning",
            f"the image circle lies {off[0]:+.1f} columns and {off[1]:+.1f} rows from where the "
            f"lens calibration has it, {size * deg_per_px:.2g} deg: all directions are off by "
            "that. Calibrate again, or give lens.centre_px.",
        )


CHECKS: tuple[Callable[[Evidence], Iterator[Finding]], ...] = (
    _standard_trend,
    _entry_patch,
    _darker_than_background,
    _albedo,
    _off_centre,
)
