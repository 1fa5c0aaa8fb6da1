"""BRDF samples: what calibration makes, what files hold, what fitting takes.

Samples of a surface seen in transmission (BTDF) are the same but for their incident direction:
it lies below the surface and is stored mirrored in the plane of the sample, so that both polar
angles are at most 90 deg. Light that goes straight through then leaves where a mirror would send
it, at (theta_i, phi_i + 180 deg), and the models of reflection fit lobes of transmission as they
stand.
"""

from gonio.samples.brdf_samples import BRDFSamples
from gonio.samples.record import (
    ANGLES,
    CONVENTION,
    FLAG_ENTRY,
    FLAG_PARTIAL,
    MAX_SAMPLES,
    MIRRORED,
    QUANTITIES,
    SCHEMA,
    Cells,
    Quantity,
    SampleRecord,
)
from gonio.shared_term import SharedTerm

__all__ = [
    "ANGLES",
    "CONVENTION",
    "FLAG_ENTRY",
    "FLAG_PARTIAL",
    "MAX_SAMPLES",
    "MIRRORED",
    "QUANTITIES",
    "SCHEMA",
    "BRDFSamples",
    "Cells",
    "Quantity",
    "SampleRecord",
    "SharedTerm",
]
