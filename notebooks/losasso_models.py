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
# # Losasso: surface reflection models side by side
#
# Losasso's survey shows seven lighting models, each by its equation, a picture and two diagrams of
# the light that goes in every direction, and asks what each costs. Here are the same models, in
# the form in which they are BRDFs, on one sphere under one lamp; their diagrams; what they cost on
# this machine; light from an environment that is filtered in advance; and the places where an
# equation is not right as printed ([errata](../docs/errata.md)).

# %%
import time
from math import asin, cos, degrees, pi, sin, sqrt

import matplotlib.pyplot as plt
import numpy as np
from _common import Notebook

from gonio import models
from gonio.checks import directional_albedo
from gonio.geometry import Directions, hemisphere_quadrature, unit_vectors
from gonio.plotting import style
from gonio.plotting.style import GREY, PURPLE
from gonio.rendering import Directional, prefilter, prefilter_error, render, sky, srgb
from gonio.rendering.prefilter import outgoing

nb = Notebook("losasso_models", paper="Losasso")
DEG = pi / 180
# In the order of the paper; the last one is today's.
GALLERY = {
    "lambert": ("Lambert", {"rho": 0.6}),
    "phong": ("Phong", {"rho_d": 0.4, "rho_s": 0.2, "n": 40.0}),
    "cook_torrance": ("Cook-Torrance", {"rho_d": 0.2, "k_s": 1.0, "m": 0.2, "eta": 2.5}),
    "blinn": ("Blinn", {"rho_d": 0.2, "k_s": 1.0, "c": 0.2, "eta": 2.5}),
    "oren_nayar_qualitative": ("Oren-Nayar", {"rho": 0.6, "sigma": 35 * DEG}),
    "minnaert": ("Minnaert", {"rho": 0.6, "k": 1.6}),
    "ward": ("Ward", {"rho_d": 0.2, "rho_s": 0.2, "alpha_x": 0.08, "alpha_y": 0.3}),
    "ggx": ("GGX", {"rho_d": 0.2, "alpha_x": 0.2, "alpha_y": 0.2, "eta": 2.5}),
}


def f(name, theta_i_deg, signed_deg, **changed):
    """BRDF in the plane of incidence; signed angles in degrees, positive on the mirror's side."""
    signed = np.asarray(signed_deg, float) * DEG
    d = Directions(theta_i_deg * DEG, 0.0, np.abs(signed), np.where(signed > 0, pi, 0.0))
    return models.get(name)(d, **{**GALLERY[name][1], **changed})


# %% [markdown]
# ## The gallery
#
# A distant lamp 45° from the camera, up and to the right. Grooves of Ward's metal run round the
# sphere.

# %%
side = nb.choose(quick=96, full=150)
samples = nb.choose(quick=4, full=16)
lamp = Directional(45 * DEG, 45 * DEG)
gallery = {
    name: render("sphere", lamp, name, p, size=(side, side), samples=samples)
    for name, (_, p) in GALLERY.items()
}

# %% tags=["hide-input"]
with style():
    fig, axes = plt.subplots(2, 4, figsize=(6.0, 3.3), layout="constrained")
    for ax, (name, picture) in zip(axes.flat, gallery.items(), strict=True):
        ax.imshow(srgb(picture, 0.7), cmap="gray", vmin=0, vmax=255)
        ax.set_title(GALLERY[name][0])
        ax.set_axis_off()
nb.figure(
    fig, "gallery", "One sphere under one lamp with eight models; radiance of 0.7 is shown white."
)

# %% [markdown]
# ## The diagrams
#
# Losasso draws the light that leaves in each direction, the cosine of the incidence included, for
# light near the normal and for oblique light (the straight line). All panels have one scale, the
# lobes that leave it are cut off.

# %% tags=["hide-input"]
sweep = np.linspace(-89.5, 89.5, 359)
with style():
    fig, axes = plt.subplots(2, 4, figsize=(9.4, 3.0), layout="constrained")
    for ax, (name, (title, _)) in zip(axes.flat, GALLERY.items(), strict=True):
        for theta_i, line in ((20, "-"), (70, "--")):
            level = f(name, theta_i, sweep) * cos(theta_i * DEG)
            x, y = np.sin(sweep * DEG) * level, np.cos(sweep * DEG) * level
            ax.plot(x, y, line, color="#000000")
            ray = 0.42
            ax.plot(
                [0, -ray * sin(theta_i * DEG)],
                [0, ray * cos(theta_i * DEG)],
                line,
                color=PURPLE,
                linewidth=0.9,
            )
        ax.axhline(0, color=GREY, linewidth=0.6)
        ax.set_xlim(-0.46, 0.46)
        ax.set_ylim(-0.02, 0.44)
        ax.set_aspect("equal")
        ax.set_title(title)
        ax.set_axis_off()
nb.figure(
    fig,
    "diagrams",
    "Light that leaves in the plane of incidence for light at 20 deg (full) and 70 deg (dashed), "
    "which comes from the left.",
)

# %% [markdown]
# What the captions say of them:

# %%
flux = [float((f("lambert", t, 0.0) * cos(t * DEG))[()]) for t in (0, 30, 60, 80)]
nb.record(
    "Lambert: light from an angle is reflected less in all directions, I at 0, 30, 60, 80 deg",
    "falling",
    ", ".join(f"{level:.3f}" for level in flux),
    bool(np.all(np.diff(flux) < 0)),
)
fine = np.linspace(-89.5, 89.5, 3581)
peaks = {
    (name, t): float(fine[np.argmax(f(name, t, fine))])
    for name in ("phong", "cook_torrance", "blinn")
    for t in (30, 45, 70)
}
nb.record(
    "Phong: the highlight is in the direction of the reflection vector, deg at 30, 45, 70",
    "30, 45, 70",
    ", ".join(f"{peaks['phong', t]:.1f}" for t in (30, 45, 70)),
    all(abs(peaks["phong", t] - t) < 0.1 for t in (30, 45, 70)),
)
away = f("phong", 45, [-80.0, -60.0])
nb.record(
    "Phong: the diffuse component is Lambert's, pi f/rho_d far from the highlight",
    1,
    float(away.max() * pi / GALLERY["phong"][1]["rho_d"]),
    bool(np.allclose(away * pi, GALLERY["phong"][1]["rho_d"], rtol=1e-6)),
)
nb.record(
    "Cook-Torrance: complete change in behaviour when the incident angle is large, peak beyond the "
    "mirror direction, deg at 30, 70",
    "none near the normal, large at 70",
    ", ".join(f"{peaks['cook_torrance', t] - t:.1f}" for t in (30, 70)),
    peaks["cook_torrance", 70] - 70 > 5 * max(peaks["cook_torrance", 30] - 30, 0.5),
)
lobes = {
    name: np.concatenate([f(name, t, sweep, rho_d=0.0) for t in (30, 45, 60)])
    for name in ("cook_torrance", "blinn")
}
correlation = float(np.corrcoef(lobes["cook_torrance"], lobes["blinn"])[0, 1])
nb.record(
    "Blinn: the diagrams are similar to Cook-Torrance's, correlation of the lobes at 30, 45, 60 "
    "deg, c = m",
    "similar",
    correlation,
    correlation > 0.9,
    "Blinn's peak is narrower at the top and its tail longer",
)
conserved = max(
    directional_albedo(
        models.get("cook_torrance"),
        {"rho_d": 0.0, "k_s": 1.0, "m": m, "eta": 4.0},
        t * DEG,
        rtol=1e-3,
    ).value
    for m in nb.choose(quick=(0.3,), full=(0.1, 0.3, 0.6))
    for t in (0, 60, 75, 85)
)
nb.record(
    "Cook-Torrance: energy conservation, largest albedo of facets of index 4",
    "<= 1",
    conserved,
    conserved <= 1,
    "incidence 0 to 85 deg",
)
# A sphere lit from the camera has f(theta, theta) cos(theta) at the radius sin(theta).
rim = {
    name: float((f(name, degrees(asin(0.95)), -degrees(asin(0.95))) * sqrt(1 - 0.95**2))[()])
    / float(f(name, 0.0, 0.0)[()])
    for name in ("lambert", "oren_nayar_qualitative")
}
spread = {
    t: float(np.ptp(v) / v.mean())
    for t in (10, 75)
    for v in [f("oren_nayar_qualitative", t, np.arange(-75, 76, 5.0))]
}
nb.record(
    "Oren-Nayar: like Lambert at low angles of incidence, spread of f over theta_r at 10 and at 75 "
    "deg",
    "small, large",
    f"{100 * spread[10]:.0f} %, {100 * spread[75]:.0f} %",
    spread[10] < 0.2 < 0.5 < spread[75],
)
nb.record(
    "Oren-Nayar: flatter, with brighter edges, brightness of a sphere at 0.95 of its radius over "
    "the middle",
    f"> {rim['lambert']:.2f} (Lambert)",
    rim["oren_nayar_qualitative"],
    rim["oren_nayar_qualitative"] > 1.5 * rim["lambert"],
    "lit from the camera",
)
# Second moments of Ward's lobe about the mirror direction, along and across the grooves.
theta, phi, weight = hemisphere_quadrature(90, 180)
w_r, w_i = unit_vectors(theta, phi), unit_vectors(30 * DEG, 0.0)
p = {**GALLERY["ward"][1], "rho_d": 0.0}
lobe = models.get("ward")(Directions(30 * DEG, 0.0, theta, phi), **p) * weight
width = [float(np.sqrt(np.sum(lobe * (w_r + w_i)[..., k] ** 2) / lobe.sum())) for k in (0, 1)]
nb.record(
    "Ward: the lobe is oriented perpendicularly to the groove, width across over width along it",
    "> 1",
    width[1] / width[0],
    width[1] > 1.5 * width[0],
    "second moments at 30 deg, grooves along x",
)
minnaert = f("minnaert", 30, [0.0, 60.0, 85.0])
nb.record(
    "Minnaert: light goes towards zero when the viewer looks along the normal, f at 0 over f at 85 "
    "deg",
    0,
    float(minnaert[0] / minnaert[2]),
    minnaert[0] < minnaert[2],
    differs="print has (1 - N.E) for (N.E): limbs that darken are seen at grazing angles",
)

# %% [markdown]
# ## What each costs (Appendix B)
#
# The appendix compares vertex and pixel shaders of 2003. Here it is nanoseconds a pair of
# directions on one core of the machine that ran this page, arrays in, arrays out, the shortest of
# several runs. Near Lambert's figure it is the memory that is timed, not the model. Blinn's facets
# were "significantly cheaper" than Cook and Torrance's; now an exponential costs little, and the
# two are within a factor of two.

# %%
N = nb.choose(quick=100_000, full=1_000_000)
rng = np.random.default_rng(7)
directions = [unit_vectors(*rng.uniform(0, (1.4, 2 * pi), (N, 2)).T) for _ in range(2)]


ROUNDS = nb.choose(quick=3, full=7)


def shortest(work, rounds=ROUNDS):
    """Seconds of the shortest run, after one to warm up."""
    work()
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def cost_ns(name):
    model = models.get(name)
    n = 500 if model.costly else N
    w_i, w_r = (w[:n] for w in directions)
    p, out = model.vector({}), np.empty(n)
    return 1e9 * shortest(lambda: model.evaluate(w_i, w_r, p, out=out, threads=1)) / n


timed = {*GALLERY, "oren_nayar", "oren_nayar_numeric"} | nb.choose(
    quick=set(), full=set(models.names())
)
cost = {name: cost_ns(name) for name in sorted(timed)}
nb.table(
    "cost",
    ["model", "ns a pair", "times Lambert"],
    [
        [models.get(name).title, f"{ns:.3g}", f"{ns / cost['lambert']:.3g}"]
        for name, ns in sorted(cost.items(), key=lambda item: item[1])
    ],
)
# No claim rests on a clock but where two costs are orders of magnitude apart.
nb.record(
    "Appendix B: cost of the integral (13) in units of Lambert's",
    "not in it",
    f"{cost['oren_nayar_numeric'] / cost['lambert']:.0e}",
    cost["oren_nayar_numeric"] > 20 * cost["lambert"],
    "the survey's others, in the notebook's table, lie within a factor of some tens",
)
nb.absent(
    "Appendix B: instructions of vertex and pixel shaders, texture look-ups",
    "the table's entries are a picture, for hardware of 2003; times on this machine stand in the "
    "notebook",
)

# %% [markdown]
# Oren-Nayar "is however very computationally expensive, and it requires the calculation of
# azimuth and zenith angles". It does not: with c_i = N·L, c_r = N·E and g = L·E - c_i c_r, which is
# sin theta_i sin theta_r cos(phi_r - phi_i), the last factor of (17) is max(0, g)/max(c_i, c_r).

# %%
w_i, w_r = (w[:1000] for w in directions)
c_i, c_r = w_i[:, 2], w_r[:, 2]
g = np.sum(w_i * w_r, axis=1) - c_i * c_r
s2 = (35 * DEG) ** 2
bare = (
    0.6
    / pi
    * (
        1
        - 0.5 * s2 / (s2 + 0.33)
        + 0.45 * s2 / (s2 + 0.09) * np.maximum(0, g) / np.maximum(c_i, c_r)
    )
)
t_i, t_r = np.arccos(c_i), np.arccos(c_r)
alpha, beta = np.maximum(t_i, t_r), np.minimum(t_i, t_r)
turn = np.cos(np.arctan2(w_r[:, 1], w_r[:, 0]) - np.arctan2(w_i[:, 1], w_i[:, 0]))
printed = (
    0.6
    / pi
    * (
        1
        - 0.5 * s2 / (s2 + 0.33)
        + 0.45 * s2 / (s2 + 0.09) * np.maximum(0, turn) * np.sin(alpha) * np.tan(beta)
    )
)
model = models.get("oren_nayar_qualitative")
ours = model.evaluate(w_i, w_r, model.vector(GALLERY["oren_nayar_qualitative"][1]))
worst = float(np.max(np.abs(bare / printed - 1)))
nb.record(
    "Oren-Nayar: requires azimuth and zenith angles, difference of a form without any",
    "requires",
    f"{worst:.0e}",
    worst > 1e-9,
    differs="sin alpha tan beta cos(dphi) follows from N.L, N.E and L.E",
)
worst = float(np.max(np.abs(printed / ours - 1)))
nb.record(
    "Oren-Nayar: the equation with A and B, largest relative difference from ours",
    0,
    f"{worst:.0e}",
    worst < 1e-9,
    "k_d = 1; the bracket is where it belongs, which it is not in the paper of 1994",
)

# %% [markdown]
# ## Environment maps, filtered in advance
#
# "All of the lighting computations are done off-line for all directions at a given point." A BRDF
# needs a table over normal *and* viewer. A map over one direction takes the viewer to look along
# the normal and is looked up along the normal (matt surfaces) or the mirror direction (lobes),
# scaled by the albedo. Under a clear sky, on a sphere seen from far in front, against the sum over
# every pixel of the sky:

# %%
heaven = sky("clear", theta_i=55 * DEG, phi_i=50 * DEG, rows=nb.choose(quick=32, full=64))
ABOUT = {"lambert": "normal", "oren_nayar_qualitative": "normal", "minnaert": "normal"}
rows, n_points = nb.choose(quick=(12, 150), full=(24, 600))
prefilter_errors = {
    name: prefilter_error(heaven, name, p, about=ABOUT.get(name, "mirror"), rows=rows, n=n_points)
    for name, (_, p) in GALLERY.items()
}
inner = {
    name: float(
        np.sqrt(
            np.mean((e.approximate - e.exact)[e.theta_r < 30 * DEG] ** 2)
            / np.mean(e.exact[e.theta_r < 30 * DEG] ** 2)
        )
    )
    for name, e in prefilter_errors.items()
}
nb.table(
    "prefiltered",
    ["model", "looked up along", "RMS, %", "RMS where theta_r < 30 deg, %"],
    [
        [
            GALLERY[name][0],
            ABOUT.get(name, "mirror direction").replace("normal", "the normal"),
            f"{100 * e.rms:.1f}",
            f"{100 * inner[name]:.1f}",
        ]
        for name, e in prefilter_errors.items()
    ],
)

# %%
side = nb.choose(quick=36, full=72)
y, x = (np.indices((side, side)) + 0.5) * 2 / side - 1
y, disc = -y, x * x + y * y < 0.97
normal = np.stack([x[disc], y[disc], np.sqrt(1 - x[disc] ** 2 - y[disc] ** 2)], axis=1)
back = np.broadcast_to([0.0, 0.0, 1.0], normal.shape)
spheres, seconds = {}, {}
for name in ("lambert", "oren_nayar_qualitative", "phong", "ggx"):
    model, p = models.get(name), GALLERY[name][1]
    table = prefilter(heaven, name, p, about=ABOUT.get(name, "mirror"), rows=rows)
    ways = {
        "sum": lambda model=model, p=p: outgoing(
            heaven, model, model.vector(p), normal, back, threads=1
        ),
        "map": lambda table=table: table.radiance(normal, back),
    }
    spheres[name] = {way: work() for way, work in ways.items()}
    seconds[name] = {way: shortest(work, 2) for way, work in ways.items()}

# %% tags=["hide-input"]
with style():
    fig, axes = plt.subplots(3, 4, figsize=(5.4, 4.1), layout="constrained")
    for column, (name, ways) in zip(axes.T, spheres.items(), strict=True):
        off = np.abs(ways["map"] - ways["sum"])
        white = float(np.percentile(ways["sum"], 99))
        for ax, values in zip(column, (ways["sum"], ways["map"], off), strict=True):
            picture = np.zeros((side, side))
            picture[disc] = values
            ax.imshow(srgb(picture, white), cmap="gray", vmin=0, vmax=255)
            ax.set_xticks([])
            ax.set_yticks([])
            ax.spines[:].set_visible(False)
        column[0].set_title(GALLERY[name][0])
    for ax, label in zip(axes[:, 0], ("sum", "map", "difference"), strict=True):
        ax.set_ylabel(label)
nb.figure(
    fig,
    "environment",
    "Spheres under a clear sky: the sum over its pixels, the map filtered in advance, and their "
    "difference.",
)

# %%
nb.record(
    "Environment maps: Lambert from a map over the normal, RMS error",
    0,
    f"{100 * prefilter_errors['lambert'].rms:.1f} %",
    prefilter_errors["lambert"].rms < nb.choose(quick=0.03, full=0.01),
    "what is left is the table's resolution",
)
nb.record(
    "Environment maps: 'incredibly complex' models from a map over one direction, RMS error of "
    "Phong, Cook-Torrance, Blinn, Ward, GGX",
    0,
    ", ".join(
        f"{100 * prefilter_errors[name].rms:.0f} %"
        for name in ("phong", "cook_torrance", "blinn", "ward", "ggx")
    ),
    max(prefilter_errors[name].rms for name in ("phong", "cook_torrance", "blinn", "ward", "ggx"))
    < 0.05,
    differs="a lobe seen obliquely is longer than the map has it, and the horizon cuts it",
)
nb.record(
    "Environment maps: the same where the surface is seen within 30 deg of its normal",
    "smaller",
    ", ".join(
        f"{100 * inner[name]:.0f} %" for name in ("phong", "cook_torrance", "blinn", "ward", "ggx")
    ),
    all(
        inner[name] < prefilter_errors[name].rms
        for name in ("phong", "cook_torrance", "blinn", "ggx")
    ),
    "without Ward's, whose map is a mean over turns of the grooves",
)
gain = min(each["sum"] / each["map"] for each in seconds.values())
nb.record(
    "Environment maps: 'then cheaply applied', time of the sum over time of the look-up",
    "> 1",
    f"{gain:.0f}",
    gain > 2,
    f"{heaven.radiance.size} pixels of sky, one thread",
)

# %% [markdown]
# ## The equations as printed
#
# What each printed factor does, in a number.


# %%
def exact_fresnel(c, n):
    """Unpolarised reflectance by Snell's law and Fresnel's two amplitudes."""
    t = sqrt(1 - (1 - c * c) / n**2)
    return (((c - n * t) / (c + n * t)) ** 2 + ((n * c - t) / (n * c + t)) ** 2) / 2


def printed_fresnel(c, g):
    return 0.5 * ((g - c) / (g + c)) ** 2 * (1 + ((c * (g + c) - 1) / (c * (g - c) + 1)) ** 2)


n = 1.5
printed, ours = printed_fresnel(1.0, sqrt(n * n + 1) - 1), exact_fresnel(1.0, n)
nb.record(
    "Fresnel term: g = sqrt(n² + c²) - 1, reflectance of n = 1.5 at normal incidence",
    printed,
    ours,
    abs(printed / ours - 1) < 1e-3,
    differs="the root must hold the -1",
)
worst = max(
    abs(printed_fresnel(c, sqrt(n * n + c * c - 1)) - exact_fresnel(c, n))
    for c in (1.0, 0.7, 0.3, 0.05)
)
nb.record(
    "Fresnel term: the formula with the root mended, largest difference from Snell and Fresnel",
    0,
    f"{worst:.0e}",
    worst < 1e-12,
)
short = [(1 - (1 - c) ** 5) + n * (1 - c) ** 5 for c in (1.0, 0.0)]
ours = [((n - 1) / (n + 1)) ** 2, 1.0]
nb.record(
    "Fresnel term, short form: reflectance of n = 1.5 at normal and at grazing incidence",
    f"{short[0]:g}, {short[1]:g}",
    f"{ours[0]:g}, {ours[1]:g}",
    bool(np.allclose(short, ours)),
    differs="F0 + (1 - F0)(1 - L.H)^5 has its ends where they belong",
)

# %%
theta, phi, weight = hemisphere_quadrature(400, 4)
m = c = 0.2
beckmann = np.exp(-((np.tan(theta) / m) ** 2)) / (4 * m**2 * np.cos(theta) ** 4)
trowbridge = (c**2 / (np.cos(theta) ** 2 * (c**2 - 1) + 1)) ** 2
areas = [float(np.sum(D * np.cos(theta) * weight)) for D in (beckmann, trowbridge)]
nb.record(
    "Cook-Torrance: D, the integral of D cos(beta), which is 1 of a density; with the DGF/pi "
    "of the paper pi/4 is right",
    areas[0],
    pi / 4,
    abs(areas[0] - pi / 4) < 1e-3,
    "D/pi is a quarter of Beckmann's density: consistent, if nothing else is mixed in",
)
nb.record(
    "Blinn: D, the integral of D cos(beta), which is 1 of a density, c = 0.2",
    areas[1],
    1.0,
    abs(areas[1] - 1) < 1e-3,
    differs="the printed D is pi c² of a density; I is 4 pi c² too much",
)


# %%
def vectors(theta_i, theta_r):
    return unit_vectors(theta_i * DEG, 0.0), unit_vectors(theta_r * DEG, pi)


def printed_lobe(w_i, w_r, n=2.5, m=0.2):
    """D G F/(pi (L.N)(E.N)) of the paper, with E.H in G and the root of g mended."""
    h = (w_i + w_r) / np.linalg.norm(w_i + w_r)
    eh, nh = float(w_r @ h), float(h[2])
    D = np.exp(-(1 / nh**2 - 1) / m**2) / (4 * m**2 * nh**4)
    G = min(1, 2 * nh * w_r[2] / eh, 2 * nh * w_i[2] / eh)
    return D * G * exact_fresnel(eh, n) / (pi * w_i[2] * w_r[2])


pairs = [vectors(*pair) for pair in ((10, 20), (40, 40), (60, 70))]
model = models.get("cook_torrance")
p = model.vector({"rho_d": 0.0, "k_s": 1.0, "m": 0.2, "eta": 2.5})
worst = max(abs(printed_lobe(*pair) / float(model.evaluate(*pair, p)) - 1) for pair in pairs)
nb.record(
    "Cook-Torrance: D G F/(pi (L.N)(E.N)), largest relative difference from ours",
    0,
    f"{worst:.0e}",
    worst < 1e-9,
    "with E.H for V.H in G",
)
w_i, w_r = vectors(0, 60)
k_d = k_s = 0.5
lobe = printed_lobe(w_i, w_r)
printed = k_d * (k_s * lobe) * w_i[2] + k_s * lobe * w_i[2]
ours = w_i[2] * (k_d / pi + k_s * lobe)
nb.record(
    "Cook-Torrance: I off the lobe, light along the normal seen at 60 deg, k_d = k_s = 0.5",
    float(printed),
    float(ours),
    abs(printed / ours - 1) < 1e-3,
    differs="print has the lobe twice, k_s twice in one of them, and no diffuse part",
)


def printed_minnaert(c_i, c_r, k=0.7):
    return c_i**k * (1 - c_r) ** (1 - k)


forward, back_again = printed_minnaert(0.3, 0.8), printed_minnaert(0.8, 0.3)
values = [
    float(models.get("minnaert").evaluate(*w, models.get("minnaert").vector({"k": 0.7})))
    for w in ([unit_vectors(np.arccos(a), 0.0) for a in pair] for pair in ((0.3, 0.8), (0.8, 0.3)))
]
nb.record(
    "Minnaert: f there over f back, (N.L, N.E) = (0.3, 0.8), k = 0.7",
    forward / back_again,
    values[0] / values[1],
    abs(forward / back_again - values[0] / values[1]) < 1e-9,
    differs="(N.L)^k (N.E)^(k-1) is reciprocal, the printed law is not, and is Lambert for no k",
)

# %%
w_i, w_r = pairs[0]
h = w_i + w_r
alpha_x, alpha_y = 0.08, 0.3
unit = h / np.linalg.norm(h)
exponent = -2 * ((unit[0] / alpha_x) ** 2 + (unit[1] / alpha_y) ** 2) / (1 + unit[2])
ward = float(np.exp(exponent)) / sqrt(w_i[2] * w_r[2]) / (4 * alpha_x * alpha_y)
model = models.get("ward_approx")
p = model.vector({"rho_d": 0.0, "rho_s": 1.0, "alpha_x": alpha_x, "alpha_y": alpha_y})
nb.record(
    "Ward: the lobe over Ward's own eq. (5b)",
    ward / float(model.evaluate(w_i, w_r, p)),
    1.0,
    abs(ward / float(model.evaluate(w_i, w_r, p)) - 1) < 1e-9,
    differs="pi is missing below the line",
)
# Light reflected of 1 that comes along the normal: the integral of I cos(theta_r) over I's light.
theta, phi, weight = hemisphere_quadrature(200, 4)
n = 50
printed = float(np.sum(0.5 * np.cos(theta) * weight))
ours = directional_albedo(models.get("lambert"), {"rho": 0.5}, 0.0).value
nb.record(
    "Lambert: I = k_d (N.L), reflected share of light along the normal, k_d = 0.5",
    printed,
    ours,
    abs(printed / ours - 1) < 1e-3,
    differs="1/pi is missing where I is a radiance: more light than came",
)
printed = float(np.sum(0.1 * np.cos(theta) ** n * np.cos(theta) * weight))
p = {"rho_d": 0.0, "rho_s": 0.1, "n": float(n)}
ours = directional_albedo(models.get("phong"), p, 0.0, rtol=1e-4).value
nb.record(
    "Phong: k_s (E.R)^n, reflected share of light along the normal, k_s = 0.1, n = 50",
    printed,
    ours,
    abs(printed / ours - 1) < 1e-3,
    differs="(n + 2)/(2 pi) makes k_s a reflectance",
)

# %%
nb.absent(
    "screenshots of the models", "their scenes were not published; the sphere stands for them"
)
nb.absent(
    "Cook-Torrance: microfacets are 'perfect Lambertian reflectors'",
    "a word: they are mirrors, else F and G of the equation have no meaning",
)
nb.absent("G: V.H in the last denominator", "V is not defined; E.H, which equals L.H, is meant")
nb.absent(
    "Oren-Nayar is 'probably not worth the increase' in cost", "a judgement; its cost is above"
)
nb.done()
