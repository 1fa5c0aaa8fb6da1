"""Versions of this installation, and a test whether it works."""

from __future__ import annotations

import math
import os
import platform
import re
from collections.abc import Callable
from importlib import metadata
from itertools import chain
from typing import Any

from gonio._version import __version__

_DIGITS = 1e-12
# What an extra of pyproject.toml adds for a user; the others are for the development of gonio.
EXTRAS = {
    "arviz": "posteriors as objects of arviz",
    "bench": "benchmarks against other programs",
    "exr": "frames and pictures in EXR files",
    "raw": "raw files of digital cameras",
}


def doctor() -> dict[str, Any]:
    """Check this installation: versions, cores, cache, and two computations.

    Returns
    -------
    dict
        ``ok`` states whether everything works. ``dependencies`` holds the version of each required
        package, None if it is missing. ``checks`` holds for each computation its title, whether it
        passed, and the numbers.

    Examples
    --------
    >>> doctor()["ok"]
    True
    """
    needed, extras = _requirements()
    versions = {name: _version(name) for name in needed}
    missing = sorted(name for name, version in versions.items() if version is None)
    checks = [] if missing else [_check(*each) for each in _CHECKS]
    return {
        "schema": "gonio.doctor/1",
        "ok": not missing and all(check["ok"] for check in checks),
        "gonio": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "dependencies": versions,
        "missing": missing,
        "missing_optional": sorted(
            name for name in {*chain(*extras.values())} if _version(name) is None
        ),
        "extras": {name: _extra(name, extras[name]) for name in sorted(EXTRAS) if name in extras},
        "cores": _cores(),
        "threads": None if missing else _threads(),
        "cache": None if missing else _cache(),
        "checks": checks,
    }


def _requirements() -> tuple[list[str], dict[str, list[str]]]:
    """Names of the packages that gonio needs, and of those that each extra needs."""
    needed: list[str] = []
    extras: dict[str, list[str]] = {}
    for line in metadata.requires("gonio") or []:
        name = re.split(r"[^A-Za-z0-9._-]", line, maxsplit=1)[0]
        extra = re.search(r"extra == ['\"]([^'\"]+)", line)
        (extras.setdefault(extra[1], []) if extra else needed).append(name)
    return needed, extras


def _extra(name: str, packages: list[str]) -> dict[str, Any]:
    """What an extra is for, its packages with their versions, and how to get it."""
    versions = {package: _version(package) for package in packages}
    return {
        "for": EXTRAS[name],
        "packages": versions,
        "installed": None not in versions.values(),
        "install": f"python -m pip install 'gonio[{name}]'",
    }


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _threads() -> int:
    from gonio.kernels.threads import default_threads

    return default_threads()


def _cache() -> dict[str, Any]:
    """The folder of compiled code; a temporary folder is used if it cannot be written."""
    import gonio.cache as cache

    wanted = cache.wanted_folder()
    return {"folder": str(wanted), "writable": cache.folder() == wanted}


def _check(title: str, compute: Callable[[], tuple[float, float]]) -> dict[str, Any]:
    """Compare one computation with a number from `math`; an exception is a failure, not a crash."""
    try:
        value, expected = compute()
    except Exception as error:
        return {"check": title, "ok": False, "detail": f"{type(error).__name__}: {error}"}
    difference = abs(value / expected - 1)
    return {
        "check": title,
        "ok": bool(difference < _DIGITS),
        "detail": f"{value:.13g}, expected {expected:.13g}",
    }


def _ward() -> tuple[float, float]:
    """Ward 1992, eq. (5a), in the plane of incidence: 30 deg in, 45 deg out."""
    import gonio.models as models
    from gonio.geometry import Directions

    theta_i, theta_r = math.radians(30), math.radians(45)
    rho_d, rho_s, alpha_x, alpha_y = 0.1, 0.2, 0.15, 0.3
    value = models.get("ward")(
        Directions(theta_i, 0.0, theta_r, math.pi),
        rho_d=rho_d,
        rho_s=rho_s,
        alpha_x=alpha_x,
        alpha_y=alpha_y,
    )
    # The half vector lies halfway between the two directions, in the x-z plane.
    tan_delta = math.tan((theta_r - theta_i) / 2)
    lobe = math.exp(-((tan_delta / alpha_x) ** 2)) / (4 * math.pi * alpha_x * alpha_y)
    shading = math.sqrt(math.cos(theta_i) * math.cos(theta_r))
    return float(value), rho_d / math.pi + rho_s * lobe / shading


def _trace() -> tuple[float, float]:
    """An ellipsoid sends every ray of the camera's focus to the sample's, the other focus."""
    from gonio.instrument import Dome

    R, D = 150.0, 15.0
    theta_r, _ = Dome(shape="ellipsoid", R=R, D=D).reflected_angles(0.0, 0.0)
    return float(theta_r), math.atan2(2 * D * math.hypot(R, D), R * R)


_CHECKS: tuple[tuple[str, Callable[[], tuple[float, float]]], ...] = (
    ("Ward model, sr^-1", _ward),
    ("ray off the dome, rad", _trace),
)
