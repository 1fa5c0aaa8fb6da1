"""Pictures of models, frames, samples, fits and posteriors.

Each function draws one thing on the axes it is given, or on new ones, and returns them; `summary`
puts them together. No function changes matplotlib's settings outside itself.

- `frames`: raw frames, merged, with the reflected angles drawn over them;
- `slices`: the BRDF in the plane of incidence, measured and fitted (Ward 1992, Fig. 6);
- `model_lobe`, `model_lobes`: a model in its plane of incidence, as a polar diagram;
- `hemisphere_map`, `hemisphere_samples`: a model, or measured values, over all directions;
- `residual_map`: the residuals of a fit over all directions;
- `albedo_curve`: directional albedo of a model;
- `lobe_solid`: a model's lobe in space;
- `corner`: the posterior of a fit;
- `dome_map`: the slope errors of a dome and where they are known;
- `resolution_map`: blur and coverage of an instrument over the hemisphere;
- `summary`: all of these on one page, with the recovered parameters;
- `save`: a figure as PNG, PDF or SVG, written whole or not at all.
"""

from gonio.plotting.albedo import albedo_curve
from gonio.plotting.dome import dome_map
from gonio.plotting.frames import frames
from gonio.plotting.hemisphere import hemisphere_map, hemisphere_samples, residual_map
from gonio.plotting.lobe import slices
from gonio.plotting.model import model_lobe, model_lobes
from gonio.plotting.posterior import corner
from gonio.plotting.resolution import resolution_map
from gonio.plotting.solid import lobe_solid
from gonio.plotting.style import save, style
from gonio.plotting.summary import summary

__all__ = [
    "albedo_curve",
    "corner",
    "dome_map",
    "frames",
    "hemisphere_map",
    "hemisphere_samples",
    "lobe_solid",
    "model_lobe",
    "model_lobes",
    "residual_map",
    "resolution_map",
    "save",
    "slices",
    "style",
    "summary",
]
