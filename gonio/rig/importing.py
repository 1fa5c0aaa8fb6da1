"""A rig's folder of pictures becomes a session, or is checked without writing anything."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np

from gonio.calibration.faults import session as faults
from gonio.calibration.faults.base import Finding
from gonio.errors import DataError
from gonio.files import write_text
from gonio.kernels.threads import default_threads
from gonio.metadata import Metadata
from gonio.rig import frame_faults, records, session_file, sources
from gonio.rig.frame_files import FrameFiles, FrameIndex, find
from gonio.rig.headers import Header, check_bytes, read_header
from gonio.rig.pictures import Sampling, opencv_silent, read_pixels
from gonio.rig.raw import RAW_ENDINGS, RawHeader, read_raw_header
from gonio.rig.session_file import RigFile
from gonio.rig.sources import Source
from gonio.session import Frame, Session

Progress = Callable[[int, int], None]
T = TypeVar("T")


@dataclass(frozen=True)
class Imported:
    """Result of an import, or of a check.

    Parameters
    ----------
    session : Session or None
        None if the frames were only checked.
    metadata : Metadata
    done : tuple of str
        What was done with the files, in sentences.
    warnings : tuple of str
        Sentences about other things than faults of frames, such as pictures outside the plan.
    findings : tuple of Finding
        What is wrong with the frames, errors first.
    n_new : int
        Number of frames read now; the others were read before.
    """

    session: Session | None
    metadata: Metadata
    done: tuple[str, ...]
    warnings: tuple[str, ...]
    findings: tuple[Finding, ...]
    n_new: int


def import_rig(
    folder: str | Path,
    output: str | Path,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Imported:
    """Make a session of a rig's folder.

    Parameters
    ----------
    folder : path
        Holds `session.toml` and the pictures that it names.
    output : path
        Folder of the session. An import that was interrupted is continued; so is one after which
        files were replaced: only those are read again.
    threads : int, optional
        Number of worker threads; the session does not depend on it.
    progress : callable, optional
        Called with (frames done, frames in all).

    Returns
    -------
    Imported

    Raises
    ------
    ConfigurationError
        If session.toml cannot be used, or another session stands at `output`.
    DataError
        If files are missing, damaged, of several sizes or no raw counts, or the disk is full.

    Examples
    --------
    >>> import tempfile
    >>> from importlib import resources
    >>> demo = resources.files("gonio.data") / "demo_rig"
    >>> imported = import_rig(str(demo), tempfile.mkdtemp() + "/rig.gonio")
    >>> imported.session.complete, imported.n_new == imported.metadata.plan.n_frames
    (True, True)
    """
    prepared = _Prepared.of(folder)
    described = prepared.described
    session = Session.create(output, described.metadata)
    write_text(session.path / session_file.NAME, prepared.rig.text)
    sources_read = {
        index: source
        for index, source in sources.read(session.path).items()
        if session.has(*index[:4], channel=index.channel)
    }
    n_new = 0
    for index, frame, source in _read_all(prepared, sources_read, threads, progress):
        if frame is not None:
            session.write(*index[:4], frame, channel=index.channel)
            sources.append(session.path, index, source)
            n_new += 1
        sources_read[index] = source
    return _judged(prepared, session, sources_read, n_new, threads)


def check_frames(
    folder: str | Path, *, threads: int | None = None, progress: Progress | None = None
) -> Imported:
    """Check a rig's folder as an import does, without writing anything.

    Parameters
    ----------
    folder : path
    threads : int, optional
    progress : callable, optional
        Called with (frames done, frames in all).

    Raises
    ------
    ConfigurationError, DataError
        As `import_rig` does.
    """
    prepared = _Prepared.of(folder)
    read = {index: source for index, _, source in _read_all(prepared, {}, threads, progress)}
    return _judged(prepared, None, read, 0, threads)


@dataclass(frozen=True)
class _Prepared:
    """A rig's folder whose description and headers are in order."""

    rig: RigFile
    files: FrameFiles
    headers: dict[str, Header]
    sampling: Sampling
    described: records.Described

    @classmethod
    def of(cls, folder: str | Path) -> _Prepared:
        rig = session_file.read(folder)
        files = find(rig)
        names = list(files.names.values())
        with ThreadPoolExecutor(default_threads()) as pool:
            headers = dict(zip(names, pool.map(partial(_header, rig), names), strict=True))
        _check_uniform(headers)
        name, header = next(iter(headers.items()))
        sampling = Sampling.of(header, rig.table.frames, name)
        return cls(rig, files, headers, sampling, records.describe(rig, header, sampling, name))

    def read(self, index: FrameIndex) -> tuple[Frame, Source]:
        """One frame of the session, with its source."""
        name = self.files.names[index]
        path = self.rig.folder / name
        try:
            data = path.read_bytes()
        except OSError as error:
            raise DataError(f"{name}: cannot be read ({error.strerror}).", value=name) from None
        pixels = read_pixels(path, name, self.headers[name], self.rig.table.frames, data)
        frame = self.sampling.sampled(pixels, self.described.metadata.camera)
        low, high = int(pixels.min()), int(pixels.max())
        at_high = int(np.count_nonzero(pixels == high))
        return frame, Source(name, sha256(data).hexdigest(), low, high, at_high)


class _Unwritten(Session):
    """The session that an import would write, read from the files."""

    def __init__(self, prepared: _Prepared) -> None:
        super().__init__(prepared.rig.folder, prepared.described.metadata, {})
        self._prepared = prepared

    def require_complete(self) -> None:
        """It is complete: `find` has checked every file."""

    def frame(
        self, role: str, take: int, incidence: int, exposure: int, *, channel: int = 0
    ) -> Frame:
        """One frame, decoded anew."""
        return self._prepared.read(FrameIndex(role, take, incidence, exposure, channel))[0]


def _header(rig: RigFile, name: str) -> Header:
    path = rig.folder / name
    is_raw = path.suffix.lower() in RAW_ENDINGS
    header = read_raw_header(path, name) if is_raw else read_header(path, name)
    check_bytes(path, header, name)
    return header


def _check_uniform(headers: dict[str, Header]) -> None:
    """All frames have one size, one depth and, where raw, one kind of sensor."""
    _check_one(
        {name: header.kind == "raw" for name, header in headers.items()},
        lambda is_raw: "is a raw file" if is_raw else "is no raw file",
        "a session has frames of one kind",
    )
    _check_one(
        {name: (header.columns, header.rows) for name, header in headers.items()},
        lambda size: f"has {size[0]} x {size[1]} pixels",
        "frames of a session have one size, that of the camera's window",
    )
    _check_one(
        {name: header.depth for name, header in headers.items()},
        lambda depth: f"holds {depth} counts",
        "one gain, black level and saturation hold for all frames: write all with the same bits",
    )
    _check_one(
        {
            name: (header.pattern or "none", header.black, header.white)
            for name, header in headers.items()
            if isinstance(header, RawHeader)
        },
        lambda raw: f"has the filters {raw[0]}, black levels {raw[1]} and saturation {raw[2]}",
        "raw frames of a session come from one camera with one setting",
    )


def _check_one(by_file: dict[str, T], words: Callable[[T], str], rule: str) -> None:
    """Refuse the first file that differs from most."""
    if len(set(by_file.values())) < 2:
        return
    usual, _ = Counter(by_file.values()).most_common(1)[0]
    odd = [name for name, value in by_file.items() if value != usual]
    more = f" (so {'are' if len(odd) > 2 else 'is'} {len(odd) - 1} more)" if len(odd) > 1 else ""
    raise DataError(
        f"{odd[0]}: {words(by_file[odd[0]])} and most of the others do not: {words(usual)}{more}; "
        f"{rule}.",
        value=odd,
    )


def _read_all(
    prepared: _Prepared,
    sources_read: dict[FrameIndex, Source],
    threads: int | None,
    progress: Progress | None,
) -> Iterator[tuple[FrameIndex, Frame | None, Source]]:
    """Every frame in the plan's order; no pixels for those whose file is unchanged."""

    def look(index: FrameIndex) -> tuple[FrameIndex, Frame | None, Source]:
        source = sources_read.get(index)
        if source is not None and source.sha256 == _digest(prepared, index):
            return index, None, replace(source, file=prepared.files.names[index])
        return index, *prepared.read(index)

    n = threads or default_threads()
    waiting, done = iter(prepared.files.names), 0
    with opencv_silent(), ThreadPoolExecutor(n) as pool:
        # Some frames at a time: what is decoded waits in memory until it is written.
        while batch := list(islice(waiting, 2 * n)):
            for frame in pool.map(look, batch):
                yield frame
                done += 1
                if progress is not None:
                    progress(done, len(prepared.files.names))


def _digest(prepared: _Prepared, index: FrameIndex) -> str:
    name = prepared.files.names[index]
    try:
        return sha256((prepared.rig.folder / name).read_bytes()).hexdigest()
    except OSError as error:
        raise DataError(f"{name}: cannot be read ({error.strerror}).", value=name) from None


def _judged(
    prepared: _Prepared,
    session: Session | None,
    read: dict[FrameIndex, Source],
    n_new: int,
    threads: int | None,
) -> Imported:
    metadata = prepared.described.metadata
    own = frame_faults.of_files(metadata, prepared.sampling.n_summed, read)
    of_session: tuple[Finding, ...] = ()
    # Spots of a mirror are judged by the alignment that is fitted to them.
    if metadata.plan.mode != "mirror":
        of_session = faults.check_session(session or _Unwritten(prepared), threads=threads)
    names = prepared.files.names
    if any(finding.code == "same_file" for finding in own):
        of_session = tuple(finding for finding in of_session if finding.code != "same_frame")
    findings = [*own, *frame_faults.with_files(of_session, metadata, names)]
    return Imported(
        session=session,
        metadata=metadata,
        done=prepared.described.done,
        warnings=tuple(_about_strangers(prepared.files.strangers)),
        findings=tuple(sorted(findings, key=lambda finding: finding.severity != "error")),
        n_new=n_new,
    )


def _about_strangers(strangers: Iterable[str]) -> Iterator[str]:
    listed = list(strangers)
    if listed:
        one = len(listed) == 1
        more = "" if one else f" and {len(listed) - 1} more"
        yield (
            f"{listed[0]}{more}: {'is' if one else 'are'} not of the plan and "
            f"{'is' if one else 'are'} left out."
        )
