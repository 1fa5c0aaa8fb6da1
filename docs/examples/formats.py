from pathlib import Path

from gonio import formats

Path("own.csv").write_text(
    "theta_i,phi_i,theta_r,phi_r,brdf,u_brdf\n30,0,0,0,0.31,0.003\n30,0,45,180,0.30,0.003\n"
)
samples = formats.read("own.csv")
print(samples.value, samples.u_independent)
print(samples.directions.theta_r.round(4), "rad")
