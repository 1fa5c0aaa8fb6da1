from pathlib import Path

from gonio.plan_file import read_plan

Path("plan.toml").write_text(
    "[plan]\ntheta_i_deg = [0, 20, 40, 60]\nrotations_deg = [0, 90]\nexposures_s = [0.004]\n"
)
plan = read_plan("plan.toml")  # what 'gonio design -o' writes
print(plan.n_frames, "frames at", plan.theta_i_deg, "deg")
