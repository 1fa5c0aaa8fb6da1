"""Slope errors of random domes, which replace the few patterns of the reduction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from gonio.calibration.effects.dome_slope import DRAWN, EFFECT
from gonio.geometry import FloatArray, unit_vectors
from gonio.instrument import Instrument
from gonio.instrument.imaging import trace_rays
from gonio.samples import BRDFSamples

N_DOMES = 32  # which gives their scatter to 1/sqrt(2 32) = 12 %


@dataclass(frozen=True)
class DrawnDomes:
    """Slope errors of `N_DOMES` drawn domes: by how much each turns the directions of pixels.

    The reduction makes a few patterns from the size and the correlation length of the errors.
    They suffice for a plan made by a person, but a search could find a plan that is insensitive
    to just these patterns.

    Parameters
    ----------
    w_r : ndarray, shape (n, 3)
        Directions from sample to a dome without errors.
    shifts : list of ndarray, shape (n, 3)
    """

    w_r: FloatArray
    shifts: list[FloatArray]

    @classmethod
    def draw(cls, instrument: Instrument, first: int) -> DrawnDomes:
        """Domes of the seeds from `first` on; none for an instrument without slope errors."""
        chief = instrument.model_copy(update={"rays_per_pixel": 1})
        none = {"slope_error_deg": 0.0, "rim_slope_error_deg": 0.0}
        smooth = chief.model_copy(update={"dome": chief.dome.model_copy(update=none)})
        w_r = trace_rays(smooth, 0).w_r[:, 0]
        if smooth == chief:
            return cls(w_r, [])
        return cls(w_r, [trace_rays(chief, first + k).w_r[:, 0] - w_r for k in range(N_DOMES)])

    def replace_slope_terms(self, samples: BRDFSamples) -> BRDFSamples:
        """The samples with these domes in place of the reduction's terms for slope errors.

        The domes are shared terms of one name, each with the weight 1/sqrt(N_DOMES).
        """
        if not self.shifts:
            return samples
        # The dome stands still in the laboratory; the sample's azimuth is minus the lamp's.
        psi = -samples.directions.phi_i
        where = unit_vectors(samples.directions.theta_r, samples.directions.phi_r + psi)
        _, nearest = cKDTree(self.w_r).query(where)
        cos, sin = np.cos(psi), np.sin(psi)
        terms = []
        for shift in self.shifts:
            x, y, z = shift[nearest].T / np.sqrt(len(self.shifts))
            turned = np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=1)
            terms.append(DRAWN.shared(shift=turned, effect=EFFECT.key))
        others = tuple(term for term in samples.shared if term.effect != EFFECT.key)
        return replace(samples, shared=(*others, *terms))
