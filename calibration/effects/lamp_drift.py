"""The lamp's output in the images of sample, standard and background."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gonio.calibration.effects.base import Effect, Measured, StatedQuantity, TermRecord, Unknown
from gonio.shared_term import SharedTerm

SAMPLE = TermRecord("lamp, sample", "lamp output, image to image", belongs_to="session")
STANDARD = TermRecord(
    "lamp, standard",
    "lamp output when the standard was taken",
    averages=True,
    belongs_to="session",
)
BACKGROUND = TermRecord(
    "lamp, background",
    "lamp output when the background was taken: stray light that remains",
    averages=True,
    belongs_to="session",
)
BACKGROUND_2 = TermRecord(
    "lamp, background 2",
    "the same for the background that belongs to the standard",
    averages=True,
    belongs_to="session",
)


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """One draw for every image of sample, standard and background.

    With outputs 1 + m, 1 + s and 1 + b, f by eq. (2) changes by m (f + e) - s f (1 + r) -
    b (e - f r), where e is the stray light as f and r the stray light in the standard's image as a
    part of its signal: drift between sample and background leaves stray light behind.
    """
    plan, drift = measured.metadata.plan, measured.metadata.lamp.drift
    if not drift:
        return
    incidence = measured.incidence
    stray, share = measured.stray
    # Background and standard are averaged over their repeats and serve every rotation.
    averaged = drift / np.sqrt(plan.repeats)
    alone = plan.standard_theta_i_deg is not None
    group = np.zeros_like(incidence) if alone else incidence
    left = stray if alone else stray - measured.value * share
    yield SAMPLE.shared(drift, group=measured.image, offset=drift * stray)
    yield STANDARD.shared(averaged, group=group, profile=1 + share)
    yield BACKGROUND.shared(group=incidence, offset=-averaged * left)
    if alone:
        yield BACKGROUND_2.shared(averaged, group=group, profile=share)


EFFECT = Effect(
    key="lamp_drift",
    order=80,
    title="drift of the lamp",
    text="The output of the lamp differs from image to image. In an image of the sample it is a "
    "factor; in one of the standard a factor on all rotations at its incidence, and in one of the "
    "background stray light that is left. Repeats of standard and background average the last two.",
    records=(SAMPLE, STANDARD, BACKGROUND, BACKGROUND_2),
    terms=terms,
    unknown=(Unknown("lamp drift", "lamp.drift"),),
    quantities=(StatedQuantity("drift of the lamp, image to image", "lamp.drift"),),
)
