"""The actual positions of dome and camera, from the spots of a mirror: `gonio calibrate alignment`.

A mirror in place of the sample sends the lamp's beam into known directions; the spots tell which
pixels see them. Fitted by least squares, the exact mapping being right: R, D, the pupil's offset,
the image centre, the camera's azimuth, and tilt and azimuth of a wedge.

**What the spots determine.** Directions do not change if all lengths grow by one factor. Without a
known length R is held, and the other lengths are multiples of it. On a sphere only D - pupil_y
shows (the camera's distance from the centre): pupil_y is held, and D is that distance. In an
ellipsoid its foci tell D apart from pupil_y, but only off the lamp's plane: a level mirror is not
enough, a wedge of 10 deg or more that is turned with the holder is. A measured separation of camera
and target does it on either. All else shows with a level mirror already if the lamp stands on both
sides; with the lamp on one side only, everything is three to ten times less sure. Twelve images,
lamp at +-20 and +-50 deg, a wedge of 15 deg turned by 0, 120 and 240 deg, determine all of it.

The frame is that of the mirror in its holder: z is the normal of a level mirror, or the axis about
which the wedge is turned, and the lamp's angles count from it. The lens is taken as calibrated; the
covariance of its quantities is propagated if it is known.

References
----------
Ward 1992, "Measuring and Modeling Anisotropic Reflection", Computer Graphics 26(2), section 3.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.dome.spot_residuals import WEDGE, Length, Task
from gonio.calibration.dome.spots import Spot
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import FloatArray
from gonio.metadata import Geometry, Limits, Uncertain

# Units of the quantities that are not lengths in mm.
UNITS = {
    **dict.fromkeys(("camera_azimuth", *WEDGE), "deg"),
    **dict.fromkeys(("centre_x", "centre_y"), "px"),
    **dict.fromkeys(("k1", "k2", "k3", "k4"), ""),
}

# If the spots determine only a combination of quantities, the first of these in it is held.
_HELD_FIRST = ("R", "pupil_y", "wedge_azimuth", "wedge", "camera_azimuth", "pupil_x", "centre_x",
               "pupil_z", "centre_y", "D")  # fmt: skip
_REJECT_SD = 6.0  # spots farther off than that, in robust standard deviations, are dropped
_MISFIT = 5.0  # residuals over their stated size from which a mirrored picture is tried
_WORST_DEG = 2.0  # rms of the residuals; no dome is so bad
_FLIPS = {
    "left and right": np.array([-1, 1]),
    "top and bottom": np.array([1, -1]),
}


@dataclass(frozen=True)
class Alignment:
    """A fitted alignment.

    Parameters
    ----------
    pixel_map : PixelMap
        The exact mapping with the fitted values.
    values : mapping
        Value of every quantity in its unit: mm, deg, px.
    sd : mapping
        Its standard uncertainty; None if the spots do not determine it.
    uncertain : Uncertain
        Joint covariance of the determined quantities of the mapping.
    held_for : mapping
        For each quantity that is not determined: the quantities that it cannot be separated from.
    residuals_px : ndarray, shape (n, 2)
        Spot less prediction.
    names : tuple of str
        The images of the spots, in the order of the residuals.
    dropped : mapping
        Image and reason of spots that were found and not used.
    chi2 : float
    dof : int
    scale : float
        Factor by which the uncertainties were widened because the residuals ask for it.
    """

    pixel_map: PixelMap
    values: Mapping[str, float]
    sd: Mapping[str, float | None]
    uncertain: Uncertain
    held_for: Mapping[str, tuple[str, ...]]
    residuals_px: FloatArray
    names: tuple[str, ...]
    dropped: Mapping[str, str]
    chi2: float
    dof: int
    scale: float

    @property
    def rms_px(self) -> float:
        """Root of the mean square of the residuals, px on each axis."""
        return float(np.sqrt(np.mean(self.residuals_px**2)))


def fit(
    spots: Sequence[Spot],
    nominal: PixelMap,
    *,
    limits: Limits | None = None,
    R: Length | None = None,
    separation: Length | None = None,
) -> Alignment:
    """Fit the alignment to the spots of a mirror.

    Parameters
    ----------
    spots : sequence of Spot
        From `gonio.calibration.dome.spots.find_spots`, of one or several sessions.
    nominal : PixelMap
        Camera, lens and the geometry from which the fit starts: off by less than some mm and deg.
    limits : Limits, optional
        Influence quantities: the dome's slope errors, which move neighbouring spots together.
    R, separation : Length, optional
        Lengths that are known: the dome's R; the distance from camera to target.

    Returns
    -------
    Alignment

    Raises
    ------
    DataError
        If there are too few spots, the picture is mirrored, or the fit leads nowhere.
    ConfigurationError
        If spots come from wedges of different tilt.

    Notes
    -----
    The residuals are taken in direction, on the two tangents nearest to x and y, and weighted with
    their whole covariance: noise of the centroids, and slope errors e of the dome that turn
    directions by 2 e and are correlated over a length. Where chi-squared exceeds its
    degrees of freedom all uncertainties are widened by the root of their ratio.
    """
    wedges = sorted({round(float(np.degrees(spot.wedge)), 6) for spot in spots} - {0.0})
    if len(wedges) > 1:
        raise ConfigurationError(
            f"the sessions hold wedges of {' and '.join(f'{w:g}' for w in wedges)} deg; give those "
            "of one wedge, with or without those of a level mirror.",
            value=wedges,
        )
    start = replace(nominal, mapping="exact")
    if R is not None:
        start = _scaled(start, R.value / start.geometry.R)
    task = Task(tuple(spots), start, limits or Limits(), R, separation)
    free, held_for = _determined(task)
    _require(len(spots), free)
    first = _solve(task, free)
    _check_picture(first)
    solution, dropped = _robust(first)
    return _result(solution, held_for, dropped)


@dataclass(frozen=True)
class _Solution:
    task: Task
    free: tuple[str, ...]
    x: FloatArray
    jacobian: FloatArray
    white: FloatArray  # whitened residuals of the spots, (n, 2)
    chi2: float
    at_bound: tuple[str, ...]

    @property
    def state(self) -> dict[str, float]:
        return dict(zip(self.free, self.x.tolist(), strict=True))

    @property
    def dof(self) -> int:
        return self.white.size + self.task.n_beside - len(self.free)


def _useful(task: Task) -> dict[str, float]:
    """Largest useful uncertainty of each quantity; with a larger one it is not determined."""
    geometry, camera = task.start.geometry, task.start.camera
    useful = dict.fromkeys(("pupil_x", "pupil_y", "pupil_z"), geometry.D / 2)
    useful |= {"R": geometry.R / 10, "D": geometry.D / 2}
    useful |= dict.fromkeys(("centre_x", "centre_y"), max(camera.rows, camera.columns) / 20)
    useful |= {"camera_azimuth": 30.0, "wedge": 2.0, "wedge_azimuth": 30.0}
    return dict(zip(task.lens.names, (30 * task.lens.sd).tolist(), strict=True)) | useful


def _determined(task: Task) -> tuple[tuple[str, ...], dict[str, tuple[str, ...]]]:
    """Quantities that the spots determine, and what each other one cannot be separated from."""
    free, held_for = list(task.names), {}
    useful = _useful(task)
    while free:
        scale = np.array([useful[name] for name in free])
        _, values, vectors = np.linalg.svd(_jacobian(task, free) * scale)
        values = np.concatenate([values, np.zeros(len(free) - len(values))])
        if values[-1] >= 1:
            break
        taking_part = np.abs(vectors[-1]) > 0.1 * np.abs(vectors[-1]).max()
        together = [name for name, takes in zip(free, taking_part, strict=True) if takes]
        first = next((name for name in _HELD_FIRST if name in together), together[0])
        held_for[first] = tuple(name for name in together if name != first)
        free.remove(first)
    return tuple(free), held_for


def _jacobian(task: Task, free: Sequence[str]) -> FloatArray:
    """Derivatives of the whitened residuals at the start, by central differences."""
    useful = _useful(task)
    step = {name: 1e-4 * useful[name] for name in free}
    slopes = [
        (task.residuals({name: h}) - task.residuals({name: -h})) / (2 * h)
        for name, h in step.items()
    ]
    return np.stack(slopes, axis=1)


def _require(n: int, free: Sequence[str]) -> None:
    least = len(free) // 2 + 2
    if n < least:
        raise DataError(
            f"{n} spots cannot determine {len(free)} quantities; take frames of a mirror until at "
            f"least {least} spots are found."
        )


def _solve(task: Task, free: tuple[str, ...]) -> _Solution:
    useful = _useful(task)
    bound = np.array([useful[name] for name in free])

    def residuals(x: FloatArray) -> FloatArray:
        return task.residuals(dict(zip(free, x.tolist(), strict=True)))

    optimum = least_squares(
        residuals, np.zeros(len(free)), bounds=(-bound, bound), x_scale=bound / 100,
        xtol=1e-12, ftol=1e-12, gtol=1e-12,
    )  # fmt: skip
    n = 2 * len(task.spots)
    at_bound = tuple(name for name, on in zip(free, optimum.active_mask, strict=True) if on)
    chi2 = float(np.sum(optimum.fun**2))
    return _Solution(
        task, free, optimum.x, optimum.jac, optimum.fun[:n].reshape(-1, 2), chi2, at_bound
    )


def _robust(solution: _Solution) -> tuple[_Solution, dict[str, str]]:
    """The solution without spots that lie far off what the others say."""
    task, free = solution.task, solution.free
    dropped: dict[str, str] = {}
    while True:
        size = np.linalg.norm(solution.white, axis=1)
        # The median of the length of two unit normals is 1.18.
        limit = _REJECT_SD * max(1.0, float(np.median(size)) / 1.18)
        worst = int(np.argmax(size))
        if size[worst] <= limit or len(task.spots) - 1 < len(free) // 2 + 2:
            return solution, dropped
        off = size[worst] / limit * _REJECT_SD
        dropped[task.spots[worst].name] = f"{off:.0f} standard deviations off"
        task = task.without(np.arange(len(size)) != worst)
        solution = _solve(task, free)


def _check_picture(solution: _Solution) -> None:
    """Refuse a picture that is mirrored, and a fit that leads nowhere."""
    task, free = solution.task, solution.free
    misfit = np.sqrt(solution.chi2 / max(solution.dof, 1))
    if misfit < _MISFIT and not solution.at_bound:
        return
    centre = np.array([(task.start.camera.columns - 1) / 2, (task.start.camera.rows - 1) / 2])
    for sides, sign in _FLIPS.items():
        turned = tuple(replace(s, at=centre + sign * (s.at - centre)) for s in task.spots)
        try:
            other = _solve(replace(task, spots=turned), free)
        except DataError:
            continue
        if not other.at_bound and other.chi2 < solution.chi2 / 100:
            raise DataError(
                f"the spots fit only when {sides} of the frames are exchanged: columns must grow "
                "with x and rows with y, seen from the camera; mirror the frames and start again.",
                value=sides,
            )
    off = task.pixel_map(solution.state).directions(*task.at.T) - task.wanted(solution.state)
    rms_deg = float(np.degrees(np.sqrt(np.mean(np.sum(off**2, axis=1)) / 2)))
    if solution.at_bound or not rms_deg < _WORST_DEG:
        where = f"runs away in {', '.join(solution.at_bound)}" if solution.at_bound else "fails"
        raise DataError(
            f"the fit {where}, with residuals of {rms_deg:.2g} deg rms; check the nominal "
            "geometry, the lamp's angles and the turns of the mirror.",
            value=rms_deg,
        )


def _result(
    solution: _Solution, held_for: dict[str, tuple[str, ...]], dropped: dict[str, str]
) -> Alignment:
    chi2, dof = solution.chi2, solution.dof
    scale = max(1.0, float(np.sqrt(chi2 / max(dof, 1))))
    if scale > 1:
        # Known lengths keep their own uncertainty: only the spots are widened.
        solution = _solve(replace(solution.task, scale=scale), solution.free)
    task, free = solution.task, solution.free
    covariance = np.linalg.inv(solution.jacobian.T @ solution.jacobian)
    pixel_map = task.pixel_map(solution.state)
    sd: dict[str, float | None] = dict.fromkeys(task.names)
    sd |= dict(zip(free, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    kept = [k for k, name in enumerate(free) if name not in WEDGE]
    joint = covariance[np.ix_(kept, kept)]
    joint = (joint + joint.T) / 2
    predicted = np.stack(pixel_map.pixels(task.wanted(solution.state)), axis=1)
    return Alignment(
        pixel_map=pixel_map,
        values=_values(pixel_map, task, solution.state),
        sd=sd,
        uncertain=Uncertain(
            names=tuple(free[k] for k in kept),
            covariance=tuple(tuple(row) for row in joint.tolist()),
        ),
        held_for=held_for,
        residuals_px=task.at - predicted,
        names=tuple(spot.name for spot in task.spots),
        dropped=dropped,
        chi2=chi2,
        dof=dof,
        scale=scale,
    )


def _values(pixel_map: PixelMap, task: Task, state: Mapping[str, float]) -> dict[str, float]:
    """Value of every quantity of a state in its unit."""
    values = {name: pixel_map.quantity(name) for name in task.names if name not in WEDGE}
    if WEDGE[0] in task.names:
        stated = float(np.degrees(max(spot.wedge for spot in task.spots)))
        values["wedge"] = stated + state.get("wedge", 0.0)
        values["wedge_azimuth"] = state.get("wedge_azimuth", 0.0)
    return values


def _scaled(pixel_map: PixelMap, factor: float) -> PixelMap:
    """The map with every length of its geometry times a factor, which turns no direction."""
    g = pixel_map.geometry
    longer = {
        "R": g.R * factor,
        "D": g.D * factor,
        "pupil_mm": tuple(factor * x for x in g.pupil_mm),
        "pupil_walk_mm": g.pupil_walk_mm * factor,
    }
    return replace(pixel_map, geometry=Geometry.model_validate(g.model_dump() | longer))
