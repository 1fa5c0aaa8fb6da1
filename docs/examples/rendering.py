from math import radians

from gonio.rendering import Directional, render, save_picture

radiance = render(
    "sphere",
    Directional(radians(30), radians(120)),
    "ward",
    {"rho_d": 0.1, "rho_s": 0.2, "alpha_x": 0.1, "alpha_y": 0.2},
    size=(48, 48),
)
save_picture(radiance, "sphere.png")
print(radiance.shape, f"brightest {radiance.max():.3f}")
