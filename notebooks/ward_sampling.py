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
# # Ward 1992: drawing directions from the lobe, eq. (7)
#
# To render with a lobe one draws directions as likely as the lobe reflects into them. Ward's eq.
# (7) draws the half vector (delta, phi) from two uniform numbers. As printed it has two slips: the
# arctangent around (7a) is missing, and (7b) folds the plane in half unless the quadrant is kept.
# And the rays that it gives are **not** "uniformly weighted".

# %%
import matplotlib.pyplot as plt
import numpy as np
from _common import Notebook

from gonio import models
from gonio.checks import directional_albedo
from gonio.geometry import unit_vectors
from gonio.plotting import style

nb = Notebook("ward_sampling", paper="Ward 1992")
n = nb.choose(quick=200_000, full=4_000_000)
rng = np.random.default_rng(7)
u = 1 - rng.random((2, n))  # (0, 1], as the paper asks
alpha = 0.3


def azimuth(u2, alpha_x, alpha_y):
    """(7b), kept in its quadrant."""
    return np.arctan2(alpha_y * np.sin(2 * np.pi * u2), alpha_x * np.cos(2 * np.pi * u2))


def root(u1, phi, alpha_x, alpha_y):
    """The right-hand side of (7a): tan(delta), though delta is printed."""
    return np.sqrt(-np.log(u1) / ((np.cos(phi) / alpha_x) ** 2 + (np.sin(phi) / alpha_y) ** 2))


# %% [markdown]
# ## (7a) lacks an arctangent
#
# The lobe is Gaussian in the slope tan(delta), with variance alpha^2/2 along each axis: 0.045 for
# alpha = 0.3. The root of (7a) has just this distribution, so that delta is its **arctangent**.
# Taken as delta itself it makes the slopes too wide and may pass 90°.

# %%
phi = azimuth(u[1], alpha, alpha)
t = root(u[0], phi, alpha, alpha)
below = t < np.pi / 2
variance = {
    "corrected": float(np.mean((t * np.cos(phi)) ** 2)),
    "printed": float(np.mean((np.tan(t[below]) * np.cos(phi[below])) ** 2)),
}
want = alpha**2 / 2
tolerance = 5 * want * np.sqrt(2 / n)  # five standard deviations of a sample variance
nb.record(
    "(7a) corrected, delta = arctan(root): variance of the slope, alpha = 0.3",
    want,
    variance["corrected"],
    abs(variance["corrected"] - want) < tolerance,
)
nb.record(
    "(7a) as printed, delta = root: variance of the slope, alpha = 0.3",
    want,
    variance["printed"],
    abs(variance["printed"] - want) < tolerance,
    differs="the arctangent is missing",
)

# %% [markdown]
# ## (7b) needs the quadrant
#
# arctan[(alpha_y/alpha_x) tan(2 pi u2)] by itself lies between -90° and 90°: one half of the lobe
# is never drawn, and the mean of cos(phi) is not 0. The paper says in a note that the angle must
# keep "its starting quadrant" (and calls the equation 7a). atan2 does it.

# %%
as_printed = np.arctan(0.16 / 0.05 * np.tan(2 * np.pi * u[1]))
with_atan2 = azimuth(u[1], 0.05, 0.16)
means = float(np.mean(np.cos(as_printed))), float(np.mean(np.cos(with_atan2)))
nb.record(
    "(7b) with atan2: mean of cos phi, rolled brass", 0, means[1], abs(means[1]) < 5 / np.sqrt(n)
)
nb.record(
    "(7b) as printed: mean of cos phi, rolled brass",
    0,
    means[0],
    abs(means[0]) < 0.01,
    "the note under it says so",
    differs="the arctangent alone covers half of the plane",
)

# %% tags=["hide-input"]
few = slice(0, 4000)
with style():
    fig, axes = plt.subplots(1, 3, figsize=(9.4, 3.2), layout="constrained")
    bins = np.linspace(-1.5, 1.5, 151)
    middle = (bins[1:] + bins[:-1]) / 2
    axes[0].plot(middle, np.exp(-((middle / alpha) ** 2)) / (alpha * np.sqrt(np.pi)), label="lobe")
    for label, x in {"corrected": t, "as printed": np.tan(t[below])}.items():
        where = phi if label == "corrected" else phi[below]
        h = np.histogram(x * np.cos(where), bins, density=True)[0]
        axes[0].plot(middle, h, "--", label=label)
    axes[0].set_xlabel("slope in x")
    axes[0].set_ylabel("density")
    axes[0].set_yscale("log")
    axes[0].set_ylim(1e-4, 4)
    axes[0].legend()
    axes[0].set_title("(7a), α = 0.3")
    for ax, angle, title in zip(
        axes[1:], (as_printed, with_atan2), ("as printed", "atan2"), strict=True
    ):
        length = root(u[0], angle, 0.05, 0.16)
        ax.plot((length * np.cos(angle))[few], (length * np.sin(angle))[few], ".", markersize=1)
        ax.set(
            aspect="equal",
            xlim=(-0.4, 0.4),
            ylim=(-0.4, 0.4),
            xlabel="slope in x",
            ylabel="slope in y",
        )
        ax.set_title(f"(7b) {title}, rolled brass")
nb.figure(
    fig,
    "slopes",
    "Left: slopes drawn by (7a), printed and corrected, against the lobe's Gaussian. Right: slopes "
    "of rolled brass by (7b), printed and with the quadrant kept.",
)

# %% [markdown]
# ## The rays have weights
#
# A ray along r = 2 (h.i) h - i that was drawn from the lobe has the density exp(...)/[4 pi alpha_x
# alpha_y (h.i) cos^3 delta], so that its weight, f cos(theta_r)/density, is
#
#     w = rho_s (h.i) cos^3(delta) sqrt(cos theta_r/cos theta_i)
#
# and rays below the horizon count with weight 0. Only at normal incidence and small alpha is this
# about rho_s. The paper's "uniformly weighted sample rays ... will correctly reproduce the
# specified highlight" realises another model, near Duer's. Nor is the term L_s rho_s of eq. (6)
# consistent with eq. (5): it is too bright by about 1/cos theta_i.


# %%
def drawn(theta_i, alpha):
    """Weights of the rays, over rho_s; 0 below the horizon."""
    phi = azimuth(u[1], alpha, alpha)
    delta = np.arctan(root(u[0], phi, alpha, alpha))
    h, i = unit_vectors(delta, phi), unit_vectors(theta_i, 0.0)
    hi = h @ i
    z = 2 * hi * h[:, 2] - i[2]
    up = (hi > 0) & (z > 0)
    w = np.where(up, hi * np.cos(delta) ** 3 * np.sqrt(np.clip(z, 0, None) / i[2]), 0.0)
    return w, z, up


p = {"rho_d": 0.0, "rho_s": 1.0, "alpha_x": 0.2, "alpha_y": 0.2}
angles = (0.0, 30.0, 60.0, 75.0)
distributions, rows = {}, []
for angle in angles:
    w, z, up = drawn(np.radians(angle), 0.2)
    exact = directional_albedo(models.get("ward"), p, np.radians(angle)).value
    duer = directional_albedo(models.get("ward_duer"), p, np.radians(angle)).value
    distributions[angle] = (float(w.mean()), float(w.std() / np.sqrt(n)), exact, float(up.mean()))
    rows.append([f"{angle:g}", exact, float(w.mean()), float(up.mean()), duer])
nb.table(
    "weights",
    ["theta_i, deg", "albedo of (5a)", "(7) with weights", "(7) without weights", "Duer's albedo"],
    rows,
)
mean, error, exact, uniform = distributions[60.0]
nb.record(
    "(7) with its weights: albedo over rho_s at 60 deg, alpha = 0.2",
    exact,
    mean,
    abs(mean - exact) < 5 * error + 1e-4,
    "printed: the integral of (5a)",
)
nb.record(
    "section 5.1: 'uniformly weighted' rays reproduce (5), albedo over rho_s at 60 deg",
    exact,
    uniform,
    abs(uniform - exact) < 0.05,
    differs="the weights are not uniform; equal ones realise a model near Duer's",
)
nb.record(
    "(6): L_s rho_s is the specular part, its weight over that of (5) at 60 deg",
    1,
    1 / exact,
    abs(1 / exact - 1) < 0.05,
    differs="(6) is too bright by about 1/cos theta_i",
)
lost = 1 - float(drawn(np.radians(60), 0.5)[2].mean())
nb.record(
    "section 5.1: rays below the horizon at 60 deg, alpha = 0.5",
    "not said",
    lost,
    abs(lost - 0.25) < 0.01,
    "a quarter; they count with weight 0",
)

# %% tags=["hide-input"]
with style():
    fig, ax = plt.subplots(figsize=(6.0, 3.4), layout="constrained")
    for angle in angles:
        w, z, up = drawn(np.radians(angle), 0.2)
        h, edges = np.histogram(w[up], np.linspace(0, 1.1, 111), density=True)
        ax.stairs(h, edges, label=f"{angle:g}°")
    ax.set_xlabel("weight of a ray, over $ρ_s$")
    ax.set_ylabel("density")
    ax.legend(title="$θ_i$")
    ax.set_title("(7) at α = 0.2: the weights are not uniform")
nb.figure(fig, "weights_of_rays", "Distribution of the weights of rays for four incidences.")

# %% [markdown]
# ## Is it efficient?
#
# "Much more efficient than distributing the samples evenly and then weighting the result": the
# albedo is estimated by both, and the variances for one ray compared.

# %%
ratio = {}
for alpha in (0.05, 0.2):
    cos = rng.random(n)
    r = unit_vectors(np.arccos(cos), 2 * np.pi * rng.random(n))
    i = unit_vectors(np.radians(30.0), 0.0)
    f = models.get("ward").evaluate(i, r, np.array([0.0, 1.0, alpha, alpha]))
    even = 2 * np.pi * f * cos
    w = drawn(np.radians(30.0), alpha)[0]
    ratio[alpha] = float(even.var() / w.var())
nb.record(
    "section 5.1: much more efficient than even samples, ratio of variances at 30 deg, "
    "alpha = 0.05, 0.2",
    "much more",
    f"{ratio[0.05]:.0f}, {ratio[0.2]:.0f}",
    min(ratio.values()) > 10,
    "as many even rays as this for one of (7)",
)
nb.done()
