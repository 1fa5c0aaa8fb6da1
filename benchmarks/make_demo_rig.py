"""Make the rig folder that `gonio import --demo` copies out: data/demo_rig.

    python -m benchmarks.make_demo_rig [FOLDER]

Rolled aluminum behind the dome and lens of `modern12`, recorded by a small camera with large
pixels, in the files of a laboratory's computer: 16-bit PNG of 12-bit counts and a session.toml
with the data of the laboratory. One seed determines all of it.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

import cv2

from gonio.files import write_text
from gonio.instrument import Instrument, preset
from gonio.metadata import Plan
from gonio.session import Session
from gonio.simulation import simulate

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "data" / "demo_rig"
MATERIAL, SEED = "rolled_aluminum", 1992
PIXELS = 96
ROLES = {"background": "dark", "standard": "white", "sample": "sample"}
PLAN = Plan(
    theta_i_deg=(0, 10, 20, 30, 45, 60, 70),
    rotations_deg=(0, 90),
    exposures_s=(0.004, 0.032, 0.256),
    repeats=2,
)
SESSION_TOML = """\
# A small rig: rolled aluminum in a dome of 150 mm, 96 x 96 pixels of 12 bits.
# 'gonio import --template' explains every key that there is.

[instrument]
name = "demo rig"
sample = "rolled_aluminum"

[geometry]
shape = "ellipsoid"
R = {R}                         # mm
D = {D}                          # mm
usable_theta_r_deg = {usable_theta_r_deg}

[lens]
projection = "{projection}"
focal_length_mm = {focal_length_mm}
k = {k}

[camera]
pitch_um = {pitch_um}
gain_dn_per_e = {gain_dn_per_e}               # from pairs of white frames
black_dn = {black_dn}                   # mean of covered frames
saturation_dn = {saturation_dn}              # 12 bits
full_well_e = {full_well_e}
read_noise_e = {read_noise_e}                # from pairs of covered frames
dark_e_per_s = {dark_e_per_s}

[standard]
kind = "pi_f0"
reflectance = {reflectance}                # certificate: pi f at the normal
uncertainty = {uncertainty}               # certificate: 0.01 with k = 2
rolloff = {rolloff}                     # certificate: loss at theta_r = 75 deg
reciprocal = false                # certificate: no loss in theta_i

[lamp]
half_angle_deg = {half_angle_deg}
drift = {drift}

[limits]
slope_error_deg = {slope_error_deg}
rim_slope_error_deg = {rim_slope_error_deg}
multibounce = {multibounce}
ambient = {ambient_reflected}                     # a frame with the lamp off shows nothing

[plan]
theta_i_deg = {theta_i_deg}
rotations_deg = {rotations_deg}
exposures_s = {exposures_s}
repeats = {repeats}                      # takes of each background and standard frame

[frames]
pattern = "{{role}}/{{theta_i:g}}_{{rotation:g}}_{{exposure_ms:g}}.png"
pattern_of_background = "{{role}}/{{theta_i:g}}_{{exposure_ms:g}}_{{take}}.png"
pattern_of_standard = "{{role}}/{{theta_i:g}}_{{exposure_ms:g}}_{{take}}.png"

[frames.roles]
background = "{background}"
standard = "{standard}"
sample = "{sample}"
"""


def instrument() -> Instrument:
    """Dome, lamp, lens and standard of modern12, and a camera of 96 x 96 large pixels."""
    small = preset("modern12")
    window_um = small.sensor.rows * small.sensor.pitch_um[0]
    pitch_um = round(window_um / PIXELS, 1)
    sensor = small.sensor.model_copy(
        update={
            "rows": PIXELS,
            "columns": PIXELS,
            "pitch_um": (pitch_um, pitch_um),
            "binning": 1,
            "full_well_e": 40_000.0,
            "gain_dn_per_e": 0.1,
            "read_noise_e": 8.0,
            "dark_e_per_s": 20.0,
            "exposures_s": PLAN.exposures_s,
        }
    )
    return small.model_copy(update={"name": "demo rig", "sensor": sensor})


def name_of(role: str, take: int, incidence: int, exposure: int) -> str:
    """File of a frame, as the patterns of session.toml say."""
    theta_i = PLAN.incidences(role)[incidence]
    ms = PLAN.exposures_s[exposure] * 1e3
    if role == "sample":
        return f"{ROLES[role]}/{theta_i:g}_{PLAN.rotations_deg[take]:g}_{ms:g}.png"
    return f"{ROLES[role]}/{theta_i:g}_{ms:g}_{take + 1}.png"


def write_frames(session: Session, folder: Path) -> None:
    """Every frame as a PNG of 16 bits."""
    for role, take, incidence in PLAN.images():
        for exposure in range(len(PLAN.exposures_s)):
            path = folder / name_of(role, take, incidence, exposure)
            path.parent.mkdir(parents=True, exist_ok=True)
            frame = session.frame(role, take, incidence, exposure)
            _, picture = cv2.imencode(".png", frame, [cv2.IMWRITE_PNG_COMPRESSION, 9])
            path.write_bytes(picture.tobytes())


def description(instrument: Instrument) -> str:
    """session.toml with the values of the instrument's data sheets."""
    values: dict[str, object] = {}
    for part in (
        instrument.dome,
        instrument.lens,
        instrument.sensor,
        instrument.standard,
        instrument.lamp,
        instrument.surroundings,
        PLAN,
    ):
        values |= part.model_dump()
    values |= {"usable_theta_r_deg": instrument.usable_theta_r_deg, **ROLES}
    values["saturation_dn"] = instrument.sensor.saturation_dn
    lists = {key: list(value) for key, value in values.items() if isinstance(value, tuple)}
    return SESSION_TOML.format(**{**values, **lists})


def make(folder: Path = FOLDER) -> None:
    """Write the folder; replace that of the package, but no other."""
    simulated = instrument()
    if folder == FOLDER:
        shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    with tempfile.TemporaryDirectory() as temporary:
        session = simulate(
            MATERIAL, output=Path(temporary) / "demo", instrument=simulated, plan=PLAN, seed=SEED,
            truth_images=False,
        )  # fmt: skip
        write_frames(session, folder)
    write_text(folder / "session.toml", description(simulated))


if __name__ == "__main__":
    make(*map(Path, sys.argv[1:2]))
