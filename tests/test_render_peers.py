"""Mitsuba as a witness of the pictures: the same surface in its ray tracer gives the same radiance.

The BRDF is ours, run by the Python interpreter at every ray; camera, shapes, frames of anisotropic
surfaces, lamps and shadows are Mitsuba's. It comes with the extra `bench`; without it these tests
are skipped.
"""

import importlib
import math

import numpy as np
import pytest

from gonio import models
from gonio.geometry import unit_vectors
from gonio.rendering import WHITE, Camera, Directional, Rectangle, Scene, render, scene
from gonio.rendering.shapes import UPRIGHT, Piece, Revolution

DEG = math.pi / 180
SIZE = 32
SURFACES = {
    "lambert": {"rho": 0.6},
    "oren_nayar": {"rho": 0.9, "sigma": 30 * DEG},
    "ward": {"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.15, "alpha_y": 0.4},
}


@pytest.fixture(scope="module")
def mitsuba():
    try:
        module = importlib.import_module("mitsuba")
    except ImportError as error:
        pytest.skip(f"mitsuba cannot be loaded ({error}); pip install 'gonio[bench]' brings it")
    module.set_variant("scalar_rgb")

    class Ours(module.BSDF):
        """One of gonio's models; eval() is f cos(theta), wi points to the camera there."""

        def __init__(self, props):
            module.BSDF.__init__(self, props)
            name = props["model"]
            self.model = models.get(name)
            self.p = self.model.vector(SURFACES[name])
            flags = module.BSDFFlags.GlossyReflection | module.BSDFFlags.FrontSide
            self.m_components = [flags | module.BSDFFlags.Anisotropic]
            self.m_flags = self.m_components[0]

        def eval(self, context, si, wo, active=True):
            view, light = np.array(si.wi, float), np.array(wo, float)
            f = self.model.plain(light, view, self.p)[0]
            return module.Color3f(f * max(light[2], 0.0))

        def pdf(self, context, si, wo, active=True):
            return max(float(wo[2]), 0.0) / math.pi

        def eval_pdf(self, context, si, wo, active=True):
            return self.eval(context, si, wo), self.pdf(context, si, wo)

        def sample(self, context, si, sample1, sample2, active=True):
            sample = module.BSDFSample3f()
            sample.wo = module.warp.square_to_cosine_hemisphere(sample2)
            sample.pdf = self.pdf(context, si, sample.wo)
            sample.eta, sample.sampled_component = 1.0, 0
            sample.sampled_type = int(self.m_flags)
            weight = self.eval(context, si, sample.wo) / sample.pdf if sample.pdf > 0 else 0.0
            return sample, module.Color3f(weight)

        def to_string(self):
            return f"Ours[{self.model.name}]"

    module.register_bsdf("gonio", Ours)
    return module


def traced(mitsuba, content: dict, half: float, back, samples: int = 16) -> np.ndarray:
    """Mitsuba's picture by parallel rays, `half` of the scene to each side of the middle."""
    place = mitsuba.ScalarTransform4f().look_at(
        origin=(30 * np.asarray(back)).tolist(), target=[0, 0, 0], up=[0, 1, 0]
    )
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
    film |= {"pixel_format": "luminance", "component_format": "float32"}
    sensor = {
        "type": "orthographic",
        "to_world": place @ mitsuba.ScalarTransform4f().scale([half, half, 1]),
        "film": film,
        "sampler": {"type": "stratified", "sample_count": samples},
    }
    integrator = {"type": "direct", "hide_emitters": True}
    drawn = {"type": "scene", "integrator": integrator, "sensor": sensor, **content}
    picture = np.array(mitsuba.render(mitsuba.load_dict(drawn)), float)
    return picture.reshape(SIZE, SIZE)


def sun(theta_i: float, phi_i: float) -> dict:
    towards = unit_vectors(theta_i, phi_i)
    return {"type": "directional", "direction": (-towards).tolist(), "irradiance": WHITE}


def middles(half: float) -> tuple[np.ndarray, np.ndarray]:
    step = ((np.arange(SIZE) + 0.5) / SIZE * 2 - 1) * half
    return np.meshgrid(step, -step)


@pytest.mark.parametrize("name", SURFACES)
@pytest.mark.parametrize("light", [(0.0, 0.0), (50 * DEG, 70 * DEG)])
def test_a_sphere_under_a_distant_lamp(mitsuba, name, light):
    upright = mitsuba.ScalarTransform4f().rotate([1, 0, 0], -90)  # its poles above and below
    shape = {"type": "sphere", "to_world": upright, "bsdf": {"type": "gonio", "model": name}}
    theirs = traced(mitsuba, {"shape": shape, "lamp": sun(*light)}, 1.1, [0, 0, 1])
    ours = render("sphere", Directional(*light), name, SURFACES[name], size=(SIZE, SIZE),
                  samples=16)  # fmt: skip
    x, y = middles(1.1)
    normal = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], axis=-1)
    # Away from the silhouette and from the edge of the light, where a pixel is partly dark.
    inside = (np.hypot(x, y) < 0.9) & (normal @ unit_vectors(*light) > 0.15)
    compare(ours, theirs, inside)


@pytest.mark.parametrize("name", ["oren_nayar", "ward"])
@pytest.mark.parametrize("theta_i", [0.0, 20 * DEG])
def test_the_cylinder_of_the_vase(mitsuba, name, theta_i):
    shape = {
        "type": "cylinder", "p0": [0, -2, 0], "p1": [0, 2, 0], "radius": 1.0,
        "bsdf": {"type": "gonio", "model": name},
    }  # fmt: skip
    theirs = traced(mitsuba, {"shape": shape, "lamp": sun(theta_i, 0.0)}, 1.1, [0, 0, 1])
    tube = Revolution(pieces=(Piece(-2, 2, 1.0),), axes=UPRIGHT)
    made = Scene("tube", "", (tube,), (2.2, 2.2))
    ours = render(made, Directional(theta_i, 0.0), name, SURFACES[name], size=(SIZE, SIZE),
                  samples=16)  # fmt: skip
    x, _ = middles(1.1)
    compare(
        ours, theirs, (np.abs(x) < 0.9) & (np.cos(np.arcsin(np.clip(x, -1, 1)) - theta_i) > 0.2)
    )


def turned_mesh(pieces, path, rings=24, around=720) -> None:
    """The surface of revolution about y as flat quadrilaterals, in a PLY file."""
    heights = np.concatenate([np.linspace(k.low, k.high, rings + 1) for k in pieces])
    radii = np.sqrt(np.concatenate([k.a + k.b * z + k.c * z * z for k, z in
                    ((k, np.linspace(k.low, k.high, rings + 1)) for k in pieces)]))  # fmt: skip
    phi = np.linspace(0, 2 * np.pi, around, endpoint=False)
    z, turn = np.meshgrid(heights, phi, indexing="ij")
    r = np.broadcast_to(radii[:, None], z.shape)
    points = np.stack([r * np.sin(turn), z, r * np.cos(turn)], axis=-1).reshape(-1, 3)
    low = np.arange(len(heights) - 1)[:, None] * around + np.arange(around)
    right = low - np.arange(around) + (np.arange(around) + 1) % around
    first = np.stack([low, right, right + around], axis=-1).reshape(-1, 3)
    second = np.stack([low, right + around, low + around], axis=-1).reshape(-1, 3)
    faces = np.concatenate([first, second])
    lines = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [f"{a:.9g} {b:.9g} {c:.9g}" for a, b, c in points]
    lines += [f"3 {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("name", ["lambert", "oren_nayar"])
@pytest.mark.parametrize("theta_i", [0.0, 20 * DEG])
def test_the_whole_vase(mitsuba, name, theta_i, tmp_path):
    vase = scene("vase")
    pieces = vase.shapes[0].pieces
    turned_mesh(pieces, tmp_path / "vase.ply")
    shape = {
        "type": "ply", "filename": str(tmp_path / "vase.ply"), "face_normals": True,
        "bsdf": {"type": "gonio", "model": name},
    }  # fmt: skip
    theirs = traced(mitsuba, {"shape": shape, "lamp": sun(theta_i, 0.0)}, 2.0, [0, 0, 1])
    made = Scene("vase", "", vase.shapes, (4.0, 4.0))
    ours = render(made, Directional(theta_i, 0.0), name, SURFACES[name], size=(SIZE, SIZE),
                  samples=16)  # fmt: skip
    x, y = middles(2.0)
    inside = np.zeros(x.shape, bool)
    pixel = 4.0 / SIZE
    for k in pieces:
        # Whole pixels of a piece, away from the silhouette and from where the light ends.
        z = np.clip(y, k.low, k.high)
        r = np.sqrt(k.a + k.b * z + k.c * z * z)
        within = (y - pixel / 2 > k.low) & (y + pixel / 2 < k.high) & (np.abs(x) < 0.85 * r)
        lit = np.cos(np.arcsin(np.clip(x / r, -1, 1)) - theta_i) > 0.25
        inside |= within & lit
    assert np.count_nonzero(inside) > 200
    compare(ours, theirs, inside)


def compare(ours, theirs, inside) -> None:
    """Pixels differ by where in them the rays pass, their mean does not."""
    difference = ours[inside] / theirs[inside] - 1
    assert abs(difference.mean()) < 1e-3
    assert np.sqrt(np.mean(difference**2)) < 0.01


def test_a_sphere_on_a_floor_under_a_rectangle(mitsuba):
    # Soft shadow, lamp near by and beside the picture: their draws and ours agree in the mean of
    # parts of it.
    area = Rectangle.facing(60 * DEG, 170 * DEG, distance=4.0, size=(2.0, 2.0))
    half = [np.append(edge / 2, 0) for edge in (area.edge_u, area.edge_v)]
    front = np.append(np.cross(area.edge_u, area.edge_v) / area.area, 0)
    place = np.stack([*half, front, np.append(area.centre, 1)], axis=1)
    lamp = {
        "type": "rectangle", "to_world": mitsuba.ScalarTransform4f(place),
        "emitter": {"type": "area", "radiance": area.radiance},
    }  # fmt: skip
    material = {"type": "gonio", "model": "oren_nayar"}
    view = (40 * DEG, 90 * DEG)
    flat = mitsuba.ScalarTransform4f().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(50)
    content = {
        "ball": {"type": "sphere", "bsdf": material},
        "floor": {"type": "rectangle", "to_world": flat, "bsdf": material},
        "lamp": lamp,
    }
    theirs = traced(mitsuba, content, 2.0, unit_vectors(*view), samples=36)
    made = scene("sphere", floor=True)
    made = Scene("spot", "", made.shapes, (4.0, 4.0))
    ours = render(made, area, "oren_nayar", SURFACES["oren_nayar"], camera=Camera(*view),
                  size=(SIZE, SIZE), samples=36)  # fmt: skip
    parts = [image.reshape(4, 8, 4, 8).mean(axis=(1, 3)) for image in (ours, theirs)]
    # 2304 rays a part; the shadow's share of the light is small and noisy.
    np.testing.assert_allclose(parts[0], parts[1], rtol=0.02, atol=0.002)
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.003)
