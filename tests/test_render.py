"""Pictures: the reflection equation holds pixel by pixel, and every light says the same."""

import json
import math
import struct
import zlib

import numpy as np
import pytest

from gonio import cli, models
from gonio.errors import ConfigurationError, DataError
from gonio.geometry import hemisphere_quadrature, unit_vectors
from gonio.rendering import (
    SCENES,
    WHITE,
    Camera,
    Directional,
    Environment,
    Rectangle,
    Scene,
    cross_section,
    lift_of,
    plate,
    plate_reference,
    prefilter,
    prefilter_error,
    read_map,
    render,
    save_picture,
    scene,
    sky,
    srgb,
    white_of,
)
from gonio.rendering.integrate import LARGEST
from gonio.rendering.prefilter import outgoing
from gonio.rendering.shapes import UPRIGHT, Box, Plate, trace

DEG = math.pi / 180
BRASS = {"rho_d": 0.1, "rho_s": 0.33, "alpha_x": 0.05, "alpha_y": 0.16}
ROUGH = {"rho": 0.7, "sigma": 40 * DEG}


def wide(theta_r: float = 0.0, phi_r: float = 0.0, **shape) -> tuple[Scene, Camera]:
    """A plate that fills the picture, by parallel rays."""
    made = Scene("wide", "a large plate", (Plate(**shape),), (0.1, 0.1))
    return made, Camera(theta_r, phi_r)


def pixel_middles(size: int, extent: float) -> np.ndarray:
    return ((np.arange(size) + 0.5) / size - 0.5) * extent


# ---------------------------------------------------------------- one lamp, by formula


@pytest.mark.parametrize("theta_i", [0.0, 50.0])
def test_a_lambertian_sphere_is_the_cosine(theta_i):
    size = 31
    image = render(
        "sphere", Directional(theta_i * DEG, 70 * DEG), "lambert", {"rho": 0.6},
        size=(size, size), samples=1,
    )  # fmt: skip
    x, y = np.meshgrid(pixel_middles(size, 2.2), -pixel_middles(size, 2.2))
    inside = x * x + y * y < 1
    normal = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], axis=-1)
    cos = np.maximum(normal @ unit_vectors(theta_i * DEG, 70 * DEG), 0)
    np.testing.assert_allclose(image[inside], 0.6 * cos[inside], atol=1e-6)
    assert not image[~inside].any()


@pytest.mark.parametrize("theta_i_deg", [0.0, 20.0])
@pytest.mark.parametrize("name", ["lambert", "oren_nayar"])
def test_the_picture_of_the_vase_is_its_cross_section(name, theta_i_deg):
    p = ROUGH if name == "oren_nayar" else {"rho": 0.7}
    light = Directional(theta_i_deg * DEG, 0.0)
    image = render("vase", light, name, p, size=(35, 25), samples=1)
    x = pixel_middles(25, 2.5)
    inside = np.abs(x) < 1
    # Row 18 is on the cylinder.
    _, expected = cross_section(name, p, theta_i=theta_i_deg * DEG, x=x[inside])
    np.testing.assert_allclose(image[18][inside], expected, rtol=1e-9, atol=1e-12)
    assert not image[18][~inside].any()


def test_a_lambertian_vase_is_the_cosine_of_the_paper():
    x, radiance = cross_section("lambert", {"rho": 1.0}, theta_i=20 * DEG)
    cos = np.cos(np.arcsin(x) - 20 * DEG)
    np.testing.assert_allclose(radiance, np.maximum(cos, 0), atol=1e-12)


def test_a_rougher_vase_is_flatter_and_its_edges_are_brighter():
    # Oren & Nayar 1994, Figs 12 to 14, lamp at the viewer.
    x = np.array([0.0, 0.9, 0.97])
    falls = []
    for sigma in (0, 10, 20, 30, 40, 50):
        _, radiance = cross_section("oren_nayar", {"rho": 0.7, "sigma": sigma * DEG}, x=x)
        falls.append(radiance[1:] / radiance[0])
    assert np.all(np.diff(falls, axis=0) > 0)
    assert falls[0] == pytest.approx(np.sqrt(1 - x[1:] ** 2), rel=1e-9)
    # At 40 deg brightness "remains nearly constant over most of the cross-section".
    x = np.linspace(-0.75, 0.75, 31)
    _, rough = cross_section("oren_nayar", ROUGH, x=x)
    _, lambert = cross_section("lambert", {"rho": 0.7}, x=x)
    assert rough.min() > 0.9 * rough.max()
    assert lambert.min() < 0.7 * lambert.max()


def test_the_brightest_place_of_the_vase_lies_beyond_lamberts():
    # Fig. 13(b): the Lambertian peak "is significantly away from the actual peak".
    x, lambert = cross_section("lambert", {}, theta_i=20 * DEG)
    _, rough = cross_section("oren_nayar", ROUGH, theta_i=20 * DEG)
    assert x[lambert.argmax()] == pytest.approx(math.sin(20 * DEG), abs=0.01)
    assert x[rough.argmax()] > math.sin(30 * DEG)


def test_swapping_lamp_and_camera_keeps_f():
    a, b = (55 * DEG, 20 * DEG), (25 * DEG, 160 * DEG)
    f = []
    for light, view in ((a, b), (b, a)):
        made, camera = wide(*view)
        image = render(made, Directional(*light), "ward", BRASS, camera=camera, size=(2, 2))
        f.append(image / (WHITE * math.cos(light[0])))
    np.testing.assert_allclose(f[0], f[1], rtol=1e-12)
    expected = models.get("ward")
    w_i, w_r = unit_vectors(*a), unit_vectors(*b)
    assert f[0][0, 0] == pytest.approx(float(expected.evaluate(w_i, w_r, expected.vector(BRASS))))


def test_f_below_zero_is_no_light():
    made, camera = wide(80 * DEG, 0.0)
    steep = {"rho": 0.1, "sigma": 60 * DEG}
    image = render(made, Directional(80 * DEG, math.pi), "oren_nayar", steep, camera=camera,
                   size=(2, 2))  # fmt: skip
    directions = unit_vectors(80 * DEG, math.pi), unit_vectors(80 * DEG, 0.0)
    model = models.get("oren_nayar")
    assert model.evaluate(*directions, model.vector(steep)) < 0
    assert not image.any()


@pytest.mark.parametrize(("turn", "tall"), [(0.0, True), (90 * DEG, False)])
def test_the_highlight_is_long_across_the_grooves(turn, tall):
    # alpha_x < alpha_y: smooth along x, the brushed direction, which is horizontal at first.
    image = render("sphere", Directional(), "ward", BRASS, size=(64, 64), samples=4, turn=turn)
    lobe = np.maximum(image - 1.2 * BRASS["rho_d"], 0)
    rows, columns = np.mgrid[:64, :64] - 31.5
    high, wide_ = (np.sum(lobe * c * c) / lobe.sum() for c in (rows, columns))
    ratio = math.sqrt(high / wide_)
    assert (ratio if tall else 1 / ratio) > 2


def test_every_scene_is_drawn_by_every_light():
    lights = [
        Directional(40 * DEG, 100 * DEG),
        Rectangle.facing(40 * DEG, 100 * DEG, distance=5, size=(1, 2)),
        sky("overcast"),
    ]
    for name in SCENES:
        for light in lights:
            image = render(name, light, "ward", BRASS, size=(9, 12), samples=4)
            assert image.shape == (9, 12)
            assert np.all(np.isfinite(image))
            assert image.min() >= 0
            assert image.max() > 0


# ---------------------------------------------------------------- shadows and shapes


def test_a_sphere_throws_its_shadow_on_the_floor():
    # Lamp at 45 deg above on the left: the shadow's middle is sqrt(2) behind the foot, on the
    # right, and long by the same factor.
    lit = scene("sphere", floor=True)
    light = Directional(90 * DEG, 135 * DEG)
    seen_from_above = Camera(90 * DEG, 90 * DEG)
    size = 44
    made = Scene("far", "", lit.shapes, (8.8, 8.8))
    image = render(made, light, "lambert", {"rho": 1.0}, camera=seen_from_above, size=(size, size),
                   samples=1)  # fmt: skip
    x, z = np.meshgrid(pixel_middles(size, 8.8), pixel_middles(size, 8.8))
    floor = x * x + z * z > 1.1
    # Distance of the floor's point from the line through the middle of the sphere to the lamp.
    to_lamp = np.array([-math.sqrt(0.5), math.sqrt(0.5), 0.0])
    point = np.stack([x, np.full_like(x, -1.0), z], axis=-1)
    across = np.linalg.norm(np.cross(point, to_lamp), axis=-1)
    sure = floor & (np.abs(across - 1) > 0.01)
    np.testing.assert_allclose(
        image[sure], np.where(across < 1, 0.0, math.sqrt(0.5))[sure], atol=1e-9
    )


def test_axes_of_the_surfaces_are_orthonormal_and_face_the_viewer():
    drawn = scene("objects", floor=True)
    rng = np.random.default_rng(3)
    x, y = rng.uniform(-3.7, 3.7, 4000), rng.uniform(-2, 2, 4000)
    origin, along = Camera(25 * DEG, 90 * DEG).rays(drawn, x, y)
    hits = trace(drawn.shapes, origin, along, 0.3)
    assert hits.met.all()
    unit = np.einsum("nij,nik->njk", hits.frame, hits.frame)
    np.testing.assert_allclose(unit, np.broadcast_to(np.eye(3), unit.shape), atol=1e-12)
    assert np.all(np.sum(hits.frame[:, :, 2] * along, axis=1) <= 1e-12)
    # A small step along the normal leaves the shape on whose surface the point lies.
    np.testing.assert_allclose(np.linalg.det(hits.frame), 1, atol=1e-12)


@pytest.mark.parametrize("shape", [*scene("vase").shapes, Box(half=np.array([1.0, 0.5, 0.8]))])
def test_normals_are_square_to_the_surface(shape):
    rng = np.random.default_rng(4)
    origin = 6 * unit_vectors(rng.uniform(0, np.pi, 500), rng.uniform(0, 2 * np.pi, 500))
    aim = rng.uniform(-0.4, 0.4, (500, 3))
    along = (aim - origin) / np.linalg.norm(aim - origin, axis=1, keepdims=True)
    hits = trace((shape,), origin, along, 0.0)
    assert hits.met.all()
    # Rays that pass beside by 1e-6 meet the tangent plane to second order.
    step = 1e-6 * rng.normal(size=(500, 3))
    beside = trace((shape,), origin + step, along, 0.0)
    same = np.linalg.norm(beside.frame[:, :, 2] - hits.frame[:, :, 2], axis=1) < 1e-4
    off = np.sum((beside.point - hits.point) * hits.frame[:, :, 2], axis=1)
    assert same.mean() > 0.95
    assert np.abs(off[same]).max() < 1e-9


def test_straight_down_the_front_is_below():
    origin, along = Camera(90 * DEG, 90 * DEG).rays(scene("vase"), np.zeros(1), np.ones(1))
    np.testing.assert_allclose(along, [[0, -1, 0]], atol=1e-15)
    assert origin[0, 2] == pytest.approx(-1)


def test_perspective_shows_the_width_in_its_angle():
    made = scene("plane")
    camera = Camera(0.0, 0.0, "perspective", 50 * DEG)
    _, along = camera.rays(made, np.array([-1.2, 1.2]), np.zeros(2))
    assert math.degrees(math.acos(along[0] @ along[1])) == pytest.approx(50)


# ---------------------------------------------------------------- light from a solid angle


def within(value: np.ndarray, expected: float, sigmas: float = 4.5) -> None:
    """The mean of independent pixels is `expected` but for chance."""
    error = value.std(ddof=1) / math.sqrt(value.size)
    assert abs(value.mean() - expected) < sigmas * error + 1e-9, (value.mean(), expected, error)


@pytest.mark.parametrize("name", models.names())
def test_in_even_light_radiance_is_the_albedo(name):
    model = models.get(name)
    theta_r, phi_r = 50 * DEG, 25 * DEG
    made, camera = wide(theta_r, phi_r)
    size, samples = ((4, 4), 4) if model.costly else ((20, 20), 16)
    image = render(made, Environment.uniform(), model, camera=camera, size=size, samples=samples)
    theta, phi, weight = hemisphere_quadrature(*((16, 24) if model.costly else (160, 320)))
    w_i, w_r = unit_vectors(theta, phi), unit_vectors(theta_r, phi_r)
    f = np.maximum(model.evaluate(w_i, w_r, model.vector({})), 0)
    within(image, float(np.sum(f * np.cos(theta) * weight)), 4.5)


def test_a_white_scene_in_even_light_cannot_be_seen():
    # With enough bounces every place of a closed white world has the radiance 1.
    image = render(
        "objects", Environment.uniform(), "lambert", {"rho": 1.0}, size=(12, 16), samples=36,
        bounces=24,
    )  # fmt: skip
    within(image, 1.0)
    direct = render("objects", Environment.uniform(), "lambert", {"rho": 1.0}, size=(12, 16))
    # The inside of the vase sees the vase: without bounces light is missing there.
    assert direct.mean() < 0.99


def test_a_convex_white_body_needs_no_bounces():
    image = render("sphere", Environment.uniform(3.0), "lambert", {"rho": 1.0}, size=(24, 24))
    within(image[8:16, 8:16], 3.0)
    assert image[0, 0] == 3.0  # beside the sphere the light itself is seen


def test_a_small_far_rectangle_is_a_lamp():
    distance, edge = 200.0, 0.5
    area = Rectangle.facing(30 * DEG, 60 * DEG, distance=distance, size=(edge, edge))
    assert area.radiance * edge**2 / distance**2 == pytest.approx(WHITE, rel=1e-5)
    for name, p in (("lambert", {"rho": 0.5}), ("ward", {**BRASS, "alpha_x": 0.2})):
        near = render("sphere", area, name, p, size=(16, 16), samples=1)
        far = render("sphere", Directional(30 * DEG, 60 * DEG), name, p, size=(16, 16), samples=1)
        # 0.16 deg of parallax over the sphere, and at the terminator more of the little there is.
        np.testing.assert_allclose(near, far, rtol=0.06, atol=0.01)


@pytest.mark.parametrize("distance", [0.5, 2.0])
def test_a_near_rectangle_gives_its_irradiance(distance):
    area = Rectangle.facing(0.0, 0.0, distance=distance, size=(1.0, 2.0), irradiance=2.0)
    made = Scene("spot", "", (Plate(),), (1e-4, 1e-4))
    camera = Camera(70 * DEG, 0.0)
    image = render(made, area, "lambert", {"rho": 1.0}, camera=camera, size=(16, 16), samples=64)
    within(image, 2.0 / math.pi)


def test_a_lamp_is_seen_from_its_front_and_not_from_behind():
    behind = Rectangle.facing(math.pi, 0.0, distance=3.0, size=(4.0, 4.0))
    image = render("sphere", behind, "lambert", {}, size=(11, 11), samples=1)
    assert image[0, 0] == pytest.approx(behind.radiance)
    assert image[5, 5] == 0
    front = Rectangle.facing(0.0, 0.0, distance=3.0, size=(4.0, 4.0))
    image = render("sphere", front, "lambert", {}, size=(11, 11), samples=4)
    assert image[0, 0] == 0
    assert image[5, 5] > 0


def test_a_narrow_lobe_under_a_lamp_is_unbiased():
    # What the draws towards the lamp and those of the lobe share must not be counted twice.
    area = Rectangle.facing(40 * DEG, math.pi, distance=2.0, size=(1.0, 1.0))
    made, camera = wide(40 * DEG, 0.0)
    made = Scene("spot", "", made.shapes, (1e-5, 1e-5))
    image = render(made, area, "ward", BRASS, camera=camera, size=(24, 24), samples=16)
    step = (np.arange(200) + 0.5) / 200 - 0.5
    u, v = np.meshgrid(step, step)
    place = area.centre + u[..., None] * area.edge_u + v[..., None] * area.edge_v
    r2 = np.sum(place**2, axis=-1)
    w_i = place / np.sqrt(r2)[..., None]
    cos_lamp = w_i @ (area.centre / np.linalg.norm(area.centre))
    model = models.get("ward")
    f = model.evaluate(w_i, unit_vectors(40 * DEG, 0.0), model.vector(BRASS))
    exact = np.mean(f * w_i[..., 2] * cos_lamp / r2) * area.radiance * area.area
    within(image, float(exact))


# ---------------------------------------------------------------- environments


def lively(rows: int = 8) -> Environment:
    return Environment(np.random.default_rng(2).exponential(size=(rows, 2 * rows)) ** 2)


def test_an_environment_is_drawn_by_its_light():
    world = lively()
    towards = world.draw(np.zeros((40_000, 3)), np.random.default_rng(1).random((2, 40_000)))
    total = float(np.sum(world.radiance * world.solid_angle[:, None]))
    np.testing.assert_allclose(towards.radiance / towards.density, total, rtol=1e-12)
    back = world.incoming(np.zeros((40_000, 3)), towards.along)
    # A direction on the edge of a pixel may round to its neighbour.
    assert np.mean(back.density == towards.density) > 0.999
    # The mean direction against the sum over pixels, each evenly filled.
    fine = Environment(np.kron(world.radiance, np.ones((16, 16))))
    flux = fine.radiance * fine.solid_angle[:, None]
    mean = np.einsum("rc,rck->k", flux, fine.directions()) / flux.sum()
    np.testing.assert_allclose(towards.along.mean(axis=0), mean, atol=0.02)


def test_the_middle_column_is_behind_the_scene_and_columns_go_to_the_right():
    world = Environment(np.arange(1.0, 13.0).reshape(3, 4))
    to = np.array([[0, 0.99, 0.01], [0.1, 0, -1], [-0.1, 0, -1], [1, 0, 0.1], [0, -1, 0.01]], float)
    seen = world.radiance_along(to / np.linalg.norm(to, axis=1, keepdims=True))
    assert seen[1:4].tolist() == [7.0, 6.0, 8.0]
    assert seen[0] <= 4
    assert seen[4] >= 9


@pytest.mark.parametrize("name", ["overcast", "clear"])
def test_skies_light_level_ground_alike(name):
    ground = Scene("ground", "", (Plate(axes=UPRIGHT),), (1.0, 1.0))
    light = sky(name, 60 * DEG, 100 * DEG)
    image = render(ground, light, "lambert", {"rho": 1.0}, camera=Camera(60 * DEG, 90 * DEG),
                   size=(24, 24))  # fmt: skip
    within(image, 1.0)
    if name == "overcast":
        up = light.radiance_along(np.array([[0, 1.0, 0], [0, 1e-3, 1]]))
        assert up[0] / up[1] == pytest.approx(3, rel=0.05)
    else:
        sun = unit_vectors(60 * DEG, 100 * DEG)[None]
        assert light.radiance_along(sun)[0] > 0.9 * light.radiance.max()


def test_pictures_of_an_environment_agree_with_the_sum_over_its_pixels():
    world = lively()
    made, camera = wide(50 * DEG, 0.0)
    p = {"rho_d": 0.2, "rho_s": 0.3, "alpha_x": 0.2, "alpha_y": 0.4}
    image = render(made, world, "ward_gmd", p, camera=camera, size=(24, 24), turn=0.4)
    fine = Environment(np.kron(world.radiance, np.ones((24, 24))))
    model = models.get("ward_gmd")
    back = unit_vectors(50 * DEG, 0.0)[None]
    # The frame of `outgoing` begins at the circle of latitude, which at +z is +x.
    exact = outgoing(fine, model, model.vector(p), np.array([[0.0, 0.0, 1.0]]), back, turn=0.4)
    within(image, float(exact[0]))


# ---------------------------------------------------------------- one seed, one picture


@pytest.mark.parametrize("light", [Directional(), sky("overcast")])
def test_threads_do_not_change_the_picture(light):
    given = {"size": (96, 64), "samples": 16, "bounces": 1}
    one = render("vase", light, "ward", BRASS, threads=1, **given)
    two = render("vase", light, "ward", BRASS, threads=2, **given)
    np.testing.assert_array_equal(one, two)
    other = render("vase", light, "ward", BRASS, seed=1, **given)
    assert np.any(other != one)


def test_progress_comes_to_its_end():
    told = []
    render("sphere", Directional(), "lambert", size=(40, 40), samples=64,
           progress=lambda done, total: told.append((done, total)))  # fmt: skip
    assert told[-1] == (40, 40)
    assert [done for done, _ in told] == sorted(done for done, _ in told)


@pytest.mark.parametrize(
    ("given", "match"),
    [
        ({"scene": "ball"}, "unknown scene 'ball'"),
        ({"size": (0, 9)}, "0 rows were asked for; a picture has 1 to 8192"),
        ({"size": (9, LARGEST + 1)}, "8193 columns were asked for"),
        ({"samples": 5}, "5 samples a pixel were asked for; give a square number"),
        ({"bounces": 65}, "65 bounces were asked for; allowed is 0"),
        ({"p": {"rho": 2.0}}, "rho = 2 is out of range"),
    ],
)
def test_what_cannot_be_drawn_is_refused(given, match):
    words = {"scene": "sphere", "light": Directional(), "model": "lambert", **given}
    with pytest.raises(ConfigurationError, match=match):
        render(**words)


def test_lights_and_cameras_refuse_what_is_none():
    with pytest.raises(ConfigurationError, match="the light's distance is 0; it must be"):
        Rectangle.facing(0.0, 0.0, distance=0.0, size=(1.0, 1.0))
    with pytest.raises(ConfigurationError, match="unknown projection 'fish'"):
        Camera(projection="fish")
    with pytest.raises(ConfigurationError, match="fov = 180 deg; the picture's width takes up"):
        Camera(fov=math.pi)
    with pytest.raises(ConfigurationError, match="the scene plane has no floor"):
        scene("plane", floor=True)
    with pytest.raises(ConfigurationError, match="unknown sky 'night'"):
        sky("night")
    with pytest.raises(ConfigurationError, match="the sun at theta_i = 30, phi_i = -90 deg is not"):
        sky("clear", 30 * DEG, -90 * DEG)
    with pytest.raises(DataError, match="the environment is black"):
        Environment(np.zeros((2, 4)))
    with pytest.raises(DataError, match="negative or not finite"):
        Environment(np.array([[1.0, -1.0]]))
    with pytest.raises(DataError, match=r"shape \(2, 2, 3\) was given; it is one grey map"):
        Environment(np.ones((2, 2, 3)))
    with pytest.raises(ConfigurationError, match="theta_i = 90 deg; the lamp stands within 90"):
        cross_section("lambert", theta_i=math.pi / 2)
    with pytest.raises(ConfigurationError, match="a position is not on the cylinder"):
        cross_section("lambert", x=np.array([1.0]))


# ---------------------------------------------------------------- Ward's Fig. 7


@pytest.fixture(scope="module")
def exact():
    return plate_reference("ward", BRASS, size=24)


class TestPlate:
    def z(self, picture, exact) -> float:
        return float(np.sum(picture.radiance - exact) / math.sqrt(np.sum(picture.variance)))

    def test_monte_carlo_is_unbiased(self, exact):
        assert abs(self.z(plate("monte_carlo", "ward", BRASS, size=24, n=512), exact)) < 4

    def test_the_hybrid_is_unbiased(self, exact):
        # As many parts of the lamp as the reference: nothing but chance is between them.
        picture = plate("hybrid", "ward", BRASS, size=24, n=256, lamp_parts=12)
        chance = math.sqrt(np.sum(picture.variance))
        # I of eq. (6) by 12 rows of the wall instead of 24: 1e-4 of it.
        assert abs(np.sum(picture.radiance - exact)) < 4 * chance + 1e-4 * exact.sum()

    def test_the_hybrid_has_less_variance_for_as_many_rays(self):
        hybrid = plate("hybrid", "ward", BRASS, size=24, n=16)
        strict = plate("monte_carlo", "ward", BRASS, size=24, n=hybrid.rays)
        assert hybrid.rays == 20
        assert hybrid.variance.mean() < strict.variance.mean() / 100

    def test_without_rays_the_wall_is_missing_in_the_plate(self, exact):
        picture = plate("deterministic", "ward", BRASS, size=24, lamp_parts=12)
        assert picture.variance is None
        assert np.all(picture.radiance <= exact + 1e-9)
        # It is mirrored in the far part of the plate.
        assert picture.radiance[:6].mean() < 0.7 * exact[:6].mean()

    def test_counting_the_lamp_twice_adds_what_the_sum_has(self, exact):
        twice = plate("double_counted", "ward", BRASS, size=24, n=512, lamp_parts=12)
        # The lobe's part of the sum over the lamp, by the same sum without the diffuse part.
        room_alone = plate("deterministic", "ward", {**BRASS, "rho_d": 0.0}, size=24, lamp_parts=12)
        extra = float(np.sum(twice.radiance - exact - room_alone.radiance))
        assert abs(extra) < 4 * math.sqrt(np.sum(twice.variance)) + 1e-3 * exact.sum()

    def test_weights_as_printed_are_too_bright(self, exact):
        printed = plate("hybrid", "ward", BRASS, size=24, n=256, weights="printed")
        assert printed.radiance.sum() > 1.05 * exact.sum()

    def test_one_seed_one_picture(self):
        one, same, other = (
            plate("hybrid", "ward", BRASS, size=6, seed=seed).radiance for seed in (1, 1, 2)
        )
        np.testing.assert_array_equal(one, same)
        assert np.any(one != other)

    @pytest.mark.parametrize(
        ("words", "match"),
        [
            ({"method": "whitted"}, "unknown method 'whitted'"),
            ({"weights": "none"}, "unknown kind of weights 'none'"),
            ({"model": "lambert"}, "lambert cannot be split as eq"),
            ({"n": 0}, "n = 0; it must be 1 or more"),
        ],
    )
    def test_refusals(self, words, match):
        with pytest.raises(ConfigurationError, match=match):
            plate(**{"method": "hybrid", **words})


# ---------------------------------------------------------------- environments in advance


class TestPrefilter:
    def test_even_light_gives_the_albedo_from_everywhere(self):
        world = Environment(np.full((32, 64), 2.0))
        found = prefilter_error(world, "oren_nayar", {"rho": 0.8, "sigma": 0.3}, rows=8, n=60)
        # The sum stands for the integral to the size of its pixels.
        np.testing.assert_allclose(found.approximate, found.exact, rtol=0.01)

    def test_along_the_normal_it_is_exact_where_it_was_made(self):
        world, model = lively(16), models.get("ggx")
        table = prefilter(world, model, rows=8)
        normal = table.table.directions().reshape(-1, 3)
        exact = outgoing(world, model, model.vector({}), normal, normal)
        np.testing.assert_allclose(table.radiance(normal, normal), exact, rtol=1e-9)

    def test_a_matt_surface_is_looked_up_by_its_normal(self):
        world = sky("clear", 50 * DEG, 120 * DEG, rows=32)
        right = prefilter_error(world, "lambert", {"rho": 0.5}, about="normal", n=100)
        wrong = prefilter_error(world, "lambert", {"rho": 0.5}, about="mirror", n=100)
        assert right.rms < 0.005
        assert wrong.rms > 0.1

    def test_a_lobe_is_wrong_off_the_normal_and_says_by_how_much(self):
        world = sky("clear", 50 * DEG, 120 * DEG, rows=32)
        lobe = {"rho_d": 0.0, "k_s": 1.0, "alpha_x": 0.3, "alpha_y": 0.3}
        found = prefilter_error(world, "ggx", lobe, rows=16, n=200)
        off = np.abs(found.approximate - found.exact) / found.exact
        assert off[found.theta_r < 10 * DEG].mean() < 0.03
        assert off[found.theta_r > 60 * DEG].mean() > 3 * off[found.theta_r < 10 * DEG].mean()

    def test_refusals(self):
        with pytest.raises(ConfigurationError, match="unknown direction to look up 'half'"):
            prefilter(lively(), "lambert", about="half")
        with pytest.raises(ConfigurationError, match="rows = 2: a table has 4 rows or more"):
            prefilter(lively(), "lambert", rows=2)


# ---------------------------------------------------------------- files


def chunks(data: bytes) -> dict[str, list[bytes]]:
    found, at = {}, 8
    while at < len(data):
        (n,) = struct.unpack(">I", data[at : at + 4])
        body = data[at + 4 : at + 8 + n]
        assert struct.unpack(">I", data[at + 8 + n : at + 12 + n]) == (zlib.crc32(body),)
        found.setdefault(body[:4].decode(), []).append(body[4:])
        at += 12 + n
    return found


def test_a_png_says_how_it_was_toned(tmp_path):
    import cv2

    image = np.linspace(0, 2, 12).reshape(3, 4)
    save_picture(image, tmp_path / "a.png", white=1.0, facts={"scene": "ramp"})
    read = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read, srgb(image, 1.0))
    found = chunks((tmp_path / "a.png").read_bytes())
    save_picture(image, tmp_path / "a.png", white=1.0, lift=3.0, facts={"scene": "ramp"})
    read = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(read, srgb(image, 1.0, 3.0))
    lifted = chunks((tmp_path / "a.png").read_bytes())["tEXt"]
    assert any(b"dark values are lifted, ln(1 + 3 v) with v = L/white;" in t for t in lifted)
    assert set(found) == {"IHDR", "sRGB", "tEXt", "IDAT", "IEND"}
    text = dict(entry.split(b"\0", 1) for entry in found["tEXt"])
    assert text[b"Description"] == (
        b"radiance 1 is white and more is clipped; 8 bits on the sRGB curve"
    )
    assert json.loads(text[b"Comment"]) == {"scene": "ramp"}


def test_the_curve_is_srgb():
    # IEC 61966-2-1: linear 0.0031308 is where the line ends, 0.5 is 188.
    assert srgb(np.array([0.0, 0.5, 1.0]), 1.0).tolist() == [0, 188, 255]
    assert srgb(np.array([1.0]), 2.0).tolist() == [188]
    with pytest.raises(ConfigurationError, match="white = 0: the radiance that is shown as white"):
        srgb(np.ones(1), 0.0)
    assert white_of(np.zeros((2, 2))) == 1.0


def test_a_highlight_does_not_leave_the_rest_black():
    matt = np.linspace(0.3, 1.0, 400).reshape(20, 20)
    assert lift_of(matt, white_of(matt)) == 0  # nothing outshines it: the scale stays linear
    metal = matt / 40
    metal[9:11, 9:11] = 3.0
    white = white_of(metal)
    shown = srgb(metal, white, lift_of(metal, white))
    assert np.median(srgb(metal, white)) < 40
    assert np.median(shown) == pytest.approx(128, abs=2)  # a middle grey
    assert shown[9, 9] == 255
    order = np.argsort(metal, axis=None)
    assert np.all(np.diff(shown.ravel()[order].astype(int)) >= 0)
    assert lift_of(np.zeros((2, 2)), 1.0) == 0


@pytest.mark.parametrize("name", ["rolled_aluminum", "rolled_brass", "wall_plaster"])
def test_the_default_ball_of_any_material_can_be_seen(run, tmp_path, name):
    import cv2

    code, out, _ = run("sphere", "--material", name, "--size", "48", "--samples", "4", "--json")
    assert code == 0
    document = json.loads(out)
    picture = cv2.imread(str(tmp_path / "sphere.png"), cv2.IMREAD_UNCHANGED)
    ball = picture[picture > 0]
    assert np.median(ball) > 110
    # Lit from above left, so that its form is seen.
    assert picture[:24, :24].mean() > 1.2 * picture[24:, 24:].mean()
    assert (document["lift"] > 0) == (name != "wall_plaster")
    code, out, _ = run("sphere", "--material", name, "--size", "48", "--white", "1", "--json")
    assert json.loads(out)["lift"] == 0  # a white that was given is a linear scale


@pytest.mark.parametrize("suffix", [".pfm", ".npy", ".exr"])
def test_linear_radiance_comes_back(tmp_path, suffix):
    if suffix == ".exr":
        pytest.importorskip("OpenEXR", exc_type=ImportError)
    image = np.random.default_rng(0).exponential(size=(5, 7))
    save_picture(image, tmp_path / f"a{suffix}")
    tolerance = 0 if suffix == ".npy" else 1e-7
    np.testing.assert_allclose(read_map(tmp_path / f"a{suffix}"), image, rtol=tolerance)


def test_a_colour_becomes_its_luminance(tmp_path):
    import cv2

    colour = np.ones((4, 8, 3), np.float32) * np.array([4.0, 2.0, 1.0], np.float32)
    cv2.imwrite(str(tmp_path / "a.hdr"), colour[:, :, ::-1])
    with (tmp_path / "a.pfm").open("wb") as file:
        file.write(b"PF\n8 4\n-1\n" + colour[::-1].astype("<f4").tobytes())
    for name in ("a.hdr", "a.pfm"):
        expected = 0.2126 * 4 + 0.7152 * 2 + 0.0722
        np.testing.assert_allclose(read_map(tmp_path / name), expected, rtol=0.01)


def test_files_that_cannot_be_read_or_written_are_reported(tmp_path):
    (tmp_path / "a.pfm").write_bytes(b"Pf\n8 4\n-1\n123")
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE")
    (tmp_path / "a.npy").write_bytes(b"junk")
    for name in ("a.pfm", "a.hdr", "a.npy"):
        with pytest.raises(DataError, match=f"{name}: cannot be read as a picture"):
            read_map(tmp_path / name)
    np.save(tmp_path / "b.npy", np.ones((2, 2, 5)))
    with pytest.raises(DataError, match=r"has the shape \(2, 2, 5\); a grey or a red-green-blue"):
        read_map(tmp_path / "b.npy")
    with pytest.raises(DataError, match="no such file; give a map"):
        read_map(tmp_path / "none.hdr")
    with pytest.raises(ConfigurationError, match=r"read from \.pfm, \.hdr, \.exr, \.npy"):
        read_map(tmp_path / "a.jpg")
    with pytest.raises(ConfigurationError, match=r"a picture is written as \.png to look at"):
        save_picture(np.ones((2, 2)), tmp_path / "a.tiff")
    with pytest.raises(DataError, match="does not exist"):
        save_picture(np.ones((2, 2)), tmp_path / "no" / "a.png")


# ---------------------------------------------------------------- the command


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Run the command in an empty folder: exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def words(*given):
        with pytest.raises(SystemExit) as left:
            cli.main(["render", *map(str, given)])
        return left.value.code, *capsys.readouterr()

    return words


SMALL = ("--size", "12", "--samples", "1", "-o", "a.png")


def test_the_command_draws_and_says_what(run, tmp_path):
    code, out, err = run("sphere", "--model", "oren_nayar", "-p", "rho=0.9", "-p", "sigma=20",
                         "--theta-i", "20", *SMALL)  # fmt: skip
    assert code == 0
    assert out.splitlines()[0] == "a.png: 12 x 12 pixels; direct light only."
    assert out.splitlines()[1].startswith("Tone: radiance 0.")
    assert err.splitlines()[-1].startswith("rendering sphere: 12 of 12 rows")
    assert chunks((tmp_path / "a.png").read_bytes())["IDAT"]


def test_json_is_one_document_that_repeats_the_picture(run, tmp_path):
    code, out, _ = run(
        "vase", "--material", "clay_vase", "--light", "area", "--theta-i", "30", "--white", "1",
        "--json", *SMALL,
    )  # fmt: skip
    document = json.loads(out)
    assert code == 0
    assert document["schema"] == "gonio.rendering/1"
    assert document["parameters"] == {"rho": 0.7, "sigma": 40.0}
    assert document["light"]["size"] == [1.0, 1.0]
    assert document["size"] == [12, 17]
    assert document["white"] == 1
    light = Rectangle.facing(30 * DEG, 0.0, distance=5.0, size=(1.0, 1.0))
    image = render("vase", light, "oren_nayar", ROUGH, size=(17, 12), samples=1)
    assert document["radiance"]["max"] == pytest.approx(image.max(), rel=1e-12)


def test_linear_files_take_no_tone(run, tmp_path):
    words = ("sphere", "--model", "lambert", "--size", "8", "-o", "a.pfm")
    code, out, _ = run(*words)
    assert code == 0
    assert out.splitlines()[1].startswith("Linear radiance, up to 0.")
    code, _, err = run(*words, "--white", "1")
    assert (code, "--white is the tone of a PNG" in err) == (2, True)


def test_a_map_of_a_file_lights_the_scene(run, tmp_path):
    np.save(tmp_path / "even.npy", np.full((4, 8), 0.5))
    code, out, _ = run("sphere", "--model", "lambert", "-p", "rho=1", "--light", "environment",
                       "--map", "even.npy", "--json", *SMALL)  # fmt: skip
    assert code == 0
    assert json.loads(out)["light"] == {"kind": "environment", "map": "even.npy"}


@pytest.mark.parametrize(
    ("words", "code", "match"),
    [
        (["sphere"], 2, "give --model NAME or --material NAME; neither was given"),
        (["ball", "--model", "lambert"], 2, "unknown scene 'ball'"),
        (["sphere", "--model", "lambert", "--light", "ara"], 2, "did you mean 'area'"),
        (["sphere", "--model", "lambert", "--phi-i", "9"], 2, "--phi-i goes with --theta-i"),
        (["sphere", "--model", "lambert", "--theta-i", "-9"], 2, "--theta-i -9: the angle from"),
        (["sphere", "--model", "lambert", "--white", "0"], 2, "--white 0: the radiance"),
        (["sphere", "--model", "lambert", "--irradiance", "0"], 2, "--irradiance 0: it must be"),
        (["sphere", "--model", "lambert", "--light", "environment", "--irradiance", "2"], 2,
         "an environment has its own radiance"),
        (["sphere", "--model", "lambert", "--light", "environment", "--map", "clera"], 2,
         "unknown sky 'clera': did you mean 'clear'"),
        (["sphere", "--model", "lambert", "--light", "area", "--light-size", "1x"], 2,
         "--light-size '1x' is not one positive number or two"),
        (["sphere", "--model", "lambert", "--light", "environment", "--map", "no.hdr"], 3,
         "no.hdr: no such file"),
    ],
)  # fmt: skip
def test_refusals_are_one_clear_sentence(run, tmp_path, words, code, match):
    found, out, err = run(*words, *SMALL)
    assert (found, out) == (code, "")
    assert match in err
    assert not (tmp_path / "a.png").exists()


def test_a_size_that_is_none_is_refused(run):
    code, _, err = run("sphere", "--model", "lambert", "--size", "0x9", "-o", "a.png")
    assert (code, "--size '0x9' is not one positive number" in err) == (2, True)


def test_without_a_name_the_picture_has_that_of_its_scene(run, tmp_path):
    code, out, _ = run("vase", "--model", "lambert", "--size", "8", "--samples", "1")
    assert code == 0
    assert out.startswith("vase.png: 8 x 11 pixels")
    assert [path.name for path in tmp_path.iterdir()] == ["vase.png"]
