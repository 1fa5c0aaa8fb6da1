"""Files as gonio 0.1 wrote them: run once with that version, `python tests/data_0_1/make.py`."""

from pathlib import Path

import numpy as np

import gonio
from gonio import models
from gonio.geometry import Directions
from gonio.instrument import preset
from gonio.metadata import Plan
from gonio.samples import BRDFSamples, SharedTerm

HERE = Path(__file__).parent


def measured(n=60, channel=None):
    """A rough surface with 1 % noise and a shared error of the standard."""
    rng = np.random.default_rng(1)
    theta = np.radians(rng.uniform(0, 70, (2, n)))
    where = Directions(theta[0], np.zeros(n), theta[1], rng.uniform(0, 2 * np.pi, n))
    f = models.get("oren_nayar")(where, rho=0.8, sigma=np.radians(25))
    return BRDFSamples(
        where,
        f * (1 + 0.01 * rng.standard_normal(n)),
        u_independent=0.01 * f,
        shared=(SharedTerm("standard", "certified reflectance of the standard", 0.01),),
        channel=channel,
        history=("made for tests",),
    )


def main():
    samples = measured()
    samples.save(HERE / "samples.nc")
    fit = gonio.fit(samples, model="oren_nayar", posterior=True, seed=1)
    fit.save(HERE / "fit.json")
    two = measured(channel=np.repeat(["red", "blue"], 30))
    gonio.fit(two, model="oren_nayar", share=("sigma",)).save(HERE / "joint.json")
    rig = preset("ideal12")
    coarse = {
        "rows": rig.sensor.rows // 16,
        "columns": rig.sensor.columns // 16,
        "pitch_um": tuple(16 * p for p in rig.sensor.pitch_um),
    }
    rig = rig.model_copy(update={"sensor": rig.sensor.model_copy(update=coarse)})
    gonio.simulate(
        model="oren_nayar",
        output=HERE / "session.gonio",
        parameters={"rho": 0.8, "sigma": np.radians(25)},
        instrument=rig,
        plan=Plan(theta_i_deg=(10.0, 50.0), rotations_deg=(0.0,), exposures_s=(0.01,)),
        seed=1,
    )


if __name__ == "__main__":
    main()
