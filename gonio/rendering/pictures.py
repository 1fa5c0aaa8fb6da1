"""Pictures on disk: PNG to look at, and the linear radiance as PFM, EXR or .npy.

A PNG holds 8 bits a pixel on the sRGB curve: 255 [L/white] by the curve of IEC 61966-2-1, clipped
at white. Where no white is given and a highlight would leave the rest of the picture nearly black,
dark values are lifted first: v becomes ln(1 + a v) / ln(1 + a) with v = L/white. The picture's text
states white and a.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigurationError, DataError
from gonio.files import atomic_path
from gonio.geometry import FloatArray

SUFFIXES = (".png", ".pfm", ".exr", ".npy")
MAPS = (".pfm", ".hdr", ".exr", ".npy")
MIDDLE = (
    0.22  # linear grey value, 128 of 255 on the sRGB curve, that the median does not fall below
)
MOST_LIFT = 1e6
BRIGHTEST = 99.5  # percentile of the lit pixels that is white by default
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear Rec. 709 red, green, blue


def white_of(image: FloatArray) -> float:
    """Radiance that a picture shows as white by default.

    Examples
    --------
    >>> white_of(np.array([[0.0, 2.0, 2.0]]))
    2.0
    """
    lit = image[image > 0]
    return float(np.percentile(lit, BRIGHTEST)) if len(lit) else 1.0


def lift_of(image: FloatArray, white: float) -> float:
    """Lift of dark values that brings the median of the lit pixels to a middle grey.

    Returns
    -------
    float
        The a of ln(1 + a v) / ln(1 + a), v = L/white; 0, which is linear, where the median is
        bright enough.

    Examples
    --------
    >>> lift_of(np.array([0.5, 0.6, 1.0]), 1.0)
    0.0
    >>> lift = lift_of(np.array([0.02, 0.02, 1.0]), 1.0)
    >>> round(float(np.log1p(lift * 0.02) / np.log1p(lift)), 6)
    0.22
    """
    lit = image[image > 0]
    median = float(np.median(lit)) / white if len(lit) else 1.0
    if median >= MIDDLE:
        return 0.0
    low, high = -8.0, float(np.log(MOST_LIFT))
    for _ in range(60):  # the lifted median grows with ln a
        middle = (low + high) / 2
        lift = np.exp(middle)
        below = np.log1p(lift * median) < MIDDLE * np.log1p(lift)
        low, high = (middle, high) if below else (low, middle)
    return float(f"{np.exp(high):.6g}")


def srgb(image: FloatArray, white: float, lift: float = 0.0) -> NDArray[np.uint8]:
    """Bytes of a picture on the sRGB curve, clipped at `white`.

    Parameters
    ----------
    image : ndarray
        Linear radiance.
    white : float
        Radiance that becomes 255.
    lift : float
        How much dark values are lifted, see `lift_of`; 0 is linear.

    Raises
    ------
    ConfigurationError
        If white is not positive.

    Examples
    --------
    >>> srgb(np.array([0.0, 0.2158605, 1.0, 5.0]), 1.0).tolist()
    [0, 128, 255, 255]
    """
    if not (np.isfinite(white) and white > 0):
        raise ConfigurationError(
            f"white = {white:g}: the radiance that is shown as white must be positive.",
            value=white,
        )
    v = np.clip(image / white, 0, 1)
    if lift > 0:
        v = np.log1p(lift * v) / np.log1p(lift)
    curve = np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * curve), np.uint8)


def check_name(path: str | Path, allowed: tuple[str, ...] = SUFFIXES) -> str:
    """The suffix of a file that a picture may be written to.

    Raises
    ------
    ConfigurationError
        For another suffix.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in allowed:
        raise ConfigurationError(
            f"{path}: a picture is written as .png to look at, or with linear radiance as "
            f"{', '.join(s for s in allowed if s != '.png')}; give a name that ends so.",
            value=path,
        )
    if suffix == ".exr":
        _openexr(path)
    return suffix


def save_picture(
    image: FloatArray,
    path: str | Path,
    *,
    white: float | None = None,
    lift: float | None = None,
    facts: Mapping[str, Any] | None = None,
) -> None:
    """Write a picture, whole or not at all.

    Parameters
    ----------
    image : ndarray, shape (rows, columns)
        Linear radiance.
    path : path
        .png shows it; .pfm and .exr (32 bits) and .npy (64 bits) keep the radiance.
    white : float, optional
        Radiance that a PNG shows as white; that of `white_of` where not given.
    lift : float, optional
        How much a PNG lifts dark values; that of `lift_of` where neither it nor `white` is given,
        else 0.
    facts : mapping, optional
        Metadata of a PNG or an EXR, written as one JSON document.

    Raises
    ------
    ConfigurationError
        For another suffix, a white that is not positive, or EXR without OpenEXR.
    DataError
        If the file cannot be written.
    """
    suffix = check_name(path)
    if suffix == ".png":
        if lift is None:
            lift = lift_of(image, white_of(image)) if white is None else 0.0
        data = png(image, white_of(image) if white is None else white, facts or {}, lift)
    with atomic_path(Path(path)) as temporary:
        if suffix == ".png":
            temporary.write_bytes(data)
        elif suffix == ".pfm":
            temporary.write_bytes(_pfm(image))
        elif suffix == ".npy":
            with temporary.open("wb") as file:
                np.save(file, image)
        else:
            _save_exr(image, temporary, facts or {})


def png(image: FloatArray, white: float, facts: Mapping[str, Any], lift: float = 0.0) -> bytes:
    """A grey PNG with its tone mapping and `facts` in its text."""
    from PIL import Image, PngImagePlugin

    pixels = srgb(image, white, lift)
    text = {
        "Software": "gonio",
        "Description": tone_text(white, lift),
        "Comment": json.dumps(dict(facts), ensure_ascii=True, allow_nan=False),
    }
    about = PngImagePlugin.PngInfo()
    about.add(b"sRGB", b"\0")
    for key, value in text.items():
        about.add_text(key, value)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG", pnginfo=about, optimize=True)
    return file.getvalue()


def tone_text(white: float, lift: float = 0.0) -> str:
    """Sentence on the mapping from radiance to grey values."""
    lifted = f"dark values are lifted, ln(1 + {lift:.4g} v) with v = L/white; " if lift > 0 else ""
    return f"radiance {white:.6g} is white and more is clipped; {lifted}8 bits on the sRGB curve"


def _pfm(image: FloatArray) -> bytes:
    """Portable float map: rows from the bottom; a negative scale says little-endian."""
    rows, columns = image.shape
    header = f"Pf\n{columns} {rows}\n-1.0\n".encode()
    return header + np.flipud(image).astype("<f4").tobytes()


def _openexr(path: str | Path) -> Any:
    try:
        import OpenEXR
    except ImportError:
        raise ConfigurationError(
            f"{path}: EXR files need OpenEXR, which is not installed; run "
            "'python -m pip install OpenEXR', or use .pfm.",
            value=path,
        ) from None
    return OpenEXR


def _save_exr(image: FloatArray, path: Path, facts: Mapping[str, Any]) -> None:
    exr = _openexr(path)
    header = {
        "compression": exr.ZIP_COMPRESSION,
        "type": exr.scanlineimage,
        "comments": json.dumps(dict(facts), ensure_ascii=True, allow_nan=False),
    }
    exr.File(header, {"Y": np.ascontiguousarray(image, np.float32)}).write(str(path))


def read_map(path: str | Path) -> FloatArray:
    """Linear radiance of a picture: .pfm, .hdr, .exr or .npy.

    Parameters
    ----------
    path : path
        A colour becomes its luminance, 0.2126 R + 0.7152 G + 0.0722 B.

    Returns
    -------
    ndarray, shape (rows, columns)
        Top row first.

    Raises
    ------
    ConfigurationError
        For another suffix, or EXR without OpenEXR.
    DataError
        If the file is missing or not readable.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MAPS:
        raise ConfigurationError(
            f"{path}: an environment is read from {', '.join(MAPS)}; convert it to one of these.",
            value=path,
        )
    if not path.is_file():
        raise DataError(f"{path}: no such file; give a map in latitude and longitude.", value=path)
    read = {".pfm": _read_pfm, ".hdr": _read_hdr, ".exr": _read_exr, ".npy": _read_npy}[suffix]
    image = read(path)
    if image.ndim == 3 and image.shape[2] in (3, 4):
        image = image[:, :, :3] @ _LUMINANCE
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim != 2 or not image.size:
        raise DataError(
            f"{path}: has the shape {image.shape}; a grey or a red-green-blue picture is needed.",
            value=path,
        )
    return np.asarray(image, float)


def _unreadable(path: Path, reason: str) -> DataError:
    return DataError(f"{path}: cannot be read as a picture ({reason}); write it again.", value=path)


def _read_pfm(path: Path) -> FloatArray:
    with path.open("rb") as file:
        kind, size, scale = (file.readline(64).strip() for _ in range(3))
        data = file.read()
    try:
        channels = {b"Pf": 1, b"PF": 3}[kind]
        columns, rows = (int(word) for word in size.split())
        order = "<f4" if float(scale) < 0 else ">f4"
        values = np.frombuffer(data, order, rows * columns * channels)
    except (KeyError, ValueError):
        raise _unreadable(path, "its header or its length is not that of a PFM") from None
    shaped: FloatArray = values.reshape(rows, columns, channels)[::-1].astype(float)
    return shaped


def _read_hdr(path: Path) -> FloatArray:
    import cv2

    try:
        decoded = cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        decoded = None
    if decoded is None:
        raise _unreadable(path, "it is no Radiance picture, or damaged")
    return np.asarray(decoded[:, :, ::-1], float)  # OpenCV has blue first


def _read_npy(path: Path) -> FloatArray:
    try:
        return np.asarray(np.load(path, allow_pickle=False), float)
    except (ValueError, EOFError, OSError):
        raise _unreadable(path, "it holds no array of numbers") from None


def _read_exr(path: Path) -> FloatArray:
    exr = _openexr(path)
    try:
        channels = exr.File(str(path), separate_channels=True).channels()
    except Exception as error:  # its bindings raise many types
        raise _unreadable(path, str(error).strip() or type(error).__name__) from None
    names = ["R", "G", "B"] if "R" in channels else list(channels)[:1]
    return np.stack([np.asarray(channels[name].pixels, float) for name in names], axis=2)
