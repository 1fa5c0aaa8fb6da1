"""Photographs of calibration boards as the camera of a virtual instrument takes them.

The camera stands alone: no dome, no lamp arm, a board held before the lens in a lit room. Every
pixel averages a grid of rays through the lens onto the board; the lens's blur, its fall-off
towards the rim and the sensor's noise follow.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gonio.board import Board
from gonio.errors import ConfigurationError, DataError
from gonio.files import atomic_path, write_text
from gonio.geometry import FloatArray, angles, unit_vectors
from gonio.instrument.lens import Lens
from gonio.instrument.noise import expose
from gonio.instrument.sensor import Sensor
from gonio.kernels.threads import map_blocks

if TYPE_CHECKING:
    from gonio.instrument import Instrument

WHITE, BLACK = 0.9, 0.05  # reflectance of the board's paper and ink
ROOM = 0.35  # mean reflectance of what stands behind the board
EXPOSED = 0.7  # of the sensor's range, for white on the axis
GRID, FINE_GRID = 4, 12  # rays along the side of a pixel, and of one that an edge crosses
_OUTSIDE = -1.0

# Directions of the boards' middles from the axis, as parts of the half field, and how often.
# The rim gets half of the photographs: there the lens is learnt or extrapolated.
_RINGS = ((0.0, 0.25, 0.2), (0.3, 0.55, 0.3), (0.65, 0.95, 0.5))
_TILT = np.radians(35)
_GOLDEN = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True)
class Pose:
    """Place of a board before the camera: X_camera = rotation X_board + translation (mm)."""

    rotation: FloatArray
    translation: FloatArray

    def to_camera(self, points: FloatArray) -> FloatArray:
        """Points (n, 3) of the board in the frame of the camera, mm."""
        return points @ self.rotation.T + self.translation


@dataclass(frozen=True)
class BoardCamera:
    """The camera of an instrument on its own: lens and sensor, in the lens's own frame.

    Parameters
    ----------
    lens : Lens
        It may see beyond 180 deg here: a board stands in no dome.
    sensor : Sensor
        Its binning is that of the photographs.

    Raises
    ------
    ConfigurationError
        If the lens's radius stops growing before the edge of its field.
    """

    lens: Lens
    sensor: Sensor

    def __post_init__(self) -> None:
        if np.any(self.lens.slope(np.linspace(0, self.half_field, 1001)) <= 0):
            raise ConfigurationError(
                f"the lens's image stops growing before its edge at {self.lens.field_deg / 2:g} "
                "deg; give a smaller field or other coefficients.",
                value=self.lens.k,
            )

    @classmethod
    def of(
        cls,
        rig: Instrument,
        *,
        binning: int = 1,
        centre_offset_px: tuple[float, float] | None = None,
        psf_px: float | None = None,
        field_deg: float | None = None,
    ) -> BoardCamera:
        """The camera of an instrument, with what is given in place of its own figures.

        Parameters
        ----------
        rig : Instrument
        binning : int
            Side of the block of pixels whose counts are summed; boards are photographed in full
            resolution where nothing is said.
        centre_offset_px : tuple of float, optional
            Column and row of the lens axis from the middle of the window, unbinned pixels.
        psf_px : float, optional
            Standard deviation of the lens's blur, unbinned pixels.
        field_deg : float, optional
            Full field, up to 300 deg.

        Raises
        ------
        ConfigurationError
            If a figure is out of range or the binning does not divide the window.
        """
        sensor = rig.sensor
        if binning < 1 or sensor.rows % binning or sensor.columns % binning:
            raise ConfigurationError(
                f"binning {binning} does not divide the {sensor.columns} x {sensor.rows} pixels "
                f"of {rig.name}.",
                value=binning,
            )
        for name, value, most in (("psf_px", psf_px, 50.0), ("field_deg", field_deg, 300.0)):
            if value is not None and not 0 <= value <= most:
                raise ConfigurationError(
                    f"{name} = {value:g} is out of range; allowed is 0 to {most:g}.", value=value
                )
        sum_dn = binning**2 * ((1 << sensor.bits) - 1)
        change: dict[str, Any] = {
            "binning": binning,
            "binned_divisor": max(sensor.binned_divisor, -(-sum_dn // 65535)),
        }
        if centre_offset_px is not None:
            change["centre_offset_px"] = centre_offset_px
        given = {"psf_px": psf_px, "field_deg": field_deg}
        return cls(
            rig.lens.model_copy(update={k: v for k, v in given.items() if v is not None}),
            sensor.model_copy(update=change),
        )

    @property
    def half_field(self) -> float:
        """Polar angle of the field's edge, radians."""
        return float(np.radians(self.lens.field_deg / 2))

    @property
    def pitch_mm(self) -> FloatArray:
        """Pitch of the photograph's pixels in x and y."""
        return np.array(self.sensor.pitch_um) * 1e-3 * self.sensor.binning

    @property
    def centre_px(self) -> FloatArray:
        """Column and row of the axis; whole numbers are pixels' centres."""
        return np.array(self.sensor.centre_px())

    def project(self, points: FloatArray) -> FloatArray:
        """Column and row (..., 2) of points (..., 3) before the camera; NaN outside the field."""
        theta, phi = angles(points)
        radius = np.where(theta <= self.half_field, self.lens.radius(theta), np.nan)
        at = np.stack([radius * np.cos(phi), radius * np.sin(phi)], -1)
        return np.asarray(at / self.pitch_mm + self.centre_px)


def draw_poses(board: Board, camera: BoardCamera, n: int, rng: np.random.Generator) -> list[Pose]:
    """Places for n photographs: in the middle, half-way and at the rim, all around, tilted.

    A plain chessboard is found only where it is seen whole: it is moved towards the axis until
    its outer corners are in the field.
    """
    rings = _rings(n, rng)
    # Turned by the golden angle from one to the next in its ring, few or many go all around.
    steps = [rings[:k].count(ring) for k, ring in enumerate(rings)]
    return [
        _draw_pose(board, camera, ring, step * _GOLDEN, rng)
        for ring, step in zip(rings, steps, strict=True)
    ]


def _rings(n: int, rng: np.random.Generator) -> list[tuple[float, float]]:
    """The ring of each photograph, in their shares, mixed."""
    last = np.cumsum([share for _, _, share in _RINGS])
    chosen = np.searchsorted(last, (np.arange(n) + 0.5) / n)
    return [_RINGS[k][:2] for k in rng.permutation(np.minimum(chosen, len(_RINGS) - 1))]


def _draw_pose(
    board: Board,
    camera: BoardCamera,
    ring: tuple[float, float],
    azimuth: float,
    rng: np.random.Generator,
) -> Pose:
    width, height = board.size_mm
    theta = rng.uniform(*ring) * camera.half_field
    phi = azimuth + rng.uniform(-0.3, 0.3)
    distance = rng.uniform(0.55, 0.85) * math.hypot(width, height)
    turn, lean = rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi)
    tilt = rng.uniform(0.25, 1) * _TILT
    middle = np.array([width / 2, height / 2, 0.0])
    square = np.array([[0, 0, 0], [width, 0, 0], [width, height, 0], [0, height, 0]], float)
    for shrink in np.linspace(1, 0, 41):
        rotation = _towards(theta * shrink, phi) @ _tilted(tilt * shrink**0.25, lean)
        rotation = rotation @ _tilted(0, 0, turn)
        direction = unit_vectors(theta * shrink, phi)
        pose = Pose(rotation, distance * direction - rotation @ middle)
        if board.kind == "charuco" or np.isfinite(camera.project(pose.to_camera(square))).all():
            return pose
    raise ConfigurationError(
        f"the {board} does not fit in the field of {camera.lens.field_deg:g} deg; "
        "use a charuco board, which is found in parts."
    )


def _towards(theta: float, phi: float) -> FloatArray:
    """Rotation that turns the axis to a direction, about a line across both."""
    return _tilted(theta, phi + np.pi / 2)


def _tilted(angle: float, about: float, turn: float = 0.0) -> FloatArray:
    """Rotation by `angle` about a line in the x-y plane at azimuth `about`, after one about z."""
    axis = np.array([math.cos(about), math.sin(about), 0.0])
    cross = np.array([[0, 0, axis[1]], [0, 0, -axis[0]], [-axis[1], axis[0], 0]])
    tilt = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
    cos, sin = math.cos(turn), math.sin(turn)
    return np.asarray(tilt @ np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]))


@dataclass(frozen=True)
class _Pixels:
    """The pixels inside the image circle: where they look, and how that changes across them."""

    index: NDArray[np.int64]  # (n,) flat
    direction: FloatArray  # (n, 3)
    by_column: FloatArray  # (n, 3), change of direction over one column
    by_row: FloatArray
    throughput: FloatArray  # (n,), 1 on the axis


class Photographer:
    """Takes photographs of one board with one camera."""

    def __init__(self, board: Board, camera: BoardCamera, *, threads: int | None = None) -> None:
        self.board, self.camera, self.threads = board, camera, threads
        self._content, self._markers = board.pattern()
        self._pixels = _pixels(camera)

    def take(self, pose: Pose, *, seed: int, number: int) -> NDArray[np.uint16]:
        """Raw counts (rows, columns) of one photograph.

        Parameters
        ----------
        pose : Pose
        seed, number : int
            Of the noise; the camera's fixed pattern and the room follow from the seed alone.
        """
        sensor = self.camera.sensor
        range_e = (sensor.saturation_dn - sensor.binned_black_dn) / sensor.binned_gain_dn_per_e
        white_e = EXPOSED * min(sensor.binned_full_well_e, range_e)
        signal = self.irradiance(pose, seed=seed) * (white_e / WHITE) * self._response(seed)
        return expose(
            signal, 1.0, seed=seed, frame=number, threads=self.threads, **sensor.figures()
        )

    def _response(self, seed: int) -> FloatArray:
        """Relative response of every pixel: PRNU alone, bad pixels left out."""
        sensor = self.camera.sensor
        rng = np.random.default_rng([seed, 11])
        return np.asarray(1 + sensor.prnu / sensor.binning * rng.standard_normal(sensor.shape))

    def irradiance(self, pose: Pose, *, seed: int = 0) -> FloatArray:
        """Irradiance of every pixel (rows, columns) without noise, 1 for a white of 1 on axis."""
        from scipy.ndimage import gaussian_filter

        pixels, camera, board = self._pixels, self.camera, self.board
        room = _room(pixels.direction, seed)
        # The board's plane in its own frame: ray = eye + s direction, z = 0.
        to_board = pose.rotation.T
        eye = -to_board @ pose.translation
        rays = [
            np.ascontiguousarray(v @ to_board.T)
            for v in (pixels.direction, pixels.by_column, pixels.by_row)
        ]
        out = np.empty(len(pixels.index))
        size = np.array([*board.size_mm, board.margin_mm, board.square_mm, board.marker_side])

        def work(a: int, b: int) -> None:
            _average(
                *(ray[a:b] for ray in rays), eye, size, self._content, self._markers, room[a:b],
                out[a:b],
            )  # fmt: skip

        map_blocks(work, len(out), threads=self.threads, block=1 << 14)
        image = np.zeros(camera.sensor.shape)
        image.ravel()[pixels.index] = out * pixels.throughput
        blur = camera.lens.psf_px / camera.sensor.binning
        return np.asarray(gaussian_filter(image, blur) if blur else image)


def _pixels(camera: BoardCamera) -> _Pixels:
    """The lens's table: a pixel's rays follow from its middle's to first order.

    What is left out is 1/(24 f^2) in angle, f in pixels: below 1e-3 of a pixel for any fisheye of
    more than 100 pixels across.
    """
    lens, pitch = camera.lens, camera.pitch_mm
    x, y = (grid.ravel() for grid in np.meshgrid(*camera.sensor.positions_mm()))
    theta = lens.polar_angle(np.hypot(x, y))
    index = np.flatnonzero(np.isfinite(theta))
    theta, phi = theta[index], np.arctan2(y, x)[index]
    # d(direction) = e_theta dtheta + e_phi sin(theta) dphi with dtheta = dr/r', dphi = ds/r.
    flat = np.zeros_like(phi)
    e_theta = np.stack([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), -np.sin(theta)])
    e_phi = np.stack([-np.sin(phi), np.cos(phi), flat])
    radius = lens.radius(theta)
    on_axis = radius == 0
    across = np.where(on_axis, 1 / lens.slope(0.0), np.sin(theta) / np.where(on_axis, 1, radius))
    radial, around = e_theta / lens.slope(theta), e_phi * across
    return _Pixels(
        index,
        unit_vectors(theta, phi),
        ((radial * np.cos(phi) - around * np.sin(phi)) * pitch[0]).T,
        ((radial * np.sin(phi) + around * np.cos(phi)) * pitch[1]).T,
        lens.relative_illumination(theta) * lens.solid_angle(theta),
    )


def _room(direction: FloatArray, seed: int) -> FloatArray:
    """What is seen past the board: a room, brighter to one side."""
    rng = np.random.default_rng([seed, 7])
    light = unit_vectors(rng.uniform(0.5, 1.5), rng.uniform(-np.pi, np.pi))
    return np.asarray(ROOM * (1 + 0.4 * direction @ light))


@njit(cache=True, nogil=True)
def _average(w, by_column, by_row, eye, size, content, markers, room, out):  # type: ignore[no-untyped-def]
    """Mean reflectance over the rays of each pixel, more of them where an edge crosses it."""
    for k in range(out.shape[0]):
        mean, mixed = _mean_of(
            GRID, w[k], by_column[k], by_row[k], eye, size, content, markers, room[k]
        )
        if mixed:
            mean, _ = _mean_of(
                FINE_GRID, w[k], by_column[k], by_row[k], eye, size, content, markers, room[k]
            )
        out[k] = mean


@njit(cache=True, nogil=True)
def _mean_of(n, w, by_column, by_row, eye, size, content, markers, room):  # type: ignore[no-untyped-def]
    """Mean reflectance over n x n rays of a pixel, and whether they differ."""
    total, first, mixed = 0.0, 0.0, False
    for i in range(n):
        u = (i + 0.5) / n - 0.5
        for j in range(n):
            v = (j + 0.5) / n - 0.5
            z = w[2] + u * by_column[2] + v * by_row[2]
            value = _OUTSIDE
            # The eye is at negative z, before the face; a ray must go towards it.
            if z > 0.0 and eye[2] < 0.0:
                s = -eye[2] / z
                x = eye[0] + s * (w[0] + u * by_column[0] + v * by_row[0])
                y = eye[1] + s * (w[1] + u * by_column[1] + v * by_row[1])
                value = _reflectance(x, y, size, content, markers)
            value = room if value == _OUTSIDE else value
            if i == 0 and j == 0:
                first = value
            mixed = mixed or value != first
            total += value
    return total / (n * n), mixed


@njit(cache=True, nogil=True)
def _reflectance(x, y, size, content, markers):  # type: ignore[no-untyped-def]
    """Reflectance at a point of the board's plane, or _OUTSIDE."""
    width, height, margin, square, marker = size
    if not (-margin <= x <= width + margin and -margin <= y <= height + margin):
        return _OUTSIDE
    if not (0.0 <= x < width and 0.0 <= y < height):
        return WHITE
    column = min(int(x / square), content.shape[1] - 1)
    row = min(int(y / square), content.shape[0] - 1)
    what = content[row, column]
    if what == -1:
        return BLACK
    if what == -2:
        return WHITE
    cells = markers.shape[1]
    edge = (square - marker) / 2
    i = math.floor((x - column * square - edge) / marker * cells)
    j = math.floor((y - row * square - edge) / marker * cells)
    if 0 <= i < cells and 0 <= j < cells and not markers[what, j, i]:
        return BLACK
    return WHITE


def save_photos(
    folder: Path,
    board: Board,
    camera: BoardCamera,
    *,
    n: int,
    seed: int,
    bits: Literal[8, 16] = 8,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Take n photographs and write them as PNG, with what they show in `truth/truth.json`.

    Parameters
    ----------
    folder : Path
        Made where it is missing; must hold no photographs.
    board, camera : Board, BoardCamera
    n : int
        How many.
    seed : int
        Of poses, room and noise.
    bits : {8, 16}
        Of the files: counts scaled to 255, or times the largest whole number that fits 16 bits.
    threads : int, optional
        The photographs do not depend on it.
    progress : callable, optional
        Called with (done, total).

    Returns
    -------
    list of Path

    Raises
    ------
    ConfigurationError
        If `n` is less than 1 or the folder holds something else.
    DataError
        If a file cannot be written.
    """
    if n < 1:
        raise ConfigurationError(f"{n} photographs; give 1 or more.", value=n)
    names = [f"photo_{k:0{max(2, len(str(n - 1)))}d}.png" for k in range(n)]
    _make_folder(folder)
    poses = draw_poses(board, camera, n, np.random.default_rng([seed, 3]))
    photographer = Photographer(board, camera, threads=threads)
    write_text(
        folder / "truth" / "truth.json",
        json.dumps(_document(board, camera, names, poses, seed), indent=1) + "\n",
    )
    paths = []
    for number, (name, pose) in enumerate(zip(names, poses, strict=True)):
        counts = photographer.take(pose, seed=seed, number=number)
        path = folder / name
        _write_png(path, _as_file(counts, camera.sensor.saturation_dn, bits))
        paths.append(path)
        if progress is not None:
            progress(number + 1, n)
    return paths


def _make_folder(folder: Path) -> None:
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigurationError(
            f"{folder}: is there already; give the name of a new folder.", value=folder
        )
    try:
        (folder / "truth").mkdir(parents=True)
    except OSError as error:
        raise DataError(f"{folder}: cannot be made ({error.strerror}).", value=folder) from None


def _as_file(counts: NDArray[np.uint16], top: int, bits: int) -> NDArray[Any]:
    if bits == 8:
        return np.round(counts * (255 / top)).astype(np.uint8)
    return counts * np.uint16(65535 // top)


def _write_png(path: Path, image: NDArray[Any]) -> None:
    import cv2

    done, data = cv2.imencode(".png", image)
    if not done:
        raise DataError(f"{path}: cannot be written as PNG.", value=path)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data.tobytes())


def _document(
    board: Board, camera: BoardCamera, names: list[str], poses: list[Pose], seed: int
) -> dict[str, Any]:
    """What the photographs show; corners are listed where the field shows them."""
    photos = []
    for name, pose in zip(names, poses, strict=True):
        points = pose.to_camera(board.corners_mm())
        pixels = camera.project(points)
        seen = np.flatnonzero(np.isfinite(pixels[:, 0]))
        photos.append(
            {
                "file": name,
                "rotation": pose.rotation.tolist(),
                "translation_mm": pose.translation.tolist(),
                "theta_max_deg": float(np.degrees(angles(points[seen])[0].max(initial=0))),
                "corners": [[int(k), *pixels[k].tolist()] for k in seen],
            }
        )
    rows, columns = camera.sensor.shape
    return {
        "schema": "gonio.boards/1",
        "board": asdict(board),
        "lens": camera.lens.model_dump(mode="json"),
        "rows": rows,
        "columns": columns,
        "pitch_mm": camera.pitch_mm.tolist(),
        "centre_px": camera.centre_px.tolist(),
        "seed": seed,
        "photos": photos,
    }
