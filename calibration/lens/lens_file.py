"""The file of a calibrated lens: TOML or JSON, with a table `lens` that a session's metadata takes.

`schema`, `lens` and `frame` are for programs; `fit` describes the calibration for people and is
free in form.
"""

from __future__ import annotations

import json
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from gonio.calibration.lens.cross_check import CrossCheck
from gonio.calibration.lens.from_photos import LensFromPhotos
from gonio.errors import ConfigurationError, DataError
from gonio.files import write_text
from gonio.metadata import LensCalibration

SCHEMA = "gonio.lens/1"
SUFFIXES = (".toml", ".json")
THETA_DEG = (60.0, 75.0, 85.0, 90.0)


@dataclass(frozen=True)
class CalibratedLens:
    """A lens with the size of the frames that its centre belongs to."""

    lens: LensCalibration
    rows: int
    columns: int


def document(
    calibration: LensFromPhotos, checks: list[CrossCheck], *, frame_binning: int = 1
) -> dict[str, Any]:
    """A calibration as JSON types; unknown is None."""
    fit, n = calibration.fit, frame_binning
    sd = np.degrees(fit.theta_sd(np.radians(THETA_DEG)))
    return {
        "schema": SCHEMA,
        "lens": calibration.record(n).model_dump(mode="json"),
        "frame": {"rows": calibration.shape[0] // n, "columns": calibration.shape[1] // n},
        "fit": {
            "board": str(calibration.board),
            "pitch_um": [p * 1e3 for p in calibration.pitch_mm],
            "frame_binning": n,
            "n_photos": calibration.n_photos,
            "n_used": len(fit.views),
            "n_corners": fit.n_corners,
            "n_outliers": sum(fit.outliers.values()),
            "rms_px": fit.rms_px,
            "theta_reached_deg": calibration.reach_deg,
            "theta_deg": list(THETA_DEG),
            "theta_sd_deg": [float(v) for v in sd],
            "photos": _photos(calibration),
            "cross_check": [_check(check) for check in checks],
            "warnings": calibration.warnings(),
        },
    }


def _photos(calibration: LensFromPhotos) -> list[dict[str, Any]]:
    used: list[dict[str, Any]] = [
        {
            "name": view.name,
            "corners": len(view.pixels),
            "outliers": calibration.fit.outliers.get(view.name, 0),
            "rms_px": float(np.sqrt(np.mean(np.sum(residual**2, axis=1)))),
        }
        for view, residual in zip(calibration.fit.views, calibration.fit.residuals, strict=True)
    ]
    return used + [{"name": name, "dropped": why} for name, why in calibration.dropped.items()]


def _check(check: CrossCheck) -> dict[str, Any]:
    if check.failure:
        return {"name": check.name, "failure": check.failure}
    return {
        "name": check.name,
        "rms_px": check.rms_px,
        "n_corners": check.n_corners,
        "theta_to_deg": list(check.difference_deg),
        "theta_difference_deg": list(check.difference_deg.values()),
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
            f"{path}: a lens is written as TOML or JSON; give a name that ends in "
            f"{' or '.join(SUFFIXES)}.",
            value=path,
        )


def write(path: Path, content: dict[str, Any]) -> None:
    """Write a `document`, whole or not at all; the suffix decides the format."""
    check_suffix(path)
    if path.suffix == ".json":
        text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    else:
        text = "\n".join(_toml(content)) + "\n"
    write_text(path, text)


def read(path: str | Path) -> CalibratedLens:
    """A lens from the file that `gonio calibrate lens` wrote.

    Raises
    ------
    DataError
        If the file cannot be read or is not one.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text) if path.suffix == ".json" else tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read as text ({error}).", value=path) from None
    except ValueError as error:
        raise DataError(
            f"{path}: not valid {path.suffix[1:].upper()}: {error}.", value=path
        ) from None
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise DataError(
            f"{path}: not a calibrated lens (schema {SCHEMA!r}); give a file that "
            "'gonio calibrate lens' wrote.",
            value=path,
        )
    try:
        frame = content["frame"]
        lens = LensCalibration.model_validate(content["lens"])
        return CalibratedLens(lens, int(frame["rows"]), int(frame["columns"]))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(("lens", *map(str, first["loc"])))
        raise DataError(f"{path}: {key}: {first['msg']}.", value=path) from None
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(
            f"{path}: lens or frame is missing or wrong ({error}).", value=path
        ) from None


def _toml(table: dict[str, Any], path: tuple[str, ...] = ()) -> list[str]:
    """Lines of a TOML table; below it tables and lists of tables."""
    scalars = {k: v for k, v in table.items() if v is not None and not _is_table(v)}
    lines = [f"{key} = {_toml_value(value)}" for key, value in scalars.items()]
    for key, value in table.items():
        if not _is_table(value):
            continue
        name = ".".join((*path, key))
        if isinstance(value, dict):
            lines += ["", f"[{name}]", *_toml(value, (*path, key))]
        for each in value if isinstance(value, list) else ():
            lines += ["", f"[[{name}]]", *_toml(each, (*path, key))]
    return lines


def _is_table(value: Any) -> bool:
    return isinstance(value, dict) or (
        isinstance(value, list) and bool(value) and isinstance(value[0], dict)
    )


def _toml_value(value: Any) -> str:
    if isinstance(value, list) and value and isinstance(value[0], list):
        rows = "".join(f"\n  {_toml_value(row)}," for row in value)
        return f"[{rows}\n]"
    # JSON's numbers, texts and lists are TOML's.
    return json.dumps(value, ensure_ascii=False, allow_nan=False)
