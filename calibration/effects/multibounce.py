"""Light that reaches the sample a second time, by way of dome and lens.

The irradiance of a surface of albedo rho grows by 1 + g rho, and eq. (2) returns
f (1 + g rho)/(1 + g rho_std): a dark sample comes out low by g rho_std. Where g is known with its
uncertainty the reduction corrects for it. The sample's albedo comes from its own image.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from gonio.calibration.effects.base import Effect, Measured, StatedQuantity, TermRecord, Unknown
from gonio.calibration.frames.certified import total_reflectance
from gonio.calibration.image_cells import ImageCells
from gonio.geometry import FloatArray
from gonio.metadata import Metadata
from gonio.shared_term import SharedTerm

# Without a correction it is the same in every simulated session, with one it is drawn.
RECORD = TermRecord("multi-bounce", "light that reaches the sample twice", constant=True)


def is_corrected(metadata: Metadata) -> bool:
    """Whether g and its uncertainty are stated. There is no correction in transmission."""
    limits = metadata.limits
    is_stated = bool(limits.multibounce) and limits.u_multibounce is not None
    return is_stated and metadata.plan.mode == "reflection"


def image_albedo(parts: Sequence[ImageCells]) -> tuple[float, float]:
    """Albedo that one image shows for its incidence, and its standard uncertainty.

    The integral of f cos(theta_r) over the cells. Directions that no cell covers, beyond the rim
    and in masked pixels, get the median f of the image, and half of that as its uncertainty.

    Parameters
    ----------
    parts : sequence of ImageCells
        The image's cells.
    """
    value = np.concatenate([part.means[0] for part in parts])
    if not len(value):
        return 0.0, 1.0
    cos = np.concatenate([part.centroid[:, 2] for part in parts])
    projected = cos * np.concatenate([part.solid_angle for part in parts])
    unseen = max(np.pi - float(np.sum(projected)), 0.0) * max(float(np.median(value)), 0.0)
    return float(np.clip(np.sum(projected * value) + unseen, 0.0, 1.0)), 0.5 * unseen


def corrected(metadata: Metadata, parts: list[ImageCells]) -> list[ImageCells]:
    """The cells with f times (1 + g rho_std)/(1 + g rho), and what is left of the error noted."""
    if not is_corrected(metadata):
        return parts
    g, u_g = metadata.limits.multibounce or 0.0, metadata.limits.u_multibounce or 0.0
    rho_std = total_reflectance(metadata.standard)
    images: dict[tuple[int, int, int], list[ImageCells]] = {}
    for part in parts:
        images.setdefault((part.channel, part.incidence, part.rotation), []).append(part)
    albedos = {image: image_albedo(own) for image, own in images.items()}
    done = []
    for part in parts:
        apparent, u_rho = albedos[part.channel, part.incidence, part.rotation]
        # apparent = rho (1 + g rho)/(1 + g rho_std), of which rho is the positive root.
        both = apparent * (1 + g * rho_std)
        rho = 2 * both / (1 + np.sqrt(1 + 4 * g * both))
        factor = (1 + g * rho_std) / (1 + g * rho)
        # f is linear in the counts: its variances scale with the square.
        means = part.means * np.array([factor, factor**2, factor**2, factor])[:, None]
        left = np.hypot(u_g * (rho_std - rho), g * u_rho)
        bend = None if part.bend is None else part.bend * factor
        stray = part.stray * [factor, 1.0]
        done.append(replace(part, means=means, stray=stray, left=float(left), bend=bend))
    return done


def terms(measured: Measured) -> Iterator[SharedTerm]:
    """The error that the correction leaves, or the whole error if there is no correction."""
    metadata, images = measured.metadata, measured.images
    g = metadata.limits.multibounce
    if not g:
        return
    # The simulator draws g only if its uncertainty is stated.
    constant = metadata.limits.u_multibounce is None
    if not is_corrected(metadata):
        # For any albedo the error is at most this.
        yield RECORD.shared(g * total_reflectance(metadata.standard), constant=constant)
        return
    left: FloatArray = np.repeat(
        [part.left for part in images], [part.means.shape[1] for part in images]
    )
    largest = float(left.max(initial=0.0))
    if largest:
        meaning = f"{RECORD.meaning}, after correction"
        yield RECORD.shared(largest, meaning=meaning, profile=left / largest, constant=constant)


def notes(metadata: Metadata) -> tuple[str, ...]:
    """What was done about it, for the history."""
    limits = metadata.limits
    if is_corrected(metadata):
        return (f"multi-bounce corrected with g = {limits.multibounce:g} +- "
                f"{limits.u_multibounce:g}",)  # fmt: skip
    return ()


EFFECT = Effect(
    key="multibounce",
    order=90,
    title="light that returns to the sample",
    text="Light from the sample comes back to it by way of dome and lens: the irradiance of a "
    "surface of albedo rho grows by 1 + g rho. If g is stated with its uncertainty, the "
    "reduction corrects for it, with the albedo that each image shows.",
    records=(RECORD,),
    terms=terms,
    unknown=(Unknown("light that reaches the sample twice", "limits.multibounce"),),
    quantities=(
        StatedQuantity("multi-bounce g", "limits.multibounce"),
        StatedQuantity("uncertainty of the multi-bounce g", "limits.u_multibounce"),
    ),
    notes=notes,
    corrected=corrected,
)
