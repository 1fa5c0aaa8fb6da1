import numpy as np

import gonio
from gonio.dome_map import DomeMap
from gonio.geometry import unit_vectors
from gonio.instrument import preset
from gonio.metadata import Plan

steps = (10.0, 30.0, 50.0)
plan = Plan(theta_i_deg=steps, rotations_deg=(0.0, 45.0, 90.0), exposures_s=(1e-3, 16e-3, 256e-3))
gonio.simulate(
    "rolled_aluminum", instrument=preset("modern12").with_pixels(52), plan=plan, rig_seed=4,
    seed=1, output="metal.gonio",
)  # fmt: skip
gonio.calibrate_dome(gonio.reduce("metal.gonio"), "ward").map.save("dome.nc")
dome = DomeMap.load("dome.nc")
after, before = dome.sd(unit_vectors(np.radians([30.0]), np.radians([180.0])))
print(f"dome of {dome.rig}: at 30 deg on the mirror side its sd is {after.max() / before[0]:.2f}")
print("of what it was before the lobe went there")
