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
# # Ward 1992: rendering an anisotropic plate three ways (Fig. 7, eq. 6)
#
# A brushed plate lies under a lamp, beside a wall. What does each pixel of it reflect? Ward's Fig.
# 7 shows three answers: lamps in closed form only (7a), rays drawn from the lobe only (7b), and
# both (7c), where a drawn ray that meets the lamp is not counted, because the closed form has it.
# His scene was not published; this one has the same parts. There is no noise in the reference: it
# is summed over small parts of lamp and wall.

# %%
import matplotlib.pyplot as plt
import numpy as np
from _common import Notebook

from gonio import models
from gonio.geometry import unit_vectors
from gonio.plotting import style
from gonio.rendering import Room, plate, plate_reference

nb = Notebook("ward_rendering", paper="Ward 1992")
BRASS = {"rho_d": 0.1, "rho_s": 0.33, "alpha_x": 0.05, "alpha_y": 0.16}
size = nb.choose(quick=24, full=48)
rays = 16  # "even with 16 samples per pixel"
room = Room()
reference = plate_reference(
    "ward", BRASS, room=room, size=size, lamp_parts=12, wall_parts=nb.choose(quick=16, full=48)
)


def picture(method, seed=7, **how):
    """The plate by one method, 16 rays a pixel and the lamp in 2 by 2 parts."""
    return plate(
        method, "ward", BRASS, room=room, size=size, n=rays, lamp_parts=2, seed=seed, **how
    )


pictures = {m: picture(m) for m in ("deterministic", "monte_carlo", "hybrid", "double_counted")}
repeats = nb.choose(quick=12, full=64)


def mean_and_error(method, **how):
    """Mean over the plate of many pictures, and its standard error."""
    means = [picture(method, seed=100 + k, **how).radiance.mean() for k in range(repeats)]
    return float(np.mean(means)), float(np.std(means, ddof=1) / np.sqrt(repeats))


# %% tags=["hide-input"]
TITLES = {
    "deterministic": "7a: lamps alone",
    "monte_carlo": "7b: 16 drawn rays",
    "hybrid": "7c: both, eq. (6)",
    "double_counted": "lamp counted twice",
}
with style():
    fig, axes = plt.subplots(1, 5, figsize=(9.4, 2.3), layout="constrained")
    top = float(np.quantile(reference, 0.995))
    shown = {**{TITLES[m]: p.radiance for m, p in pictures.items()}, "reference": reference}
    for ax, (title, image) in zip(axes, shown.items(), strict=True):
        ax.imshow((np.clip(image, 0, None) / top) ** (1 / 2.2), cmap="gray", vmin=0, vmax=1)
        ax.set(title=title, xticks=[], yticks=[])
nb.figure(
    fig,
    "fig7",
    "The plate by Ward's three methods, with the lamp counted twice, and without noise.",
)

# %% [markdown]
# ## 7a: what the lamps alone leave out
#
# "A strictly deterministic calculation fails to pick up indirect semispecular contributions": the
# wall's image in the plate is missing.

# %%
missing = 1 - float(pictures["deterministic"].radiance.mean() / reference.mean())
nb.record(
    "Fig. 7a: fails to pick up the indirect semispecular part, share of the light that is missing",
    "> 0",
    missing,
    missing > 0.01,
    "the plate's mean, against the reference",
)

# %% [markdown]
# ## 7b: noise, and 7c: a clean result
#
# Drawn rays seldom meet a small lamp, and those that do carry all of it: "excessive noise, even
# with 16 samples per pixel". The closed form takes this part out; what is left to draw is the
# wall, which fills much of the lobe. Both are right in the mean.

# %%
noise = {
    m: float(np.sqrt(pictures[m].variance.mean()) / reference.mean())
    for m in ("monte_carlo", "hybrid")
}
ratio = (noise["monte_carlo"] / noise["hybrid"]) ** 2
nb.record(
    "Fig. 7b: excessive noise even with 16 samples a pixel, standard deviation over the mean",
    "excessive",
    noise["monte_carlo"],
    noise["monte_carlo"] > 0.2,
)
nb.record(
    "Fig. 7c: a clean result with the same number of samples, standard deviation over the mean",
    "clean",
    noise["hybrid"],
    noise["hybrid"] < noise["monte_carlo"] / 2,
    f"the variance is {ratio:.0f} times smaller",
)
bias = {}
for method in ("monte_carlo", "hybrid"):
    mean, error = mean_and_error(method)
    bias[method] = mean / reference.mean() - 1, error / reference.mean()
    # The sums over parts of lamp and wall are good to half a per cent.
    nb.record(
        f"eq. (6): without compromising accuracy, bias of the {method.replace('_', ' ')} mean",
        0,
        bias[method][0],
        abs(bias[method][0]) < 4 * bias[method][1] + 0.005,
        f"standard error {bias[method][1]:.4f}, corrected weights",
    )
timed = {m: pictures[m] for m in ("deterministic", "monte_carlo", "hybrid")}
nb.table(
    "methods",
    ["method", "rays a pixel", "seconds here", "noise", "bias of the mean"],
    [
        [
            TITLES[m],
            one.rays,
            f"{one.seconds:.3f}",
            f"{noise[m]:.3f}" if m in noise else "none",
            f"{bias[m][0]:+.3f}" if m in bias else f"{-missing:+.3f}",
        ]
        for m, one in timed.items()
    ],
)
nb.record(
    "Fig. 7: 7b and 7c took approximately the same time, rays a pixel",
    "same",
    f"{pictures['monte_carlo'].rays}, {pictures['hybrid'].rays}",
    pictures["hybrid"].rays <= 2 * pictures["monte_carlo"].rays,
    "the lamp's 4 parts count as rays, the table has seconds",
)
nb.record(
    "Fig. 7: 7a took less time, rays a pixel",
    "less",
    pictures["deterministic"].rays,
    pictures["deterministic"].rays < pictures["hybrid"].rays,
)

# %% [markdown]
# At equal **time** the pure drawing gets more rays. Its variance falls as 1/n; so many rays would
# it need to be as clean:

# %%
needed = rays * ratio
nb.record(
    "Fig. 7: rays a pixel that drawing alone needs to be as clean as eq. (6)",
    "more than 16",
    needed,
    needed > 2 * pictures["hybrid"].rays,
    f"eq. (6) has {pictures['hybrid'].rays}",
)

# %% [markdown]
# ## Counting the lamp twice
#
# "It is very important not to bias the sample by overcounting the specular component." With the
# flag left out the lamp comes in twice, and noisily. "Few rays are wasted in this way": so few of
# the drawn rays meet the lamp.

# %%
twice, error = mean_and_error("double_counted")
excess = twice / reference.mean() - 1
nb.record(
    "section 5: the flag avoids overcounting, bias of the mean without it",
    "> 0",
    excess,
    excess > 10 * bias["hybrid"][1],
    f"with it {bias['hybrid'][0]:+.4f}",
)
step = ((np.arange(size) + 0.5) / size * 2 - 1) * room.half_plate
point = np.stack([a.ravel() for a in (*np.meshgrid(step, step), np.zeros((size, size)))], axis=1)
back = np.broadcast_to(unit_vectors(room.theta_r, -np.pi / 2), point.shape)
lobe = models.get("ward").vector(BRASS | {"rho_d": 0.0})
draws = models.get("ward").sample(back, lobe, np.random.default_rng(1))
wasted = float(np.mean(room.meets_lamp(point, draws.w_r) & (draws.w_r[:, 2] > 0)))
nb.record(
    "section 5: few rays are wasted, share of the drawn rays that meet the lamp",
    "few",
    wasted,
    wasted < 0.05,
)

# %% [markdown]
# ## Weights
#
# Eq. (6) multiplies each drawn radiance by rho_s, whatever the angle. To agree with eq. (5) each
# ray must carry f cos(theta)/density, about rho_s cos(theta_r) in the mean: as printed the wall's
# image is too bright ([why](ward_sampling.py)).

# %%
printed, error = mean_and_error("hybrid", weights="printed")
indirect = reference.mean() - pictures["deterministic"].radiance.mean()
brighter = (printed - pictures["deterministic"].radiance.mean()) / indirect
nb.record(
    "(6): L_s rho_s as printed, the wall's image over that of (5)",
    1,
    float(brighter),
    abs(brighter - 1) < 0.1,
    f"1/cos theta_r = {1 / np.cos(room.theta_r):.2f}",
    differs="the weight is not rho_s; too bright by about 1/cos theta_r",
)

# %% [markdown]
# ## The shape of the highlight
#
# "The crescent shape of the highlight is due to longitudinal anisotropy and not the light source":
# the same plate with one alpha, the geometric mean of the two, has a compact highlight under the
# same lamp.


# %%
def shape(p):
    """Width along y over width along x of the highlight, from second moments."""
    dark = plate("deterministic", "ward", p | {"rho_s": 0.0}, room=room, size=size).radiance
    lamp_light = plate("deterministic", "ward", p, room=room, size=size).radiance - dark
    w = np.clip(lamp_light - 0.2 * lamp_light.max(), 0, None)
    x, y = np.meshgrid(step, step[::-1])
    w = w / w.sum()
    spread = [np.sqrt(np.sum(w * (a - np.sum(w * a)) ** 2)) for a in (x, y)]
    return float(spread[1] / spread[0])


even = BRASS | dict.fromkeys(("alpha_x", "alpha_y"), float(np.sqrt(0.05 * 0.16)))
turned = BRASS | {"alpha_x": 0.16, "alpha_y": 0.05}
shapes = {name: shape(p) for name, p in (("y", BRASS), ("one", even), ("x", turned))}
nb.record(
    "Fig. 7: the highlight's shape comes from the anisotropy, its length over its width: wide "
    "slopes along y, isotropic, along x",
    "drawn out across the grooves",
    ", ".join(f"{shapes[k]:.2f}" for k in ("y", "one", "x")),
    shapes["y"] > 1.2 * shapes["one"] > 1.2**2 * shapes["x"],
    "same lamp for all three",
)
nb.absent("Fig. 7: the scene itself", "not published; a plate, a lamp and a wall stand for it")
nb.absent("Figs. 8b, 8c: the chair by isotropic and elliptical models", "geometry not published")
nb.done()
