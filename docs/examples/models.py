from math import pi

from gonio import models
from gonio.geometry import Directions

ward = models.get("ward")
mirror = Directions(theta_i=0.5, phi_i=0.0, theta_r=0.5, phi_r=pi)
value = ward(mirror, rho_d=0.1, rho_s=0.2, alpha_x=0.1, alpha_y=0.2)
print(f"{value:.4f} sr^-1 in the mirror direction")
print([f"{p.name}: {p.lower:g} to {p.upper:g}" for p in ward.parameters])
