"""Checks of models and of measured samples: reciprocity, sign, energy, symmetry, quantity."""

from gonio.checks.model import check_model
from gonio.checks.model_report import Finding, ModelReport
from gonio.checks.samples import check_samples
from gonio.checks.samples_report import BRDF, UNDECIDED, Pairing, SamplesReport
from gonio.models.albedo import Albedo, bihemispherical_albedo, directional_albedo

__all__ = [
    "BRDF",
    "UNDECIDED",
    "Albedo",
    "Finding",
    "ModelReport",
    "Pairing",
    "SamplesReport",
    "bihemispherical_albedo",
    "check_model",
    "check_samples",
    "directional_albedo",
]
