"""The samples of several channels as one list, with the errors that they share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gonio.fitting.problem.channels import (
    Channel,
)
from gonio.geometry import Directions, FloatArray
from gonio.samples import BRDFSamples, Cells, SharedTerm


def joined(channels: Sequence[Channel]) -> BRDFSamples:
    """All samples as one list, channel after channel, with the errors that they share.

    A shared error of one source acts across its channels as its groups say. In several sources
    an error of the same name, meaning and size is one and the same where it belongs to the
    instrument: it moves directions, or is one number for all samples (the standard). One that has
    groups and changes values, as a lamp that drifts, is each source's own; so is everything on
    instruments of different names.
    """
    parts = [channel.samples for channel in channels]
    angles = [
        np.concatenate([np.broadcast_to(getattr(s.directions, name), (len(s),)) for s in parts])
        for name in ("theta_i", "phi_i", "theta_r", "phi_r")
    ]
    one = len({channel.source for channel in channels}) == 1
    return BRDFSamples(
        directions=Directions(*angles),
        value=np.concatenate([s.value for s in parts]),
        u_independent=_column(parts, "u_independent"),
        noise_slope=_column(parts, "noise_slope"),
        u_reference=_column(parts, "u_reference"),
        reference_sharing=max(s.reference_sharing for s in parts),
        shared=_joined_terms(channels),
        history=_history(channels, one=one),
        metadata=_common([s.metadata for s in parts]),
        quantity=parts[0].quantity,
    )


def _column(parts: Sequence[BRDFSamples], name: str) -> FloatArray | None:
    columns = [getattr(s, name) for s in parts]
    return None if any(c is None for c in columns) else np.concatenate(columns)


def _common(metadata: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What all sources say alike."""
    return {
        key: value
        for key, value in metadata[0].items()
        if all(key in other and other[key] == value for other in metadata[1:])
    }


def _history(channels: Sequence[Channel], *, one: bool) -> tuple[str, ...]:
    """Of one source what its channels have in common; of several every line once, with names."""
    if one:
        first = channels[0].samples.history
        return first[: -1 if len(channels) > 1 and channels[0].select else None]
    lines = [f"{c.material}: {line}" for c in channels for line in c.samples.history]
    return tuple(dict.fromkeys(lines))


def _joined_terms(channels: Sequence[Channel]) -> tuple[SharedTerm, ...]:
    by_key: dict[tuple[Any, ...], list[SharedTerm | None]] = {}
    for k, channel in enumerate(channels):
        count: dict[tuple[Any, ...], int] = {}
        for term in channel.samples.shared:
            key = _identity(term, channel)
            # The same error twice in one source is two errors.
            count[key] = count.get(key, 0) + 1
            by_key.setdefault((*key, count[key]), [None] * len(channels))[k] = term
    return tuple(_one_term(terms, channels) for terms in by_key.values())


def _identity(term: SharedTerm, channel: Channel) -> tuple[Any, ...]:
    """Terms with the same identity are one error."""
    owner = str(channel.samples.metadata.get("instrument")) if term.of_rig else channel.source
    return (owner, term.name, term.meaning, term.relative, term.blur, term.turn)


def _one_term(terms: Sequence[SharedTerm | None], channels: Sequence[Channel]) -> SharedTerm:
    """One term over all samples; it does nothing to channels that do not have it."""
    sizes = [len(channel.samples) for channel in channels]
    given = [term for term in terms if term is not None]
    partial = len(given) < len(terms)

    def column(name: str, shape: tuple[int, ...], unset: float) -> Any:
        filled = [
            np.full((n, *shape), unset if term is not None else 0.0)
            if term is None or getattr(term, name) is None
            else getattr(term, name)
            for term, n in zip(terms, sizes, strict=True)
        ]
        return np.concatenate(filled)

    def has(name: str) -> bool:
        return any(getattr(term, name) is not None for term in given)

    group = column("group", (), 0).astype(np.int64) if has("group") else None
    return replace(
        given[0],
        group=group,
        shift=column("shift", (3,), 0.0) if has("shift") else None,
        profile=column("profile", (), 1.0) if has("profile") or partial else None,
        offset=column("offset", (), 0.0) if has("offset") else None,
    )


def joined_cells(cells: Sequence[Cells]) -> Cells:
    ends = np.cumsum([0, *(c.offsets[-1] for c in cells)])
    offsets = [c.offsets[1:] + end for c, end in zip(cells, ends, strict=False)]
    return Cells(
        np.concatenate([c.w_r for c in cells]),
        np.concatenate([c.weight for c in cells]),
        np.concatenate([[0], *offsets]).astype(np.int64),
    )


def cells_within(cells: Cells, where: slice) -> Cells:
    """The cells of consecutive samples."""
    offsets = cells.offsets[where.start : where.stop + 1]
    first, last = int(offsets[0]), int(offsets[-1])
    return Cells(cells.w_r[first:last], cells.weight[first:last], offsets - first)
