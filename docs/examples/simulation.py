from gonio.instrument import preset
from gonio.metadata import Plan
from gonio.simulation import simulate

session = simulate(
    model="lambert",
    parameters={"rho": 0.5},
    instrument=preset("ideal12").with_pixels(64),
    plan=Plan(theta_i_deg=(20.0,), rotations_deg=(0.0,), exposures_s=(16e-3,)),
    output="grey.gonio",
    seed=7,
)
print(session.metadata.plan.n_frames, "frames of", session.path.name)
