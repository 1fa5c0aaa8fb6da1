"""A notebook in a fresh process: a model by a numpy function, measured, fitted, shown, exported."""

from __future__ import annotations

import subprocess
import sys

NOTEBOOK = '''
import numpy as np
import gonio
from gonio import models, plotting
from gonio.geometry import Directions
from gonio.samples import BRDFSamples

def sheen(directions, rho, gloss, width):
    off = directions.theta_r - directions.theta_i
    return rho / np.pi + gloss * np.exp(-((off / width) ** 2)) * (np.cos(directions.phi_r) < 0)

model = models.Model.from_function(
    sheen, {"rho": (0.5, 0, 1), "gloss": (0.2, 0, 5), "width": (0.2, 0.02, 1)})
rng = np.random.default_rng(1)
theta, phi_r = rng.uniform(0, 1.1, (2, 400)), rng.choice([0, 3.1], 400)
where = Directions(theta[0], 0.0, theta[1], phi_r)
f = model(where, rho=0.4, gloss=0.6, width=0.15)
samples = BRDFSamples(where, f + 0.005 * rng.standard_normal(400), np.full(400, 0.005))
result = gonio.fit(samples, model, posterior=True, seed=1)
plotting.corner(result.inference_data().posterior)
print(result)
frame = result.to_dataframe()
draws = result.inference_data(log_likelihood=True)
'''  # fmt: skip
CHECKS = """
truth = {"rho": 0.4, "gloss": 0.6, "width": 0.15}
assert all(abs(frame.loc[n, "value"] - v) < 4 * frame.loc[n, "stderr"] for n, v in truth.items())
assert result.ok and len(repr(result)) < 2000
assert draws.log_likelihood["brdf"].shape[-1] == 400
assert np.allclose(result.predict(where).value, model(where, **result.values()))
"""


def test_a_notebook_of_twenty_lines_runs(tmp_path):
    lines = [line for line in NOTEBOOK.splitlines() if line.strip()]
    assert len(lines) <= 20
    done = subprocess.run(
        [sys.executable, "-c", NOTEBOOK + CHECKS],
        capture_output=True, text=True, cwd=tmp_path, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "rho" in done.stdout
    assert "posterior: converged" in done.stdout
