"""The scenes that can be drawn, and the camera that looks at them.

Frame: x to the right, y up, z along the axis of the scene, towards a viewer in front. Directions
are given about that axis as everywhere in gonio: theta from z, phi counter-clockwise from x as the
viewer sees it, so that (20 deg, 0) is to the right of the viewer and (20 deg, 90 deg) above.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gonio.errors import ConfigurationError, unknown_name
from gonio.geometry import FloatArray, unit_vectors
from gonio.rendering.shapes import UPRIGHT, Box, Piece, Plate, Revolution, Shape

Projection = Literal["orthographic", "perspective"]
FOV = math.radians(30.0)


@dataclass(frozen=True)
class Scene:
    """Shapes of one material, with a default view and a default light.

    Parameters
    ----------
    name, title : str
    shapes : sequence of Shape
    extent : tuple of float
        Width and height that a picture shows, in the unit of the scene.
    centre : tuple of float
        Point at which the camera looks.
    view : tuple of float
        theta_r, phi_r of the camera, radians.
    light : tuple of float
        theta_i, phi_i of the light, radians.
    """

    name: str
    title: str
    shapes: Sequence[Shape]
    extent: tuple[float, float]
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    view: tuple[float, float] = (0.0, 0.0)
    light: tuple[float, float] = (0.0, 0.0)
    projection: Projection = "orthographic"


@dataclass(frozen=True)
class Camera:
    """Turns positions in a picture into rays.

    Parameters
    ----------
    theta_r, phi_r : float
        Direction towards the camera about the axis of the scene, radians.
    projection : {"orthographic", "perspective"}
        Parallel rays, or rays from one point at the distance at which `fov` shows the width of
        the scene.
    fov : float
        Angle that the width of the picture takes up in perspective, radians.
    """

    theta_r: float = 0.0
    phi_r: float = 0.0
    projection: Projection = "orthographic"
    fov: float = FOV

    def __post_init__(self) -> None:
        if self.projection not in ("orthographic", "perspective"):
            raise unknown_name("projection", self.projection, ("orthographic", "perspective"))
        if not 0 < self.fov < math.pi:
            raise ConfigurationError(
                f"fov = {math.degrees(self.fov):g} deg; the picture's width takes up more than 0 "
                "and less than 180 deg.",
                value=self.fov,
            )

    def rays(self, scene: Scene, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Origins and directions (n, 3) of rays through positions in the picture.

        Parameters
        ----------
        x, y : ndarray, shape (n,)
            Right and up from the middle, in the unit of the scene.
        """
        back = unit_vectors(self.theta_r, self.phi_r)
        up = np.array([0.0, 1.0, 0.0])
        if abs(back[1]) > 1 - 1e-9:  # seen from straight above the front is at the bottom
            up = np.array([0.0, 0.0, -math.copysign(1.0, back[1])])
        right = np.cross(up, back)
        right /= np.linalg.norm(right)
        on_plane = scene.centre + np.outer(x, right) + np.outer(y, np.cross(back, right))
        far = 10 * max(scene.extent)
        if self.projection == "orthographic":
            return on_plane + far * back, np.broadcast_to(-back, on_plane.shape)
        eye = scene.centre + back * (scene.extent[0] / 2 / math.tan(self.fov / 2))
        along = on_plane - eye
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        return np.broadcast_to(eye, on_plane.shape), along


def _sphere() -> Scene:
    ball = Revolution(pieces=(Piece(-1, 1, 1.0, c=-1.0),), axes=UPRIGHT)
    above_left = math.radians(30), math.radians(120)
    return Scene("sphere", "a sphere of radius 1", (ball,), (2.2, 2.2), light=above_left)


def vase_pieces() -> tuple[Piece, ...]:
    """Foot, cylinder, shoulder, neck and lip of a vase whose cylinder has the radius 1.

    Neighbouring pieces meet in one circle.
    """
    shoulder = (1 - 0.55**2) / 0.5**2  # from radius 1 to 0.55 over a height of 0.5
    return (
        Piece(-1.55, -1.3, *_square(0.85, 1.0, -1.55, -1.3)),
        Piece(-1.3, 0.7, 1.0),
        Piece(0.7, 1.2, 1 - shoulder * 0.7**2, 2 * 0.7 * shoulder, -shoulder),
        Piece(1.2, 1.45, 0.55**2),
        Piece(1.45, 1.6, *_square(0.55, 0.68, 1.45, 1.6)),
    )


def _square(r_low: float, r_high: float, low: float, high: float) -> tuple[float, float, float]:
    """a, b, c of a cone that has two radii at two heights: the square of a line."""
    slope = (r_high - r_low) / (high - low)
    at_0 = r_low - slope * low
    return at_0**2, 2 * at_0 * slope, slope**2


def _vase() -> Scene:
    vase = Revolution(pieces=vase_pieces(), open_top=True, axes=UPRIGHT)
    return Scene("vase", "an upright cylindrical vase of radius 1", (vase,), (2.5, 3.5))


def _plane() -> Scene:
    plate = Plate(half_x=1.0, half_y=1.0)
    oblique = math.radians(40)
    return Scene(
        "plane", "a flat square of edge 2, its normal along the axis", (plate,), (2.4, 2.0),
        view=(oblique, -math.pi / 2), light=(oblique, math.pi / 2), projection="perspective",
    )  # fmt: skip


def _objects() -> Scene:
    block = Revolution(
        pieces=(Piece(-0.9, 0.9, 0.8**2),), centre=np.array([0.0, -0.7, 0.8]), axes=UPRIGHT
    )
    vase = Revolution(
        pieces=vase_pieces(), open_top=True, centre=np.array([-2.3, -0.05, 0.0]), axes=UPRIGHT
    )
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    turned = np.array([[c, s, 0.0], [0.0, 0.0, 1.0], [s, -c, 0.0]])  # local z is up
    cube = Box(half=np.full(3, 0.85), centre=np.array([2.2, -0.75, 0.0]), axes=turned)
    above = math.radians(25)
    return Scene(
        "objects", "a vase, a cylindrical block and a cube, after Oren and Nayar's Fig. 15",
        (vase, block, cube), (7.4, 4.4), centre=(-0.05, -0.1, 0.0),
        view=(above, math.pi / 2), light=(above, math.pi / 2),
    )  # fmt: skip


_SCENES: dict[str, Callable[[], Scene]] = {
    "sphere": _sphere,
    "vase": _vase,
    "plane": _plane,
    "objects": _objects,
}
SCENES = tuple(_SCENES)


def scene(name: str, *, floor: bool = False) -> Scene:
    """A scene by its name.

    Parameters
    ----------
    name : {"sphere", "vase", "plane", "objects"}
    floor : bool
        Put a floor of the same material under sphere, vase and objects, so that shadows fall.

    Raises
    ------
    ConfigurationError
        For another name, or a floor under the plane.

    Examples
    --------
    >>> len(scene("objects").shapes)
    3
    """
    if name not in _SCENES:
        raise unknown_name("scene", name, SCENES)
    chosen = _SCENES[name]()
    if not floor:
        return chosen
    if name == "plane":
        raise ConfigurationError("the scene plane has no floor; choose sphere, vase or objects.")
    height = {"sphere": -1.0, "vase": -1.55, "objects": -1.6}[name]
    under = Plate(centre=np.array([0.0, height, 0.0]), axes=UPRIGHT)
    return Scene(**{**chosen.__dict__, "shapes": (*chosen.shapes, under)})
