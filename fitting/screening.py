"""Samples as a fit uses them, and what is implausible in them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gonio.checks import Plausibility, plausible
from gonio.fitting.result import FitResult
from gonio.samples import BRDFSamples

Samples = BRDFSamples | Sequence[BRDFSamples] | Mapping[str, BRDFSamples]


@dataclass(frozen=True)
class Screening:
    """What questions to the samples found before a fit.

    Parameters
    ----------
    samples : BRDFSamples, sequence or mapping of them
        Without the values that are no measurements.
    warnings : tuple of str
    findings : tuple of dict
        Every finding as plain data.
    """

    samples: Any
    warnings: tuple[str, ...] = ()
    findings: tuple[dict[str, Any], ...] = ()

    def noted(self, result: FitResult) -> FitResult:
        """A result with the warnings of the samples before its own."""
        if not self.findings:
            return result
        return replace(
            result,
            warnings=(*self.warnings, *result.warnings),
            diagnostics={**result.diagnostics, "plausibility": list(self.findings)},
        )


def screened(samples: Any) -> Screening:
    """Ask every question of the samples of a fit.

    Parameters
    ----------
    samples : BRDFSamples, sequence or mapping of them
        Anything else comes back as it is.

    Raises
    ------
    DataError
        If samples cannot be what they claim.
    """
    if isinstance(samples, BRDFSamples):
        one = _asked(samples, "the samples")
        return Screening(one.samples, tuple(one.warnings), _plain(one, ""))
    if isinstance(samples, Mapping):
        named = {name: _asked(each, str(name)) for name, each in samples.items()}
        return Screening(
            {name: each.samples for name, each in named.items()},
            tuple(f"{name}: {text}" for name, each in named.items() for text in each.warnings),
            tuple(found for name, each in named.items() for found in _plain(each, str(name))),
        )
    if isinstance(samples, Sequence) and all(isinstance(s, BRDFSamples) for s in samples):
        several = [_asked(each, f"samples {k + 1}") for k, each in enumerate(samples)]
        return Screening(
            [each.samples for each in several],
            tuple(f"samples {k + 1}: {t}" for k, each in enumerate(several) for t in each.warnings),
            tuple(f for k, each in enumerate(several) for f in _plain(each, f"samples {k + 1}")),
        )
    return Screening(samples)


def _asked(samples: Any, name: str) -> Plausibility:
    if not isinstance(samples, BRDFSamples):
        return Plausibility(samples, ())
    path = samples.metadata.get("path")
    return plausible(samples).require(str(path) if path else name)


def _plain(found: Plausibility, name: str) -> tuple[dict[str, Any], ...]:
    where = {"input": name} if name else {}
    return tuple({**finding.describe(), **where} for finding in found.findings)
