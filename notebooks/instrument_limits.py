# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # What the instrument resolves, and where its uncertainty comes from
#
# Section 3.3 of the paper names two limits: grazing angles, "due to the size and shape of our
# reflecting hemisphere and the size of our sample", and polished surfaces, because of the dome's
# optics and "the finite collimation of our light source". Both can be traced by rays, for
# `lbl1992` and for a modern instrument; and what limits everything in between is a table, the
# uncertainty budget.

# %%
import matplotlib.pyplot as plt
from _common import Notebook

import gonio
from gonio.calibration.budget import budget
from gonio.instrument import preset
from gonio.instrument.plans import default_plan
from gonio.instrument.resolution import report, resolve
from gonio.metadata import Plan
from gonio.plotting import resolution_map, style

nb = Notebook("instrument_limits", paper="Ward 1992")
INSTRUMENTS = ("lbl1992", "modern12")
step = nb.choose(quick=2.0, full=0.5)
resolutions = {name: resolve(preset(name), step_deg=step) for name in INSTRUMENTS}
reports = {name: report(one) for name, one in resolutions.items()}

# %% [markdown]
# ## Smooth surfaces: the smallest alpha
#
# A blur of standard deviation s on each axis widens a lobe to alpha^2 + s^2/2. An alpha is called
# resolved here if the blur widens it by less than 5 %. The lobe is half as wide as it looks,
# because directions turn twice as far as facets.

# %%
rows = []
for name in INSTRUMENTS:
    blur, alpha = reports[name]["blur_deg"], reports[name]["alpha"][0]["in_plane"]["alpha"]
    rows.append([
        name,
        *(f"{blur[part]['median_major']:.2f}" for part in ("pixel", "pupil", "source", "total")),
        f"{alpha:.3f}",
        f"{reports[name]['theta_r']['rim_mask_deg']:g}",
    ])  # fmt: skip
nb.table(
    "resolution",
    ["instrument", "pixel, deg", "pupil", "source", "all", "smallest alpha", "rim, deg"],
    rows,
)
smallest = {name: reports[name]["alpha"][0]["in_plane"]["alpha"] for name in INSTRUMENTS}
nb.record(
    "section 3.3: polished surfaces are out of reach, smallest alpha that lbl1992 resolves",
    "sharp peaks not measurable",
    smallest["lbl1992"],
    smallest["lbl1992"] > 0.01,
    f"modern12: {smallest['modern12']:.3f}; a polished metal has below 0.01",
)
nb.record(
    "section 6: the narrowest of the 28 surfaces, alpha 0.037, is resolved by lbl1992",
    0.037,
    smallest["lbl1992"],
    smallest["lbl1992"] < 0.037,
    "smallest alpha at normal incidence",
)
parts = reports["lbl1992"]["blur_deg"]
nb.record(
    "section 3.3: 'the finite collimation of our light source', its part of the blur's variance",
    "a limit",
    parts["source"]["median_major"] ** 2 / parts["total"]["median_major"] ** 2,
    parts["source"]["median_major"] > 0.3 * parts["total"]["median_major"],
    "half-angle 1 deg is assumed; the pixels of 2.25 deg are the rest",
)
pupil = parts["pupil"]["median_major"]
nb.record(
    "section 3.1: focused at half the radius, 'a near perfect imaging of the reflected angles', "
    "blur by pupil and dome, deg",
    "near perfect",
    pupil,
    pupil < 0.1,
    "against 0.65 deg by the pixel",
)
at_dome = preset("lbl1992")
at_dome = at_dome.model_copy(update={"lens": at_dome.lens.model_copy(update={"focus": "R"})})
focused_on_dome = report(resolve(at_dome, step_deg=2.0))["blur_deg"]["pupil"]["median_major"]
nb.record(
    "section 3.1: the same focused on the dome, deg",
    "worse",
    focused_on_dome,
    focused_on_dome > 3 * pupil,
    "parallel rays meet at R/2, not at R",
)

# %% tags=["hide-input"]
fig = resolution_map(resolutions["lbl1992"])
nb.figure(fig, "map", "Blur and coverage of lbl1992 over the hemisphere of directions.")

# %% [markdown]
# ## Grazing angles
#
# A pixel that looks past the lit patch sees dark holder. How far all of a pixel's rays land on lit
# sample, in the worst azimuth, is the limit that a larger sample and a larger dome would move.

# %%
reach = {name: reports[name]["theta_r"]["whole"]["min_deg"] for name in INSTRUMENTS}
nb.record(
    "section 3.3: grazing angles are out of reach, theta_r in deg up to which lbl1992 sees lit "
    "sample alone",
    "limited",
    reach["lbl1992"],
    reach["lbl1992"] < 80,
    f"modern12: {reach['modern12']:.1f}",
)
wide = preset("lbl1992")
wide = wide.model_copy(update={"lamp": wide.lamp.model_copy(update={"lit_diameter_mm": 60.0})})
larger = report(resolve(wide, step_deg=step))["theta_r"]["whole"]["min_deg"]
nb.record(
    "section 3.3: 'a larger sample target' reaches further, lit diameter 60 in place of 25 mm, deg",
    "further",
    larger,
    larger > reach["lbl1992"] + 2,
)

# %% [markdown]
# ## How long it takes
#
# "A complete BRDF can be recorded in a few minutes, including time for manual rotation": the
# exposures themselves take seconds.

# %%
plan = default_plan(preset("lbl1992"), anisotropic=True)
frames = len(plan.theta_i_deg) * len(plan.rotations_deg)
seconds = frames * sum(plan.exposures_s)
nb.record(
    "section 3.1: a complete BRDF in a few minutes, exposures of 21 angles and 3 rotations, s",
    "minutes with manual rotation",
    seconds,
    seconds < 60,
    "what is left is the arm's motion and three turns by hand",
)

# %% [markdown]
# ## The uncertainty budget
#
# Every source with what it does to f, for rolled aluminum: the median over the samples, in per
# cent, and its share of the variance. Noise is small everywhere; with Ward's instrument the
# standard, the mapping and the lamp decide, and on the slopes of the lobe the dome's slope errors.

# %%
rows, combined, leading = [], {}, {}
angles = nb.choose(quick=(30.0,), full=(0.0, 15.0, 30.0, 45.0, 60.0))
with nb.scratch() as folder:
    for name in INSTRUMENTS:
        default = default_plan(preset(name), anisotropic=True)
        few = Plan.model_validate(
            default.model_dump() | {"theta_i_deg": angles, "rotations_deg": (0.0,)}
        )
        gonio.simulate("rolled_aluminum", output=folder / name, instrument=name, plan=few, seed=2)
        budget_report = budget(gonio.reduce(folder / name)).describe()
        for source in budget_report["sources"]:
            part = source["relative"]
            share = source["share_of_variance"]
            rows.append([
                name,
                source["name"],
                source["kind"],
                source["shared_by"],
                "in the fit" if part is None else f"{100 * part['median']:.3f}",
                "" if share is None else f"{100 * share:.0f}",
            ])  # fmt: skip
        combined[name] = 100 * budget_report["combined"]["median"]
        leading[name] = max(
            (s for s in budget_report["sources"] if s["share_of_variance"] is not None),
            key=lambda s: s["share_of_variance"],
        )["name"]
nb.table(
    "budget",
    ["instrument", "source", "type", "shared by", "u/f, median %", "share of variance, %"],
    rows,
)
nb.record(
    "section 3.2: 'absolute BRDF values directly', combined standard uncertainty of f, median, "
    "lbl1992 and modern12, %",
    "not said",
    f"{combined['lbl1992']:.1f}, {combined['modern12']:.1f}",
    combined["modern12"] < combined["lbl1992"] < 10,
    f"most of it from {leading['lbl1992']} and {leading['modern12']}",
)

# %% tags=["hide-input"]
with style():
    fig, axes = plt.subplots(1, 2, figsize=(9.4, 3.0), layout="constrained")
    for ax, name in zip(axes, INSTRUMENTS, strict=True):
        selected = [row for row in rows if row[0] == name and row[5]]
        ax.barh([row[1] for row in selected], [float(row[5]) for row in selected], color="#0072B2")
        ax.invert_yaxis()
        ax.set_xlabel("share of the variance (%)")
        ax.set_title(f"{name}: {combined[name]:.2f} % in all")
nb.figure(fig, "budget_bars", "Shares of the variance of f by source, on both instruments.")

# %%
nb.done()
