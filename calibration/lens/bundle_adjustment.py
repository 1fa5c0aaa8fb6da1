"""Lens and poses from the corners of boards in photographs: a bundle adjustment.

The lens is Kannala and Brandt's (`gonio.calibration.lens.fisheye`), so that corners at 90 deg and
beyond are corners like others. The start needs a focal length within about a third: the radius of
the image circle over the half field.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gonio.calibration.lens.board_poses import Pose, View, pose_of_board
from gonio.calibration.lens.fisheye import Fisheye
from gonio.calibration.lens.rotations import left_jacobian, rotation
from gonio.errors import DataError
from gonio.geometry import FloatArray, angles
from gonio.wording import counted

QUANTITIES = ("f", "k1", "k2", "k3", "k4", "centre_x", "centre_y", "ratio")
LEAST_VIEWS = 3
LEAST_CORNERS = 8  # in a view; a pose has six parameters
REJECT_SD = 5.0  # corners farther off than that, in robust standard deviations, are dropped
LEAST_SD_PX = 0.005  # no corner is measured better; outliers are judged by this at least
LEAST_SPREAD_DEG = 10.0  # between the boards' normals
WORST_THETA_SD_DEG = 1.0  # within the corners; beyond it the photographs do not determine the lens
_MOST_ROUNDS = 10
_STARTS = np.geomspace(0.7, 1.4, 15)  # tried as factors of the focal length


@dataclass(frozen=True)
class LensFit:
    """A fitted lens with what it was fitted to.

    Parameters
    ----------
    lens : Fisheye
    free : tuple of str
        Names of the fitted parameters, of `QUANTITIES`.
    covariance : ndarray
        Of the free parameters, scaled by the residuals; poses are marginalised.
    views : list of View
        Corners that were used.
    poses : list of Pose
        One for each view.
    residuals : list of ndarray, shape (n, 2)
        Observed minus projected, pixels.
    outliers : dict
        Number of dropped corners by name of the photograph.
    left_out : dict
        Photographs without enough corners after that, each with its reason.
    """

    lens: Fisheye
    free: tuple[str, ...]
    covariance: FloatArray
    views: list[View]
    poses: list[Pose]
    residuals: list[FloatArray]
    outliers: dict[str, int]
    left_out: dict[str, str]

    @property
    def n_corners(self) -> int:
        """Corners used."""
        return sum(len(view.pixels) for view in self.views)

    @property
    def rms_px(self) -> float:
        """Root mean square distance of the corners from their projections, pixels."""
        return float(np.sqrt(np.mean(np.sum(np.vstack(self.residuals) ** 2, axis=1))))

    def theta(self) -> FloatArray:
        """Polar angles of all corners used, radians."""
        pairs = zip(self.views, self.poses, strict=True)
        return np.concatenate([angles(pose.to_camera(view.board))[0] for view, pose in pairs])

    def theta_sd(self, theta: FloatArray) -> FloatArray:
        """Standard deviation, radians, of the polar angle that a pixel stands for.

        Mean square over the azimuth, from the covariance of all free parameters:
        dtheta = -(dr + cos(phi) dcx + sin(phi) dcy) / r'.
        """
        phi = np.linspace(-np.pi, np.pi, 16, endpoint=False)
        t, p = np.meshgrid(theta, phi, indexing="ij")
        x = np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1)
        _, by_lens, _ = self.lens.derivatives(x.reshape(-1, 3))
        outward = np.stack([np.cos(p), np.sin(p)], -1).reshape(-1, 2)
        outward[:, 1] /= self.lens.ratio
        columns = [QUANTITIES.index(name) for name in self.free]
        gradient = np.einsum("ni,nij->nj", outward, by_lens)[:, columns]
        gradient /= self.lens.slope(t.ravel())[:, None]
        variance = np.einsum("ni,ij,nj->n", gradient, self.covariance, gradient)
        return np.asarray(np.sqrt(variance.reshape(t.shape).mean(axis=1)))


def fit_lens(views: Sequence[View], start: Fisheye, *, free_ratio: bool = False) -> LensFit:
    """Lens, poses and covariance from corners.

    Parameters
    ----------
    views : sequence of View
    start : Fisheye
        Its focal length may be a third off, its centre some 5 % of the image; `ratio` is kept
        unless `free_ratio`.
    free_ratio : bool
        Fit the ratio of the pixels' pitches too.

    Returns
    -------
    LensFit

    Raises
    ------
    DataError
        If there are too few views or corners, the boards are nearly parallel, or the corners do
        not determine the lens.

    Notes
    -----
    Least squares on the distances in pixels with a loss that grows linearly for outliers; then
    corners beyond 5 robust standard deviations are dropped and the rest is fitted by ordinary least
    squares, until nothing changes. The covariance is that of the last fit.
    """
    names = QUANTITIES if free_ratio else QUANTITIES[:-1]
    used, left_out = _enough(views, {})
    _require(len(used) >= LEAST_VIEWS, _few(used, views))
    lens, poses = _first_guess(used, start)
    lens, poses = _fit_robustly(used, lens, poses, names)
    used, poses, left_out = _from_front(used, poses, left_out)
    outliers: dict[str, int] = {}
    for _ in range(_MOST_ROUNDS):
        used, wrong = _trimmed(used, lens, poses)
        for name, n in wrong.items():
            outliers[name] = outliers.get(name, 0) + n
        pose_of = dict(zip((view.name for view in used), poses, strict=True))
        used, left_out = _enough(used, left_out, outliers)
        _require(len(used) >= LEAST_VIEWS, _few(used, views))
        poses = [pose_of[view.name] for view in used]
        lens, poses = _solve(used, lens, poses, names, loss="linear", scale=1.0)
        if not wrong:
            break
    _check_spread(poses)
    covariance = _covariance(used, lens, poses, names)
    residuals = _residuals(used, lens, poses)
    fit = LensFit(lens, names, covariance, used, poses, residuals, outliers, left_out)
    _check_determined(fit)
    return fit


def _trimmed(
    views: Sequence[View], lens: Fisheye, poses: Sequence[Pose]
) -> tuple[list[View], dict[str, int]]:
    """Views without their outliers, and how many those were by name of the photograph."""
    residuals = _residuals(views, lens, poses)
    limit = REJECT_SD * max(_robust_sd(residuals), LEAST_SD_PX)
    kept, wrong = [], {}
    for view, residual in zip(views, residuals, strict=True):
        good = np.hypot(*residual.T) <= limit
        kept.append(view.subset(good))
        if not good.all():
            wrong[view.name] = int(np.sum(~good))
    return kept, wrong


# ------------------------------------------------------------------ what is refused


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise DataError(message)


def _few(good: Sequence[View], views: Sequence[View]) -> str:
    return (
        f"{len(good)} of {len(views)} photographs show {LEAST_CORNERS} or more corners of the "
        f"board; a calibration needs {LEAST_VIEWS} or more, and 15 to 30 all over the field "
        "for a good one. Take more."
    )


def _enough(
    views: Sequence[View], left_out: dict[str, str], outliers: dict[str, int] | None = None
) -> tuple[list[View], dict[str, str]]:
    """Views with enough corners that do not lie on one line; the others with their reason."""
    good, bad = [], dict(left_out)
    for view in views:
        n, wrong = len(view.pixels), (outliers or {}).get(view.name, 0)
        if n < LEAST_CORNERS and wrong:
            bad[view.name] = f"{wrong} of its {n + wrong} corners do not fit the other photographs"
        elif n == 0:
            bad[view.name] = "no corner of the board was found"
        elif n < LEAST_CORNERS:
            bad[view.name] = f"{counted(n, 'corner')}, fewer than {LEAST_CORNERS}"
        elif np.linalg.matrix_rank(view.board[:, :2] - view.board[0, :2]) < 2:
            bad[view.name] = "its corners lie on one line"
        else:
            good.append(view)
    return good, bad


def _from_front(
    views: Sequence[View], poses: list[Pose], left_out: dict[str, str]
) -> tuple[list[View], list[Pose], dict[str, str]]:
    """Views of the boards' printed sides: seen from behind, a picture is mirrored."""
    front = [bool(pose.normal() @ pose.shift > 0) for pose in poses]
    _require(
        sum(front) > len(views) / 2,
        "the boards are seen from behind: the photographs are mirrored. Give them as the sensor "
        "has them, not flipped.",
    )
    behind = {
        view.name: "its board is seen from behind: it is mirrored"
        for view, good in zip(views, front, strict=True)
        if not good
    }
    kept = [(v, p) for v, p, good in zip(views, poses, front, strict=True) if good]
    return [v for v, _ in kept], [p for _, p in kept], {**left_out, **behind}


def _check_spread(poses: list[Pose]) -> None:
    """Refuse boards that all lie in nearly one direction: focal length and distance trade."""
    normals = np.array([pose.normal() for pose in poses])
    widest = np.degrees(np.arccos(np.clip(normals @ normals.T, -1, 1))).max()
    _require(
        bool(widest >= LEAST_SPREAD_DEG),
        f"all boards are parallel within {widest:.1f} deg, so that focal length and distance of "
        f"the boards cannot be separated; tilt the board by {2 * LEAST_SPREAD_DEG:g} deg and more "
        "between photographs.",
    )


def _check_determined(fit: LensFit) -> None:
    # Where corners are: what is extrapolated has a large uncertainty, and says so.
    theta = min(float(fit.theta().max()), np.radians(60.0))
    sd = float(np.degrees(fit.theta_sd(np.array([theta])))[0])
    _require(
        bool(np.isfinite(sd) and sd <= WORST_THETA_SD_DEG),
        f"the photographs do not determine the lens (sd {sd:.2g} deg at theta = "
        f"{np.degrees(theta):.0f} deg): take more, with the board tilted and in all parts of the "
        "field.",
    )
    _require(
        fit.lens.f > 0 and fit.lens.grows_to() > float(fit.theta().max()),
        "the fitted polynomial is not a lens: its image shrinks towards the rim. The start was too "
        "far off, or corners are wrong; check the field of the lens and the board.",
    )


# ------------------------------------------------------------------ start


def _first_guess(views: Sequence[View], start: Fisheye) -> tuple[Fisheye, list[Pose]]:
    """The best of a few focal lengths, each with the poses that suit it."""
    best: tuple[float, Fisheye, list[Pose]] | None = None
    for factor in _STARTS:
        lens = replace(start, f=start.f * float(factor))
        poses = [pose_of_board(view, lens) for view in views]
        miss = _robust_sd(_residuals(views, lens, poses))
        if best is None or miss < best[0]:
            best = miss, lens, poses
    assert best is not None
    return best[1], best[2]


# ------------------------------------------------------------------ least squares


def _fit_robustly(
    views: Sequence[View], lens: Fisheye, poses: list[Pose], names: tuple[str, ...]
) -> tuple[Fisheye, list[Pose]]:
    """Fits with a loss whose scale follows the residuals down."""
    for _ in range(6):
        sd = max(_robust_sd(_residuals(views, lens, poses)), LEAST_SD_PX)
        lens, poses = _solve(views, lens, poses, names, loss="soft_l1", scale=2 * sd)
        after = max(_robust_sd(_residuals(views, lens, poses)), LEAST_SD_PX)
        if after > 0.8 * sd:
            break
    return lens, poses


def _solve(
    views: Sequence[View],
    lens: Fisheye,
    poses: list[Pose],
    names: tuple[str, ...],
    *,
    loss: str,
    scale: float,
) -> tuple[Fisheye, list[Pose]]:
    from scipy.optimize import least_squares

    def unpack(x: FloatArray) -> tuple[Fisheye, list[Pose]]:
        values = lens.vector()
        values[: len(names)] = x[: len(names)]
        rest = x[len(names) :].reshape(-1, 6)
        return lens.with_vector(values), [Pose(each[:3], each[3:]) for each in rest]

    def residuals(x: FloatArray) -> FloatArray:
        return np.vstack(_residuals(views, *unpack(x))).ravel()

    def jacobian(x: FloatArray) -> FloatArray:
        return _jacobian(views, *unpack(x), names)

    x0 = np.concatenate(
        [lens.vector()[: len(names)], *(np.concatenate([p.turn, p.shift]) for p in poses)]
    )
    optimum = least_squares(
        residuals, x0, jac=jacobian, x_scale="jac", loss=loss, f_scale=scale, max_nfev=200,
        xtol=1e-12, ftol=1e-12, gtol=1e-12,
    )  # fmt: skip
    return unpack(optimum.x)


def _residuals(views: Sequence[View], lens: Fisheye, poses: Sequence[Pose]) -> list[FloatArray]:
    """Observed minus projected of every view, pixels."""
    pairs = zip(views, poses, strict=True)
    return [view.pixels - lens.project(pose.to_camera(view.board)) for view, pose in pairs]


def _jacobian(
    views: Sequence[View], lens: Fisheye, poses: Sequence[Pose], names: tuple[str, ...]
) -> FloatArray:
    """Derivatives of all residuals (2 corners) by the lens and then by each pose."""
    n = len(names)
    sizes = [len(view.pixels) for view in views]
    out = np.zeros((2 * sum(sizes), n + 6 * len(views)))
    row = 0
    for k, (view, pose) in enumerate(zip(views, poses, strict=True)):
        block = slice(row, row + 2 * len(view.pixels))
        turned = view.board @ rotation(pose.turn).T
        _, by_lens, by_point = lens.derivatives(turned + pose.shift)
        # exp(turn + d) = exp(J d) exp(turn): a turn of the turned point about J d.
        cross = np.zeros((len(turned), 3, 3))
        x, y, z = turned.T
        cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = z, -y, x
        cross -= np.swapaxes(cross, 1, 2)
        by_turn = by_point @ cross @ left_jacobian(pose.turn)
        out[block, :n] = -by_lens[..., :n].reshape(-1, n)
        column = n + 6 * k
        out[block, column : column + 3] = -by_turn.reshape(-1, 3)
        out[block, column + 3 : column + 6] = -by_point.reshape(-1, 3)
        row = block.stop
    return out


def _covariance(
    views: Sequence[View], lens: Fisheye, poses: Sequence[Pose], names: tuple[str, ...]
) -> FloatArray:
    """Covariance of the lens's parameters, the poses marginalised, scaled by the residuals."""
    jacobian = _jacobian(views, lens, poses, names)
    residuals = np.vstack(_residuals(views, lens, poses)).ravel()
    dof = jacobian.shape[0] - jacobian.shape[1]
    _require(
        dof > 0,
        f"{jacobian.shape[0]} coordinates of corners do not determine {jacobian.shape[1]} "
        "parameters of lens and poses; take more photographs.",
    )
    size = np.linalg.norm(jacobian, axis=0)
    inverse = np.linalg.pinv(jacobian / np.where(size > 0, size, 1))
    inverse = inverse[: len(names)] / size[: len(names), None]
    return np.asarray(inverse @ inverse.T * (residuals @ residuals / dof))


def _robust_sd(residuals: Sequence[FloatArray]) -> float:
    """Standard deviation of a coordinate from the median distance, which outliers hardly move."""
    # The median distance of a round normal distribution is sd sqrt(2 ln 2).
    distance = np.hypot(*np.vstack(residuals).T)
    return float(np.median(distance) / np.sqrt(2 * np.log(2)))
