"""Checks of models and of measured samples: reciprocity, sign, energy, symmetry, quantity."""

from gonio.checks.model import check_model
from gonio.checks.model_report import Finding, ModelReport
from gonio.checks.pairs import Pairing
from gonio.checks.plausibility import Plausibility, measurements, plausible
from gonio.checks.quantity import BRDF, UNDECIDED
from gonio.checks.questions import Finding as SamplesFinding
from gonio.checks.samples import check_samples
from gonio.checks.samples_report import SamplesReport
from gonio.models.albedo import Albedo, bihemispherical_albedo, directional_albedo

__all__ = [
    "BRDF",
    "UNDECIDED",
    "Albedo",
    "Finding",
    "ModelReport",
    "Pairing",
    "Plausibility",
    "SamplesFinding",
    "SamplesReport",
    "bihemispherical_albedo",
    "check_model",
    "check_samples",
    "directional_albedo",
    "measurements",
    "plausible",
]
