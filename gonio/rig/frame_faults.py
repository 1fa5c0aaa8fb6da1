"""Faults of frames that only their files give away, and the files behind a session's findings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from gonio.calibration.faults.base import Finding
from gonio.calibration.faults.evidence import Evidence
from gonio.metadata import Metadata
from gonio.rig.frame_files import FrameIndex, describe
from gonio.rig.pictures import full_count
from gonio.rig.sources import Source

_SHOWN = 3  # files that a finding names
_FULL, _FEW = 0.98, 10  # of what so many bits hold; pixels at the end of the counts


def of_files(
    metadata: Metadata, n_summed: int, read: dict[FrameIndex, Source]
) -> tuple[Finding, ...]:
    """What is wrong with the files of a session's frames.

    Parameters
    ----------
    metadata : Metadata
    n_summed : int
        Pixels of a file in a pixel of the session.
    read : dict of Place to Source
        All frames.
    """
    return (
        *_fewer_bits(metadata, n_summed, read),
        *_empty(metadata, n_summed, read),
        *_same_files(read),
    )


def _fewer_bits(
    metadata: Metadata, n_summed: int, read: dict[FrameIndex, Source]
) -> Iterator[Finding]:
    """Counts that end where fewer bits end than the camera is said to have."""
    brightest = max(read.values(), key=lambda source: (source.high, source.at_high))
    saturation = metadata.camera.saturation_dn // n_summed
    most, bits = brightest.high, brightest.high.bit_length()
    full = most >= _FULL * ((1 << bits) - 1) and brightest.at_high >= _FEW
    if bits >= 8 and full and 2 * most <= saturation:
        yield Finding(
            "fewer_bits",
            "error",
            f"{brightest.file}: {brightest.at_high} pixels have {most} counts and none of any "
            f"frame has more; that is what {bits} bits hold, and "
            f"camera.saturation_dn is {saturation}: saturated pixels would pass for good ones. "
            "Write the frames with all bits of the camera, or correct saturation_dn, black_dn and "
            "gain_dn_per_e.",
        )


def _empty(metadata: Metadata, n_summed: int, read: dict[FrameIndex, Source]) -> Iterator[Finding]:
    """Frames in which every pixel has the same count, where some light was to be expected.

    The short exposures of a dark image may well be so, the longest may not, nor any that follows
    one with light; and not even the shortest may be saturated everywhere.
    """
    plan = metadata.plan
    full = full_count(metadata.camera) / n_summed
    last = len(plan.exposures_s) - 1
    for index, source in read.items():
        if not source.empty:
            continue
        shorter = [read[index._replace(exposure=k)] for k in range(index.exposure)]
        what = describe(plan, index)
        if source.low >= full:
            if index.exposure == 0:
                yield Finding(
                    "saturated_frame",
                    "error",
                    f"{source.file}: {what}: every pixel is saturated in the shortest exposure; "
                    "take a shorter one.",
                )
        elif index.exposure == last or any(not before.empty for before in shorter):
            yield Finding(
                "empty_frame",
                "error",
                f"{source.file}: {what}: every count is {source.low}; no light reached the camera "
                "or the file is empty. Take the frame again.",
            )


def _same_files(read: dict[FrameIndex, Source]) -> Iterator[Finding]:
    """Two frames that are one file, copied."""
    first: dict[str, Source] = {}
    for source in read.values():
        if source.empty:
            continue
        other = first.setdefault(source.sha256, source)
        if other is not source:
            yield Finding(
                "same_file",
                "error",
                f"{source.file}: is {other.file}, byte for byte; noise never comes twice. One of "
                "the two was copied over the other: take it again.",
            )


def with_files(
    findings: Iterable[Finding], metadata: Metadata, names: dict[FrameIndex, str]
) -> Iterator[Finding]:
    """Findings that name the files of the frames that they name."""
    called = _files_by_name(metadata, names)
    for finding in findings:
        text, files = finding.text, list[str]()
        for name, own in called:
            if name in text:
                # Not to be found again as the name of the image that the frame belongs to.
                text = text.replace(name, "")
                files = own + files if finding.text.startswith(name) else files + own
        more = f" and {len(files) - _SHOWN} more" if len(files) > _SHOWN else ""
        ending = f" ({', '.join(files[:_SHOWN])}{more})" if files else ""
        yield replace(finding, text=finding.text + ending)


def _files_by_name(metadata: Metadata, names: dict[FrameIndex, str]) -> list[tuple[str, list[str]]]:
    """Files of each image and frame by what findings call it, longest name first."""
    nowhere = np.zeros((1, 1))
    evidence = Evidence(metadata, nowhere, nowhere)
    called: dict[str, list[str]] = {}
    for index, file in names.items():
        if index.channel == 0:
            image = (index.role, index.take, index.incidence)
            called.setdefault(evidence.name(image), []).append(file)
            called[evidence.name(image, index.exposure)] = [file]
    return sorted(called.items(), key=lambda each: -len(each[0]))
