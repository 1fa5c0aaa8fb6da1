"""Samples of a session with the joint solution taken out, for an ordinary fit.

Viewing directions are moved by the field, values are freed of the lamp's drift, and shared errors
carry what is still unknown. A fit of the same model then ends at the joint solution with its
covariance (`gonio.fitting.dome_field.posterior`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gonio.fitting.dome_field.equations import floor
from gonio.fitting.dome_field.part import is_unknown
from gonio.fitting.dome_field.posterior import Uncertainty, change_of_samples, modes
from gonio.fitting.dome_field.solve import Joint
from gonio.geometry import Directions, FloatArray, angles
from gonio.samples import BRDFSamples, SharedTerm

# What image formation and the integration over cells leave, as a fraction of each parameter: 1e-4,
# and 2e-4 more where the smallest cell is 0.03 rad wide, as found on rigs without other errors.
FLOOR_OF_PARAMETERS = 1e-4
_COARSE = 2e-4 / 0.03**2
EFFECT = "dome_field"
IMAGE_FORMATION = "image_formation"


def calibrated_samples(joint: Joint, uncertainty: Uncertainty, number: int) -> BRDFSamples:
    """The samples of one session, moved by the joint solution, with their shared errors.

    Parameters
    ----------
    joint : Joint
    uncertainty : Uncertainty
    number : int
        Of the session.
    """
    part, state = joint.parts[number], joint.state
    samples = part.problem.samples
    shift, turn = part.moves(state.field, state.z)
    moved = part.problem.with_directions(shift=shift, turn=turn)
    centre = samples.directions.vectors()[1] + shift
    theta_r, phi_r = angles(centre / np.linalg.norm(centre, axis=1, keepdims=True))
    factor, offset = part.correction(state.z)
    # Where a turn of the sample was found, both azimuths follow it.
    n = len(samples)
    directions = Directions(
        samples.directions.theta_i,
        np.broadcast_to(samples.directions.phi_i, n) - turn,
        np.minimum(theta_r, np.pi / 2),
        phi_r - turn,
    )
    shared = tuple(term for term in samples.shared if not (term.typical or is_unknown(term)))
    left = floor(joint.rows[number].slope)

    def scaled(column: FloatArray | None, more: FloatArray | float = 0.0) -> FloatArray | None:
        return None if column is None else np.sqrt(column**2 + more**2) / np.abs(factor)

    return replace(
        samples,
        directions=directions,
        value=(samples.value - offset) / factor,
        u_independent=scaled(samples.u_independent, left),
        u_reference=scaled(samples.u_reference),
        noise_slope=None if samples.noise_slope is None else samples.noise_slope / factor,
        shared=(*shared, *_unknown_still(joint, uncertainty, number), *_floor(joint, number)),
        cells=None if samples.cells is None else moved.cells,
        history=(*samples.history, "self-calibrated: moved by the slope errors of the dome"),
    )


def _unknown_still(joint: Joint, uncertainty: Uncertainty, number: int) -> Iterator[SharedTerm]:
    """What is unknown of field and draws, as errors of the session's parameters."""
    factor, _ = joint.parts[number].correction(joint.state.z)
    change = change_of_samples(joint, number, modes(joint, uncertainty, number))
    for k, column in enumerate(change.T, start=1):
        yield SharedTerm(
            f"dome and lamp, mode {k}",
            "what is unknown of the dome's slope errors, the lamp and the geometry",
            offset=column / factor,
            effect=EFFECT, evaluation="A", averages=False, constant=False, belongs_to="session",
        )  # fmt: skip


def _floor(joint: Joint, number: int) -> Iterator[SharedTerm]:
    """What image formation and integration leave, as an error of every parameter."""
    part, slope, p = joint.parts[number], joint.rows[number].slope, joint.state.p[number]
    omega = part.problem.samples.solid_angle
    coarse = 0.0 if omega is None else _COARSE * float(np.min(omega))
    size = FLOOR_OF_PARAMETERS + coarse
    for j, parameter in enumerate(part.problem.parameters):
        change = size * p[j] * slope.by_parameter[:, j] / slope.factor
        if np.any(change):
            yield SharedTerm(
                f"image formation, {parameter.name}",
                f"{size:.1e} of {parameter.name}: formation of images, integration over cells",
                offset=change,
                effect=IMAGE_FORMATION, evaluation="B", averages=False, constant=True,
                belongs_to="rig",
            )  # fmt: skip
