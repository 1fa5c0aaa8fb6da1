"""What a fit gives back."""

from gonio.fitting.result.document import SCHEMA, plain
from gonio.fitting.result.estimates import (
    Estimate,
    NuisanceEstimate,
    PartFit,
    PosteriorSummary,
    Sharing,
)
from gonio.fitting.result.fit_result import FitResult
from gonio.fitting.result.record import FitRecord
from gonio.fitting.result.score import Score
from gonio.fitting.result.verdict import Verdict

__all__ = [
    "SCHEMA",
    "Estimate",
    "FitRecord",
    "FitResult",
    "NuisanceEstimate",
    "PartFit",
    "PosteriorSummary",
    "Score",
    "Sharing",
    "Verdict",
    "plain",
]
