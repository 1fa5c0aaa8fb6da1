"""The polar diagram of a model: what is drawn is f, on a scale that is named."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from gonio import models, plotting
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import Directions
from gonio.plotting.model import Radius, model_lobe, model_lobes


@pytest.fixture(autouse=True)
def no_figure_stays_open():
    import matplotlib.pyplot as plt

    yield
    plt.close("all")


def curves(ax):
    """The lines that are no part of the frame: signed theta_r and distance from the centre."""
    drawn = [line for line in ax.lines if len(line.get_xdata()) > 1000]
    return [
        (np.arctan2(x, y), np.hypot(x, y)) for line in drawn for x, y in [np.array(line.get_data())]
    ]


def texts(ax):
    return [text.get_text() for text in ax.texts]


def test_a_lambertian_surface_is_a_half_circle():
    ax = model_lobe("lambert", {"rho": 0.4})
    assert len(curves(ax)) == 3
    for angle, r in curves(ax):
        assert np.ptp(r) < 1e-12
        assert np.degrees(angle).min() == pytest.approx(-89.5)
        assert np.degrees(angle).max() == pytest.approx(89.5)
    assert any("linear" in text for text in texts(ax))


def test_the_distance_from_the_centre_is_f_on_the_given_scale():
    scale = Radius(0.01, 10.0, logarithmic=True)
    ax = model_lobe("ward", {"alpha_x": 0.2}, phi_i=0.3, theta_i=[0.5], radius=scale)
    ((signed, r),) = curves(ax)
    phi_r = np.where(signed > 0, 0.3 + np.pi, 0.3)
    f = models.get("ward")(Directions(0.5, 0.3, abs(signed), phi_r), alpha_x=0.2)
    # Three decades from the centre to the rim.
    assert r == pytest.approx(np.log10(f / 0.01) / 3, abs=1e-9)


def test_the_mirror_direction_lies_to_the_right_and_is_one_of_the_points():
    ax = model_lobe("ward_isotropic", {"alpha": 0.005, "rho_d": 0.0}, theta_i=[0.7])
    ((signed, r),) = curves(ax)
    assert signed[np.argmax(r)] == pytest.approx(0.7, abs=1e-9)


@pytest.mark.parametrize("name", models.names())
def test_every_model_fits_its_diagram(name):
    axes = model_lobes(name)
    isotropic = models.get(name).claims.isotropic
    assert len(axes) == (1 if isotropic else 2)
    for ax in axes:
        reach = [r for _, r in curves(ax)]
        assert all(np.isfinite(r).all() for r in reach)
        assert 0.5 < max(r.max() for r in reach) <= 1
        assert sum("θ_{\\mathrm{i}}" in text for text in texts(ax)) == 3
        assert any("BRDF $f$ (sr$^{-1}$)" in text for text in texts(ax))
    titles = [ax.get_title() for ax in axes]
    assert [title.endswith("°") for title in titles] == ([False] if isotropic else [True, True])


def test_both_planes_of_an_anisotropic_model_have_one_scale():
    first, second = model_lobes("ward", {"alpha_x": 0.05, "alpha_y": 0.3})
    rings = [
        [text for text in texts(ax) if text.replace(".", "").isdigit()] for ax in (first, second)
    ]
    assert rings[0] == rings[1]
    widths = [np.mean(r > 0.6 * r.max()) for ax in (first, second) for _, r in curves(ax)[:1]]
    assert widths[1] > 2 * widths[0]


def test_the_values_of_the_parameters_stand_above_in_degrees():
    (ax,) = model_lobes("oren_nayar", {"sigma": np.radians(35)})
    title = ax.figure.get_suptitle()
    assert title == "oren_nayar:  $ρ$ = 0.8, $σ$ = 35°"


@pytest.mark.parametrize(
    ("scale", "rings"),
    [
        (Radius(0.01, 3.0, logarithmic=True), [0.01, 0.1, 1.0]),
        (Radius(1e-4, 0.2, logarithmic=True), [1e-4, 1e-3, 1e-2, 1e-1]),
        (Radius(0.0, 0.18, logarithmic=False), [0.0, 0.05, 0.1, 0.15]),
        (Radius(0.0, 0.4, logarithmic=False), [0.0, 0.1, 0.2, 0.3, 0.4]),
    ],
)
def test_rings_are_decades_or_round_steps(scale, rings):
    assert scale.rings() == pytest.approx(rings)
    assert scale.of(np.array([scale.low, scale.high])) == pytest.approx([0, 1])


def test_values_below_the_scale_lie_at_the_centre():
    # Oren and Nayar's approximation falls below 0 forward on very rough, dark surfaces.
    ax = model_lobe("oren_nayar", {"rho": 0.1, "sigma": np.radians(60)}, theta_i=[np.radians(85)])
    ((_, r),) = curves(ax)
    assert r.min() == 0
    assert any("linear" in text for text in texts(ax))


def test_it_draws_on_given_axes():
    given = Figure().subplots()
    assert plotting.model_lobe(models.get("lambert"), ax=given) is given


@pytest.mark.parametrize(
    ("theta_i", "match"),
    [
        ([], "0 angles of incidence were given; 1 to 7 can be told apart in one diagram"),
        (np.linspace(0, 1, 8), "8 angles of incidence were given; 1 to 7"),
        ([45.0], r"theta_i = 45 rad is not above the horizon; allowed is 0 up to pi/2"),
        ([-0.1], r"theta_i = -0.1 rad is not above the horizon"),
    ],
)
def test_incidences_that_cannot_be_drawn_are_refused(theta_i, match):
    with pytest.raises(ConfigurationError, match=match):
        model_lobe("lambert", theta_i=theta_i)


def test_a_black_surface_is_nothing_to_draw():
    with pytest.raises(DataError, match="nothing to draw: f is 0 everywhere in the plane"):
        model_lobe("lambert", {"rho": 0.0})


def test_parameters_are_checked():
    with pytest.raises(ConfigurationError, match="rho = 2 is out of range; allowed is 0 to 1"):
        model_lobe("lambert", {"rho": 2.0})
    with pytest.raises(
        ConfigurationError, match="unknown model 'lambertt': did you mean 'lambert'"
    ):
        model_lobes("lambertt")
