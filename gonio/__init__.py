"""gonio: a virtual imaging gonioreflectometer and a BRDF fitting toolkit."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from gonio._version import __version__

if TYPE_CHECKING:
    from gonio.calibration.reduction.reduce import reduce
    from gonio.fitting.fit import fit
    from gonio.planning.plan_search import design
    from gonio.simulation import simulate

__all__ = ["__version__", "design", "fit", "reduce", "simulate"]

# The verbs load their machinery at first use, so that `import gonio` stays light.
_VERBS = {
    "simulate": "gonio.simulation",
    "reduce": "gonio.calibration.reduction.reduce",
    "fit": "gonio.fitting.fit",
    "design": "gonio.planning.plan_search",
}


def __getattr__(name: str) -> Any:
    if name in _VERBS:
        return getattr(importlib.import_module(_VERBS[name]), name)
    raise AttributeError(f"module 'gonio' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *_VERBS])
