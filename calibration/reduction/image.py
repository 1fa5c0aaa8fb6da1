"""The images of a session to cells: eq. (2), mask, thin."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from gonio.calibration.frames import nonlinearity, standard
from gonio.calibration.frames.exposure import Rate
from gonio.calibration.frames.reader import FrameReader
from gonio.calibration.image_cells import ImageCells
from gonio.calibration.reduction import cells
from gonio.calibration.reduction.pixel_table import PixelTable
from gonio.geometry import FloatArray, rotated
from gonio.kernels.threads import default_threads
from gonio.metadata import Metadata
from gonio.samples import Cells

Progress = Callable[[int, int], None]


def cells_of_session(
    table: PixelTable,
    readers: Sequence[FrameReader],
    *,
    retro: bool,
    threads: int | None,
    progress: Progress | None,
) -> list[ImageCells]:
    """Cells of every image, incidence after incidence, channel after channel.

    Parameters
    ----------
    table : PixelTable
    readers : sequence of FrameReader
        One for each channel.
    retro : bool
        Cells of the lamp's entry patch too, after those of the same image.
    threads : int, optional
        Number of worker threads; the result does not depend on it.
    progress : callable, optional
        Called with (images done, images in all).
    """
    plan = readers[0].session.metadata.plan
    tasks = [(reader, k) for reader in readers for k in range(len(plan.theta_i_deg))]
    n_images = len(tasks) * len(plan.rotations_deg)
    images: list[ImageCells] = []
    with ThreadPoolExecutor(threads or default_threads()) as pool:
        work = pool.map(
            lambda task: list(_cells_of_incidence(task[0], task[1], table, retro)), tasks
        )
        for done in work:
            images.extend(done)
            if progress is not None:
                progress(sum(not image.entry for image in images), n_images)
    return images


def _cells_of_incidence(
    reader: FrameReader, incidence: int, table: PixelTable, retro: bool
) -> Iterator[ImageCells]:
    """All rotations of one incidence in one channel, which share background and standard."""
    metadata = reader.session.metadata
    ref = reader.reference(incidence)
    for rotation in range(len(metadata.plan.rotations_deg)):
        measured = reader.rate("sample", rotation, incidence)
        for entry in (False, True) if retro else (False,):
            yield _cells_of_image(
                metadata, table, ref, measured, reader.channel, incidence, rotation, entry=entry
            )


def _cells_of_image(
    metadata: Metadata,
    table: PixelTable,
    ref: standard.Reference,
    measured: Rate,
    channel: int,
    incidence: int,
    rotation: int,
    *,
    entry: bool,
) -> ImageCells:
    """Cells of one image, outside the lamp's entry patch or inside it."""
    f = standard.brdf(measured, ref)
    # Splits and weights follow a median-filtered guide, not the noise that is averaged.
    guide = cells.median(f)
    own, shared = standard.variances(measured, ref, guide)
    wanted = ref.entry if entry else ref.usable
    good = wanted & ~measured.saturated & (measured.time > 0)
    safe_time = np.where(good, measured.time, 1.0)
    # sum of counts over sum of (time x standard): optimal for shot noise and free of it.
    weight = np.where(good, safe_time / np.where(good, ref.f_per_rate, 1.0), 0.0)
    slope = ref.f_per_rate / safe_time
    at = table.index
    weight_s, guide_s = weight.ravel()[at], guide.ravel()[at]
    columns = np.stack([image.ravel()[at] for image in (f, own, shared, slope, slope * guide)])
    total_variance = np.maximum(columns[1] + columns[2], 1e-300)
    first, last = cells.split(table.keys, guide_s, total_variance, weight_s)
    means, centroid, solid_angle, partial = cells.gather(
        first, last, weight_s, columns, table.w_r, table.solid_angle
    )
    means = _at_own_value(means)
    # A uniform disc of half-angle a has the standard deviation a/2 on each axis.
    cone = float(np.radians(metadata.lamp.half_angle_deg or 0.0)) / 2
    w_m, share, offsets = cells.members(first, last, weight_s, table.points, centroid, cone)
    psi = np.radians(metadata.plan.rotations_deg[rotation])
    bend = None
    if metadata.camera.u_nonlinearity_per_decade:
        change = nonlinearity.change_of_f(f, measured, ref, metadata)
        bend = cells.mean_of(first, last, weight_s, change.ravel()[at][:, None])[:, 0]
    return ImageCells(
        theta_i=float(np.radians(metadata.plan.theta_i_deg[incidence])),
        psi=float(psi),
        incidence=incidence,
        rotation=rotation,
        means=means,
        centroid=rotated(centroid, psi),
        at=cells.mean_of(first, last, weight_s, table.at),
        stray=cells.mean_of(
            first,
            last,
            weight_s,
            np.stack([image.ravel()[at] for image in (ref.stray, ref.standard_stray)], axis=1),
        ),
        solid_angle=solid_angle,
        partial=partial,
        members=Cells(rotated(w_m, psi), share, offsets),
        n_used=int(np.count_nonzero(weight_s > 0)),
        n_saturated=int(np.count_nonzero((wanted & measured.saturated).ravel()[at])),
        n_reference=0 if entry else int(np.count_nonzero(~ref.usable.ravel()[at])),
        entry=entry,
        channel=channel,
        bend=bend,
    )


def _at_own_value(means: FloatArray) -> FloatArray:
    """Variances of the cells at their own value instead of at the guide.

    The fit moves them from there to the model's value; what is left of the guide's own noise
    would otherwise bias it by a part in 10^5.
    """
    value, own, shared, slope, slope_times_guide = means
    value = np.maximum(value, 0.0)
    guide = slope_times_guide / slope
    own = np.maximum(own + slope * (value - guide), 0.1 * own)
    ratio = value / np.where(guide > 0, guide, 1.0)
    return np.stack([means[0], own, shared * np.clip(ratio, 0.7, 1.4) ** 2, slope])
