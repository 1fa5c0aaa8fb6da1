"""A virtual instrument without a disk: expected images, and sessions drawn from them in memory."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from gonio import models
from gonio.instrument import Instrument, preset
from gonio.instrument.images import Fixed, Images, Surface
from gonio.instrument.noise import expose
from gonio.instrument.records import metadata
from gonio.metadata import Metadata, Plan
from gonio.session import Session

PATTERN, DOME = 11, 12  # seeds of the camera's fixed pattern and of the dome's fields


def small(name: str = "ideal12", n: int = 104, **parts) -> Instrument:
    """A preset with n x n pixels (2 x 2 binned) and a few changed values of its parts."""
    return preset(name).with_pixels(n).altered(**parts)


def images(
    rig: Instrument, plan: Plan, model: str = "lambert", standard_scale: float = 1.0, **parameters
) -> Images:
    """Expected images of a surface."""
    chosen = models.get(model)
    surface = Surface(model, chosen, (chosen.vector(parameters),))
    return Images(rig, surface, plan, Fixed(DOME, PATTERN, standard_scale))


class Drawn(Session):
    """A session in memory: frames drawn from expected images with noise of one seed.

    Parameters
    ----------
    scene : Images
    seed : int
        Of the noise alone.
    lamp : callable, optional
        Output of the lamp in image number k, in the plan's order; 1 where not given.
    known : Metadata, optional
        What the session says of itself; the instrument's data sheet where not given.
    """

    def __init__(
        self,
        scene: Images,
        seed: int = 0,
        lamp: Callable[[int], float] = lambda number: 1.0,
        known: Metadata | None = None,
    ) -> None:
        rig, plan = scene.instrument, scene.plan
        super().__init__(Path("drawn"), known or metadata(rig, plan, scene.surface.name, ""), {})
        dark = rig.sensor.dark_current(PATTERN)
        self.brackets = {}
        n = len(plan.exposures_s)
        for number, image in enumerate(plan.images()):
            (rate,) = scene.rates(*image, [lamp(number)])
            self.brackets[image] = np.stack(
                [
                    expose(rate + dark, t, seed=seed, frame=number * n + k, **rig.sensor.readout())
                    for k, t in enumerate(plan.exposures_s)
                ]
            )

    def require_complete(self) -> None:
        pass

    def bracket(self, role, take, incidence, *, channel=0):
        return self.brackets[role, take, incidence]


class Remembered:
    """Expected images that are computed once, for many draws; the lamp's output scales them."""

    def __init__(self, scene: Images) -> None:
        self.instrument, self.plan, self.surface = scene.instrument, scene.plan, scene.surface
        self._light = {image: scene.rates(*image, [1.0])[0] for image in scene.plan.images()}

    def rates(self, role, take, incidence, lamp):
        return [self._light[role, take, incidence] * lamp[0]]
