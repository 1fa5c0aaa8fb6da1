from gonio.metadata import Plan

plan = Plan(theta_i_deg=(15.0, 45.0), rotations_deg=(0.0, 90.0), exposures_s=(1e-3, 16e-3))
print(plan.n_frames, "frames")
