"""What a joint solution says of itself: misfit taken, plausibility, prediction, what was learnt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gonio.dome_map import LEARNT
from gonio.fitting.dome_field.evidence import LOG_SD
from gonio.fitting.dome_field.held_out import Prediction, predictions
from gonio.fitting.dome_field.solve import Joint
from gonio.geometry import FloatArray

IMPLAUSIBLE = 1e-3  # chance below which a field does not follow its prior
MUCH = 2.0  # chi-squared a number: a statement of the size is good to a factor of 1.4
# Mean relative change by the uncertainty of the lamp's cone, weighted by what a sample tells of the
# field, from which on the cone hides what the field should predict.
NEXT_TO_CONE = 0.01
LARGE = 3.0  # standard deviations of the statement by which a field may be larger


@dataclass(frozen=True)
class Spectrum:
    """The field in coordinates in which its prior covariance and the information are diagonal.

    Parameters
    ----------
    information : ndarray, shape (2 K,)
        Of each coordinate, whose prior variance is 1.
    vectors : ndarray, shape (2 K, 2 K)
    estimate : ndarray, shape (2 K,)
    """

    information: FloatArray
    vectors: FloatArray
    estimate: FloatArray

    @classmethod
    def of(cls, joint: Joint) -> Spectrum:
        m, pull = joint.data.whitened(joint.nodes)
        size, vectors = np.linalg.eigh(m)
        size = np.maximum(size, 0.0)
        return cls(size, vectors, vectors.T @ pull / (1 + size))

    def plausibility(self) -> tuple[float, int, float]:
        """chi-squared of the coordinates that are informed, their number and the chance of it.

        A coordinate with information q has an estimate of variance q / (1 + q) over all domes.
        """
        from scipy.stats import chi2

        informed = self.information > 1.0
        q = self.information[informed]
        size = float(np.sum(self.estimate[informed] ** 2 * (1 + q) / q))
        k = int(np.count_nonzero(informed))
        return size, k, float(chi2.sf(size, k)) if k else 1.0


@dataclass(frozen=True)
class Findings:
    """What was found, in numbers.

    Parameters
    ----------
    chi2_before, chi2_after : float
        chi-squared a sample, without and with the field.
    share : float
        Share of the misfit that the field and the lamp's drift took.
    sd_factor : float
        Standard deviation of the slope errors over what is stated.
    correlation : float
        Correlation length, radians.
    log_evidence : float
        Logarithm of the marginal likelihood over that without a field.
    field_chi2, field_p : float
        Plausibility of the field under its prior.
    field_n : int
        Number of coordinates of the field that the samples inform.
    known : float
        Share of the directions at which the field is known better than its prior.
    predictions : tuple of Prediction
    settled : bool
    by_cone : float
        Mean relative change of the lobe by the uncertainty of the lamp's cone.
    """

    chi2_before: float
    chi2_after: float
    share: float
    sd_factor: float
    correlation: float
    log_evidence: float
    field_chi2: float
    field_n: int
    field_p: float
    known: float
    predictions: tuple[Prediction, ...]
    settled: bool
    by_cone: float

    @classmethod
    def of(cls, joint: Joint, spectrum: Spectrum) -> Findings:
        size, k, p = spectrum.plausibility()
        prior = joint.nodes.prior
        return cls(
            chi2_before=joint.chi2_before / joint.n,
            chi2_after=joint.chi2 / joint.n,
            share=joint.share,
            sd_factor=prior.zenith / joint.stated.zenith,
            correlation=prior.correlation,
            log_evidence=joint.data.log_evidence(joint.nodes),
            field_chi2=size,
            field_n=k,
            field_p=p,
            known=_known(joint, spectrum),
            predictions=predictions(joint),
            settled=joint.settled,
            by_cone=_by_cone(joint),
        )

    @property
    def taught_nothing(self) -> bool:
        """Whether the samples leave the field at its prior everywhere."""
        return self.known == 0.0

    @property
    def failures(self) -> tuple[str, ...]:
        """Reasons for which the field may hide a wrong model, in words; empty where none."""
        reasons = []
        if not self.settled:
            reasons.append("material and slope errors of the dome do not settle together")
        failed = [each for each in self.predictions if each.fails]
        if failed:
            worst = max(failed, key=lambda each: each.ratio)
            reasons.append(
                "the slope errors found do not predict images that were left out "
                f"({worst.left_out}: chi2/n {worst.ratio:.3g})"
            )
        if np.log(self.sd_factor) > LARGE * LOG_SD:
            reasons.append(
                f"the slope errors would have to be {self.sd_factor:.2g} times what is stated"
            )
        if reasons and self.hidden_by_cone:
            reasons.append(
                "but the lobe is so narrow that the uncertainty of the lamp's half-angle changes "
                f"it by {100 * self.by_cone:.2g} %, and that alone may be the cause: measure the "
                "half-angle (lamp.half_angle_deg and its u_half_angle_deg)"
            )
        return tuple(reasons)

    @property
    def hidden_by_cone(self) -> bool:
        """Whether a failure may be that of the lamp's cone and not of the model."""
        return self.by_cone > NEXT_TO_CONE

    @property
    def notes(self) -> tuple[str, ...]:
        """What was found, in sentences for people."""
        lines = [
            f"self-calibrated: with the dome's slope errors as unknowns chi2/n is "
            f"{self.chi2_after:.3g} instead of {self.chi2_before:.3g}; they and the lamp took "
            f"{100 * self.share:.3g} % of the misfit",
        ]
        if not self.taught_nothing:
            lines.append(
                f"slope errors of the dome: {self.sd_factor:.2g} times the stated ones, correlated "
                f"over {np.degrees(self.correlation):.2g} deg; {100 * self.known:.0f} % of the "
                "directions are known better than before"
            )
        return tuple(lines)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user must know before the result is used."""
        lines = []
        if self.taught_nothing:
            lines.append(
                "the samples tell nothing of the dome's slope errors: their lobe is too wide. A "
                "map of the dome from another sample helps"
            )
        elif self.field_p < IMPLAUSIBLE and self.field_chi2 > MUCH * self.field_n:
            lines.append(
                "the field does not look as its statement says (correlation or growth to the rim): "
                f"chi2 of its {self.field_n} numbers is {self.field_chi2:.3g}"
            )
        if not (self.predictions or self.taught_nothing):
            lines.append(
                "one rotation at one incidence cannot be predicted from others: nothing tests "
                "whether the field hides a wrong model"
            )
        return tuple(lines)

    def to_dict(self) -> dict[str, Any]:
        """Plain data for documents."""
        return {
            "chi2_before": self.chi2_before,
            "chi2_after": self.chi2_after,
            "share": self.share,
            "sd_factor": self.sd_factor,
            "correlation_deg": float(np.degrees(self.correlation)),
            "log_evidence": self.log_evidence,
            "field_chi2": self.field_chi2,
            "field_n": self.field_n,
            "field_p": self.field_p,
            "known": self.known,
            "settled": self.settled,
            "by_cone": self.by_cone,
            "notes": list(self.notes),
            "predictions": [
                {"left_out": p.left_out, "chi2": p.chi2, "n": p.n, "fails": p.fails}
                for p in self.predictions
            ],
        }


def _known(joint: Joint, spectrum: Spectrum) -> float:
    """Share of the nodes at which a component is known better than its prior."""
    k = len(joint.nodes)
    root = joint.nodes.root
    lost = spectrum.information / (1 + spectrum.information)
    share = np.empty((2, k))
    prior = np.sum(root**2, axis=1)
    for component in range(2):
        rows = root @ spectrum.vectors[component * k : (component + 1) * k]
        share[component] = 1 - (rows**2 @ lost) / prior
    return float(np.mean(np.min(share, axis=0) < LEARNT**2))


def _by_cone(joint: Joint) -> float:
    """Mean relative change by propagated blurs, weighted by the information on the field."""
    change, information = 0.0, 0.0
    for part, rows, p in zip(joint.parts, joint.rows, joint.state.p, strict=True):
        weight = np.sum(rows.slope.by_field**2, axis=1) * rows.root**2
        blur = part.propagated_blur(p, joint.state.field, joint.state.z)
        change += float(weight @ blur)
        information += float(np.sum(weight))
    return change / information if information > 0 else 0.0
