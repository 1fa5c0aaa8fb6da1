import numpy as np

from gonio.geometry import Directions
from gonio.samples import BRDFSamples

directions = Directions(theta_i=0.5, phi_i=0.0, theta_r=[0.1, 0.3, 0.5], phi_r=3.1)
samples = BRDFSamples(
    directions,
    value=np.array([0.31, 0.30, 0.29]),
    u_independent=np.array([0.003, 0.003, 0.003]),
)
samples.save("readings.nc")
again = BRDFSamples.load("readings.nc")
print(len(again), again.value)
