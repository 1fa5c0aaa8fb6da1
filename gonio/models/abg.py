"""The ABg model: light scattered by a polished surface, about the mirror direction.

f = A/(B + |beta - beta_0|^g)

beta and beta_0 are the projections of the viewing and of the mirror direction on the surface. With
both directions leaving the surface beta_0 = -(xi, yi), so that |beta - beta_0| is the length of
(xi + xr, yi + yr). Far from the mirror direction f falls with the power g, nearer than B^(1/g) it
is A/B. In the grating equation |beta - beta_0| is the spatial frequency of the roughness times the
wavelength: f is then in proportion to the power spectral density of the surface, whose usual law
is the K-correlation; ABg has its plateau and its slope.

Often printed is |sin theta_r - sin theta_i|, which is the same in the plane of incidence with
theta_r counted from the normal towards the mirror direction, and wrong elsewhere: with the polar
angles alone every direction of a cone about the normal would be the mirror direction.
"""

from __future__ import annotations

import math

from gonio.models._lobes import AboutMirrorProjection
from gonio.models.base import Claims, Model, Parameter


def kernel(
    xi: float,
    yi: float,
    zi: float,
    xr: float,
    yr: float,
    zr: float,
    A: float,
    B: float,
    g: float,
) -> tuple[float, float, float, float]:
    """f and its derivatives by A, B, g."""
    x = math.sqrt((xi + xr) ** 2 + (yi + yr) ** 2)
    if x <= 0.0:
        return A / B, 1 / B, -A / (B * B), 0.0
    power = x**g
    by_A = 1 / (B + power)
    f = A * by_A
    return f, by_A, -f * by_A, -f * power * by_A * math.log(x)


MODEL = Model(
    name="abg",
    title="ABg, scatter of polished surfaces",
    reference="Dittman 2006, Proc. SPIE 6291, 62910R; Pfisterer 2011, Optics & Photonics News "
    "22(10), 16",
    parameters=(
        Parameter("A", "A", "f |beta - beta_0|^g far from the mirror", 0.01, 0.0, 10.0,
                  linear=True, start=(1e-6, 1.0)),
        Parameter("B", "B", "|beta - beta_0|^g at half the peak", 1e-3, 1e-12, 10.0,
                  scale="log", start=(1e-8, 1.0), prior="log"),
        Parameter("g", "g", "power with which f falls", 2.0, 0.1, 10.0, start=(0.5, 4.0)),
    ),
    kernel=kernel,
    claims=Claims(isotropic=True),
    validity="Polished, clean surfaces whose roughness is well below the wavelength, at one "
    "wavelength, outside the mirror image of the lamp itself. The shape does not change with "
    "theta_i; energy is not conserved where A/B is large.",
    lobes=(AboutMirrorProjection(B="B", g="g"),),
)  # fmt: skip
