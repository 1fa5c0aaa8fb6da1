"""Which shared errors a fit is asked to profile, by name."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Literal

from gonio.errors import ConfigurationError
from gonio.samples import BRDFSamples

Nuisance = Literal["none", "all"] | Sequence[str]


def profiled_terms(samples: BRDFSamples, nuisance: Nuisance) -> tuple[str, ...]:
    """Names of the shared terms that are to be profiled.

    Parameters
    ----------
    samples : BRDFSamples
    nuisance : {"none", "all"} or sequence of str
        Names of terms, or what stands before the comma in the names of several: "geometry" for
        "geometry, mode 1" and its like. All are those that are not `typical`: to learn the typical
        shape of an error that has another one is to learn something wrong for certain.

    Raises
    ------
    ConfigurationError
        If the samples state no shared error that can be profiled, or none of a name.

    Examples
    --------
    >>> import numpy as np
    >>> from gonio.geometry import Directions
    >>> from gonio.shared_term import SharedTerm
    >>> one = np.zeros(1)
    >>> terms = (SharedTerm("lamp, sample", "", 0.01), SharedTerm("standard", "", 0.02))
    >>> profiled_terms(BRDFSamples(Directions(one, one, one, one), one, shared=terms), ["lamp"])
    ('lamp, sample',)
    """
    if isinstance(nuisance, str):
        nuisance = {"none": [], "all": ["all"]}.get(nuisance, [nuisance])
    names = tuple(dict.fromkeys(term.name for term in samples.shared if not term.typical))
    typical = {term.name for term in samples.shared if term.typical}
    if nuisance and not names:
        raise ConfigurationError(
            "the samples state no shared errors that a fit could profile; give a session, or "
            "samples of 'gonio reduce'.",
            value=nuisance,
        )
    if list(nuisance) == ["all"]:
        return names
    chosen: list[str] = []
    for name in nuisance:
        family = [term for term in names if term.partition(",")[0] == name]
        matching = [name] if name in names else family
        if name in typical or (not matching and name in {t.partition(",")[0] for t in typical}):
            raise ConfigurationError(
                f"the shared error {name!r} is only a typical shape of an error of many shapes: it "
                f"is propagated and cannot be profiled; others can: {'; '.join(names)}.",
                value=name,
            )
        if not matching:
            raise ConfigurationError(
                f"nuisance {name!r} is not a shared error of these samples; give all, none, "
                f"or some of: {'; '.join(names)}.",
                value=name,
            )
        chosen += matching
    return tuple(name for name in names if name in chosen)


def parse_names(text: str) -> Nuisance:
    """What stands after `--nuisance`: all, none, or names between commas.

    A comma with a space after it belongs to a name.

    Examples
    --------
    >>> parse_names("standard,lamp, sample,azimuth")
    ['standard', 'lamp, sample', 'azimuth']
    """
    if text in ("none", "all"):
        return text
    return [name.strip() for name in re.split(r",(?! )", text) if name.strip()]
