"""A folder of flat and dark frames -> figures of the camera."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gonio.calibration.frames import camera_file
from gonio.calibration.frames.photon_transfer import photon_transfer
from gonio.rig.flats import read_flats


def calibrate_camera(flats: str | Path, *, output: str | Path | None = None) -> dict[str, Any]:
    """Measure a camera by photon transfer from flat and dark frames at several exposures.

    Parameters
    ----------
    flats : path
        Folder with the frames and a `flats.toml`, such as `gonio.flats` writes.
    output : path, optional
        File of the camera to write, .toml or .json. session.toml names it by `camera.file`.

    Returns
    -------
    dict
        Tables `camera` and `uncertainty` (gain_dn_per_e, black_dn, saturation_dn, full_well_e,
        read_noise_e, dark_e_per_s, nonlinearity_per_decade, prnu, dsnu_e_per_s, with standard
        uncertainties; unknown is None), `frame` and `fit` with the warnings.

    Raises
    ------
    ConfigurationError
        If flats.toml cannot be used, or for another ending of `output`.
    DataError
        If frames are missing, damaged or copied, too few are below saturation, the black level is
        cut off at 0, or the frames are gamma-encoded.

    Notes
    -----
    As EMVA Standard 1288 has it: the gain is the variance of a flat frame over its mean, both
    less those of the dark; variances come from differences of two frames.

    Examples
    --------
    >>> import gonio, tempfile
    >>> instrument = gonio.instrument.preset("ideal12").with_pixels(104)
    >>> folder = gonio.flats(tempfile.mkdtemp() + "/flats", instrument=instrument)
    >>> found = calibrate_camera(folder)
    >>> abs(found["camera"]["gain_dn_per_e"] / instrument.sensor.binned_gain_dn_per_e - 1) < 0.03
    True
    """
    if output is not None:
        camera_file.check_suffix(Path(output))
    folder = read_flats(flats)
    sampling = folder.sampling
    result = photon_transfer(folder.frame, folder.table.exposures_s, folder.table.takes)
    content = camera_file.document(result, sampling.shape, n_summed=sampling.n_summed)
    if output is not None:
        camera_file.write(Path(output), content)
    return content
