"""Directions, half vectors, quadrature and the equal-area map."""

import math

import numpy as np
import pytest

from gonio.errors import DataError
from gonio.geometry import (
    HORIZON,
    Directions,
    angles,
    equal_area,
    from_equal_area,
    hemisphere_quadrature,
    rotated,
    unit_vectors,
)


def random_vectors(seed: int, n: int = 500, theta_max: float = np.pi) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return unit_vectors(rng.uniform(0, theta_max, n), rng.uniform(-np.pi, np.pi, n))


def test_vectors_point_where_the_angles_say():
    np.testing.assert_allclose(unit_vectors(np.pi / 2, np.pi / 2), [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(
        unit_vectors(math.radians(30), math.pi), [-0.5, 0, math.sqrt(0.75)], atol=1e-15
    )
    assert unit_vectors(np.zeros((3, 1)), np.zeros(4)).shape == (3, 4, 3)


def test_angles_invert_vectors_and_keep_all_digits_near_the_normal():
    v = random_vectors(1)
    assert np.allclose(np.linalg.norm(v, axis=-1), 1, rtol=1e-15)
    np.testing.assert_allclose(unit_vectors(*angles(3.7 * v)), v, atol=1e-14)
    for theta in (1e-3, 1e-9, 1e-12):
        assert angles(unit_vectors(theta, 0.4))[0] == pytest.approx(theta, rel=1e-14)


def test_directions_broadcast_and_swap():
    d = Directions(0.1, [0.2, 0.3], [[0.4], [0.5], [0.6]], 0.7)
    assert d.shape == (3, 2)
    w_i, w_r = d.vectors()
    assert w_i.shape == w_r.shape == (3, 2, 3)
    back_i, back_r = d.swapped().vectors()
    np.testing.assert_array_equal(back_i, w_r)
    np.testing.assert_array_equal(back_r, w_i)


def test_a_direction_at_the_horizon_has_no_height():
    assert unit_vectors(HORIZON, 0.3)[2] == 0
    assert unit_vectors(np.nextafter(HORIZON, 0), 0.3)[2] > 0
    assert unit_vectors(2.0, 0.3)[2] == pytest.approx(np.cos(2.0), rel=1e-15)


def test_directions_cannot_be_changed():
    with pytest.raises(AttributeError):
        Directions(0, 0, 0, 0).theta_i = 1.0


def test_delta_is_zero_at_the_mirror_angle_and_theta_in_retro():
    theta = np.linspace(0, 1.5, 7)
    np.testing.assert_allclose(Directions(theta, 0.3, theta, 0.3 + np.pi).delta(), 0, atol=1e-14)
    np.testing.assert_allclose(Directions(theta, 0.3, theta, 0.3).delta(), theta, atol=1e-15)
    assert Directions(0.2, 0.0, 0.8, 0.0).delta() == pytest.approx(0.5)


@pytest.mark.parametrize("name", ["theta_i", "phi_i", "theta_r", "phi_r"])
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_an_angle_that_is_not_finite_is_refused_by_name(name, bad):
    given = {"theta_i": 0.1, "phi_i": 0.1, "theta_r": 0.1, "phi_r": 0.1, name: [0.1, bad]}
    with pytest.raises(DataError, match=f"^{name} holds a value that is not finite; remove it"):
        Directions(**given)


@pytest.mark.parametrize(("bad", "shown"), [(-0.1, "-0.1"), (60.0, "60"), (3.2, "3.2")])
def test_a_polar_angle_out_of_range_is_refused_with_its_value(bad, shown):
    with pytest.raises(
        DataError, match=rf"theta_r = {shown} is outside \[0, pi\]; polar"
    ) as caught:
        Directions(0.1, 0.0, [0.2, bad], 0.0)
    assert caught.value.value == bad
    assert caught.value.exit_code == 3


def test_shapes_that_do_not_broadcast_are_refused_with_all_four():
    match = r"do not broadcast: theta_i \(2,\), phi_i \(\), theta_r \(3,\), phi_r \(\); give equal"
    with pytest.raises(DataError, match=match):
        Directions([0.1, 0.2], 0.0, [0.1, 0.2, 0.3], 0.0)


def test_quadrature_integrates_polynomials_of_the_direction():
    theta, phi, w = hemisphere_quadrature(16, 16)
    x, y, z = unit_vectors(theta, phi).T
    assert w.sum() == pytest.approx(2 * np.pi, rel=1e-14)
    assert np.sum(w * z) == pytest.approx(np.pi, rel=1e-14)
    assert np.sum(w * x * x) == pytest.approx(2 * np.pi / 3, rel=1e-14)
    assert np.sum(w * x * x * y * y) == pytest.approx(2 * np.pi / 15, rel=1e-13)
    assert np.sum(w * x) == pytest.approx(0, abs=1e-14)


def test_quadrature_over_a_cap_sums_to_its_solid_angle():
    for edge in (0.2, 1.0, HORIZON):
        theta, _, w = hemisphere_quadrature(8, 8, theta_max=edge)
        assert w.sum() == pytest.approx(2 * np.pi * (1 - np.cos(edge)), rel=1e-13)
        assert theta.max() < edge


def test_the_equal_area_map_inverts_and_ends_at_radius_one():
    v = random_vectors(2, theta_max=HORIZON)
    x, y = equal_area(v)
    np.testing.assert_allclose(from_equal_area(x, y), v, atol=1e-14)
    assert np.hypot(x, y).max() <= 1
    edge = equal_area(unit_vectors(HORIZON, np.linspace(0, 6, 5)))
    np.testing.assert_allclose(np.hypot(*edge), 1, rtol=1e-15)


def test_the_equal_area_map_keeps_areas():
    """The Jacobian by central differences is sin(theta)/2: the hemisphere's 2 pi sr fill pi."""
    theta, phi, step = np.linspace(0.1, 1.5, 9), 0.8, 1e-6

    def disc(t, f):
        return np.array(equal_area(unit_vectors(t, f)))

    by_theta = (disc(theta + step, phi) - disc(theta - step, phi)) / (2 * step)
    by_phi = (disc(theta, phi + step) - disc(theta, phi - step)) / (2 * step)
    area = by_theta[0] * by_phi[1] - by_theta[1] * by_phi[0]
    np.testing.assert_allclose(area, np.sin(theta) / 2, rtol=1e-8)


def test_turning_the_frame_lowers_phi():
    v = random_vectors(3)
    theta, phi = angles(v)
    turned_theta, turned_phi = angles(rotated(v, 0.4))
    np.testing.assert_allclose(turned_theta, theta, atol=1e-14)
    np.testing.assert_allclose(np.cos(turned_phi - phi + 0.4), 1, atol=1e-12)
    np.testing.assert_allclose(rotated(rotated(v, 0.4), -0.4), v, atol=1e-15)
