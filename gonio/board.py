"""Calibration boards: a plain chessboard, or one with ArUco markers in its white squares (ChArUco).

Frame of a board: origin at the outer corner of the first square, x along the rows of squares, y
along the columns, z away from the viewer. Seen from the front x is right and y is down, as in a
picture, so that a board that faces the camera is not turned.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigurationError, unknown_name
from gonio.geometry import FloatArray

if TYPE_CHECKING:
    import cv2

Kind = Literal["charuco", "chessboard"]
KINDS: tuple[Kind, ...] = ("charuco", "chessboard")
MARKER_SHARE = 0.75  # side of a marker over that of its square, where not given
LEAST_SQUARES = 4


@dataclass(frozen=True)
class Board:
    """A calibration board.

    Parameters
    ----------
    kind : {"charuco", "chessboard"}
    columns, rows : int
        Number of squares, 4 or more.
    square_mm : float
        Side of a square.
    marker_mm : float, optional
        Side of a marker, its black border included; 3/4 of the square by default. Only charuco.
    dictionary : str
        ArUco dictionary of the markers, as OpenCV names it: "4x4_100" is DICT_4X4_100.

    Raises
    ------
    ConfigurationError
        If a size or a name is not allowed, or the dictionary has too few markers.

    Notes
    -----
    The first square is black. Corners are the inner corners of the squares, row by row, as
    OpenCV counts them in both kinds of board. The lens does not depend on the unit of length,
    only on the board being flat and its squares equal.

    Examples
    --------
    >>> board = Board("chessboard", 12, 9, 20.0)
    >>> board.n_corners, board.corners_mm()[12].tolist()
    (88, [40.0, 40.0, 0.0])
    """

    kind: Kind = "charuco"
    columns: int = 12
    rows: int = 9
    square_mm: float = 20.0
    marker_mm: float | None = None
    dictionary: str = "4x4_100"

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise unknown_name("kind of board", self.kind, KINDS)
        if min(self.columns, self.rows) < LEAST_SQUARES:
            raise ConfigurationError(
                f"a board of {self.columns} x {self.rows} squares is too small; "
                f"allowed are {LEAST_SQUARES} or more each way.",
                value=(self.columns, self.rows),
            )
        if not 0 < self.square_mm < np.inf:
            raise ConfigurationError(
                f"squares of {self.square_mm:g} mm; the side must be positive.",
                value=self.square_mm,
            )
        if self.kind == "charuco":
            self._check_markers()

    def _check_markers(self) -> None:
        if not 0 < self.marker_side < self.square_mm:
            raise ConfigurationError(
                f"markers of {self.marker_side:g} mm do not fit in squares of "
                f"{self.square_mm:g} mm; they must be smaller.",
                value=self.marker_mm,
            )
        names = dictionaries()
        if self.dictionary not in names:
            raise unknown_name("dictionary", self.dictionary, names)
        holds = len(aruco_dictionary(self.dictionary).bytesList)
        if holds < self.n_markers:
            raise ConfigurationError(
                f"the board has {self.n_markers} markers and the dictionary {self.dictionary} "
                f"only {holds}; choose a larger one or fewer squares.",
                value=self.dictionary,
            )

    @property
    def marker_side(self) -> float:
        """Side of a marker, mm."""
        return MARKER_SHARE * self.square_mm if self.marker_mm is None else self.marker_mm

    @property
    def n_markers(self) -> int:
        """Markers on the board: one in every white square of a charuco board."""
        return self.columns * self.rows // 2 if self.kind == "charuco" else 0

    @property
    def n_corners(self) -> int:
        """Inner corners."""
        return (self.columns - 1) * (self.rows - 1)

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the squares, without the white margin around them."""
        return self.columns * self.square_mm, self.rows * self.square_mm

    @property
    def margin_mm(self) -> float:
        """Width of the white margin, which the finding of the outer squares needs."""
        return self.square_mm

    def corners_mm(self) -> FloatArray:
        """Inner corners (n, 3) in the frame of the board, in the order of their numbers."""
        x = np.arange(1, self.columns) * self.square_mm
        y = np.arange(1, self.rows) * self.square_mm
        corners = np.zeros((self.n_corners, 3))
        corners[:, 0], corners[:, 1] = np.tile(x, len(y)), np.repeat(y, len(x))
        return corners

    def charuco(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's record of this board."""
        import cv2

        return cv2.aruco.CharucoBoard(
            (self.columns, self.rows),
            self.square_mm,
            self.marker_side,
            aruco_dictionary(self.dictionary),
        )

    def pattern(self) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """What stands in every square, for drawing.

        Returns
        -------
        content : ndarray of int, shape (rows, columns)
            -1 black, -2 white, else the index of a marker.
        markers : ndarray of bool, shape (n_markers, cells, cells)
            The white cells of each marker, its black border included.
        """
        rows, columns = np.indices((self.rows, self.columns))
        content = np.where((rows + columns) % 2 == 0, -1, -2)
        if self.kind == "chessboard":
            return content, np.zeros((0, 1, 1), bool)
        import cv2

        board, dictionary = self.charuco(), aruco_dictionary(self.dictionary)
        middles = np.mean(np.array(board.getObjPoints()), axis=1) / self.square_mm
        ids = np.ravel(board.getIds())
        content[middles[:, 1].astype(int), middles[:, 0].astype(int)] = np.arange(len(ids))
        cells = dictionary.markerSize + 2
        images = [cv2.aruco.generateImageMarker(dictionary, int(i), cells) for i in ids]
        return content, np.array(images) > 0

    def __str__(self) -> str:
        squares = f"{self.columns} x {self.rows} squares of {self.square_mm:g} mm"
        if self.kind == "chessboard":
            return f"chessboard, {squares}"
        return f"charuco, {squares}, markers of {self.marker_side:g} mm, {self.dictionary}"


def dictionaries() -> list[str]:
    """Names of the ArUco dictionaries that OpenCV has."""
    import cv2

    names = {name.removeprefix("DICT_").lower() for name in vars(cv2.aruco) if "DICT_" in name}
    return sorted(names)


def aruco_dictionary(name: str) -> Any:
    """OpenCV's record of a dictionary."""
    import cv2

    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name.upper()}"))
