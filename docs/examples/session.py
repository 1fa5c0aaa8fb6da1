import gonio
from gonio.instrument import preset
from gonio.metadata import Plan
from gonio.session import Session

gonio.simulate(
    "clay_vase",
    instrument=preset("ideal12").with_pixels(64),
    plan=Plan(theta_i_deg=(20.0, 60.0), rotations_deg=(0.0,), exposures_s=(1e-3, 16e-3)),
    output="clay.gonio",
    seed=1,
)
session = Session.open("clay.gonio")
print(session.n_done, "frames;", session.metadata.plan.theta_i_deg, "deg")
print(session.metadata.geometry.shape, session.metadata.camera.columns, "pixels a row")
