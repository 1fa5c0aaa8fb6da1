"""From sessions of a mirror to the alignment of dome and camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gonio.calibration.dome import geometry_file
from gonio.calibration.dome.alignment import Alignment, fit
from gonio.calibration.dome.pixel_map import PixelMap
from gonio.calibration.dome.spot_residuals import Length
from gonio.calibration.dome.spots import Spot, find_spots
from gonio.errors import ConfigurationError
from gonio.session import Session


@dataclass(frozen=True)
class MirrorAlignment:
    """Positions of dome and camera, from the spots of a mirror.

    Parameters
    ----------
    alignment : Alignment
        Values, uncertainties and residuals.
    instrument : str
        Name of the instrument of the sessions.
    without_spot : dict of str to str
        Images in which no spot was found, each with its reason.
    """

    alignment: Alignment
    instrument: str
    without_spot: dict[str, str]

    def save(self, path: str | Path) -> Path:
        """Write the geometry for ``gonio.reduce(geometry=...)``, TOML; returns its path."""
        geometry_file.write(
            Path(path), self.alignment, instrument=self.instrument, lost=self.without_spot
        )
        return Path(path)


def calibrate_alignment(
    sessions: Session | str | Path | Sequence[Session | str | Path],
    *,
    R: Length | None = None,
    separation: Length | None = None,
) -> MirrorAlignment:
    """Fit R, D, pupil, image centre and azimuth of the camera to the spots of a mirror.

    Directions do not change if all lengths grow by one factor: give one that was measured, or
    lengths stay multiples of R. Quantities that the spots do not determine keep their value. Lamp
    on both sides and a wedge of 10 deg or more, turned to three azimuths, determine all.

    Parameters
    ----------
    sessions : Session or path, or a sequence of them
        Frames of a mirror in place of the sample, of one instrument.
    R : Length, optional
        The dome's R in mm with its standard uncertainty, if it was measured.
    separation : Length, optional
        Distance from the camera's pupil to the target, 2 D, in mm, if it was measured.

    Returns
    -------
    MirrorAlignment

    Raises
    ------
    DataError
        If there are too few spots, the picture is mirrored, or the fit leads nowhere.
    ConfigurationError
        If the sessions are of different instruments or of wedges of different tilt.

    Examples
    --------
    >>> import gonio, tempfile
    >>> from gonio.instrument.plans import mirror_plan
    >>> instrument = gonio.instrument.preset("ideal12").with_pixels(208)
    >>> instrument = instrument.altered(lamp={"half_angle_deg": 0.5})
    >>> folder = tempfile.mkdtemp() + "/mirror.gonio"
    >>> plan = mirror_plan(instrument, wedge_deg=15.0)
    >>> session = gonio.simulate(output=folder, instrument=instrument, plan=plan)
    >>> result = calibrate_alignment(session, R=Length(instrument.dome.R, 0.01))
    >>> bool(abs(result.alignment.values["D"] - instrument.dome.D) < 0.1)
    True
    """
    given = [sessions] if isinstance(sessions, Session | str | Path) else list(sessions)
    opened = [each if isinstance(each, Session) else Session.open(each) for each in given]
    _require_one_instrument(opened)
    metadata = opened[0].metadata
    nominal = PixelMap.of(metadata, "exact")
    spots: list[Spot] = []
    without: dict[str, str] = {}
    for session in opened:
        located, missing = find_spots(session, nominal)
        where = f"{session.path.name}: " if len(opened) > 1 else ""
        spots += located
        without |= {where + name: why for name, why in missing.items()}
    alignment = fit(spots, nominal, limits=metadata.limits, R=R, separation=separation)
    return MirrorAlignment(alignment, metadata.instrument, without)


def _require_one_instrument(sessions: list[Session]) -> None:
    """Refuse sessions of different instruments."""
    first = sessions[0].metadata
    for session in sessions[1:]:
        other = session.metadata
        same = (other.instrument, other.camera, other.lens, other.geometry) == (
            first.instrument, first.camera, first.lens, first.geometry,
        )  # fmt: skip
        if not same:
            raise ConfigurationError(
                f"{session.path}: of another instrument, camera or lens than {sessions[0].path}; "
                "give the sessions of one.",
                value=session.path,
            )
