"""Faults that one frame or one bracket of exposures gives away."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator

import numpy as np

from gonio.calibration.faults.evidence import Evidence, Finding, Image
from gonio.calibration.faults.frame_statistics import Figure, middle
from gonio.metadata import Camera

SIGMAS = 5.0  # that a figure must stand out by
DARK_DN = 0.5  # counts by which the dark level may be off
ZEROS = 0.01  # share of counts at 0
GROWTH = 0.05  # by which a signal may fail to grow as the exposure
SATURATED = 0.005  # share of saturated pixels


def _missing_background(seen: Evidence) -> Iterator[Finding]:
    camera = seen.metadata.camera
    for image, figures in seen.of("background"):
        if min(figures.zeros) == 1:
            # A camera without a black level may be that dark.
            possible = camera.black_dn <= 3 * camera.noise_dn
            yield Finding(
                "missing_background",
                "warning" if possible else "error",
                f"{seen.name(image)}: every count is 0; it was not taken. Take it without the "
                "sample, with the lamp where it stands.",
            )


def _twins(seen: Evidence) -> Iterator[Finding]:
    """The same frame twice, noise and all."""
    places = defaultdict(list)
    for image, figures in seen.of("background", "standard", "sample"):
        for k, mark in enumerate(figures.prints):
            if mark is not None:
                places[mark].append((image, k))
    twins = [place for place in places.values() if len(place) > 1]
    for place in twins[:1]:
        (a, j), (b, k) = place[:2]
        code = "missing_background" if "background" in (a[0], b[0]) else "same_frame"
        more = f" There are {len(twins)} such pairs." if len(twins) > 1 else ""
        yield Finding(
            code,
            "error",
            f"{seen.name(a, j)}, and {seen.name(b, k)}, are one and the same frame, noise and "
            f"all.{more}",
        )


def _clipped(seen: Evidence) -> Iterator[Finding]:
    cut = [
        (share, image, k)
        for image, figures in seen.of("background", "standard", "sample")
        for k, share in enumerate(figures.zeros)
        if share > ZEROS and min(figures.zeros) < 1
    ]
    if cut:
        share, image, k = max(cut, key=lambda each: each[0])
        yield Finding(
            "clipped_at_zero",
            "warning",
            f"{seen.name(image, k)}: {share:.0%} of the counts are 0, as in {len(cut)} frames; "
            "the black level is too low for the read noise and dark pixels come out too bright. "
            "Raise the camera's offset.",
        )


def _dark_level(seen: Evidence) -> Iterator[Finding]:
    """The level well outside the image circle against black level and dark current."""
    camera, times = seen.metadata.camera, seen.metadata.plan.exposures_s
    off: list[tuple[float, Image, int, float]] = []
    for image, figures in seen.of("background", "standard", "sample"):
        for k, level in enumerate(figures.dark_dn):
            if level is None or figures.zeros[k] > ZEROS:
                continue
            dark, allowed = _dark_dn(camera, times[k])
            excess = level[0] - camera.black_dn - dark
            if abs(excess) > max(DARK_DN, SIGMAS * level[1], allowed):
                off.append((abs(excess), image, k, excess))
    if not off:
        return
    _, image, k, excess = max(off, key=lambda each: each[0])
    rate = excess / camera.gain_dn_per_e * len(times) / sum(times)
    white = seen.mean("standard", 0)
    effect = ""
    if white is not None and middle(white) > 0 and camera.gamma == 1:
        share = abs(rate) / middle(white)
        effect = f", {share:.2g} of the white standard's light if it is in one image only"
    yield Finding(
        "dark_drift",
        "warning",
        f"{seen.name(image, k)}: outside the image circle the level is {excess:+.3g} counts from "
        f"black level and dark current{effect}; {len(off)} frames are off. Let the camera warm up, "
        "or correct camera.black_dn and camera.dark_e_per_s.",
    )


def _dark_dn(camera: Camera, time_s: float) -> tuple[float, float]:
    """Counts above black by the dark current, and what they may be off by."""
    electrons = camera.dark_e_per_s * time_s
    if camera.gamma == 1:
        return camera.gain_dn_per_e * electrons, 0.05 * camera.gain_dn_per_e * electrons
    # The mean of a response that is steep at zero is not the response to the mean.
    most = camera.gain_dn_per_e * camera.full_well_e * (
        max(electrons, 1.0) / camera.full_well_e
    ) ** camera.gamma  # fmt: skip
    return most / 2, most


def _exposures(seen: Evidence) -> Iterator[Finding]:
    """Counts must grow as the exposure does."""
    times = seen.metadata.plan.exposures_s
    wrong: list[tuple[float, Image, int, float]] = []
    for image, figures in seen.of("standard", "sample"):
        for k, figure in enumerate(figures.growth, start=1):
            expected = times[k] / times[k - 1]
            if figure is not None and _stands_out(figure, expected, GROWTH * expected):
                wrong.append((abs(np.log(max(figure[0], 1e-6) / expected)), image, k, figure[0]))
    if not wrong:
        return
    _, image, k, growth = max(wrong, key=lambda each: each[0])
    expected = times[k] / times[k - 1]
    text = (
        f"{seen.name(image, k)}: signals are {growth:.3g} times those of "
        f"{times[k - 1] * 1e3:g} ms, not {expected:.3g}"
    )
    images = {each[1] for each in wrong}
    if growth <= 1:
        yield Finding(
            "exposure_order",
            "error",
            f"{text}: frames are exchanged, or plan.exposures_s is not what the camera did.",
        )
    else:
        yield Finding(
            "not_linear",
            "warning",
            f"{text}, as in {len(images)} images: the response is not what camera.gamma = "
            f"{seen.metadata.camera.gamma:g} says, or plan.exposures_s is not what the camera "
            "did.",
        )


def _stands_out(figure: Figure, expected: float, tolerance: float) -> bool:
    return abs(figure[0] - expected) > max(tolerance, SIGMAS * figure[1])


def _depth(seen: Evidence) -> Iterator[Finding]:
    """Counts that stop early, and counts in steps: fewer bits than session.json says."""
    camera = seen.metadata.camera
    images = seen.of("background", "standard", "sample")
    cut = [
        (figures.cut_off_dn, image) for image, figures in images if figures.cut_off_dn is not None
    ]
    if cut:
        count, image = max(cut, key=lambda each: each[0])
        bits = f"; {count} is what 8 bits hold" if count == 255 else ""
        yield Finding(
            "saturates_early",
            "error",
            f"{seen.name(image)}: counts stop at {count}, and camera.saturation_dn is "
            f"{camera.saturation_dn}{bits}. Saturated pixels would pass for good ones: correct "
            "session.json.",
        )
    steps = {figures.step for _, figures in seen.of("standard", "sample")}
    step = min(steps, default=1)
    if step > 1:
        yield Finding(
            "coarse_counts",
            "warning",
            f"all counts are multiples of {step} apart: frames of fewer bits in a wider container. "
            f"Divide them by {step}, with gain, black level and saturation, so that their rounding "
            "is known.",
        )


def _saturation(seen: Evidence) -> Iterator[Finding]:
    for role in ("background", "standard", "sample"):
        full = [(figures.saturated, image) for image, figures in seen.of(role)]
        full = [each for each in full if each[0] > SATURATED]
        if full:
            share, image = max(full, key=lambda each: each[0])
            yield Finding(
                f"saturated_{role}",
                "error" if share > 0.5 else "warning",
                f"{seen.name(image)}: {share:.1%} of the pixels are saturated in the shortest "
                f"exposure, or where none is expected; so are some in {len(full)} images. They "
                "are left out: take a shorter exposure.",
            )


def _bad_pixels(seen: Evidence) -> Iterator[Finding]:
    for kind, why in (
        ("dead", "see less than a fifth of what their neighbours see of the standard"),
        ("hot", "are far brighter than their neighbours in the background"),
    ):
        masks = list(seen.bad[kind].values())
        # A pixel at the edge of the lit spot may look dead, but not from every incidence.
        often = np.sum(masks, axis=0) > 0.7 * len(masks)
        n = int(np.count_nonzero(often))
        if n:
            yield Finding(f"{kind}_pixels", "warning", f"{n} pixels {why}; they are left out.")


CHECKS: tuple[Callable[[Evidence], Iterator[Finding]], ...] = (
    _missing_background,
    _twins,
    _exposures,
    _depth,
    _saturation,
    _dark_level,
    _clipped,
    _bad_pixels,
)
