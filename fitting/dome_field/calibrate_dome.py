"""`calibrate_dome`: samples of sessions on one rig -> map of its dome."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gonio.dome_map import DomeMap
from gonio.errors import ConfigurationError
from gonio.fitting.dome_field.findings import Findings, Spectrum
from gonio.fitting.dome_field.part import azimuths, lab_directions
from gonio.fitting.dome_field.posterior import Uncertainty
from gonio.fitting.dome_field.rig import Rig, common_rig
from gonio.fitting.dome_field.solve import Joint, solve
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.screening import screened
from gonio.geometry import FloatArray, rotated
from gonio.models import Model
from gonio.models import get as get_model
from gonio.samples import BRDFSamples
from gonio.tangent_field import tangents
from gonio.wording import counted

_LEAST = 1e-3  # information on a coordinate of unit prior variance that a map keeps


@dataclass(frozen=True)
class DomeCalibration:
    """A map with what was found of material and rig.

    Parameters
    ----------
    map : DomeMap
    findings : Findings
    parameters : tuple of dict
        Value and standard uncertainty of every parameter of each session, without the standard's.
    """

    map: DomeMap
    findings: Findings
    parameters: tuple[dict[str, tuple[float, float]], ...]

    def save(self, path: str) -> None:
        """Write the map."""
        self.map.save(path)


def calibrate_dome(
    samples: BRDFSamples | Sequence[BRDFSamples],
    model: str | Model | Sequence[str | Model],
    *,
    threads: int | None = None,
) -> DomeCalibration:
    """Find the slope errors of a dome and the material(s) of one or several sessions together.

    Parameters
    ----------
    samples : BRDFSamples or sequence of them
        Of sessions on one rig, by `gonio.reduce`.
    model : str or Model, or a sequence of them
        One for all sessions, or one for each.
    threads : int, optional
        The result does not depend on it.

    Returns
    -------
    DomeCalibration

    Raises
    ------
    ConfigurationError
        If the sessions are of different rigs, or the numbers of models and sessions differ.
    DataError
        If samples do not say on which rig they were measured.

    Examples
    --------
    >>> import gonio, tempfile
    >>> instrument = gonio.instrument.preset("modern12").with_pixels(52)
    >>> plan = gonio.metadata.Plan(
    ...     theta_i_deg=(20, 30), rotations_deg=(0,), exposures_s=instrument.sensor.exposures_s
    ... )
    >>> session = gonio.simulate("rolled_brass", output=tempfile.mkdtemp() + "/brass.gonio",
    ...                          instrument=instrument, plan=plan)
    >>> result = calibrate_dome(gonio.reduce(session), "ward")
    >>> result.map.rig
    'modern12 no. 7da18a3e'
    """
    several = [samples] if isinstance(samples, BRDFSamples) else list(samples)
    models = [model] if isinstance(model, str | Model) else list(model)
    if not several:
        raise ConfigurationError("a map needs the samples of one session at least.")
    if len(models) == 1:
        models = models * len(several)
    if len(models) != len(several):
        raise ConfigurationError(
            f"{counted(len(models), 'model')} for {counted(len(several), 'session')}: give one "
            "for all, or one for each in their order.",
            value=len(models),
        )
    rigs = [Rig.of(each, f"samples {k}") for k, each in enumerate(several, start=1)]
    rig = common_rig(rigs)
    used = [screened(each).samples for each in several]
    minima = [
        find_minimum(each, get_model(name), threads=threads)
        for each, name in zip(used, models, strict=True)
    ]
    joint = solve(minima, rig.prior)
    spectrum, uncertainty = Spectrum.of(joint), Uncertainty.of(joint.information)
    findings = Findings.of(joint, spectrum)
    dome = DomeMap(
        rig.identity, rig.instrument, rig.shape, rig.mapping, rig.R, rig.D, joint.nodes,
        joint.stated, _mean(joint), _gain(joint, spectrum),
        tuple(each.session_sha256 for each in rigs), findings.to_dict(),
    )  # fmt: skip
    sd = np.sqrt(np.diag(uncertainty.covariance))
    parameters = tuple(
        {
            q.name: (float(p), float(sd[place]))
            for q, p, place in zip(
                minimum.problem.parameters, own, joint.layout.of_session(k), strict=True
            )
        }
        for k, (minimum, own) in enumerate(zip(minima, joint.state.p, strict=True))
    )
    return DomeCalibration(dome, replace(findings), parameters)


def _gain(joint: Joint, spectrum: Spectrum) -> FloatArray:
    """What the samples take off the prior covariance, as columns."""
    kept = spectrum.information > _LEAST
    q = spectrum.information[kept]
    k, root = len(joint.nodes), joint.nodes.root
    vectors = spectrum.vectors[:, kept] * np.sqrt(q / (1 + q))
    return np.concatenate([root @ vectors[:k], root @ vectors[k:]])


def _mean(joint: Joint) -> FloatArray:
    """The field, and what the rig's calibrated figures and eq. (3) move directions by."""
    from scipy.spatial import cKDTree

    mean = np.array(joint.state.field)
    part = joint.parts[0]
    lab, turn = lab_directions(part.problem), azimuths(part.problem)
    _, nearest = cKDTree(lab).query(joint.nodes.directions)
    axes = tangents(lab[nearest])
    for each in part.draws:
        if each.term.shift is None or not each.term.of_rig:
            continue
        shift = rotated(each.term.shift[nearest], turn[nearest])
        size = joint.state.z[each.draw[nearest]]
        mean += size * np.stack([np.sum(shift * axis, axis=1) for axis in axes])
    return mean
