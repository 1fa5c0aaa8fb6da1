from gonio.instrument import preset
from gonio.planning.plan_search import design

result = design(
    "lambert", {"rho": 0.5}, instrument=preset("ideal12").with_pixels(64), wanted={"rho": 0.01}
)
print(result.plan.n_frames, "frames at", result.plan.theta_i_deg, "deg")
