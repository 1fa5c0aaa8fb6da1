"""Photographs of a calibration board as files, with their true poses."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gonio.board import Board
from gonio.errors import ConfigurationError, DataError
from gonio.files import atomic_path, write_text
from gonio.geometry import angles
from gonio.instrument.board_camera import BoardCamera
from gonio.instrument.board_photos import Photographer
from gonio.instrument.board_poses import Pose, draw_poses


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
    """Take n photographs and write them as PNG, with their true poses in `truth/truth.json`.

    Parameters
    ----------
    folder : Path
        Created if it does not exist; must not contain photographs.
    board, camera : Board, BoardCamera
    n : int
        Number of photographs.
    seed : int
        Seed of the random numbers: poses, room and noise.
    bits : {8, 16}
        Bits per pixel: counts scaled to 255, or times the largest integer factor that fits 16 bits.
    threads : int, optional
        Number of worker threads; the photographs do not depend on it.
    progress : callable, optional
        Called with (done, total).

    Returns
    -------
    list of Path

    Raises
    ------
    ConfigurationError
        If `n` is less than 1 or the folder contains other files.
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
    """Poses of the photographs, with those corners that lie in the field."""
    photos = []
    for name, pose in zip(names, poses, strict=True):
        points = pose.to_camera(board.corners_mm())
        pixels = camera.project(points)
        visible = np.flatnonzero(np.isfinite(pixels[:, 0]))
        photos.append(
            {
                "file": name,
                "rotation": pose.rotation.tolist(),
                "translation_mm": pose.translation.tolist(),
                "theta_max_deg": float(np.degrees(angles(points[visible])[0].max(initial=0))),
                "corners": [[int(k), *pixels[k].tolist()] for k in visible],
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
