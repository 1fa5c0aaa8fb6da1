"""From photographs of a board to the record of the lens that a reduction reads.

1. The detectors find corners in each photograph, the image circle gives a first lens.
2. A bundle adjustment fits lens and poses.
3. With these, every corner of every board is looked for where it must be, out to the edge of the
   field, and measured against the board's own pattern.
4. The bundle is fitted to these corners. 3 and 4 are done twice: the first time the windows around
   the corners are placed by a lens that the detectors' errors moved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.board import Board
from gonio.calibration.lens import boards
from gonio.calibration.lens.board_poses import View, pose_of_board
from gonio.calibration.lens.boards import Corners
from gonio.calibration.lens.bundle_adjustment import QUANTITIES, LensFit, fit_lens
from gonio.calibration.lens.corner_template import Ink, refine
from gonio.calibration.lens.fisheye import Fisheye
from gonio.calibration.lens.image_circle import ImageCircle, fit_image_circle
from gonio.errors import ConfigurationError, DataError
from gonio.metadata import LensCalibration, Uncertain

REACH_DEG = 85.0  # corners must go that far, or the rim is extrapolated
FEW_VIEWS = 10
_SEARCHED_BELOW = 0.5  # of the corners found; then the perspective views are searched
_LEAST_FOR_POSE = 4
_PASSES = 2
_CIRCLE_OFF = 0.03
_LARGE_RMS_PX = 1.0
_GROWING = 0.97  # of the angle at which the image stops growing; near it angles are not determined

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class LensFromPhotos:
    """A lens as calibrated from photographs.

    Parameters
    ----------
    fit : LensFit
        In pixels of the photographs.
    board : Board
    shape : tuple of int
        Rows and columns of the photographs.
    n_photos : int
    pitch_mm : tuple of float
        Pitch of the photographs' pixels, in y as fitted where that was asked for.
    field_deg : float
        Full field of the lens, as it was given.
    circle : ImageCircle or None
        The bright disc, where the photographs show its edge.
    """

    fit: LensFit
    board: Board
    shape: tuple[int, int]
    n_photos: int
    pitch_mm: tuple[float, float]
    field_deg: float
    circle: ImageCircle | None

    @property
    def dropped(self) -> dict[str, str]:
        """Photographs that were not used, each with its reason."""
        return self.fit.left_out

    @property
    def reach_deg(self) -> float:
        """Largest polar angle of a corner that was used."""
        return float(np.degrees(self.fit.theta().max()))

    def record(self, frame_binning: int = 1) -> LensCalibration:
        """The lens as a session carries it.

        Parameters
        ----------
        frame_binning : int
            Side of the block of the photographs' pixels that makes one pixel of the session's
            frames; the frames' window must be that of the photographs.
        """
        fit, n = self.fit, frame_binning
        if n < 1 or self.shape[0] % n or self.shape[1] % n:
            raise ConfigurationError(
                f"frames binned {n} x {n} are not made of whole blocks of the photographs' "
                f"{self.shape[1]} x {self.shape[0]} pixels.",
                value=n,
            )
        units = {"f": self.pitch_mm[0], "centre_x": 1 / n, "centre_y": 1 / n}
        column, row = ((c + 0.5) / n - 0.5 for c in fit.lens.centre)
        names = [name for name in QUANTITIES if name != "ratio"]
        unit = np.array([units.get(name, 1.0) for name in names])
        covariance = fit.covariance[: len(names), : len(names)] * np.outer(unit, unit)
        covariance = (covariance + covariance.T) / 2
        return LensCalibration(
            projection="kannala_brandt",
            focal_length_mm=fit.lens.f * self.pitch_mm[0],
            k=fit.lens.k,
            field_deg=self._usable_field_deg(),
            centre_px=(column, row),
            uncertain=Uncertain(
                names=("focal_length", *names[1:]),
                covariance=tuple(tuple(float(v) for v in row) for row in covariance),
            ),
        )

    def _usable_field_deg(self) -> float:
        """The given field up to the horizon, and less where the fitted image stops growing."""
        return min(self.field_deg, 180.0, 2 * _GROWING * self._grows_to_deg())

    def _grows_to_deg(self) -> float:
        return float(np.degrees(self.fit.lens.grows_to()))

    def warnings(self) -> list[str]:
        """Sentences that a user must know before trusting the record."""
        sentences, fit = [], self.fit
        if self.reach_deg < REACH_DEG:
            sentences.append(
                f"the corners reach theta = {self.reach_deg:.1f} deg: beyond it the lens is "
                f"extrapolated. Photograph the board at the rim, to {REACH_DEG:g} deg and more."
            )
        if len(fit.views) < FEW_VIEWS:
            sentences.append(f"only {len(fit.views)} photographs were used; 15 to 30 are better.")
        if fit.rms_px > _LARGE_RMS_PX:
            sentences.append(
                f"the corners miss by {fit.rms_px:.2f} px rms: the board is not flat or not as "
                "described, or the lens does not follow the Kannala-Brandt model."
            )
        if self._usable_field_deg() < min(self.field_deg, 180.0):
            sentences.append(
                f"the fitted image stops growing at theta = {self._grows_to_deg():.1f} deg: the "
                f"field of the record ends at {self._usable_field_deg() / 2:.1f} deg from the axis."
            )
        sentences += self._circle_warning()
        return sentences

    def _circle_warning(self) -> list[str]:
        if self.circle is None:
            return []
        edge = float(np.degrees(self.fit.lens.polar_angle(self.circle.radius)))
        if abs(edge / (self.field_deg / 2) - 1) <= _CIRCLE_OFF:
            return []
        said = "beyond where the lens is unique" if np.isnan(edge) else f"at theta = {edge:.1f} deg"
        return [
            f"the image circle ends {said} and the field was taken as {self.field_deg:g} deg; "
            "give the lens's field."
        ]


def calibrate_lens(
    paths: Sequence[str | Path],
    board: Board,
    *,
    pitch_mm: tuple[float, float],
    field_deg: float = 180.0,
    free_ratio: bool = False,
    progress: Progress | None = None,
) -> LensFromPhotos:
    """Lens, with its covariance, from photographs of a board.

    Parameters
    ----------
    paths : sequence of path
        Photographs of the same window of the sensor, the board all over the field and tilted.
    board : Board
    pitch_mm : tuple of float
        Pitch of the photographs' pixels in x and y.
    field_deg : float
        Full field of the lens, for the start: the image circle's edge is taken to be there.
    free_ratio : bool
        Fit the ratio of the pitches too.
    progress : callable, optional
        Called with (done, total) readings of photographs; each is read a few times.

    Returns
    -------
    LensFromPhotos

    Raises
    ------
    DataError
        If a photograph cannot be read or has another size, fewer than three show the board, or
        they do not determine the lens.
    ConfigurationError
        If a photograph is given twice.

    Examples
    --------
    Twenty photographs take a minute:

    >>> board = Board("charuco", 12, 9, 20.0)
    >>> paths = sorted(Path("photos").glob("*.png"))
    >>> lens = calibrate_lens(paths, board, pitch_mm=(0.00345, 0.00345))  # doctest: +SKIP
    >>> lens.fit.lens.f, lens.reach_deg  # doctest: +SKIP

    Wrong arguments are refused at once:

    >>> calibrate_lens(["a.png", "a.png"], board, pitch_mm=(0.00345, 0.00345))
    Traceback (most recent call last):
    gonio.errors.ConfigurationError: a.png is given twice; give each photograph once.
    """
    names = [str(path) for path in paths]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise ConfigurationError(f"{min(twice)} is given twice; give each photograph once.")
    report = _Counter((1 + _PASSES) * len(names), progress)
    ratio = pitch_mm[0] / pitch_mm[1]
    corners, brightest = _detect(names, board, report)
    circle = fit_image_circle(brightest, ratio)
    start = _start(brightest.shape, circle, ratio, field_deg)
    _search_views(names, board, start, corners)
    if not any(map(len, corners.values())):
        raise _no_board(names, board)
    views = [_view(name, board, corners[name]) for name in names]
    fit = fit_lens(views, start, free_ratio=free_ratio)
    fit = _refined(views, board, fit, free_ratio, report)
    return LensFromPhotos(
        fit,
        board,
        (brightest.shape[0], brightest.shape[1]),
        len(names),
        (pitch_mm[0], pitch_mm[0] / fit.lens.ratio),
        field_deg,
        circle,
    )


class _Counter:
    """Counts photographs for the progress."""

    def __init__(self, total: int, progress: Progress | None) -> None:
        self.done, self.total, self.progress = 0, total, progress

    def __call__(self) -> None:
        self.done = min(self.done + 1, self.total)
        if self.progress is not None:
            self.progress(self.done, self.total)


def _detect(
    names: Sequence[str], board: Board, report: _Counter
) -> tuple[dict[str, Corners], NDArray[np.generic]]:
    """Corners of each photograph and the brightest value of each pixel in all of them."""
    corners: dict[str, Corners] = {}
    brightest: NDArray[np.generic] | None = None
    for name in names:
        image = boards.read_photo(name)
        if brightest is None:
            brightest = image
        elif image.shape != brightest.shape:
            raise DataError(
                f"{name}: has {_size(image.shape)} pixels and {names[0]} has "
                f"{_size(brightest.shape)}; give photographs of one window of the sensor.",
                value=name,
            )
        brightest = np.maximum(brightest, image)
        corners[name] = boards.find_corners(boards.stretched(image), board)
        report()
    if brightest is None:
        raise ConfigurationError("no photograph is given; give three or more.")
    return corners, brightest


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} x {shape[0]}"


def _start(
    shape: tuple[int, ...], circle: ImageCircle | None, ratio: float, field_deg: float
) -> Fisheye:
    """An equidistant lens that fills the image circle, or the picture where it has none."""
    if circle is None:
        middle = ((shape[1] - 1) / 2, (shape[0] - 1) / 2)
        return Fisheye(max(shape) / np.pi, centre=middle, ratio=ratio)
    return Fisheye(circle.radius / np.radians(field_deg / 2), centre=circle.centre, ratio=ratio)


def _search_views(
    names: Sequence[str], board: Board, start: Fisheye, corners: dict[str, Corners]
) -> None:
    """Look again, in perspective views, at photographs in which little was found."""
    for name in names:
        if len(corners[name]) < _SEARCHED_BELOW * board.n_corners:
            image = boards.stretched(boards.read_photo(name))
            more = boards.find_in_views(image, board, start)
            if len(more) > len(corners[name]):
                corners[name] = more


def _view(name: str, board: Board, corners: Corners) -> View:
    return View(name, board.corners_mm()[corners.numbers], corners.pixels)


def _refined(
    views: Sequence[View],
    board: Board,
    fit: LensFit,
    free_ratio: bool,
    report: _Counter,
) -> LensFit:
    """The fit to corners that are measured against the board's pattern, to the field's edge."""
    ink = Ink.of(board)
    for _ in range(_PASSES):
        pose_of = dict(zip((view.name for view in fit.views), fit.poses, strict=True))
        better = []
        for view in views:
            pose = pose_of.get(view.name)
            if pose is None and len(view.pixels) >= _LEAST_FOR_POSE:
                pose = pose_of_board(view, fit.lens)
            corners = boards.NONE
            if pose is not None:
                corners = Corners(*refine(boards.read_photo(view.name), ink, fit.lens, pose))
            better.append(_view(view.name, board, corners))
            report()
        fit = fit_lens(better, fit.lens, free_ratio=free_ratio)
    return fit


def _no_board(names: Sequence[str], board: Board) -> DataError:
    """The error for photographs none of which shows the board, with a likely reason."""
    hint = "check the number of squares, the light and the focus"
    if board.kind == "charuco":
        for name in names[:5]:
            image = boards.stretched(boards.read_photo(name))
            if boards.is_mirrored(image, board):
                hint = "they are mirrored: give them as the sensor has them, not flipped"
                break
            other = boards.other_dictionary(image, board)
            if other is not None:
                hint = f"{name} shows markers of the dictionary {other}: give that one"
                break
    return DataError(
        f"{names[0]}{f' and {len(names) - 1} more' if len(names) > 1 else ''}: no board was found "
        f"({board}); {hint}.",
        value=list(names),
    )
