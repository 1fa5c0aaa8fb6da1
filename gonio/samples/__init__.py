"""BRDF samples: output of calibration, content of files, input of fitting.

Samples of a surface seen in transmission (BTDF) differ only in their incident direction. It lies
below the surface and is stored mirrored in the plane of the sample, so that both polar angles are
at most 90 deg. Directly transmitted light then has the specular direction (theta_i, phi_i + 180
deg), and models of reflection also fit lobes of transmission.
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
