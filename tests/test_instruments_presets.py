"""The four instruments that come with gonio, and the words with which wrong ones are refused."""

import json
import re
import tomllib
from importlib.resources import files
from typing import get_args

import numpy as np
import pytest
from pydantic import ValidationError

from gonio.errors import ConfigurationError
from gonio.instrument import Dome, Instrument, Lens, Sensor, load, preset, preset_names
from gonio.instrument.part import Part

MS = (0.25e-3, 1e-3, 4e-3, 16e-3, 64e-3, 256e-3)
KANNALA_BRANDT = (-0.012, 0.004, -0.0015, 0.0002)

# Typed from the description of the instruments, not from the files.
EXPECTED = {
    "modern12": {
        "usable_theta_r_deg": 80, "dome.shape": "ellipsoid", "dome.R": 150, "dome.D": 15,
        "dome.reflectance": 0.45, "dome.transmittance": 0.45, "dome.slope_error_deg": 0.03,
        "dome.rim_slope_error_deg": 0.2, "lens.projection": "kannala_brandt",
        "lens.k": KANNALA_BRANDT, "lens.focal_length_mm": 1.8, "lens.pupil_mm": 0.45,
        "lens.field_deg": 180, "lens.vignetting": 0.25, "lens.focus": "R/2",
        "sensor.binning": 4, "sensor.pitch_um": (3.45, 3.45), "sensor.full_well_e": 10_700,
        "sensor.read_noise_e": 2.3, "sensor.dark_e_per_s": 2, "sensor.prnu": 0.006,
        "sensor.bits": 12, "sensor.gain_dn_per_e": 0.38, "sensor.black_dn": 64,
        "sensor.exposures_s": MS, "lamp.half_angle_deg": 0.5, "lamp.lit_diameter_mm": 16,
        "lamp.drift": 0.003, "standard.reflectance": 0.99, "standard.rolloff": 0.10,
        "standard.uncertainty": 0.005, "surroundings.stray": 1e-3, "surroundings.entry_patch": 3,
        "surroundings.multibounce": 0.01,
    },
    "ideal12": {
        "usable_theta_r_deg": 80, "dome.shape": "ellipsoid", "dome.R": 150, "dome.D": 15,
        "dome.slope_error_deg": 0, "dome.rim_slope_error_deg": 0, "lens.pupil_mm": 0.45,
        "sensor.full_well_e": 10_700, "sensor.read_noise_e": 2.3, "sensor.bits": 12,
        "sensor.gain_dn_per_e": 0.38, "sensor.black_dn": 64, "sensor.exposures_s": MS,
        "lamp.half_angle_deg": 0, "lamp.drift": 0, "standard.reflectance": 0.99,
        "standard.uncertainty": 0, "standard.rolloff": 0, "surroundings.multibounce": 0,
    },
    "modern14": {
        "usable_theta_r_deg": 80, "dome.shape": "ellipsoid", "dome.R": 150, "dome.D": 15,
        "dome.reflectance": 0.45, "dome.transmittance": 0.45, "dome.slope_error_deg": 0.03,
        "dome.rim_slope_error_deg": 0.2, "lens.projection": "kannala_brandt",
        "lens.focal_length_mm": 3.6, "lens.pupil_mm": 0.9, "lens.vignetting": 0.25,
        "lens.focus": "R/2", "sensor.rows": 3000, "sensor.columns": 3000,
        "sensor.pitch_um": (3.76, 3.76), "sensor.full_well_e": 50_000,
        "sensor.read_noise_e": 1.8, "sensor.dark_e_per_s": 0.05, "sensor.prnu": 0.005,
        "sensor.bits": 14, "sensor.gain_dn_per_e": 0.32, "sensor.black_dn": 256,
        "sensor.exposures_s": MS, "lamp.half_angle_deg": 0.5, "lamp.lit_diameter_mm": 16,
        "lamp.drift": 0.003, "standard.reflectance": 0.99, "standard.rolloff": 0.10,
        "standard.uncertainty": 0.005, "surroundings.stray": 1e-3, "surroundings.entry_patch": 3,
        "surroundings.multibounce": 0.01,
    },
    "lbl1992": {
        "usable_theta_r_deg": 70, "dome.shape": "sphere", "dome.R": 300, "dome.D": 30,
        "dome.reflectance": 0.40, "dome.transmittance": 0.45, "dome.slope_error_deg": 0.1,
        "dome.rim_slope_error_deg": 1.0, "lens.projection": "equisolid", "lens.pupil_mm": 3,
        "sensor.full_well_e": 40_000, "sensor.read_noise_e": 60, "sensor.dark_e_per_s": 500,
        "sensor.prnu": 0.015, "sensor.bits": 8, "sensor.black_dn": 8,
        "lamp.half_angle_deg": 1.0, "lamp.lit_diameter_mm": 25, "lamp.drift": 0.01,
        "standard.reflectance": 0.95, "standard.uncertainty": 0.02, "surroundings.stray": 5e-3,
        "surroundings.multibounce": 0.03,
    },
}  # fmt: skip


def value(rig, dotted):
    for part in dotted.split("."):
        rig = getattr(rig, part)
    return rig


@pytest.mark.parametrize(
    ("name", "key"), [(name, key) for name, keys in EXPECTED.items() for key in keys]
)
def test_figures(name, key):
    assert value(preset(name), key) == EXPECTED[name][key]


class TestPresets:
    def test_all_are_listed(self):
        assert preset_names() == ["ideal12", "lbl1992", "modern12", "modern14"]
        for name in preset_names():
            rig = preset(name)
            assert rig.name == name
            assert rig.description

    def test_ideal12_is_modern12_without_its_systematic_effects(self):
        assert preset("ideal12").sensor == preset("modern12").sensor
        assert preset("ideal12").lens == preset("modern12").lens

    def test_the_frames_of_1992_have_108_by_80_pixels_of_2_25_degrees(self):
        rig = preset("lbl1992")
        assert rig.sensor.shape == (80, 108)
        assert len(rig.sensor.exposures_s) == 2
        assert rig.sensor.exposures_s[1] / rig.sensor.exposures_s[0] == pytest.approx(4)
        _, y = rig.sensor.positions_mm()
        middle = np.degrees(rig.lens.polar_angle(y[40:42]))
        # 180 deg over 80 rows; an equisolid image has finer pixels in the middle than at the rim.
        assert np.diff(middle)[0] == pytest.approx(2.25, rel=0.12)
        assert np.degrees(rig.lens.polar_angle(y[-1])) == pytest.approx(88, abs=1.5)

    @pytest.mark.parametrize("name", ["modern12", "ideal12"])
    def test_the_window_of_the_modern_camera_holds_the_image_circle(self, name):
        rig = preset(name)
        diameter = 2 * float(rig.lens.radius(np.pi / 2)) / 3.45e-3
        # 1639 pixels for r = f theta; the small departures of the lens take 2 % off.
        assert np.pi * rig.lens.focal_length_mm / 3.45e-3 == pytest.approx(1639, abs=0.5)
        assert diameter == pytest.approx(1639, rel=0.025)
        assert diameter < 1664
        assert rig.sensor.shape == (416, 416)
        # 180 deg over the circle: 0.11 deg a pixel.
        assert 180 / diameter == pytest.approx(0.110, rel=0.025)

    def test_modern14_is_modern12_with_a_larger_camera(self):
        large, small = preset("modern14"), preset("modern12")
        for part in ("holder", "dome", "standard", "surroundings"):
            assert getattr(large, part) == getattr(small, part)
        diameter = 2 * float(large.lens.radius(np.pi / 2)) / 3.76e-3
        assert diameter == pytest.approx(2947, abs=0.5)
        assert diameter < large.sensor.columns
        # The same aperture: a pixel gets light in proportion to its area.
        ratio = large.lamp.white_rate_e_per_s / small.lamp.white_rate_e_per_s
        assert ratio == pytest.approx((3.76 / 3.45) ** 2, rel=0.01)
        # Sixteen pixels of 14 bits are divided by 4: the full well and the converter's end fit.
        assert large.sensor.saturation_dn <= 65535
        full = large.sensor.binned_full_well_e * large.sensor.binned_gain_dn_per_e
        assert full + large.sensor.binned_black_dn <= large.sensor.saturation_dn

    def test_the_white_standard_fills_none_of_the_short_exposures(self):
        for name in preset_names():
            rig = preset(name)
            white = rig.lamp.white_rate_e_per_s * rig.dome.transmittance * rig.dome.reflectance
            shortest = rig.sensor.exposures_s[0] * white
            assert shortest < 0.5 * rig.sensor.full_well_e

    def test_white_rate_behind_the_dome(self):
        rig = preset("modern12")
        white = rig.lamp.white_rate_e_per_s * rig.dome.transmittance * rig.dome.reflectance
        assert white == pytest.approx(2e5, rel=0.01)  # e-/s in a pixel on the axis

    def test_an_instrument_survives_json(self):
        rig = preset("lbl1992")
        assert Instrument.model_validate_json(rig.model_dump_json()) == rig

    def test_instruments_are_frozen(self):
        with pytest.raises(ValidationError, match="frozen"):
            preset("modern12").dome.R = 3.0


def settings(part, prefix=""):
    """Dotted names of all settings of an instrument and of its parts."""
    for name, field in part.model_fields.items():
        kinds = [field.annotation, *get_args(field.annotation)]
        inner = next((k for k in kinds if isinstance(k, type) and issubclass(k, Part)), None)
        if inner is None:
            yield prefix + name
        else:
            yield from settings(inner, f"{prefix}{name}.")


def toml(document):
    """An instrument as TOML: its own settings, parts in [], channels in [[]]."""
    own = [f"{k} = {json.dumps(v)}" for k, v in document.items()
           if not isinstance(v, dict) and k != "channels"]  # fmt: skip
    parts = [(f"[{k}]", v) for k, v in document.items() if isinstance(v, dict)]
    parts += [("[[channels]]", channel) for channel in document["channels"]]
    for header, part in parts:
        own += [header, *(f"{k} = {json.dumps(v)}" for k, v in part.items())]
    return "\n".join(own)


class TestFiles:
    """The files of the presets are what people start their own from."""

    @pytest.mark.parametrize("name", preset_names())
    def test_every_setting_stands_in_the_file_with_a_comment(self, name):
        text = files("gonio.data").joinpath(f"instruments/{name}.toml").read_text("utf-8")
        found, section, above = {}, "", ""
        for line in text.splitlines():
            if header := re.fullmatch(r"\[\[?(\w+)\]?\]", line):
                section = f"{header[1]}."
            # A setting without a value, as TOML has none for "not known", is commented out.
            elif setting := re.match(r"(?:# )?(\w+) = [^#]*(#.*)?", line):
                found[section + setting[1]] = setting[2] or above
            above = line if line.startswith("# ") else ""
        assert sorted(found) == sorted(settings(Instrument))
        without = [key for key, comment in found.items() if len(comment) < 4]
        assert without == []
        assert max(map(len, text.splitlines())) <= 100

    @pytest.mark.parametrize("name", preset_names())
    def test_the_file_says_all_that_the_instrument_is(self, name):
        # Nothing is left to a default that might change.
        text = files("gonio.data").joinpath(f"instruments/{name}.toml").read_text("utf-8")
        stated = preset(name).model_dump(mode="json")
        # What is not known is left out: TOML has no value for it.
        assert stated["channels"][0].pop("wavelength_nm") is None
        assert stated["standard"].pop("u_shape") is None
        assert stated["sensor"].pop("u_nonlinearity_per_decade") is None
        assert tomllib.loads(text) == stated

    def test_parts_explain_every_setting(self):
        for path in settings(Instrument):
            *parts, key = path.split(".")
            part = Instrument
            for name in parts:
                annotation = part.model_fields[name].annotation
                part = next(iter(get_args(annotation)), annotation)
            assert part.model_fields[key].description, path


class TestRefusals:
    @pytest.mark.parametrize("path", [p for p in settings(Instrument) if len(p.split(".")[-1]) > 4])
    def test_a_misspelt_setting_is_named_with_the_nearest(self, tmp_path, path):
        *part, key = path.split(".")
        document = preset("modern14").model_dump(mode="json", exclude_none=True)
        target = document
        for name in part:
            target = target[name][0] if name == "channels" else target[name]
        # Two letters exchanged, and the right key left out.
        wrong = key[:2] + key[3] + key[2] + key[4:] if key[2] != key[3] else key[:-1]
        target[wrong] = target.pop(key, 1)
        with pytest.raises(
            ConfigurationError, match=f"unknown key '{wrong}': did you mean '{key}'"
        ):
            self.load_text(tmp_path, toml(document))

    def test_unknown_preset(self):
        with pytest.raises(
            ConfigurationError,
            match=r"unknown instrument 'modren12': did you mean 'modern12'\? Choose from ideal12,",
        ):
            preset("modren12")
        with pytest.raises(ConfigurationError, match="unknown instrument 'modern13'"):
            load("modern13")

    @staticmethod
    def text(old="", new=""):
        text = files("gonio.data").joinpath("instruments/modern12.toml").read_text("utf-8")
        assert old in text
        return text.replace(old, new)

    def load_text(self, tmp_path, text):
        path = tmp_path / "rig.toml"
        path.write_text(text, encoding="utf-8")
        return load(str(path))

    def test_a_copy_of_a_preset_loads(self, tmp_path):
        assert self.load_text(tmp_path, self.text()) == preset("modern12")

    @pytest.mark.parametrize(
        ("old", "new", "message"),
        [
            ("vignetting", "vigneting",
             r"rig.toml: lens.vigneting: unknown key 'vigneting': did you mean 'vignetting'\? "),
            ("[surroundings]", "[surrounding]",
             r"rig.toml: surrounding: unknown key 'surrounding': did you mean 'surroundings'\?"),
            ("[surroundings]", "[dome.surroundings]",
             "rig.toml: dome.surroundings: unknown key 'surroundings'; choose from D, R,"),
            ('name = "modern12"', "", "rig.toml: name: Field required."),
            ("rays_per_pixel", "rays_per_pixels",
             "unknown key 'rays_per_pixels': did you mean 'rays_per_pixel'"),
            ("R = 150.0", 'R = "wide"',
             r"dome.R: Input should be a valid number.* \(given: 'wide'\)\."),
            ("D = 15.0", "D = 150.0", "dome: .*D = 150.0 mm must be smaller than R = 150.0 mm"),
            ("D = 15.0", "D = -1.0", r"dome.D: Input should be greater than 0 \(given: -1.0\)"),
            ("D = 15.0", "D = nan", "dome.D: Input should be a finite number"),
            ("reflectance = 0.45", "reflectance = 0.56",
             r"reflectance \+ transmittance must not exceed 1"),
            ('shape = "ellipsoid"', 'shape = "cube"',
             r"dome.shape: Input should be 'sphere' or 'ellipsoid' \(given: 'cube'\)"),
            ("binning = 4", "binning = 5",
             "binning 5 must divide rows 1664 and columns 1664"),
            ("bits = 12", "bits = 14", "14 bits binned 4 x 4 exceed 16 bits a frame"),
            ("0.25e-3, 1e-3", "1e-3, 0.25e-3", "exposures_s must grow"),
            ("0.25e-3, 1e-3", "-1.0, 1e-3", "exposures_s must be positive"),
            ("prnu = 0.006", "prnu = 0.6", "sensor.prnu: Input should be less than 0.5"),
            ("[dome]", "[dome", "rig.toml: not valid TOML: "),
        ],
    )  # fmt: skip
    def test_a_wrong_file_says_what_and_where(self, tmp_path, old, new, message):
        with pytest.raises(ConfigurationError, match=message):
            self.load_text(tmp_path, self.text(old, new))

    def test_a_missing_file(self, tmp_path):
        with pytest.raises(ConfigurationError, match=r"none.toml: cannot be read as text"):
            load(str(tmp_path / "none.toml"))

    def test_a_file_that_is_not_text(self, tmp_path):
        (tmp_path / "rig.toml").write_bytes(b"\xff\xfe\x00")
        with pytest.raises(ConfigurationError, match=r"rig.toml: cannot be read as text"):
            load(str(tmp_path / "rig.toml"))

    def test_parts_refuse_the_impossible_in_python_too(self):
        with pytest.raises(ValidationError, match="must be smaller than R"):
            Dome(R=10.0, D=10.0)
        with pytest.raises(ValidationError, match="must not exceed 1"):
            Dome(R=10.0, D=1.0, reflectance=0.7, transmittance=0.4)
        with pytest.raises(ValidationError, match="less than or equal to 180"):
            Lens(focal_length_mm=1.0, pupil_mm=0.0, field_deg=200)
        sensor = preset("modern12").sensor.model_dump()
        with pytest.raises(ValidationError, match="exceed 16 bits"):
            Sensor.model_validate(sensor | {"bits": 16})
