"""gonio: a virtual imaging gonioreflectometer and a BRDF fitting toolkit.

Every command of the command line is a verb of this package: ``gonio.simulate``, ``gonio.reduce``,
``gonio.fit``. Verbs and rooms load at first use, so that ``import gonio`` stays light.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from gonio._version import __version__
from gonio.verbs import ROOMS, TYPES, VERBS

if TYPE_CHECKING:
    import gonio.board as board
    import gonio.calibration as calibration
    import gonio.checks as checks
    import gonio.data as data
    import gonio.dome_map as dome_map
    import gonio.errors as errors
    import gonio.files as files
    import gonio.fitting as fitting
    import gonio.formats as formats
    import gonio.geometry as geometry
    import gonio.instrument as instrument
    import gonio.materials as materials
    import gonio.metadata as metadata
    import gonio.models as models
    import gonio.planning as planning
    import gonio.plotting as plotting
    import gonio.reading as reading
    import gonio.recovery as recovery
    import gonio.rendering as rendering
    import gonio.reporting as reporting
    import gonio.rig as rig
    import gonio.samples as samples
    import gonio.session as session
    import gonio.simulation as simulation
    from gonio.calibration.budget import budget
    from gonio.calibration.dome.from_mirror import calibrate_alignment
    from gonio.calibration.lens.from_photos import calibrate_lens
    from gonio.calibration.reduction.reduce import reduce
    from gonio.fitting.comparison.compare import compare
    from gonio.fitting.dome_field.calibrate_dome import calibrate_dome
    from gonio.fitting.fit import fit
    from gonio.fitting.result import FitResult
    from gonio.geometry import Directions
    from gonio.models import Model
    from gonio.planning.plan_search import design
    from gonio.reading import load
    from gonio.rendering.integrate import render
    from gonio.rig.importing import import_rig
    from gonio.samples import BRDFSamples
    from gonio.simulation import simulate
    from gonio.verbs.boards import boards
    from gonio.verbs.calibrate_camera import calibrate_camera
    from gonio.verbs.check import check
    from gonio.verbs.doctor import doctor
    from gonio.verbs.evaluate import evaluate
    from gonio.verbs.flats import flats
    from gonio.verbs.plot import plot
    from gonio.verbs.report import report

__all__ = [
    "BRDFSamples",
    "Directions",
    "FitResult",
    "Model",
    "__version__",
    "board",
    "boards",
    "budget",
    "calibrate_alignment",
    "calibrate_camera",
    "calibrate_dome",
    "calibrate_lens",
    "calibration",
    "check",
    "checks",
    "compare",
    "data",
    "design",
    "doctor",
    "dome_map",
    "errors",
    "evaluate",
    "files",
    "fit",
    "fitting",
    "flats",
    "formats",
    "geometry",
    "import_rig",
    "instrument",
    "load",
    "materials",
    "metadata",
    "models",
    "planning",
    "plot",
    "plotting",
    "reading",
    "recovery",
    "reduce",
    "render",
    "rendering",
    "report",
    "reporting",
    "rig",
    "samples",
    "session",
    "simulate",
    "simulation",
]


def __getattr__(name: str) -> Any:
    if name in VERBS:
        return getattr(importlib.import_module(VERBS[name]), name)
    if name in TYPES:
        return getattr(importlib.import_module(TYPES[name]), name)
    if name in ROOMS:
        return importlib.import_module(f"gonio.{name}")
    raise AttributeError(f"module 'gonio' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__} - {"TYPE_CHECKING", "Any", "annotations", "importlib"})
