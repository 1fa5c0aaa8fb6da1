"""The names in `gonio`: its verbs, packages and types, and the command of each verb.

Some verbs are defined in other packages; the others have a file each in this folder. The root
package, the tests and the manual's table of commands read the names here.
"""

from __future__ import annotations

# Verb and the module that holds the function of this name, in the order of the work.
VERBS = {
    "design": "gonio.planning.plan_search",
    "simulate": "gonio.simulation",
    "import_rig": "gonio.rig.importing",
    "load": "gonio.reading",
    "reduce": "gonio.calibration.reduction.reduce",
    "fit": "gonio.fitting.fit",
    "compare": "gonio.fitting.comparison.compare",
    "plot": "gonio.verbs.plot",
    "report": "gonio.verbs.report",
    "render": "gonio.rendering.integrate",
    "evaluate": "gonio.verbs.evaluate",
    "budget": "gonio.calibration.budget",
    "check": "gonio.verbs.check",
    "calibrate_lens": "gonio.calibration.lens.from_photos",
    "calibrate_camera": "gonio.verbs.calibrate_camera",
    "calibrate_alignment": "gonio.calibration.dome.from_mirror",
    "calibrate_dome": "gonio.fitting.dome_field.calibrate_dome",
    "boards": "gonio.verbs.boards",
    "flats": "gonio.verbs.flats",
    "doctor": "gonio.verbs.doctor",
}

# Modules and packages below the root that resolve after `import gonio` alone.
ROOMS = (
    "board",
    "calibration",
    "checks",
    "data",
    "dome_map",
    "errors",
    "files",
    "fitting",
    "formats",
    "geometry",
    "instrument",
    "materials",
    "metadata",
    "models",
    "planning",
    "plotting",
    "reading",
    "recovery",
    "rendering",
    "reporting",
    "rig",
    "samples",
    "session",
    "simulation",
)

# Types that people make or receive, and the module of each.
TYPES = {
    "BRDFSamples": "gonio.samples",
    "Directions": "gonio.geometry",
    "FitResult": "gonio.fitting.result",
    "Model": "gonio.models",
}

# Commands with another name in Python: `import` is a keyword, a subcommand is one name, and a list
# is a package.
PYTHON_NAMES = {
    "import": "import_rig",
    "calibrate lens": "calibrate_lens",
    "calibrate camera": "calibrate_camera",
    "calibrate alignment": "calibrate_alignment",
    "calibrate dome": "calibrate_dome",
    "instruments": "instrument",
}


def python_name(command: str) -> str:
    """The name in `gonio` of what a command does.

    Parameters
    ----------
    command : str
        The words after ``gonio`` on the command line.

    Examples
    --------
    >>> python_name("fit"), python_name("calibrate lens")
    ('fit', 'calibrate_lens')
    """
    return PYTHON_NAMES.get(command, command)
