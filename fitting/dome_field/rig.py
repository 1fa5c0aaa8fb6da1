"""What samples say of the rig that they were measured on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gonio.errors import ConfigurationError, DataError
from gonio.samples import BRDFSamples
from gonio.tangent_field import FieldPrior

REFLECTION_DOUBLES = 2.0  # a mirror tilted by e turns a ray by 2 e
_AGAIN = "reduce the session again with 'gonio reduce'"


@dataclass(frozen=True)
class Rig:
    """The rig of some samples.

    Parameters
    ----------
    identity, instrument : str
    shape, mapping : str
        Of the dome, and how pixels became directions.
    R, D : float
        mm.
    prior : FieldPrior
        Displacement of directions by the dome's slope errors, as stated.
    session_sha256 : str
        Hash of the session.
    """

    identity: str
    instrument: str
    shape: str
    mapping: str
    R: float
    D: float
    prior: FieldPrior
    session_sha256: str

    @classmethod
    def of(cls, samples: BRDFSamples, name: str = "the samples") -> Rig:
        """The rig that the samples state.

        Raises
        ------
        DataError
            If they do not come from a session, or are of several channels.
        ConfigurationError
            If the session states no slope errors of the dome.
        """
        stated: dict[str, Any] | None = samples.metadata.get("rig")
        if stated is None or samples.image is None or "session_sha256" not in samples.metadata:
            raise DataError(
                f"{name} do not say on which rig they were measured, and the slope errors of its "
                f"dome cannot be found; {_AGAIN}."
            )
        if "dome_map" in samples.metadata:
            raise ConfigurationError(
                f"{name} were reduced with a map of the dome, which has been found already; fit "
                "them without self-calibration, or reduce the session without the map."
            )
        if samples.quantity != "BRDF":
            raise DataError(f"{name} are a {samples.quantity}; give samples in reflection.")
        if samples.channel is not None and len(set(samples.channel.tolist())) > 1:
            raise DataError(
                f"{name} hold several channels; select one of them, as with --select channel=NAME."
            )
        slope, rim = stated["slope_error_deg"] or 0.0, stated["rim_slope_error_deg"] or 0.0
        if slope <= 0:
            raise ConfigurationError(
                f"{name}: the session states no slope errors of the dome, so that there is nothing "
                "to find; state limits.slope_error_deg in session.json, or leave the "
                "self-calibration out."
            )
        identity = stated["identity"] or f"{stated['instrument']}, unnamed"
        prior = FieldPrior(
            zenith=float(np.radians(REFLECTION_DOUBLES * slope)),
            rim=float(np.radians(REFLECTION_DOUBLES * rim)),
            correlation=float(np.radians(stated["slope_correlation_deg"])),
        )
        return cls(
            identity, stated["instrument"], stated["shape"],
            stated["mapping"], stated["R_mm"], stated["D_mm"], prior,
            samples.metadata["session_sha256"],
        )  # fmt: skip


def common_rig(rigs: list[Rig]) -> Rig:
    """The one rig of several sessions.

    Raises
    ------
    ConfigurationError
        If they were measured on different rigs, or one of them is given twice.
    """
    first = rigs[0]
    for other in rigs[1:]:
        if other.mapping != first.mapping:
            raise ConfigurationError(
                f"the sessions were reduced with mapping {first.mapping!r} and {other.mapping!r}; "
                "reduce all with one.",
                value=other.mapping,
            )
        if (other.identity, other.shape) != (first.identity, first.shape):
            raise ConfigurationError(
                f"sessions of two rigs, {first.identity!r} and {other.identity!r}: each dome has "
                "its own map; give sessions of one rig.",
                value=other.identity,
            )
    hashes = [rig.session_sha256 for rig in rigs]
    if len(set(hashes)) < len(hashes):
        raise ConfigurationError(
            "one session is given twice, and its noise would count twice; give each once."
        )
    return first
