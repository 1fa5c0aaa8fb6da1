"""Files of BRDF samples: one file of this folder is one format.

A format is a module with `NAME`, `TITLE`, `mismatch(path, head)`, which says why a file that begins
with these bytes is in another format (None where it is in this one), and `read(path)`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from gonio.discovery import modules_in
from gonio.errors import ConfigurationError, DataError, unknown_name
from gonio.files import sha256_of
from gonio.samples import BRDFSamples

__all__ = ["choose", "names", "read"]

SELECTIONS = ("channel", "wavelength")
_HEAD = 1 << 16
# Wavelengths agree when they do to a millionth of a nanometre.
_SAME_NM = 1e-6


@cache
def _all() -> dict[str, ModuleType]:
    formats = {module.NAME: module for module in modules_in(__name__, private=False)}
    # A file that only its suffix gives away is taken for gonio's own table last.
    return dict(sorted(formats.items(), key=lambda item: (item[0] == "gonio_csv", item[0])))


def names() -> list[str]:
    """Names of the formats that can be read.

    Examples
    --------
    >>> names()
    ['cornell', 'nist_ptfe', 'samples_nc', 'gonio_csv']
    """
    return list(_all())


def read(path: str | Path, *, select: Mapping[str, str] | None = None) -> BRDFSamples:
    """Read BRDF samples from a file of any known format, which its content decides.

    Parameters
    ----------
    path : str or Path
        The file.
    select : mapping, optional
        ``{"wavelength": "650"}`` keeps the samples at that wavelength in nm,
        ``{"channel": "red"}`` those of that channel. Several: ``"450,650"``, ``"600..700"``,
        ``"600.."``, ``"..480"``, ``"red,blue"``.

    Returns
    -------
    BRDFSamples
        With `metadata` telling ``format``, ``path`` (the file's name without folders) and
        ``sha256`` of the file.

    Raises
    ------
    DataError
        If the file is in no known format (the message says for each why not) or its content
        cannot be used (the message ends with the format that was read).
    ConfigurationError
        If `select` has an unknown key or asks for what the file does not hold.

    Examples
    --------
    >>> import tempfile
    >>> file = Path(tempfile.mkdtemp()) / "paint.brdf"
    >>> n = file.write_text("2\\n450 650\\n0.5 0 0.5 3.141593 0.02 0.3\\n")
    >>> samples = read(file, select={"wavelength": "650"})
    >>> samples.value.tolist(), samples.metadata["format"]
    ([0.3], 'cornell')
    """
    path = Path(path)
    # A wrong key is refused before a long file is read.
    for key in select or ():
        if key not in SELECTIONS:
            raise unknown_name("selection", key, SELECTIONS)
    module = _format_of(path)
    try:
        samples: BRDFSamples = module.read(path)
    except DataError as error:
        raise DataError(f"{error} (Read as {module.NAME}.)", value=error.value) from error
    samples = replace(
        samples,
        metadata={
            **samples.metadata,
            "format": module.NAME,
            "path": path.name,
            "sha256": sha256_of(path),
        },
        history=(*samples.history, f"{len(samples)} samples read from {path.name}, {module.NAME}"),
    )
    return choose(samples, select or {}, where=str(path))


def choose(
    samples: BRDFSamples, select: Mapping[str, str], *, where: str = "samples"
) -> BRDFSamples:
    """The samples of some wavelengths or channels, as `read` selects them.

    Parameters
    ----------
    samples : BRDFSamples
    select : mapping
        As for `read`.
    where : str
        What the messages call the samples.

    Raises
    ------
    ConfigurationError
        If `select` has an unknown key or asks for what the samples do not hold.
    """
    for key, wanted in select.items():
        if key == "wavelength":
            samples = _at_wavelength(samples, str(wanted), where)
        elif key == "channel":
            samples = _in_channel(samples, str(wanted), where)
        else:
            raise unknown_name("selection", key, SELECTIONS)
    return samples


def require_file(path: Path) -> None:
    """Refuse what is no file.

    Raises
    ------
    DataError
        If there is none of this name, or it is a folder.
    """
    if not path.is_file():
        kind = "a folder, not a file" if path.is_dir() else "no such file"
        raise DataError(f"{path}: {kind}; give a file of BRDF samples.", value=path)


def _format_of(path: Path) -> ModuleType:
    require_file(path)
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD)
    except OSError as error:
        raise DataError(
            f"{path}: cannot be read ({error.strerror or error}).", value=path
        ) from error
    if not head:
        raise DataError(f"{path}: the file is empty; give a file of BRDF samples.", value=path)
    reasons = []
    for name, module in _all().items():
        reason = module.mismatch(path, head)
        if reason is None:
            return module
        reasons.append(f"{name}: {reason}")
    raise DataError(
        f"{path}: in no known format of BRDF samples; tried {'; '.join(reasons)}.", value=path
    )


def _at_wavelength(samples: BRDFSamples, wanted: str, where: str) -> BRDFSamples:
    ranges = [_range(text.strip(), wanted) for text in wanted.split(",")]
    if samples.wavelength_nm is None:
        raise ConfigurationError(
            f"{where}: no wavelengths are stated, so none can be selected; "
            "leave the selection out.",
            value=wanted,
        )
    keep = np.zeros(len(samples), dtype=bool)
    for low, high in ranges:
        within = samples.wavelength_nm >= low - _SAME_NM
        within &= samples.wavelength_nm <= high + _SAME_NM
        if not within.any():
            raise _no_wavelength(np.unique(samples.wavelength_nm), low, high, where)
        keep |= within
    shown = wanted if len(ranges) > 1 or ".." in wanted else f"{ranges[0][0]:.9g}"
    return samples.select(keep, f"wavelength {shown} nm")


def _range(text: str, wanted: str) -> tuple[float, float]:
    """Ends in nm of ``650``, ``600..700``, ``600..`` or ``..480``."""
    first, dots, last = text.partition("..")
    try:
        low = float(first) if first or not dots else 0.0
        high = (float(last) if last else np.inf) if dots else low
    except ValueError:
        low = high = np.nan
    if not (0 <= low <= high and high > 0) or text == "..":
        raise ConfigurationError(
            f"wavelength {wanted!r} is not a positive number; give it in nm, such as 650, or "
            "several as 450,650 or 600..700, where one end may be left out.",
            value=wanted,
        )
    return low, high


def _no_wavelength(
    listed: NDArray[np.float64], low: float, high: float, where: str
) -> ConfigurationError:
    listed_text = f"Listed: {_shortened([f'{value:.9g}' for value in listed])}."
    if low != high:
        end = "up" if np.isinf(high) else f"to {high:.9g}"
        return ConfigurationError(
            f"{where}: no sample from {low:.9g} nm {end}. {listed_text}", value=(low, high)
        )
    nearest = listed[np.argmin(np.abs(listed - low))]
    return ConfigurationError(
        f"{where}: no sample at {low:.9g} nm; the nearest is {nearest:.9g} nm. {listed_text}",
        value=low,
    )


def _in_channel(samples: BRDFSamples, wanted: str, where: str) -> BRDFSamples:
    if samples.channel is None:
        raise ConfigurationError(
            f"{where}: no channels are named, so none can be selected; leave the selection out.",
            value=wanted,
        )
    channels = np.unique(samples.channel).tolist()
    # A comma may stand in a name: the whole text is a name first.
    names = [wanted] if wanted in channels else [name.strip() for name in wanted.split(",")]
    for name in names:
        if name not in channels:
            raise unknown_name("channel", name, channels, of=where)
    return samples.select(np.isin(samples.channel, names), f"channel {wanted}")


def _shortened(items: list[str], most: int = 40) -> str:
    return ", ".join(items[:most]) + (f" and {len(items) - most} more" if len(items) > most else "")
