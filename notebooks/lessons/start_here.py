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
# # Start here
#
# Ten minutes with gonio: simulate a measurement, reduce it, fit a model, plot the result,
# then the same with a model and with data of your own. Every cell runs in seconds; run them
# from top to bottom.
#
# Angles in Python are radians. A BRDF is in sr⁻¹ and does not include the cosine.

# %%
import tempfile
from math import radians
from pathlib import Path

import numpy as np

import gonio
from gonio import formats, models, plotting
from gonio.geometry import Directions
from gonio.instrument import preset
from gonio.metadata import Plan

folder = Path(tempfile.mkdtemp(prefix="start_here_"))

# %% [markdown]
# ## 1. A model
#
# A model is a function of directions. Here is Ward's model for a brushed metal: a diffuse part, a
# specular lobe, and two slopes, one along the grooves and one across them.

# %%
ward = models.get("ward")
mirror = Directions(theta_i=radians(30), phi_i=0.0, theta_r=radians(30), phi_r=np.pi)
print([p.name for p in ward.parameters])
print("f in the mirror direction:", ward(mirror, rho_d=0.1, rho_s=0.2, alpha_x=0.1, alpha_y=0.2))

# %% [markdown]
# ## 2. Simulate
#
# `gonio.simulate` records the raw frames that an imaging gonioreflectometer would record of
# that surface. The instrument is `modern12`, with fewer pixels and three angles of incidence,
# so that it is quick.

# %%
truth = {"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.1, "alpha_y": 0.2}
session = gonio.simulate(
    model="ward",
    parameters=truth,
    instrument=preset("modern12").with_pixels(104),
    plan=Plan(theta_i_deg=(10.0, 30.0, 50.0), rotations_deg=(0.0, 90.0), exposures_s=(1e-3, 32e-3)),
    output=folder / "brushed.gonio",
    seed=1,
)
print(session.metadata.plan.n_frames, "frames")

# %% [markdown]
# ## 3. Reduce
#
# `gonio.reduce` turns the frames into BRDF samples: directions, a value, and what is known of its
# uncertainty. It reads what the operator of a rig would know; it never sees the true parameters.

# %%
samples = gonio.reduce(session)
print(len(samples), "samples; the largest is", f"{samples.value.max():.3g} sr^-1")

# %% [markdown]
# ## 4. Fit
#
# `gonio.fit` finds the parameters. The standard uncertainties hold noise and the errors that the
# samples share, such as that of the white standard.

# %%
result = gonio.fit(samples, model="ward")
for name, estimate in result.parameters.items():
    print(f"{name:8} {estimate.value:.4f} ± {estimate.stderr:.4f}   true {truth[name]}")

# %% [markdown]
# What a fit returns goes back into the model, in radians where it is an angle.

# %%
print(f"{ward(mirror, **result.values()):.3f} sr^-1 in the mirror direction")

# %% [markdown]
# ## 5. Plot
#
# Points are measured, lines are the fitted model, one colour for each angle of incidence.

# %%
ax = plotting.slices(samples, result)

# %% [markdown]
# The residuals in per cent of f. A pattern here would say that the model is wrong.

# %%
axes = plotting.residual_map(samples, result)

# %% [markdown]
# ## 6. Another model
#
# Does an isotropic lobe describe the same samples? Its single slope cannot follow the
# grooves: chi-squared per degree of freedom tells the two apart.

# %%
round_lobe = gonio.fit(samples, model="ward_isotropic")
for one in (result, round_lobe):
    print(f"{one.model:15} chi2/dof {one.chi2 / one.dof:8.3g}")

# %% [markdown]
# ## 7. Your own data
#
# A CSV with angles in degrees, the BRDF in sr⁻¹ and `u_brdf`, its standard uncertainty. Here
# are seven readings of a matt white surface, each good to one per cent.

# %%
own = folder / "own.csv"
own.write_text(
    """theta_i,phi_i,theta_r,phi_r,brdf,u_brdf
30,0,0,0,0.2561,0.0026
30,0,20,180,0.2497,0.0025
30,0,40,180,0.2471,0.0025
30,0,60,180,0.2452,0.0025
30,0,20,0,0.2622,0.0026
30,0,40,0,0.2745,0.0027
30,0,60,0,0.2831,0.0028
""",
    encoding="utf-8",
)
readings = formats.read(own)
matt = gonio.fit(readings, model="oren_nayar")
for name, estimate in matt.parameters.items():
    print(f"{name:6} {estimate.value:.3f} ± {estimate.stderr:.3f} {estimate.unit}")

# %% [markdown]
# It reflects more light back to the lamp than forward: the mark of a rough surface, which
# Oren and Nayar's sigma measures.

# %%
ax = plotting.slices(readings, matt)

# %% [markdown]
# ## 8. A model of your own
#
# A plain function of numpy arrays is a model: directions and parameters in, sr⁻¹ out. Here is
# Minnaert's, with a range for each parameter. It fits and plots as the others do.


# %%
def own_minnaert(directions, rho, k):
    cosines = np.cos(directions.theta_i) * np.cos(directions.theta_r)
    return rho / np.pi * cosines ** (k - 1)


own_model = models.Model.from_function(own_minnaert, {"rho": (0.5, 0, 1), "k": (1.0, 0.2, 2.0)})
mine = gonio.fit(readings, model=own_model)
for name, estimate in mine.parameters.items():
    print(f"{name:6} {estimate.value:.3f} ± {estimate.stderr:.3f}")

# %% [markdown]
# It cannot tell light that goes back to the lamp from light that goes forward, and
# chi-squared says so.

# %%
for one in (matt, mine):
    print(f"{one.model:15} chi2/dof {one.chi2 / one.dof:.3g}")

# %% [markdown]
# ## Where to go on
#
# - [How a small lobe is sampled](../ward_sampling.py) and [Ward's table](../ward_table.py) compute
#   a paper.
# - [Errata](../../docs/errata.md) list what is printed wrong.
# - The command line does the same: `gonio simulate`, `gonio reduce`, `gonio fit`, `gonio plot`.
