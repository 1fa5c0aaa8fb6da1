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
# # Ward 1992: latex paint, brushed, rolled and sprayed
#
# Two tables of nine surfaces each: semi-gloss and gloss latex, on metal, sheetrock and wood. The
# paper gives rho_d "around 0.45" and rho_s "around 0.048" (semi-gloss) and 0.059 (gloss) for all
# of them; the two alphas depend on how the paint was put on and on what. Measured here as the
# other materials are ([the table of ten](ward_table.py)), on `lbl1992` and `modern12`.

# %%
from itertools import product

from _common import Notebook
from _recovery import HEAD, family, lines, record, recover

nb = Notebook("ward_latex", paper="Ward 1992")
GLOSSES = ("semigloss", "gloss")
WAYS, BASES = ("brushed", "rolled", "sprayed"), ("metal", "sheetrock", "wood")
INSTRUMENTS = ("lbl1992", "modern12")
angles = nb.choose(quick=(25.0, 50.0), full=None)
surfaces = list(product(BASES, WAYS))
found = {gloss: [] for gloss in GLOSSES}
with nb.scratch() as folder:
    for gloss, (base, way) in product(GLOSSES, nb.choose(quick=surfaces[-1:], full=surfaces)):
        for instrument in INSTRUMENTS:
            found[gloss] += recover(
                f"latex_{gloss}_{way}_{base}",
                instrument,
                folder,
                theta_i_deg=angles,
                posterior=not nb.quick or instrument == "lbl1992",
            )

# %% [markdown]
# ## Semi-gloss
#
# rho_s is a tenth of rho_d, and the lobe of the widest of these (wood, alpha_y 0.26) stands little
# above the floor. Its uncertainty is no larger for that: what all samples share, the standard
# first, is most of it, and the same for all.

# %% tags=["hide-input"]
nb.figure(
    family(found["semigloss"], "Latex, semi-gloss"),
    "semigloss",
    "Errors and 95 % intervals of semi-gloss latex.",
)

# %% [markdown]
# ## Gloss
#
# A little more in the lobe. On metal the paint flows out smoothest, and sprayed it is about as
# smooth as brushed.

# %% tags=["hide-input"]
nb.figure(
    family(found["gloss"], "Latex, gloss"), "gloss", "Errors and 95 % intervals of gloss latex."
)

# %% [markdown]
# ## The tables
#
# Each surface on each instrument is one row; the lines below it hold the parameters one by one.

# %%
for gloss in GLOSSES:
    record(nb, found[gloss], f"latex table, {gloss}")
nb.table("surfaces", HEAD, lines(found["semigloss"] + found["gloss"]))

# %% [markdown]
# Wood lets the brush show: the slopes across the brush strokes are wider than along them, and the
# fits say so. The paper adds that "flat" latex is very nearly diffuse up to 60°, of which it gives
# no numbers.

# %%
pair = {
    (one.instrument, one.parameter): one.value
    for one in found["gloss"] + found["semigloss"]
    if one.material.endswith("wood")
}
wider = [pair[name, "alpha_y"] / pair[name, "alpha_x"] for name in INSTRUMENTS]
nb.record(
    "latex tables: on wood alpha_y is larger than alpha_x, ratio on lbl1992 and modern12",
    "> 1",
    ", ".join(f"{ratio:.2f}" for ratio in wider),
    min(wider) > 1,
)
nb.absent("section 6: flat latex is very nearly diffuse up to 60 deg", "no data were published")
nb.done()
