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
# # How good is eq. (3)?
#
# Eq. (3) turns the angles under which the camera sees a point of the dome into the angles under
# which the sample sent light there. It is the direction from the sample to that **point**; the law
# of reflection does not occur in it. The paper calls it "a good approximation both for
# hemispherical and hemi-ellipsoidal reflectors as long as D is small in relation to R". Here each
# camera ray is followed to the dome and mirrored there, and the two directions are compared.

# %%
import matplotlib.pyplot as plt
import numpy as np
from _common import Notebook

from gonio.calibration.reflector import (
    camera_angles,
    reflected_angles,
    reflected_directions,
    solid_angle_ratio,
)
from gonio.geometry import hemisphere_quadrature, unit_vectors
from gonio.plotting import style
from gonio.plotting.style import BLUE, VERMILLION

nb = Notebook("instrument_mapping", paper="Ward 1992")
R = 150.0
SHAPES = ("sphere", "ellipsoid")
n = nb.choose(quick=60, full=300)


def error(ratio, shape, sign=1.0):
    """Camera rays, exact directions, their angle to eq. (3)'s in degrees, theta_r up to 85 deg."""
    D = ratio * R
    theta, phi, _ = hemisphere_quadrature(n, 2 * n)
    w_c = unit_vectors(theta, phi)
    pupil = np.array([0.0, -D, 0.0])
    exact = reflected_directions(pupil, w_c, R=R, D=D, shape=shape, mapping="exact")[0]
    ward = unit_vectors(*reflected_angles(theta, phi, R=R, D=D))
    if sign < 0:  # D taken with the wrong sign
        ward = unit_vectors(*camera_angles(theta, phi, R=R, D=D))
    half = np.linalg.norm(exact - ward, axis=-1) / 2
    inside = exact[:, 2] > np.cos(np.radians(85))
    return w_c[inside], exact[inside], np.degrees(2 * np.arcsin(half))[inside]


# %% [markdown]
# ## Sphere and ellipsoid
#
# On a sphere the error is (D/R)^2 sin(2 gamma), gamma being the angle from the line through camera
# and sample: second order. On the ellipsoid with its foci in camera and sample every ray from one
# focus does go to the other; only the distance r_c is wrong, and the error is third order, (D/R)^3
# cos^2(gamma) sin(gamma) at most 0.385 (D/R)^3. So both are approximated, but not alike: at D/R =
# 0.1 the ellipsoid is 24 times better.

# %%
ratios = np.array([0.02, 0.05, 0.1, 0.15])
largest = {shape: [float(error(x, shape)[2].max()) for x in ratios] for shape in SHAPES}
theory = {
    "sphere": np.degrees(ratios**2),
    "ellipsoid": np.degrees(2 / np.sqrt(27) * ratios**3),
}
nb.table(
    "errors",
    ["D/R", "sphere, deg", "(D/R)^2", "ellipsoid, deg", "0.385 (D/R)^3"],
    [
        [f"{x:g}", *(f"{v:.4f}" for s in SHAPES for v in (largest[s][k], theory[s][k]))]
        for k, x in enumerate(ratios)
    ],
)
for shape, limit in (("sphere", 0.6), ("ellipsoid", 0.6)):
    nb.record(
        f"(3): a good approximation for the {shape}, largest error at D/R = 0.1, deg",
        "good",
        largest[shape][2],
        largest[shape][2] < limit,
        "agrees if below a quarter of lbl1992's pixel of 2.25 deg",
    )
nb.record(
    "(3): 'both for hemispherical and hemi-ellipsoidal', error of the sphere over the ellipsoid's "
    "at D/R = 0.1",
    1,
    largest["sphere"][2] / largest["ellipsoid"][2],
    0.5 < largest["sphere"][2] / largest["ellipsoid"][2] < 2,
    differs="second order on the sphere, third on the ellipsoid",
)
for shape, power in (("sphere", 2), ("ellipsoid", 3)):
    slope = float(np.polyfit(np.log(ratios), np.log(largest[shape]), 1)[0])
    nb.record(
        f"(3): 'as long as D is small', power of D/R in the largest error, {shape}",
        "small with D",
        slope,
        abs(slope - power) < 0.1,
        f"theory: {power}",
    )

# %% tags=["hide-input"]
with style():
    fig, axes = plt.subplots(1, 3, figsize=(9.4, 3.1), layout="constrained")
    for ax, shape in zip(axes, SHAPES, strict=False):
        _, w, e = error(0.1, shape)
        scale = np.sqrt(1 / (1 + w[:, 2]))
        image = ax.scatter(
            w[:, 0] * scale,
            w[:, 1] * scale,
            c=e,
            s=nb.choose(quick=6, full=1),
            cmap="viridis",
            vmin=0,
            rasterized=True,
        )
        fig.colorbar(image, ax=ax, shrink=0.8, label="error (°)")
        ax.set(aspect="equal", xticks=[], yticks=[], title=f"{shape}, D/R = 0.1")
        ax.set_xlabel("x, plane of the lamp")
        ax.set_ylabel("y, camera to sample")
        ax.spines[:].set_visible(False)
    for shape, colour in zip(SHAPES, (BLUE, VERMILLION), strict=True):
        axes[2].loglog(ratios, largest[shape], "o", color=colour, label=shape)
        axes[2].loglog(ratios, theory[shape], color=colour)
    axes[2].set(xlabel="D/R", ylabel="largest error (°)", title="lines: theory")
    axes[2].set_xticks(ratios, [f"{x:g}" for x in ratios])
    axes[2].minorticks_off()
    axes[2].legend()
nb.figure(
    fig, "eq3", "Error of eq. (3) over the hemisphere for sphere and ellipsoid, and its growth."
)

# %% [markdown]
# ## What else follows from it
#
# The inverse is the same formula with D replaced by -D: camera and sample change places. A wrong
# sign of D, on the other hand, turns directions by some 20°, twice what the whole of eq. (3)
# corrects. And the dome does not show all directions with equal size: a pixel's solid angle at the
# sample varies by half over the hemisphere, which sums over pixels must weigh.

# %%
theta, phi, _ = hemisphere_quadrature(40, 80)
returned = camera_angles(*reflected_angles(theta, phi, R=R, D=15.0), R=R, D=15.0)
back = np.degrees(
    2 * np.arcsin(np.linalg.norm(unit_vectors(*returned) - unit_vectors(theta, phi), axis=-1) / 2)
)
nb.record(
    "(3): inverse by D -> -D, largest error of the round trip, deg",
    0,
    float(back.max()),
    back.max() < 1e-6,
)
w_c, exact, wrong = error(0.1, "ellipsoid", sign=-1)
nb.record(
    "(3): D with the wrong sign at D/R = 0.1, median error, deg",
    "not said",
    float(np.median(wrong)),
    18 < np.median(wrong) < 23,
    "a picture that is drawn upside down does this",
)
ratio = solid_angle_ratio(theta, phi, R=R, D=15.0)
low, high = float(ratio.min()), float(ratio.max())
nb.record(
    "(3): solid angle at the sample over that at the camera, D/R = 0.1",
    "'near perfect imaging of the reflected angles'",
    f"{low:.2f} to {high:.2f}",
    high / low < 1.1,
    differs="directions are stretched and squeezed; eq. (3) is known, so that its Jacobian is too",
)
nb.absent("R, D, lens and lamp of the LBL instrument", "not stated in the paper")
nb.done()
