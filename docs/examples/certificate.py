import numpy as np

from gonio.calibration.frames.certified import estimate
from gonio.certificate import Certificate

# 8 deg/hemispherical; f falls by 10 % towards 75 deg
total = Certificate(kind="total", reflectance=0.97, uncertainty=0.005, rolloff=0.1)
print(f"pi f(0 deg) = {np.pi * estimate(total).brdf(0.0, 0.0, 0.0):.3f}")
