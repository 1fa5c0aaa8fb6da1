"""The file of a calibrated camera: TOML or JSON, with tables that a rig's description takes.

`schema`, `camera`, `uncertainty` and `frame` are for programs; `fit` is for people and free in
form. Figures are of one pixel of the frames, which is a sum of `frame.n_summed` pixels of the
files. TOML has no value for unknown: what is unknown is not written there, and null in JSON.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from gonio.calibration.frames.photon_transfer import CameraFigures
from gonio.errors import ConfigurationError, DataError
from gonio.files import write_text

SCHEMA = "gonio.camera/1"
SUFFIXES = (".toml", ".json")
_NEEDED = ("gain_dn_per_e", "black_dn", "read_noise_e", "dark_e_per_s")


def document(result: CameraFigures, shape: tuple[int, int], *, n_summed: int = 1) -> dict[str, Any]:
    """Figures as JSON types; unknown is None.

    Parameters
    ----------
    result : CameraFigures
    shape : tuple of int
        Rows and columns of the frames.
    n_summed : int
        Pixels of the files in a pixel of the frames.
    """
    found = result.levels
    departure = [None if np.isnan(value) else float(value) for value in result.departure]
    return {
        "schema": SCHEMA,
        "camera": {name: figure.value for name, figure in result.figures.items()},
        "uncertainty": {name: figure.u for name, figure in result.figures.items()},
        "frame": {"rows": shape[0], "columns": shape[1], "n_summed": n_summed},
        "fit": {
            "exposures_s": found.time_s.tolist(),
            "signal_dn": result.signal_dn.tolist(),
            "variance_dn2": found.flat_variance.tolist(),
            "used": result.used.tolist(),
            "largest_departure": max(abs(value) for value in departure if value is not None),
            "lamp_sd": result.lamp_sd,
            "dof": result.dof,
            "n_pixels": found.n_pixels,
            "n_bad_pixels": found.n_bad,
            "warnings": list(result.warnings),
        },
    }


def check_suffix(path: Path) -> None:
    """Refuse a name that ends in neither .toml nor .json.

    Raises
    ------
    ConfigurationError
        If it does.
    """
    if path.suffix not in SUFFIXES:
        raise ConfigurationError(
            f"{path}: a camera is written as TOML or JSON; give a name that ends in "
            f"{' or '.join(SUFFIXES)}.",
            value=path,
        )


def write(path: Path, content: dict[str, Any]) -> None:
    """Write a `document`, whole or not at all; the suffix decides the format."""
    check_suffix(path)
    if path.suffix == ".json":
        write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")
        return
    lines = [f"schema = {json.dumps(content['schema'])}"]
    for name in ("camera", "uncertainty", "frame", "fit"):
        # JSON's numbers, texts and lists are TOML's.
        known = {key: value for key, value in content[name].items() if value is not None}
        lines += ["", f"[{name}]", *(f"{k} = {json.dumps(v)}" for k, v in known.items())]
    write_text(path, "\n".join(lines) + "\n")


def read(path: Path) -> dict[str, float]:
    """The figures of one pixel of the files, as the table [camera] of session.toml has them.

    What the calibration did not find is missing.

    Raises
    ------
    DataError
        If the file cannot be read or is not one.
    """
    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read as text ({error}).", value=path) from None
    except ValueError as error:
        kind = path.suffix[1:].upper()
        raise DataError(f"{path}: not valid {kind}: {error}.", value=path) from None
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise DataError(
            f"{path}: not a calibrated camera (schema {SCHEMA!r}); give a file that "
            "'gonio calibrate camera' wrote.",
            value=path,
        )
    try:
        camera = {k: float(v) for k, v in content["camera"].items() if v is not None}
        u = content["uncertainty"].get("nonlinearity_per_decade")
        n = int(content["frame"]["n_summed"])
        return _of_one(camera, n) | ({} if u is None else {"u_nonlinearity_per_decade": float(u)})
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(
            f"{path}: camera, uncertainty or frame is missing or wrong ({error}).", value=path
        ) from None


def _of_one(camera: dict[str, float], n: int) -> dict[str, float]:
    """Figures of one of n pixels whose rounded counts were summed."""
    gain, black, noise_e, dark = (camera[name] for name in _NEEDED)
    sum_noise = (gain * noise_e) ** 2 - (n - 1) / 12
    found = {
        "gain_dn_per_e": gain,
        "black_dn": max(black / n, 0.0),
        "read_noise_e": max(sum_noise / n, 0.0) ** 0.5 / gain,
        "dark_e_per_s": dark / n,
    }
    if "saturation_dn" in camera:
        found["saturation_dn"] = round(camera["saturation_dn"] / n)
    if "full_well_e" in camera:
        found["full_well_e"] = camera["full_well_e"] / n
    if "nonlinearity_per_decade" in camera:
        found["nonlinearity_per_decade"] = camera["nonlinearity_per_decade"]
    return found
