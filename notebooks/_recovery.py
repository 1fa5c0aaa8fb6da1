"""Simulate, reduce and fit the papers' materials, for the notebooks that reproduce their tables."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from _common import Notebook
from matplotlib.figure import Figure

import gonio
from gonio.instrument import preset
from gonio.instrument.plans import default_plan, is_anisotropic
from gonio.materials import get as get_material
from gonio.materials import names
from gonio.metadata import Plan
from gonio.models import get as get_model
from gonio.plotting import style
from gonio.plotting.style import COLOURS, symbol

# What may be left at most: the lobe's bias (eq. (3) on a sphere, slope errors of the dome, blur) as
# docs/accuracy.md finds it, and for what scales with the standard three of its uncertainties.
LOBE_BIAS = {"ideal12": 0.001, "modern12": 0.015, "lbl1992": 0.04}

HEAD = ("material", "instrument", "parameter", "printed", "recovered", "95 %", "bias, %")


@dataclass(frozen=True)
class Recovered:
    """One parameter of one material on one instrument, in the units of files.

    Parameters
    ----------
    material, instrument, parameter : str
    printed, value, stderr : float
    interval : tuple of float
        95 %, of the posterior where there is one.
    allowed : float
        Largest relative error that the instrument's accuracy allows.
    """

    material: str
    instrument: str
    parameter: str
    printed: float
    value: float
    stderr: float
    interval: tuple[float, float]
    allowed: float

    @property
    def error(self) -> float:
        """Error relative to the printed value."""
        return self.value / self.printed - 1

    @property
    def inside(self) -> bool:
        """Whether the interval covers the printed value."""
        return self.interval[0] <= self.printed <= self.interval[1]


def recover(
    material: str,
    instrument: str,
    folder: Path,
    *,
    theta_i_deg: Sequence[float] | None = None,
    posterior: bool = True,
) -> list[Recovered]:
    """Raw frames of a material, reduced by eqs. (2) and (3), fitted with its model and a posterior.

    Parameters
    ----------
    material, instrument : str
    folder : Path
        For the frames, which are removed.
    theta_i_deg : sequence of float, optional
        Incidence angles, degrees; 21 of them and all rotations where not given.
    posterior : bool
        Intervals from the posterior, else from the standard uncertainties.
    """
    virtual, printed = preset(instrument), get_material(material)
    model = get_model(printed.model)
    plan = default_plan(virtual, anisotropic=is_anisotropic(model, printed.parameters))
    if theta_i_deg is not None:
        few = {"theta_i_deg": tuple(theta_i_deg), "rotations_deg": plan.rotations_deg[::2]}
        plan = Plan.model_validate(plan.model_dump() | few)
    path = folder / f"{material}_{instrument}"
    # The seeds of docs/recovery: each material has its own.
    seed = 1 + names().index(material)
    gonio.simulate(material, output=path, instrument=instrument, plan=plan, seed=seed)
    fit = gonio.fit(gonio.reduce(path), model=model, posterior=posterior, seed=seed)
    shutil.rmtree(path)
    recovered = []
    for name, fitted in fit.parameters.items():
        estimate = fitted.in_file_units()
        parameter = model.parameter(name)
        scale = 3 * virtual.standard.uncertainty if parameter.linear else 0.0
        recovered.append(
            Recovered(
                material,
                instrument,
                name,
                float(f"{parameter.to_file(printed.parameters[name]):.12g}"),
                estimate.value,
                np.nan if estimate.stderr is None else estimate.stderr,
                estimate.interval_95 or (np.nan, np.nan),
                LOBE_BIAS[instrument] + scale,
            )
        )
    return recovered


def record(nb: Notebook, recovered: Sequence[Recovered], where: str) -> None:
    """A row for each material and instrument, and two for each instrument's intervals."""
    for group in by_session(recovered):
        worst = max(group, key=lambda one: abs(one.error))
        allowed = sorted({f"{100 * one.allowed:.2g}" for one in group}, key=float)
        nb.record(
            f"{where}: {title(group[0].material)} on {group[0].instrument}, "
            + ", ".join(one.parameter for one in group),
            ", ".join(f"{one.printed:g}" for one in group),
            ", ".join(f"{one.value:.4g}" for one in group),
            all(abs(one.error) < one.allowed for one in group),
            f"worst {worst.parameter} {100 * worst.error:+.2f} %, "
            f"allowed {' and '.join(allowed)} %",
        )
    for instrument in dict.fromkeys(one.instrument for one in recovered):
        of_instrument = [one for one in recovered if one.instrument == instrument]
        inside = sum(one.inside for one in of_instrument)
        # Parameters of one material share the standard's error and miss together: three standard
        # deviations of a binomial of a third as many are left room.
        least = 0.95 * len(of_instrument) - 3 * (3 * 0.05 * 0.95 * len(of_instrument)) ** 0.5
        nb.record(
            f"{where}: parameters within their 95 % interval, {instrument}",
            "95 %",
            f"{inside} of {len(of_instrument)}",
            inside >= least,
            f"an honest interval holds 95 %; {least:.0f} leaves room for chance",
        )


def lines(recovered: Sequence[Recovered]) -> list[list[str]]:
    """Printed, recovered, interval and bias, a line a parameter, under HEAD."""
    return [
        [
            title(one.material),
            one.instrument,
            one.parameter,
            f"{one.printed:g}",
            f"{one.value:.4g}",
            f"{one.interval[0]:.4g} to {one.interval[1]:.4g}",
            f"{100 * one.error:+.2f}",
        ]
        for one in recovered
    ]


def by_session(recovered: Sequence[Recovered]) -> Iterator[list[Recovered]]:
    """The parameters of each material on each instrument together."""
    for key in dict.fromkeys((one.material, one.instrument) for one in recovered):
        yield [one for one in recovered if (one.material, one.instrument) == key]


def title(material: str) -> str:
    """A material's name for people: "rolled brass"."""
    return material.replace("_", " ")


def family(recovered: Sequence[Recovered], heading: str) -> Figure:
    """Relative errors with their 95 % intervals, a panel a parameter, a line a material."""
    parameters = list(dict.fromkeys(one.parameter for one in recovered))
    materials = list(dict.fromkeys(one.material for one in recovered))
    instruments = list(dict.fromkeys(one.instrument for one in recovered))
    with style():
        fig, axes = plt.subplots(
            1,
            len(parameters),
            figsize=(9.4, 1.1 + 0.3 * len(materials)),
            sharey=True,
            layout="constrained",
        )
        for ax, name in zip(axes, parameters, strict=True):
            for k, instrument in enumerate(instruments):
                group = [o for o in recovered if (o.parameter, o.instrument) == (name, instrument)]
                y = [materials.index(one.material) + 0.3 * (k - 0.5) for one in group]
                low, high = (
                    [100 * (one.interval[side] / one.printed - 1) for one in group]
                    for side in (0, 1)
                )
                ax.hlines(y, low, high, color=COLOURS[k + 1], linewidth=1.4)
                ax.plot([100 * one.error for one in group], y, "os"[k], color=COLOURS[k + 1],
                        markersize=4, label=instrument)  # fmt: skip
            ax.axvline(0, color="#888888", linewidth=0.6)
            model = get_model(get_material(materials[0]).model)
            ax.set_title(symbol(model.parameter(name)))
            ax.set_xlabel("error (%)")
        axes[0].set_yticks(range(len(materials)), [title(m) for m in materials])
        axes[0].set_ylim(len(materials) - 0.4, -0.6)
        axes[-1].legend(loc="upper left", bbox_to_anchor=(1, 1))
        fig.suptitle(heading, fontsize=9)
    return fig
