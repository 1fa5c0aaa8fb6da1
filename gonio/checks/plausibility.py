"""Samples without the values that are no measurements, and what is implausible in the others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gonio.checks.pairs import groups
from gonio.checks.questions import LEVELS, Evidence, Finding, all_questions
from gonio.errors import DataError
from gonio.samples import BRDFSamples

LISTED_GROUPS = 6


@dataclass(frozen=True)
class Plausibility:
    """Result of `plausible`.

    Parameters
    ----------
    samples : BRDFSamples
        Without the values that are no measurements.
    findings : tuple of Finding
        What is implausible, refusals first.
    """

    samples: BRDFSamples
    findings: tuple[Finding, ...]

    def at(self, *levels: str) -> tuple[Finding, ...]:
        """The findings of these levels."""
        return tuple(finding for finding in self.findings if finding.level in levels)

    @property
    def warnings(self) -> list[str]:
        """The sentences that a fit prints."""
        return [finding.text for finding in self.at("warning")]

    def require(self, where: str = "the samples") -> Plausibility:
        """Refuse samples that cannot be what they claim.

        Raises
        ------
        DataError
            With the evidence and the cure.
        """
        refused = self.at("refuse")
        if refused:
            more = f" ({len(refused) - 1} more such findings.)" if len(refused) > 1 else ""
            raise DataError(f"{where}: {refused[0].text}{more}", value=refused)
        return self


def measurements(samples: BRDFSamples) -> Plausibility:
    """Samples without the values that are no measurements: codes for missing readings.

    The metadata of the samples keep what was left out, under ``reading``.
    """
    findings, bad = _asked(samples, of_values=True)
    if not bad:
        return Plausibility(samples, findings)
    keep = np.ones(len(samples), dtype=bool)
    keep[sorted(bad)] = False
    reading = dict(samples.metadata.get("reading", {}))
    left_out = [f.describe() for f in findings if f.left_out]
    reading["no_measurements"] = [*reading.get("no_measurements", []), *left_out]
    kept = samples.select(keep, "values that are no measurements left out")
    kept = replace(kept, metadata={**kept.metadata, "reading": reading})
    return Plausibility(kept, tuple(f for f in findings if not f.left_out))


def plausible(samples: BRDFSamples) -> Plausibility:
    """Ask every question of samples, after leaving out the values that are no measurements.

    Parameters
    ----------
    samples : BRDFSamples
        Several wavelengths and channels are asked one by one; samples of images are not asked.

    Returns
    -------
    Plausibility

    Examples
    --------
    >>> from gonio.geometry import Directions
    >>> theta = np.radians(np.arange(5.0, 65.0, 5.0))
    >>> value = 0.1 + 0.01 * theta
    >>> value[3] = -9999
    >>> found = plausible(BRDFSamples(Directions(0.3, 0.0, theta, 0.0), value))
    >>> len(found.samples), [finding.code for finding in found.findings]
    (11, ['missing_code'])
    """
    screened = measurements(samples)
    recorded = screened.samples.metadata.get("reading", {}).get("no_measurements", ())
    before = [Finding.described(record) for record in recorded]
    findings, _ = _asked(screened.samples, of_values=False)
    every = [*before, *screened.findings, *findings]
    return Plausibility(screened.samples, tuple(sorted(every, key=lambda f: LEVELS.index(f.level))))


def _asked(samples: BRDFSamples, *, of_values: bool) -> tuple[tuple[Finding, ...], set[int]]:
    """Findings of the questions of a kind, and the samples that are no measurements."""
    # Images that gonio reduced have directions and a unit of its own, and noise about 0 is noise.
    if not len(samples) or samples.image is not None:
        return (), set()
    whole = Evidence(samples)
    parts = _parts(samples)
    evidence = {name: Evidence(samples[index]) for name, index in parts.items() if name}
    findings: list[Finding] = []
    bad: set[int] = set()
    for question in all_questions():
        if question.of_values != of_values:
            continue
        answers: list[tuple[str, Finding]] = []
        if question.of_file or not evidence:
            answers = [("", finding) for finding in question.ask(whole)]
        else:
            for name, own in evidence.items():
                answers += [
                    (name, _at(finding, parts[name].tolist())) for finding in question.ask(own)
                ]
        bad.update(k for _, finding in answers if finding.left_out for k in finding.samples)
        findings += _merged(answers)
    return tuple(findings), bad


def _parts(samples: BRDFSamples) -> dict[str, np.ndarray[tuple[int], np.dtype[np.int64]]]:
    """Indices of the samples of each wavelength and channel, by name; one is called ""."""
    if samples.wavelength_nm is None and samples.channel is None:
        return {"": np.arange(len(samples))}
    group = groups(samples)
    numbers = np.unique(group)
    if len(numbers) < 2:
        return {"": np.arange(len(samples))}
    parts = {}
    for number in numbers.tolist():
        index = np.flatnonzero(group == number)
        words = []
        if samples.wavelength_nm is not None:
            words.append(f"{samples.wavelength_nm[index[0]]:g} nm")
        if samples.channel is not None:
            words.append(f"channel {samples.channel[index[0]]}")
        parts[", ".join(words)] = index
    return parts


def _at(finding: Finding, index: Sequence[int]) -> Finding:
    """A finding of a part with its samples counted in the whole."""
    return replace(finding, samples=tuple(index[k] for k in finding.samples))


def _merged(answers: Iterable[tuple[str, Finding]]) -> list[Finding]:
    """One finding for each code: that of the first part, with the names of the others."""
    by_code: dict[tuple[str, str], list[tuple[str, Finding]]] = {}
    for name, finding in answers:
        by_code.setdefault((finding.code, finding.level), []).append((name, finding))
    merged = []
    for same in by_code.values():
        name, first = same[0]
        names = [n for n, _ in same]
        if len(same) > 1 and name:
            shown = ", ".join(names[1:LISTED_GROUPS])
            rest = f" and {len(names) - LISTED_GROUPS} more" if len(names) > LISTED_GROUPS else ""
            text = f"{name}: {first.text} (The same at {shown}{rest}.)"
        else:
            text = f"{name}: {first.text}" if name else first.text
        merged.append(
            replace(
                first,
                text=text,
                samples=tuple(k for _, f in same for k in f.samples),
                lines=tuple(sorted({k for _, f in same for k in f.lines})),
            )
        )
    return merged
