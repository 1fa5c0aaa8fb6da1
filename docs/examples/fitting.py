import numpy as np

from gonio import models
from gonio.fitting.fit import fit
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

theta_i, theta_r = np.meshgrid(np.radians([20, 40, 60]), np.radians(np.arange(0, 80, 10)))
directions = Directions(theta_i.ravel(), 0.0, theta_r.ravel(), np.pi)
value = models.get("ward_isotropic")(directions, rho_d=0.2, rho_s=0.1, alpha=0.15)
noise = np.random.default_rng(1).normal(0.0, 0.01, value.shape)
samples = BRDFSamples(directions, value * (1 + noise), u_independent=0.01 * value)

result = fit(samples, model="ward_isotropic")
for name, estimate in result.parameters.items():
    print(f"{name} = {estimate.value:.4f} ± {estimate.stderr:.4f}")
