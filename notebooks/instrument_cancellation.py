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
# # What eq. (2) cancels, and what it does not
#
# f = (V_measured - V_background)/(V_standard - V_background) rho_standard/pi, at each image point.
# All that multiplies sample and standard alike goes out in the quotient, all that is added to
# every frame in the differences. Here the virtual instrument shows its expected images, without
# noise; one property after the other is changed, and eq. (2) is written out by hand.

# %%
import matplotlib.pyplot as plt
import numpy as np
from _common import Notebook

from gonio import models
from gonio.calibration.frames.standard import standard_brdf
from gonio.geometry import angles
from gonio.instrument import preset
from gonio.instrument.images import Fixed, Images, Surface
from gonio.instrument.records import metadata
from gonio.metadata import Plan
from gonio.plotting import style

nb = Notebook("instrument_cancellation", paper="Ward 1992")
N = 52
WARD = models.get("ward")
METAL = WARD.vector({"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.1, "alpha_y": 0.2})


def instrument(**parts):
    """The preset ideal12 with N x N pixels and some values changed."""
    return preset("ideal12").with_pixels(N).altered(**parts)


def eq2(virtual, theta_i_deg, *, standard_scale=1.0, lamp=1.0, standard_at=None, certified=True):
    """f at each image point by eq. (2), and which points lie within 78 deg of the normal.

    `lamp` is its output at the sample's frames over that at the standard's.
    """
    plan = Plan(theta_i_deg=(theta_i_deg,), rotations_deg=(0.0,), exposures_s=(1.0,))
    images = Images(virtual, Surface("metal", WARD, (METAL,)), plan, Fixed(1, 2, standard_scale))
    V_measured = images.rates("sample", 0, 0, [lamp])[0]
    V_background = images.rates("background", 0, 0, [1.0])[0]
    if standard_at is None:
        V_standard = images.rates("standard", 0, 0, [1.0])[0]
        V_dark = V_background
    else:
        standard_plan = plan.model_copy(update={"theta_i_deg": (standard_at,)})
        standard_images = Images(
            virtual, images.surface, standard_plan, Fixed(1, 2, standard_scale)
        )
        V_standard, V_dark = (
            standard_images.rates(r, 0, 0, [1.0])[0] for r in ("standard", "background")
        )
    theta_r, phi_r = (np.full(V_standard.shape, np.nan) for _ in range(2))
    theta_r.ravel()[images.rays.pixel], phi_r.ravel()[images.rays.pixel] = angles(
        images.mean_directions
    )
    rho = virtual.standard.reflectance * np.ones(V_standard.shape)
    if certified:  # the standard's own BRDF, where the certificate states it
        certificate = metadata(virtual, plan, "metal", "").standard
        rho = standard_brdf(certificate, np.radians(theta_i_deg), theta_r, phi_r) * np.pi
    with np.errstate(invalid="ignore", divide="ignore"):
        f = (V_measured - V_background) / (V_standard - V_dark) * rho / np.pi
    return f, theta_r < np.radians(78)


unchanged = {angle: eq2(instrument(), angle) for angle in (0.0, 60.0)}


def change(virtual, angle=60.0, **how):
    """Relative change of f against the unchanged instrument: of 95 % of the points, and median."""
    f, _ = eq2(virtual, angle, **how)
    ratio = (f / unchanged[angle][0] - 1)[unchanged[angle][1]]
    ratio = ratio[np.isfinite(ratio)]
    return float(np.quantile(np.abs(ratio), 0.95)), float(np.median(ratio))


# %% [markdown]
# ## What cancels
#
# Everything that belongs to the camera, the lens, the dome's coating and the lamp, if the response
# is linear and the standard is seen at the **same** incidence as the sample.

# %%
CANCELS = {
    "lamp and quantum efficiency": {"lamp": {"white_rate_e_per_s": 2.3e5}},
    "vignetting of the lens": {"lens": {"vignetting": 0.6}},
    "reflectance of the dome, uneven": {"dome": {"reflectance_variation": 0.1}},
    "transmittance of the dome, uneven": {"dome": {"transmittance_variation": 0.1}},
    "response of the pixels (PRNU)": {"sensor": {"prnu": 0.05}},
    "stray light of the lamp": {"surroundings": {"stray": 0.03}},
    "room light on its own way": {"surroundings": {"ambient": 0.05}},
    "a beam that is not even": {"lamp": {"edge_falloff": 0.3}},
}
rows, cancelled = [], []
for name, parts in CANCELS.items():
    most, _ = change(instrument(**parts))
    rows.append([name, "cancels", f"{most:.1e}"])
    cancelled.append(most)
    nb.record(f"(2) cancels: {name}, relative change of f at 60 deg", 0, most, most < 1e-4)

# %% [markdown]
# ## What does not
#
# What the sample itself sends round twice; room light that the **sample** reflects, which the
# frame without a sample does not hold; a lamp that drifts between sample and standard; a standard
# that is not what its certificate says, or not Lambertian as eq. (2) supposes; and a standard
# measured at one incidence only, where the cosine is missing.

# %%
unsaid = {"standard": {"rolloff": 0.1, "rolloff_certified": False}}
REMAINS = {
    "light that goes round twice, g = 0.03": (instrument(surroundings={"multibounce": 0.03}), {}),
    "room light reflected by the sample, 1 %": (
        instrument(surroundings={"ambient_reflected": 0.01}),
        {},
    ),
    "lamp 1 % brighter than for the standard": (instrument(), {"lamp": 1.01}),
    "standard 2 % brighter than certified": (instrument(), {"standard_scale": 1.02}),
    "standard darker by 10 % at 75 deg": (instrument(**unsaid), {"certified": False}),
    "standard seen at 0 deg, sample at 60 deg": (instrument(), {"standard_at": 0.0}),
}
changes = {}
for name, (virtual, how) in REMAINS.items():
    most, middle = change(virtual, **how)
    changes[name] = (most, middle)
    rows.append([name, "remains", f"{most:.1e}"])
    nb.record(
        f"(2) cancels: {name}, relative change of f at 60 deg",
        0,
        most,
        most < 1e-4,
        f"median {100 * middle:+.2f} %",
        differs="it does not multiply or add to all three frames alike",
    )
nb.table("terms", ["term", "verdict", "relative change of f, 95 % of the points"], rows)
nb.record(
    "(2): standard at one incidence only, what is left is the cosine, at 60 deg",
    0.5,
    1 + changes["standard seen at 0 deg, sample at 60 deg"][1],
    abs(1 + changes["standard seen at 0 deg, sample at 60 deg"][1] - 0.5) < 0.01,
    "printed: cos 60 deg / cos 0",
)

# %% tags=["hide-input"]
with style():
    fig, ax = plt.subplots(figsize=(7.2, 3.6), layout="constrained")
    names = [*CANCELS, *REMAINS]
    values = [max(v, 1e-17) for v in cancelled] + [most for most, _ in changes.values()]
    colours = ["#009E73"] * len(CANCELS) + ["#D55E00"] * len(REMAINS)
    ax.barh(range(len(names)), values, color=colours, left=1e-17)
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()
    ax.set_xscale("log")
    ax.set_xlim(1e-17, 2)
    ax.set_xlabel("relative change of f by eq. (2), 60° incidence")
nb.figure(fig, "terms_bars", "What is left of each property in f: rounding above, the rest below.")

# %%
nb.done()
