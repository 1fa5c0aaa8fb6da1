"""Raw frames to BRDF samples: merge, eq. (2), eq. (3), mask, thin."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gonio.calibration import cells, lens, reflector, standard
from gonio.calibration.exposure import Rate, average, merge
from gonio.calibration.shared_terms import shared_terms
from gonio.errors import DataError
from gonio.geometry import Directions, FloatArray, angles, equal_area, rotated, unit_vectors
from gonio.kernels.threads import default_threads
from gonio.metadata import Metadata
from gonio.samples import FLAG_PARTIAL, BRDFSamples, Cells
from gonio.session import Session

Progress = Callable[[int, int], None]


def reduce(
    session: Session | str | Path,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
) -> BRDFSamples:
    """BRDF samples with uncertainties from a complete session.

    Parameters
    ----------
    session : Session or path
        Raw frames with their metadata.
    threads : int, optional
        Images are reduced in so many threads; the result does not depend on it.
    progress : callable, optional
        Called with (images done, images in all).

    Returns
    -------
    BRDFSamples
        Adaptive cells with their members, in the frame of the sample.

    Raises
    ------
    DataError
        If frames are missing or damaged, or no pixel is usable.

    Notes
    -----
    Each pixel is linearised and merged over its exposures, turned into a BRDF by Ward's eq. (2),
    placed by eq. (3), masked (saturated, outside the image circle, beyond the usable rim, in the
    lamp's entry patch) and averaged with its neighbours in equal-area cells.
    """
    if not isinstance(session, Session):
        session = Session.open(session)
    session.require_complete()
    table = _pixel_table(session.metadata)
    plan = session.metadata.plan
    incidences = range(len(plan.theta_i_deg))
    n_images = len(incidences) * len(plan.rotations_deg)
    parts: list[Part] = []
    with ThreadPoolExecutor(threads or default_threads()) as pool:
        work = pool.map(lambda i: list(_reduce_incidence(session, table, i)), incidences)
        for done in work:
            parts.extend(done)
            if progress is not None:
                progress(len(parts), n_images)
    samples = _collect(session.metadata, parts)
    return replace(samples, metadata={**samples.metadata, "session": str(session.path)})


@dataclass(frozen=True)
class _PixelTable:
    """Pixels of the usable hemisphere in Morton order, laboratory frame."""

    index: NDArray[np.int64]  # flat index in the frame
    keys: NDArray[np.int64]
    w_r: FloatArray  # (n, 3) centres, by eq. (3)
    points: FloatArray  # (n, 4, 3) Gauss points of each pixel's area, by eq. (3)
    solid_angle: FloatArray  # (n,) sr on the side of the sample
    theta_r: FloatArray  # (rows, columns), NaN outside the image circle


@dataclass(frozen=True)
class Part:
    """The cells of one image, frame of the sample."""

    theta_i: float
    psi: float
    incidence: int
    rotation: int
    means: FloatArray  # value, own variance, shared variance, noise slope
    centroid: FloatArray
    shift: FloatArray
    solid_angle: FloatArray
    partial: NDArray[np.bool_]
    members: Cells
    n_used: int
    n_saturated: int
    n_reference: int


def _pixel_table(metadata: Metadata) -> _PixelTable:
    camera, geometry = metadata.camera, metadata.geometry
    columns, rows = np.meshgrid(np.arange(camera.columns), np.arange(camera.rows))
    theta_r, w_r = _mapped(metadata, columns, rows)
    usable = theta_r <= np.radians(geometry.usable_theta_r_deg)
    index = np.flatnonzero(usable)
    if len(index) == 0:
        raise DataError(
            f"no pixel lies inside theta_r <= {geometry.usable_theta_r_deg:g} deg; "
            "check the lens calibration and the pixel pitch in session.json."
        )
    x, y = equal_area(w_r.reshape(-1, 3)[index])
    keys = cells.morton_keys(x, y)
    order = np.argsort(keys, kind="stable")
    index = index[order]
    # Gauss-Legendre points of order 2 in each direction integrate over the pixel's area.
    half = 0.5 / np.sqrt(3)
    points = np.stack(
        [
            _mapped(metadata, columns.ravel()[index] + dx, rows.ravel()[index] + dy)[1]
            for dx in (-half, half)
            for dy in (-half, half)
        ],
        axis=1,
    )
    return _PixelTable(
        index=index,
        keys=keys[order],
        w_r=np.ascontiguousarray(w_r.reshape(-1, 3)[index]),
        points=np.ascontiguousarray(points),
        solid_angle=_solid_angles(metadata, columns.ravel()[index], rows.ravel()[index]),
        theta_r=theta_r,
    )


def _mapped(
    metadata: Metadata, columns: ArrayLike, rows: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """theta_r and unit vectors of (fractional) pixels, by the lens and eq. (3)."""
    x, y = lens.pixel_positions(metadata.camera, columns, rows)
    theta_c, phi_c = lens.camera_angles(metadata.lens, x, y)
    R, D = metadata.geometry.R, metadata.geometry.D
    theta_r, phi_r = reflector.reflected_angles(theta_c, phi_c, R=R, D=D)
    return theta_r, unit_vectors(theta_r, phi_r)


def _solid_angles(metadata: Metadata, columns: ArrayLike, rows: ArrayLike) -> FloatArray:
    """Solid angles of pixels on the side of the sample, sr."""
    camera, geometry = metadata.camera, metadata.geometry
    x, y = lens.pixel_positions(camera, columns, rows)
    theta_c, phi_c = lens.camera_angles(metadata.lens, x, y)
    # The lens is close to equal angles per pixel: sin(theta)/r dtheta/dr is taken numerically.
    step = 1e-4
    radius = np.hypot(x, y)
    scale = 1 + step / np.maximum(radius, step)
    further, _ = lens.camera_angles(metadata.lens, x * scale, y * scale)
    per_area = np.sin(theta_c) * (further - theta_c) / (step * np.maximum(radius, step))
    solid_angle = per_area * camera.pitch_mm[0] * camera.pitch_mm[1]
    ratio = reflector.solid_angle_ratio(theta_c, phi_c, R=geometry.R, D=geometry.D)
    return np.asarray(solid_angle * ratio)


def _reduce_incidence(session: Session, table: _PixelTable, incidence: int) -> Iterator[Part]:
    """All rotations of one incidence, which share background and standard."""
    metadata = session.metadata
    plan, camera = metadata.plan, metadata.camera

    def taken(role: str, take: int) -> Rate:
        return merge(session.bracket(role, take, incidence), plan.exposures_s, camera)

    ref = standard.reference(
        average([taken("background", k) for k in range(plan.repeats)]),
        average([taken("standard", k) for k in range(plan.repeats)]),
        metadata.standard,
        table.theta_r,
        dark_e_per_s=camera.dark_e_per_s,
    )
    for rotation in range(len(plan.rotations_deg)):
        yield _reduce_image(metadata, table, ref, taken("sample", rotation), incidence, rotation)


def _reduce_image(
    metadata: Metadata,
    table: _PixelTable,
    ref: standard.Reference,
    measured: Rate,
    incidence: int,
    rotation: int,
) -> Part:
    f = standard.brdf(measured, ref)
    # Splits and weights follow a median-filtered guide, not the noise that is averaged.
    guide = cells.median(f)
    own, shared = standard.variances(measured, ref, guide)
    good = ref.usable & ~measured.saturated & (measured.time > 0)
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
    w_m, share, offsets = cells.members(first, last, weight_s, table.points, centroid)
    geometry = metadata.geometry
    shift = reflector.mapping_error(centroid, R=geometry.R, D=geometry.D, shape=geometry.shape)
    psi = np.radians(metadata.plan.rotations_deg[rotation])
    return Part(
        theta_i=float(np.radians(metadata.plan.theta_i_deg[incidence])),
        psi=float(psi),
        incidence=incidence,
        rotation=rotation,
        means=means,
        centroid=rotated(centroid, psi),
        shift=rotated(shift, psi),
        solid_angle=solid_angle,
        partial=partial,
        members=Cells(rotated(w_m, psi), share, offsets),
        n_used=int(np.count_nonzero(weight_s > 0)),
        n_saturated=int(np.count_nonzero(measured.saturated.ravel()[at])),
        n_reference=int(np.count_nonzero(~ref.usable.ravel()[at])),
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


def _collect(metadata: Metadata, parts: list[Part]) -> BRDFSamples:
    """Put the images' cells together, with the errors they share."""
    parts = [part for part in parts if part.means.shape[1]]
    if not parts:
        raise DataError(
            "no pixel of the session is usable: every one is saturated, too dark or masked."
        )
    counts = [part.means.shape[1] for part in parts]
    rotations = len(metadata.plan.rotations_deg)
    image = np.repeat([p.incidence * rotations + p.rotation for p in parts], counts)
    incidence = np.repeat([part.incidence for part in parts], counts)
    theta_r, phi_r = angles(np.concatenate([part.centroid for part in parts]))
    value, own, shared, slope = np.concatenate([part.means for part in parts], axis=1)
    ends = np.cumsum([0] + [len(part.members.weight) for part in parts])
    offsets = [part.members.offsets[1:] + end for part, end in zip(parts, ends, strict=False)]
    partial = np.concatenate([part.partial for part in parts])
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
        reference_sharing=rotations,
        shared=shared_terms(metadata, parts, image, incidence),
        solid_angle=np.concatenate([part.solid_angle for part in parts]),
        flags=(partial * FLAG_PARTIAL).astype(np.uint8),
        image=image,
        cells=Cells(
            np.concatenate([part.members.w_r for part in parts]),
            np.concatenate([part.members.weight for part in parts]),
            np.concatenate([[0], *offsets]).astype(np.int64),
        ),
        history=_history(metadata, parts, sum(counts)),
        metadata={"instrument": metadata.instrument, "sample": metadata.sample},
    )


def _history(metadata: Metadata, parts: list[Part], n: int) -> tuple[str, ...]:
    geometry = metadata.geometry
    masked = {
        "saturated": sum(part.n_saturated for part in parts),
        "entry patch or dark standard": sum(part.n_reference for part in parts),
    }
    used = sum(part.n_used for part in parts)
    return (
        f"{metadata.instrument}: {metadata.sample}, {len(parts)} images of "
        f"{len(metadata.plan.exposures_s)} exposures merged",
        f"eq. (2) with a standard of {metadata.standard.reflectance:g}",
        f"eq. (3) with R = {geometry.R:g} mm, D = {geometry.D:g} mm ({geometry.shape})",
        f"masked: theta_r > {geometry.usable_theta_r_deg:g} deg; "
        + "; ".join(f"{k} {v} pixels" for k, v in masked.items()),
        f"{used} pixels in {n} equal-area cells",
    )
