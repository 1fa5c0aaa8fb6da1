"""Flat and dark frames of a virtual instrument: an even light on its sensor, without lens or dome.

The sensor is that of the sessions with the same seed: its fixed patterns are the same, and so are
the pixels, which are binned as in the sessions.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gonio.errors import ConfigurationError, DataError
from gonio.files import atomic_path, write_text
from gonio.instrument import Instrument
from gonio.instrument.noise import expose
from gonio.instrument.realisation import Realisation
from gonio.metadata import Plan
from gonio.progress import Progress

BRIGHTEST, DIMMEST = 1.3, 0.0065  # signals of the exposures over the one that saturates


def exposure_times(instrument: Instrument, count: int) -> tuple[float, ...]:
    """Exposures in s, up to the longest of the instrument, which saturates."""
    longest = max(instrument.sensor.exposures_s)
    times = longest * np.geomspace(DIMMEST / BRIGHTEST, 1, count)
    return tuple(float(f"{time:.6g}") for time in times)


def save_flats(
    folder: Path,
    instrument: Instrument,
    *,
    count: int,
    takes: int,
    seed: int,
    threads: int | None = None,
    progress: Progress | None = None,
) -> None:
    """Take flat and dark frames and write them as PNG of 16 bits, with a flats.toml.

    Parameters
    ----------
    folder : Path
        Created if it does not exist; must be empty.
    instrument : Instrument
    count, takes : int
        Exposures, and frames of a kind at each.
    seed : int
    threads : int, optional
    progress : callable, optional
        Called with (frames done, frames in all).

    Raises
    ------
    ConfigurationError
        If the folder is not empty.
    DataError
        If a file cannot be written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ConfigurationError(
            f"{folder}: is there already; give the name of a new folder.", value=folder
        )
    try:
        (folder / "truth").mkdir(parents=True)
    except OSError as error:
        raise DataError(f"{folder}: cannot be made ({error.strerror}).", value=folder) from None
    sensor = instrument.sensor
    times = exposure_times(instrument, count)
    plan = Plan(theta_i_deg=(0.0,), rotations_deg=(0.0,), exposures_s=times)
    pattern = Realisation.from_seed(seed, instrument, plan).pattern_seed
    rng = np.random.default_rng([seed, 5])
    noise = int(rng.integers(0, 2**63))
    readout = sensor.readout() | {"seed": noise, "threads": threads}
    end = sensor.saturation_dn - sensor.binned_black_dn
    full = min(sensor.binned_full_well_e, end / sensor.binned_gain_dn_per_e)
    light = BRIGHTEST * full / times[-1] * sensor.response(pattern)
    dark = sensor.dark_current(pattern)
    lamp, total, number = [], 2 * count * takes, 0
    for time in times:
        for role in ("flat", "dark"):
            for take in range(1, takes + 1):
                output = 1 + instrument.lamp.drift * float(rng.standard_normal())
                rate = dark + output * light if role == "flat" else dark
                if role == "flat":
                    lamp.append(output)
                frame = expose(rate, time, frame=number, **readout)
                _write_png(folder / f"{role}_{1e3 * time:g}ms_{take}.png", frame)
                number += 1
                if progress is not None:
                    progress(number, total)
    record = {"schema": "gonio.flats/1", "seed": seed, "pattern_seed": pattern, "lamp": lamp,
              "sensor": sensor.model_dump(mode="json")}  # fmt: skip
    write_text(folder / "truth" / "truth.json", json.dumps(record, indent=1) + "\n")
    write_text(folder / "flats.toml", _description(instrument.name, times, takes))


def _description(name: str, times: tuple[float, ...], takes: int) -> str:
    return f"""# Flat and dark frames of {name}, for 'gonio calibrate camera'.
[flats]
exposures_s = {json.dumps(list(times))}
takes = {takes}                         # frames of a kind at each exposure

[frames]                          # as in session.toml; {{role}} is flat or dark
pattern = "{{role}}_{{exposure_ms:g}}ms_{{take}}.png"
"""


def _write_png(path: Path, image: NDArray[np.uint16]) -> None:
    import cv2

    done, data = cv2.imencode(".png", image)
    if not done:
        raise DataError(f"{path}: cannot be written as PNG.", value=path)
    with atomic_path(path) as temporary:
        temporary.write_bytes(data.tobytes())
