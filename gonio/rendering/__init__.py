"""Pictures of simple scenes made of one material, and the papers' figures that are pictures.

Light goes from a lamp to a surface to the camera; more than that only where `bounces` asks for it.

- `render`: sphere, vase, plane or three objects by a distant lamp, a rectangle, an environment;
- `scene`, `Camera`; `Directional`, `Rectangle`, `Environment`, `sky`; `save_picture`, `read_map`;
- `cross_section`: brightness across a cylindrical vase (Oren & Nayar 1994, Fig. 13);
- `plate`, `plate_reference`: an anisotropic plate three ways (Ward 1992, eq. (6), Fig. 7);
- `prefilter`, `prefilter_error`: environment maps filtered in advance (Losasso).
"""

from gonio.rendering.integrate import render
from gonio.rendering.lights import SKIES, WHITE, Directional, Environment, Light, Rectangle, sky
from gonio.rendering.pictures import lift_of, read_map, save_picture, srgb, white_of
from gonio.rendering.plate import METHODS, PlatePicture, Room, plate, plate_reference
from gonio.rendering.prefilter import Prefiltered, PrefilterError, prefilter, prefilter_error
from gonio.rendering.scene import SCENES, Camera, Scene, scene
from gonio.rendering.vase import cross_section

__all__ = [
    "METHODS",
    "SCENES",
    "SKIES",
    "WHITE",
    "Camera",
    "Directional",
    "Environment",
    "Light",
    "PlatePicture",
    "PrefilterError",
    "Prefiltered",
    "Rectangle",
    "Room",
    "Scene",
    "cross_section",
    "lift_of",
    "plate",
    "plate_reference",
    "prefilter",
    "prefilter_error",
    "read_map",
    "render",
    "save_picture",
    "scene",
    "sky",
    "srgb",
    "white_of",
]
