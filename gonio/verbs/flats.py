"""Flat and dark frames by the sensor of a virtual instrument."""

from __future__ import annotations

from pathlib import Path

from gonio.errors import ConfigurationError
from gonio.instrument import Instrument, load
from gonio.instrument.flats import save_flats
from gonio.progress import Progress


def flats(
    output: str | Path,
    *,
    instrument: Instrument | str = "modern12",
    count: int = 12,
    takes: int = 2,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Path:
    """Record flat and dark frames with the sensor of a virtual instrument.

    An even light falls on the sensor, without lens or dome. The exposures span two decades of
    signal, and the longest saturates. `gonio.calibrate_camera` reads the folder.

    Parameters
    ----------
    output : path
        New folder.
    instrument : Instrument or str
        A preset, a TOML file, or an object.
    count : int
        Number of exposures, 4 or more.
    takes : int
        Frames of a kind at an exposure, 2 or more.
    seed : int
        Seed of the random numbers. The sensor is that of sessions with the same seed.
    threads : int, optional
        Number of worker threads; the frames do not depend on it.
    progress : callable, optional
        Called with (frames done, frames in all).

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ConfigurationError
        For an unknown instrument, too few exposures or takes, or a folder that is not empty.
    DataError
        If a file cannot be written.

    Examples
    --------
    >>> import gonio, tempfile
    >>> instrument = gonio.instrument.preset("ideal12").with_pixels(52)
    >>> folder = flats(tempfile.mkdtemp() + "/flats", instrument=instrument, count=4)
    >>> len(list(folder.glob("*.png")))
    16
    """
    if count < 4 or takes < 2 or not 0 <= seed < 2**63:
        raise ConfigurationError(
            f"count = {count}, takes = {takes}, seed = {seed}; allowed are 4 or more exposures, 2 "
            "or more takes, and a seed from 0 to 2^63 - 1.",
            value=(count, takes, seed),
        )
    chosen = load(instrument) if isinstance(instrument, str) else instrument
    save_flats(
        Path(output), chosen, count=count, takes=takes, seed=seed, threads=threads,
        progress=progress,
    )  # fmt: skip
    return Path(output)
