import gonio
from gonio.instrument import preset
from gonio.metadata import Plan

session = gonio.simulate(
    "clay_vase",
    instrument=preset("ideal12").with_pixels(64),
    plan=Plan(theta_i_deg=(20.0, 60.0), rotations_deg=(0.0,), exposures_s=(4e-3,)),
    output="clay.gonio",
    seed=1,
)
samples = gonio.reduce(session)
result = gonio.fit(samples, model="oren_nayar")
for name, estimate in result.parameters.items():
    print(f"{name} = {estimate.value:.3f} ± {estimate.stderr:.3f} {estimate.unit}")
