"""Samples of one session, calibrated by themselves for the fit of one model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from gonio.errors import ConfigurationError
from gonio.fitting.dome_field.calibrated_samples import calibrated_samples
from gonio.fitting.dome_field.findings import Findings, Spectrum
from gonio.fitting.dome_field.posterior import Uncertainty
from gonio.fitting.dome_field.rig import Rig
from gonio.fitting.dome_field.solve import solve
from gonio.fitting.minimum.find import find_minimum
from gonio.fitting.result import FitResult
from gonio.models import Model
from gonio.samples import BRDFSamples


@dataclass(frozen=True)
class SelfCalibration:
    """Calibrated samples, and what was found.

    Parameters
    ----------
    samples : BRDFSamples
    findings : Findings
    """

    samples: BRDFSamples
    findings: Findings

    def noted(self, result: FitResult) -> FitResult:
        """A fit to the samples with what was found, and with the verdict of the predictions.

        A fit is refused where the field may hide that its model is wrong. It stays undecided where
        the uncertainty of the lamp's cone may be the cause.
        """
        verdict, failures = result.verdict, self.findings.failures
        if failures and verdict is not None:
            reasons = failures if verdict.fits else (verdict.reason, *failures)
            reason = "; ".join(reasons)
            if verdict.fits and self.findings.hidden_by_cone:
                verdict = replace(verdict, kind="undecided", reason=reason)
            else:
                verdict = replace(verdict, kind="does_not_fit", reason=reason)
        return replace(
            result,
            verdict=verdict,
            warnings=(*(f"{line}." for line in self.findings.warnings), *result.warnings),
            diagnostics={**result.diagnostics, "self_calibration": self.findings.to_dict()},
        )


def self_calibrated(samples: Any, model: Model, **options: Any) -> SelfCalibration:
    """Find the dome's slope errors together with the material.

    Parameters
    ----------
    samples : BRDFSamples
        Of a session.
    model : Model
    **options
        Of `gonio.fitting.minimum.find.find_minimum`.

    Raises
    ------
    ConfigurationError
        For several samples, weights that are not the uncertainties, or a loss.
    DataError
        If the samples do not say on which rig they were measured.
    """
    if not isinstance(samples, BRDFSamples):
        raise ConfigurationError(
            "self_calibrate takes the samples of one session; make a map of the dome of several "
            "sessions with gonio.calibrate_dome."
        )
    if options.get("weights") not in (None, "sd") or options.get("loss", "chi2") != "chi2":
        raise ConfigurationError(
            "self_calibrate needs the stated uncertainties as weights and loss chi2; leave weights "
            "and loss out."
        )
    rig = Rig.of(samples)
    joint = solve([find_minimum(samples, model, **options)], rig.prior)
    uncertainty = Uncertainty.of(joint.information)
    calibrated = calibrated_samples(joint, uncertainty, 0)
    return SelfCalibration(calibrated, Findings.of(joint, Spectrum.of(joint)))
