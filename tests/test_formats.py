"""Readers and writers of BRDF files: values, conventions, and every message by its text."""

from __future__ import annotations

import hashlib
import re

import numpy as np
import pytest

from gonio import formats
from gonio.errors import ConfigurationError, DataError
from gonio.formats import _text, cornell, gonio_csv, nist_ptfe
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

HEADER = "theta_i,phi_i,theta_r,phi_r,brdf"


@pytest.fixture
def put(tmp_path):
    """Write text or bytes to a file and return its path."""

    def write(content, name="samples.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def refused(path, message, error=DataError, **kwargs):
    """The file is refused with these words, and named."""
    with pytest.raises(error, match=re.escape(message)) as caught:
        formats.read(path, **kwargs)
    assert str(path) in str(caught.value)
    return caught.value


def some_samples(n=2000, *, seed=1, **columns):
    rng = np.random.default_rng(seed)
    theta_i, theta_r = rng.uniform(0, 90, (2, n))
    phi_i, phi_r = rng.uniform(-360, 360, (2, n))
    return BRDFSamples(
        Directions(*(np.radians(a) for a in (theta_i, phi_i, theta_r, phi_r))),
        rng.normal(0.1, 0.1, n),
        **columns,
    )


def same(a, b):
    """Equal to the last bit in everything that the table holds."""
    for name in gonio_csv.ANGLES:
        np.testing.assert_array_equal(getattr(a.directions, name), getattr(b.directions, name))
    for name in ("value", "u_independent", "wavelength_nm", "channel"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


# ---------------------------------------------------------------- gonio CSV


def test_csv_values_and_units(put):
    path = put(f"{HEADER},u_brdf,channel,wavelength_nm\n30,0,45,180,0.25,0.01,red,650\n")
    samples = formats.read(path)
    d = samples.directions
    assert np.degrees([d.theta_i, d.phi_i, d.theta_r, d.phi_r]).ravel() == pytest.approx(
        [30, 0, 45, 180]
    )
    assert samples.value.tolist() == [0.25]
    assert samples.u_independent.tolist() == [0.01]
    assert samples.channel.tolist() == ["red"]
    assert samples.wavelength_nm.tolist() == [650]


def test_csv_round_trip_is_bit_exact(tmp_path):
    n = 2000
    rng = np.random.default_rng(2)
    samples = some_samples(
        n,
        u_independent=rng.uniform(1e-5, 1e-2, n),
        wavelength_nm=rng.uniform(380, 780, n),
        channel=rng.choice(["red", "green, near", 'a "b"'], n),
    )
    path, again = tmp_path / "a.csv", tmp_path / "b.csv"
    gonio_csv.write(path, samples)
    back = formats.read(path)
    same(samples, back)
    gonio_csv.write(again, back)
    assert path.read_bytes() == again.read_bytes()


def test_csv_of_any_radians_is_within_one_ulp(tmp_path):
    rng = np.random.default_rng(3)
    theta, phi = rng.uniform(0, 1.57, 500), rng.uniform(-3, 3, 500)
    samples = BRDFSamples(Directions(theta, phi, theta, phi), np.ones(500))
    gonio_csv.write(tmp_path / "a.csv", samples)
    back = formats.read(tmp_path / "a.csv").directions
    np.testing.assert_array_max_ulp(back.theta_i, theta, 1)
    np.testing.assert_array_max_ulp(back.phi_r, phi, 1)


def test_csv_column_order_mark_and_line_ends_do_not_matter(put):
    plain = formats.read(put(f"{HEADER}\n10,20,30,40,0.5\n"))
    other = put(
        b"\xef\xbb\xbfbrdf, phi_r ,theta_r,phi_i,theta_i\r\n\r\n0.5,40,30,20,10\r\n", "b.csv"
    )
    same(plain, formats.read(other))


def test_csv_names_may_be_followed_by_their_units(put):
    plain = formats.read(put(f"{HEADER},u_brdf,wavelength_nm\n10,20,30,40,0.5,0.01,650\n"))
    for header in (
        "theta_i [deg],phi_i (deg),theta_r/deg,phi_r [\N{DEGREE SIGN}],BRDF [1/sr],u_brdf (sr^-1),"
        "wavelength_nm [nm]",
        "theta_i_deg,phi_i deg,theta_r [degrees],phi_r(deg),brdf/sr,u_brdf [sr-1],wavelength/nm",
    ):
        same(plain, formats.read(put(f"{header}\n10,20,30,40,0.5,0.01,650\n", "b.csv")))


ANOTHER_UNIT = {
    "theta_i [rad]": "column 'theta_i [rad]': 'rad' is not the unit of theta_i, which is deg; "
    "convert the values (multiply by 57.29577951 (180/pi)) and call the column theta_i.",
    "theta_i/gon": "convert the values (multiply by 0.9) and call the column theta_i.",
    "theta_i [foo]": "convert the values, or call the column theta_i if they are in deg.",
    "theta_i [deg],theta_i": "column theta_i stands twice in the header, once as 'theta_i'",
    "THETA_I": "unknown column 'THETA_I': names have small letters; write theta_i.",
    "u_brdf [%]": "'%' is not the unit of u_brdf, which is sr^-1; convert the values (multiply by "
    "brdf and divide by 100 if they are per cent of the reading)",
    "wavelength_um": "'um' is not the unit of wavelength_nm, which is nm; convert the values "
    "(multiply by 1000) and call the column wavelength_nm.",
    "wavelength": "Wavelengths are in nm: convert them and call the column wavelength_nm.",
    "brdf_450nm": "One line holds one value: write a line for each wavelength or channel",
    "temperature": "unknown column 'temperature'; choose from brdf, channel, phi_i, phi_r, "
    "theta_i, theta_r, u_brdf, wavelength_nm. Remove this column; if lines with different "
    "temperature do not belong together, call it channel.",
}


@pytest.mark.parametrize("name", ANOTHER_UNIT)
def test_csv_names_with_another_unit_or_unknown_say_what_to_do(put, name):
    cells = ",".join(["1"] * (name.count(",") + 1))
    path = put(f"{name},phi_i,theta_r,phi_r,brdf\n{cells},2,3,4,0.5\n")
    refused(path, ANOTHER_UNIT[name])


def test_csv_polar_angles_up_to_100_may_be_gradians(put):
    path = put(f"{HEADER}\n10,0,90,200,0.5\n10,0,95,200,0.5\n10,0,99,200,0.5\n")
    refused(path, "in gradians, 100 to a right angle, multiply theta and phi by 0.9.")


def test_csv_is_recognised_by_content(put):
    samples = formats.read(put(f"{HEADER}\n10,20,30,40,0.5\n", "samples.dat"))
    assert samples.metadata["format"] == "gonio_csv"


def test_csv_keeps_and_counts_negative_values(put):
    samples = formats.read(put(f"{HEADER}\n0,0,10,0,-0.001\n0,0,20,0,0.1\n"))
    assert samples.value.tolist() == [-0.001, 0.1]
    assert samples.n_negative == 1


def test_csv_metadata_and_history(put):
    path = put(f"{HEADER}\n0,0,10,0,0.1\n")
    samples = formats.read(path)
    assert samples.metadata == {
        "format": "gonio_csv",
        "path": "samples.csv",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }
    assert samples.history == ("1 samples read from samples.csv, gonio_csv",)


@pytest.mark.parametrize(
    ("cell", "shown"),
    [("abc", "'abc'"), ("nan", "'nan'"), ("inf", "'inf'"), ("", "''"), ("1_000", "'1_000'")],
)
def test_csv_cell_that_is_no_number(put, cell, shown):
    path = put(f"{HEADER}\n0,0,10,0,0.1\n\n0,0,20,0,{cell}\n")
    refused(path, f"line 4, column brdf: {shown} is not a finite number; correct it")


BAD_TABLES = {
    "theta_in,phi_i,theta_r,phi_r,brdf\n1,2,3,4,5\n": (
        "unknown column 'theta_in': did you mean 'theta_i'? Choose from"
    ),
    f"{HEADER},fudge\n1,2,3,4,5,6\n": "unknown column 'fudge'; choose from",
    "theta_i,phi_i,theta_r,brdf\n1,2,3,4\n": (
        "no column phi_r in the header 'theta_i,phi_i,theta_r,brdf'; wanted are theta_i, phi_i"
    ),
    f"{HEADER},brdf\n1,2,3,4,5,6\n": "column brdf stands twice in the header; remove one",
    f"{HEADER}\n": "no rows follow the header",
    f"{HEADER}\n1,2,3,4\n": "line 2: 4 cells where the header has 5 columns",
    f"{HEADER.replace(',', ';')}\n1;2;3;4;5\n": "line 1: the header is not separated by commas",
    f"{HEADER}\n1,2,3,4,5\n95,0,3,4,5\n": (
        "line 3, column theta_i: 95 deg is beyond the horizon; allowed is 0 to 90 deg"
    ),
    f"{HEADER}\n1,2,-15,4,5\n": (
        "line 2, column theta_r: -15 deg is negative; polar angles count from the normal, "
        "so write 15 and add 180 to phi_r"
    ),
    f"{HEADER},u_brdf\n1,2,3,4,5,0\n": (
        "line 2, column u_brdf: 0 is not positive; leave the column out where it is unknown"
    ),
    f"{HEADER},wavelength_nm\n1,2,3,4,5,-650\n": "column wavelength_nm: -650 is not positive",
    f"{HEADER},channel\n1,2,3,4,5,\n": "line 2, column channel: the name is empty",
    f'{HEADER}\n1,2,3,4,"5\n': "line 2: not a comma-separated line (unexpected end of data)",
}


@pytest.mark.parametrize("text", BAD_TABLES)
def test_csv_refusals_say_what_where_and_how(put, text):
    error = refused(put(text), BAD_TABLES[text])
    assert str(error).endswith("(Read as gonio_csv.)")


def test_csv_that_is_not_utf8(put):
    path = put(f"{HEADER},channel\n1,2,3,4,5,gr\xfcn\n".encode("latin-1"))
    refused(path, "byte 0xfc is not UTF-8 text; save the file as UTF-8")


def test_size_is_checked_before_reading(put, monkeypatch):
    path = put(f"{HEADER}\n0,0,10,0,0.1\n")
    monkeypatch.setattr(_text, "MAX_BYTES", 10)
    refused(path, "46 bytes is more than the 10 bytes that are read from a text file; split it")


def test_count_is_checked_while_reading(put, monkeypatch):
    path = put(f"{HEADER}\n" + "0,0,10,0,0.1\n" * 4)
    monkeypatch.setattr(_text, "MAX_SAMPLES", 3)
    refused(path, "more than 3 samples; split the file")


def test_lines_are_counted_through_blocks(put, monkeypatch):
    monkeypatch.setattr(_text, "_BLOCK", 2)
    path = put(f"{HEADER}\n" + "0,0,10,0,0.1\n" * 5)
    assert len(formats.read(path)) == 5
    path = put(f"{HEADER}\n" + "0,0,10,0,0.1\n" * 4 + "0,0,10,0,x\n")
    refused(path, "line 6, column brdf: 'x'")


def test_a_long_csv_comes_back_whole(tmp_path):
    path = tmp_path / "long.csv"
    samples = some_samples(60_000)
    gonio_csv.write(path, samples)
    assert path.stat().st_size > 5e6
    np.testing.assert_array_equal(formats.read(path).value, samples.value)


# ---------------------------------------------------------------- directions


def test_directions_need_the_angles_only(put):
    d = gonio_csv.read_directions(put("theta_i,phi_i,theta_r,phi_r\n10,20,95,40\n"))
    assert np.degrees(d.theta_r).tolist() == pytest.approx([95])


def test_directions_from_a_file_of_samples(put):
    d = gonio_csv.read_directions(put(f"{HEADER}\n10,20,30,40,not read\n"))
    assert d.shape == (1,)


def test_directions_refuse_what_is_no_polar_angle(put):
    path = put("theta_i,phi_i,theta_r,phi_r\n10,20,195,40\n")
    with pytest.raises(DataError, match="195 deg is not a polar angle; allowed is 0 to 180 deg"):
        gonio_csv.read_directions(path)


def test_directions_without_a_column(put):
    path = put("theta_i,phi_i,theta_r\n10,20,30\n")
    with pytest.raises(DataError, match="no column phi_r in the header"):
        gonio_csv.read_directions(path)


# ---------------------------------------------------------------- the choice of a format


def test_unknown_format_tells_what_was_tried(put):
    error = refused(put(b"\0\1\2\3" * 50, "image.raw"), "in no known format of BRDF samples; tried")
    for name in formats.names():
        assert f"{name}: it" in str(error)


def test_missing_empty_and_folder(put, tmp_path):
    refused(tmp_path / "nothing.csv", "no such file; give a file of BRDF samples")
    refused(tmp_path, "a folder, not a file; give a file of BRDF samples")
    refused(put(""), "the file is empty; give a file of BRDF samples")


def test_samples_file(tmp_path):
    samples = some_samples(20, u_independent=np.full(20, 0.01))
    samples.save(tmp_path / "samples.nc")
    (tmp_path / "samples.nc").rename(tmp_path / "samples.bin")
    back = formats.read(tmp_path / "samples.bin")
    same(samples, back)
    assert back.metadata["format"] == "samples_nc"


def test_truncated_samples_file(tmp_path):
    path = tmp_path / "samples.nc"
    some_samples(20).save(path)
    path.write_bytes(path.read_bytes()[:2000])
    refused(path, "not a readable samples file")


# ---------------------------------------------------------------- selection


@pytest.fixture
def spectral(put):
    rows = [
        f"10,0,{20 + k},0,0.{k + 1},{channel},{nm}\n"
        for k, (channel, nm) in enumerate([("red", 650), ("red", 700), ("blue", 450)])
    ]
    return put(f"{HEADER},channel,wavelength_nm\n" + "".join(rows))


def test_select_wavelength_and_channel(spectral):
    assert formats.read(spectral, select={"wavelength": "650"}).value.tolist() == [0.1]
    assert formats.read(spectral, select={"channel": "red"}).value.tolist() == [0.1, 0.2]
    both = formats.read(spectral, select={"channel": "red", "wavelength": "700.0"})
    assert both.value.tolist() == [0.2]
    assert both.history[-1] == "wavelength 700 nm: 1 of 2 samples kept"


@pytest.mark.parametrize(
    ("select", "message"),
    [
        (
            {"wavelength": "660"},
            "no sample at 660 nm; the nearest is 650 nm. Listed: 450, 650, 700",
        ),
        ({"channel": "rad"}, "did you mean 'red'? Choose from blue, red."),
    ],
)
def test_select_what_is_not_there(spectral, select, message):
    refused(spectral, message, ConfigurationError, select=select)


@pytest.mark.parametrize(
    ("select", "message"),
    [
        (
            {"wave": "1"},
            "unknown selection 'wave': did you mean 'wavelength'? Choose from ",
        ),
        ({"wavelength": "red"}, "wavelength 'red' is not a positive number; give it in nm"),
    ],
)
def test_select_that_makes_no_sense(spectral, select, message):
    with pytest.raises(ConfigurationError, match=re.escape(message)):
        formats.read(spectral, select=select)


def test_select_where_nothing_is_stated(put):
    path = put(f"{HEADER}\n0,0,10,0,0.1\n")
    refused(path, "no wavelengths are stated", ConfigurationError, select={"wavelength": "650"})
    refused(path, "no channels are named", ConfigurationError, select={"channel": "red"})


# ---------------------------------------------------------------- NIST

NIST_HEADER = "lambda,thetai,phi,thetar,phir,f_r11,f_r12/f_r11"


def test_nist_negative_angle_turns_the_azimuth(put):
    path = put(f"{NIST_HEADER}\n0.532,-45,0,44,0,0.3,0.01\n0.351,15,10,-20,30,0.2,0\n")
    samples = formats.read(path)
    d = samples.directions
    assert np.degrees(d.theta_i) == pytest.approx([45, 15])
    assert np.degrees(d.phi_i) == pytest.approx([180, 10])
    assert np.degrees(d.theta_r) == pytest.approx([44, 20])
    assert np.degrees(d.phi_r) == pytest.approx([0, 210])
    assert samples.wavelength_nm.tolist() == [532, 351]
    assert samples.value.tolist() == [0.3, 0.2]
    assert samples.metadata["format"] == "nist_ptfe"
    assert "azimuth + 180 deg" in samples.history[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lambda,thetai,phi,thetar,phir\n", "no column f_r11; wanted are lambda, thetai, phi"),
        (f"{NIST_HEADER}\n0.5,0,0,91,0,0.3,0\n", "line 2, column thetar: 91 deg is beyond the hor"),
        (f"{NIST_HEADER}\n0.5,0,0,x,0,0.3,0\n", "line 2, column thetar: 'x' is not a finite num"),
        (f"{NIST_HEADER}\n0,0,0,1,0,0.3,0\n", "line 2, column lambda: 0 um is not positive"),
        (f"{NIST_HEADER}\n", "no rows follow the header"),
    ],
)
def test_nist_refusals(put, text, message):
    error = refused(put(text), message)
    assert str(error).endswith("(Read as nist_ptfe.)")


def test_real_ptfe(real_data):
    samples = formats.read(real_data / "nist_ptfe" / "PTFE.data.csv")
    assert len(samples) == 4 * 1824
    assert np.unique(samples.wavelength_nm).tolist() == [351, 532, 633, 1064]
    assert samples.value.min() == pytest.approx(0.232, abs=5e-4)
    assert samples.value.max() == pytest.approx(0.714, abs=5e-4)
    assert np.median(samples.value) == pytest.approx(0.314, abs=1e-3)


def test_real_ptfe_mirror_pairs_agree(real_data):
    samples = formats.read(real_data / "nist_ptfe" / "PTFE.data.csv")
    d = samples.directions
    degrees = np.degrees([d.theta_i, d.theta_r, d.phi_r]).round(3)
    values: dict[tuple[float, ...], dict[bool, float]] = {}
    for nm, theta_i, theta_r, phi_r, value in zip(
        samples.wavelength_nm, *degrees, samples.value, strict=True
    ):
        if 0 < abs(phi_r) < 180:
            values.setdefault((nm, theta_i, theta_r, abs(phi_r)), {})[phi_r > 0] = value
    pairs = np.array([(pair[True], pair[False]) for pair in values.values() if len(pair) == 2])
    assert len(pairs) > 3000
    difference = (pairs[:, 0] - pairs[:, 1]) / pairs.mean(axis=1)
    assert np.sqrt(np.mean(difference**2)) < 0.02


def test_real_ptfe_scatters_forward(real_data):
    samples = formats.read(real_data / "nist_ptfe" / "PTFE.data.csv", select={"wavelength": "532"})
    w_i, w_r = samples.directions.vectors()
    grazing = (w_i[:, 2] < np.cos(np.radians(70))) & (w_r[:, 2] < np.cos(np.radians(55)))
    # Both directions leave the surface: forward is where their tangential parts are opposed.
    opposed = w_i[:, 0] * w_r[:, 0] + w_i[:, 1] * w_r[:, 1] < 0
    forward, backward = (samples.value[grazing & side].mean() for side in (opposed, ~opposed))
    assert forward > 1.2 * backward


# ---------------------------------------------------------------- Cornell

CORNELL = """# a paint
2   # num wls

450
650
0.872665 0 0.5 3.141593 0.02 0.3
0.174533 0 1.570797 -0.5 -0.01 0.2
"""


def test_cornell_layout(put):
    samples = formats.read(put(CORNELL.replace("\n", "\r\n"), "paint.txt"))
    assert samples.metadata["format"] == "cornell"
    assert samples.value.tolist() == [0.02, 0.3, -0.01, 0.2]
    assert samples.wavelength_nm.tolist() == [450, 650, 450, 650]
    d = samples.directions
    assert d.theta_i.tolist() == [0.872665, 0.872665, 0.174533, 0.174533]
    assert d.phi_r.tolist() == [3.141593, 3.141593, -0.5, -0.5]
    assert d.theta_r[2] == np.pi / 2  # six printed digits may pass the horizon
    assert samples.n_negative == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# nothing\n", "the file holds comments only; the number of wavelengths comes first"),
        ("0\n", "line 1: '0' is not the number of wavelengths; a whole number from 1 to 100000"),
        ("999999999\n1 2\n", "line 1: '999999999' is not the number of wavelengths"),
        ("3\n450 650\n", "the file ends after 2 of 3 wavelengths; it is truncated"),
        ("1\n450 650\n", "line 2: 2 wavelengths where 1 are announced"),
        ("2\n450 x\n", "line 2, column wavelength: 'x' is not a finite number"),
        ("2\n450 -1\n", "line 2: the wavelength -1 nm is not positive"),
        ("1\n450\n", "no geometry follows the wavelengths"),
        (CORNELL + "0.1 0 0.1 0 0.5\n", "line 8: 5 numbers where 4 angles and 2 values are wanted"),
        (CORNELL + "0.1 0 0.1 0 0.5 nan\n", "line 8, column value 2: 'nan' is not a finite number"),
        (CORNELL + "0.1 0 ? 0 0.5 1\n", "line 8, column theta_s: '?' is not a finite number"),
        (CORNELL + "30 0 0.1 0 0.5 1\n", "line 8, column theta_i: 30 rad is beyond the horizon"),
        (
            CORNELL + "0.1 0 -0.1 0 0.5 1\n",
            "line 8, column theta_s: -0.1 rad is negative; polar angles count from the normal, "
            "so write 0.1 and add pi to phi_s",
        ),
    ],
)
def test_cornell_refusals(put, text, message):
    error = refused(put(text, "paint.brdf"), message)
    assert str(error).endswith("(Read as cornell.)")


@pytest.mark.parametrize("name", ["garnet_red", "krylon_blue"])
def test_real_cornell(real_data, name):
    samples = formats.read(real_data / "cornell" / f"{name}.brdf")
    assert len(samples) == 1439 * 31
    assert np.unique(samples.wavelength_nm).tolist() == list(range(400, 701, 10))
    assert np.all(samples.directions.phi_i == 0)
    red = formats.read(real_data / "cornell" / f"{name}.brdf", select={"wavelength": "650"})
    assert len(red) == 1439
    # The brightest sample at 50 degrees lies near the mirror direction, phi_r = 180 degrees.
    at_50 = red.select(np.abs(red.directions.theta_i - np.radians(50)) < 1e-3, "50 deg")
    peak = int(np.argmax(at_50.value))
    assert np.cos(at_50.directions.phi_r[peak]) < -0.9


def test_every_format_says_what_it_is():
    for module in (cornell, gonio_csv, nist_ptfe):
        assert module.NAME in formats.names()
        assert module.TITLE


def test_a_btdf_has_no_column_in_the_table(tmp_path):
    directions = Directions([0.1, 0.1], 0.0, [0.2, 0.3], 0.0)
    samples = BRDFSamples(directions, np.array([0.1, 0.2]), quantity="BTDF")
    with pytest.raises(DataError, match="a BTDF and the table has a column for a BRDF; save them"):
        gonio_csv.write(tmp_path / "sheet.csv", samples)
    assert not list(tmp_path.iterdir())
