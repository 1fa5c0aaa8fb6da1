"""Joins the images' cells to one list of samples, with their shared errors and their history."""

from __future__ import annotations

from typing import Any

import numpy as np

from gonio.calibration import effects
from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.effects.base import Measured
from gonio.calibration.frames import standard
from gonio.calibration.image_cells import ImageCells
from gonio.dome_map import DomeMap
from gonio.errors import DataError
from gonio.geometry import Directions, angles
from gonio.metadata import Metadata
from gonio.samples import FLAG_ENTRY, FLAG_PARTIAL, BRDFSamples, Cells
from gonio.wording import counted


def samples_of(
    metadata: Metadata,
    pixel_map: PixelMap,
    parts: list[ImageCells],
    dome: DomeMap | None = None,
) -> BRDFSamples:
    """Put the images' cells together, with the errors they share.

    Parameters
    ----------
    metadata : Metadata
    pixel_map : PixelMap
    parts : list of ImageCells
        In the order of channels, incidences and rotations.
    dome : DomeMap, optional
        By which the directions were corrected.

    Raises
    ------
    DataError
        If no pixel is usable.
    """
    parts = [part for part in parts if part.means.shape[1]]
    if not parts:
        raise DataError(
            "no pixel of the session is usable: every one is saturated, too dark or masked."
        )
    counts = [part.means.shape[1] for part in parts]
    rotations = len(metadata.plan.rotations_deg)
    # Every channel has frames of its own, and so a lamp that drifts by itself.
    steps = len(metadata.plan.theta_i_deg)
    step = [part.channel * steps + part.incidence for part in parts]
    image = np.repeat(
        [k * rotations + part.rotation for k, part in zip(step, parts, strict=True)], counts
    )
    incidence = np.repeat(step, counts)
    channels = metadata.plan.channels
    names = np.repeat([channels[part.channel].name for part in parts], counts)
    wavelengths = [channels[part.channel].wavelength_nm for part in parts]
    stated = [w for w in wavelengths if w is not None]
    theta_r, phi_r = angles(np.concatenate([part.centroid for part in parts]))
    value, own, shared, slope = np.concatenate([part.means for part in parts], axis=1)
    ends = np.cumsum([0] + [len(part.members.weight) for part in parts])
    offsets = [part.members.offsets[1:] + end for part, end in zip(parts, ends, strict=False)]
    partial = np.concatenate([part.partial for part in parts])
    entry = np.repeat([part.entry for part in parts], counts)
    alone = metadata.plan.standard_theta_i_deg is not None
    return BRDFSamples(
        directions=Directions(
            np.repeat([part.theta_i for part in parts], counts),
            np.repeat([-part.psi for part in parts], counts),
            theta_r,
            phi_r,
        ),
        value=value,
        u_independent=np.sqrt(own + shared),
        noise_slope=slope,
        u_reference=np.sqrt(shared),
        # Where the standard was taken once every image uses it; that each has a background of its
        # own is left out, which errs on the safe side.
        reference_sharing=len(metadata.plan.theta_i_deg) * rotations if alone else rotations,
        shared=effects.shared_terms(Measured(metadata, pixel_map, parts, image, incidence, dome)),
        solid_angle=np.concatenate([part.solid_angle for part in parts]),
        flags=(partial * FLAG_PARTIAL + entry * FLAG_ENTRY).astype(np.uint8),
        image=image,
        channel=names if len(channels) > 1 or names[0] else None,
        wavelength_nm=(
            np.repeat(stated, counts) if wavelengths and len(stated) == len(wavelengths) else None
        ),
        cells=Cells(
            np.concatenate([part.members.w_r for part in parts]),
            np.concatenate([part.members.weight for part in parts]),
            np.concatenate([[0], *offsets]).astype(np.int64),
        ),
        history=_history(metadata, pixel_map, parts, sum(counts)),
        metadata={
            "instrument": metadata.instrument,
            "sample": metadata.sample,
            "unknown": list(effects.unknown(metadata, pixel_map)),
            "rig": _rig(metadata, pixel_map),
        },
        quantity="BTDF" if metadata.plan.mode == "transmission" else "BRDF",
    )


def _rig(metadata: Metadata, pixel_map: PixelMap) -> dict[str, Any]:
    """What belongs to the rig and its dome, and how the sample was turned in each image.

    The lamp stands at azimuth 0 of the laboratory, in which the dome is at rest: a direction of
    the samples has the azimuth phi + `turn_deg` there.
    """
    geometry, limits, plan = pixel_map.geometry, metadata.limits, metadata.plan
    steps = len(plan.theta_i_deg) * len(plan.channels)
    return {
        "identity": metadata.rig,
        "instrument": metadata.instrument,
        "shape": geometry.shape,
        "mapping": pixel_map.mapping,
        "R_mm": geometry.R,
        "D_mm": geometry.D,
        "slope_error_deg": limits.slope_error_deg,
        "rim_slope_error_deg": limits.rim_slope_error_deg,
        "slope_correlation_deg": limits.slope_correlation_deg,
        "lamp_drift": metadata.lamp.drift,
        "turn_deg": list(plan.rotations_deg) * steps,
    }


def _history(
    metadata: Metadata, pixel_map: PixelMap, parts: list[ImageCells], n: int
) -> tuple[str, ...]:
    geometry = metadata.geometry
    retro = sum(part.n_used for part in parts if part.entry)
    masked = {
        "saturated": sum(part.n_saturated for part in parts),
        "entry patch or dark standard": sum(part.n_reference for part in parts) - retro,
    }
    used = sum(part.n_used for part in parts)
    images = {(part.channel, part.incidence, part.rotation) for part in parts}
    return (
        f"{metadata.instrument}: {metadata.sample}, {counted(len(images), 'image')} of "
        f"{counted(len(metadata.plan.exposures_s), 'exposure')} merged",
        standard.describe(metadata),
        pixel_map.describe(),
        f"masked: theta_r > {geometry.usable_theta_r_deg:g} deg; "
        + "; ".join(f"{k} {v} pixels" for k, v in masked.items()),
        f"{used} pixels in {n} equal-area cells",
        *([f"retro: {retro} of them in the lamp's entry patch, flagged"] if retro else []),
        *effects.notes(metadata, pixel_map),
    )
