"""A notebook in a fresh process: a model by a numpy function, measured, fitted, shown, exported."""

from __future__ import annotations

import subprocess
import sys

NOTEBOOK = '''
import numpy as np
import gonio
from gonio import models, plotting
from gonio.instrument import preset
from gonio.metadata import Plan

def sheen(directions, rho, gloss, width):
    tan2 = np.tan(directions.delta()) ** 2
    return rho / np.pi + gloss * np.exp(-tan2 / width**2)

model = models.Model.from_function(
    sheen, {"rho": (0.5, 0, 1), "gloss": (0.2, 0, 5), "width": (0.2, 0.02, 1)})
truth = {"rho": 0.4, "gloss": 0.6, "width": 0.3}
rig = preset("ideal12").with_pixels(26)
plan = Plan(theta_i_deg=(10, 50), rotations_deg=(0,), exposures_s=(1e-3, 32e-3))
session = gonio.simulate(model=model, parameters=truth, instrument=rig, plan=plan, output="sheen")
result = gonio.fit(gonio.reduce(session), model, posterior=True, seed=1)
plotting.corner(result.inference_data().posterior)
print(result)
frame = result.to_dataframe()
draws = result.inference_data(log_likelihood=True)
'''  # fmt: skip
CHECKS = """
assert all(abs(frame.loc[n, "value"] - v) < 4 * frame.loc[n, "stderr"] for n, v in truth.items())
assert result.ok and len(repr(result)) < 2000
assert draws.log_likelihood["brdf"].shape[-1] == result.n_samples
where = gonio.geometry.Directions(0.3, 0.0, np.linspace(0, 1, 5), np.pi)
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
