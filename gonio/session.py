"""Raw frames with their metadata, on disk.

A session is a folder:

- `session.json`: metadata, written before the first frame, synced and renamed;
- `frames.zarr`: zarr v3, one array per role, one chunk per frame; dimensions take, incidence,
  exposure, row, column, and channel before them where there are several;
- `manifest.jsonl`: one line per frame with its crc32, appended and synced after the frame itself is
  on the disk. A frame is in the session when its line is: a crash loses at most the frame that
  was being written.

A simulated session also has a folder `truth`, written by the simulator. In this module only
`read_truth` and `open_truth_images` read it; the reduction never calls them.
"""

from __future__ import annotations

import hashlib
import json
import os
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from gonio.errors import ConfigurationError, DataError
from gonio.files import write_text
from gonio.metadata import SCHEMA, Metadata, Plan

MAX_FRAME_PIXELS = 1 << 28
MAX_FRAMES = 1 << 24

Frame = NDArray[np.uint16]


class Session:
    """Raw frames of one sample with their metadata.

    Examples
    --------
    `Session.open(path).frame("sample", take=0, incidence=3, exposure=1)` is a uint16 array whose
    crc32 has been checked against the manifest.
    """

    def __init__(self, path: Path, metadata: Metadata, manifest: dict[str, int]) -> None:
        self.path = path
        self.metadata = metadata
        self._manifest = manifest
        self._arrays: dict[str, Any] = {}

    @classmethod
    def create(cls, path: str | Path, metadata: Metadata) -> Session:
        """Make a new, empty session folder, or continue one that the same command began.

        Raises
        ------
        ConfigurationError
            If `path` exists and is something else.
        DataError
            If the folder cannot be written.
        """
        path = Path(path)
        if (path / "session.json").exists():
            session = cls.open(path)
            if session.metadata.fingerprint != metadata.fingerprint:
                raise ConfigurationError(
                    f"{path}: holds a session of {session.metadata.sample} on "
                    f"{session.metadata.instrument} made with other settings or another seed than "
                    f"the one asked for, {metadata.sample} on {metadata.instrument}; "
                    "give another folder or delete it.",
                    value=path,
                )
            # zarr renames a file when it is written: what a kill left half written goes.
            for unfinished in path.rglob("*.partial"):
                unfinished.unlink(missing_ok=True)
            return session
        if path.exists() and not _can_become_session(path):
            raise ConfigurationError(
                f"{path}: exists and is not a session; give another name.", value=path
            )
        try:
            path.mkdir(parents=True, exist_ok=True)
            (path / "manifest.jsonl").touch()
            _create_arrays(path / "frames.zarr", metadata)
        except OSError as error:
            raise _refused(path, error) from error
        # session.json comes last: a folder without it is not a session yet.
        write_text(path / "session.json", metadata.model_dump_json(by_alias=True, indent=1) + "\n")
        return cls(path, metadata, {})

    @classmethod
    def open(cls, path: str | Path) -> Session:
        """Open a session for reading or for continuing.

        Raises
        ------
        DataError
            If there is no session at `path` or its metadata or manifest cannot be understood.
        """
        path = Path(path)
        if not path.exists():
            raise DataError(
                f"{path}: no such session; give a folder that 'gonio simulate' or 'gonio import' "
                "wrote."
            )
        file = path / "session.json"
        if not file.is_file():
            raise DataError(f"{path}: not a session, session.json is missing.", value=path)
        try:
            metadata = Metadata.model_validate_json(file.read_bytes())
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in first["loc"]) or "content"
            raise DataError(f"{file}: {key}: {first['msg']}.", value=file) from None
        if metadata.schema_ != SCHEMA:
            raise DataError(f"{file}: schema {metadata.schema_!r} is not {SCHEMA!r}.", value=file)
        if metadata.camera.rows * metadata.camera.columns > MAX_FRAME_PIXELS:
            raise DataError(f"{file}: frames of more than {MAX_FRAME_PIXELS} pixels are refused.")
        if metadata.plan.n_frames > MAX_FRAMES:
            raise DataError(f"{file}: more than {MAX_FRAMES} frames are refused.")
        return cls(path, metadata, _read_manifest(path / "manifest.jsonl", metadata.plan))

    @property
    def n_done(self) -> int:
        """Number of frames that are safely on the disk."""
        return len(self._manifest)

    @property
    def complete(self) -> bool:
        """True when every frame of the plan is there."""
        return self.n_done == self.metadata.plan.n_frames

    @property
    def sha256(self) -> str:
        """Hex digest of the metadata and of the checksums of all frames: what was recorded."""
        frames = sorted(self._manifest.items())
        text = self.metadata.model_dump_json() + json.dumps(frames)
        return hashlib.sha256(text.encode()).hexdigest()

    def require_complete(self) -> None:
        """Raise DataError unless every frame is there."""
        if not self.complete:
            raise DataError(
                f"{self.path}: {self.n_done} of {self.metadata.plan.n_frames} frames are there; "
                "run the same 'gonio simulate' or 'gonio import' command again to finish it.",
                value=self.path,
            )

    def has(self, role: str, take: int, incidence: int, exposure: int, *, channel: int = 0) -> bool:
        """True if this frame is safely on the disk."""
        return _key(role, take, incidence, exposure, channel) in self._manifest

    def frame(
        self, role: str, take: int, incidence: int, exposure: int, *, channel: int = 0
    ) -> Frame:
        """One raw frame, shape (rows, columns), checked against its crc32.

        Parameters
        ----------
        role : str
            One of `metadata.plan.roles`.
        take, incidence, exposure, channel : int
            Indices into the plan's takes and incidences of that role, exposures and channels.

        Raises
        ------
        DataError
            If the frame is missing, cannot be read, or its content has changed.
        """
        key = _key(role, take, incidence, exposure, channel)
        if key not in self._manifest:
            raise DataError(f"{self.path}: frame {key} is missing.", value=key)
        try:
            index = self._index(take, incidence, exposure, channel)
            frame: Frame = np.asarray(self._array(role)[index])
        except Exception as error:  # the codecs of zarr raise many kinds of exceptions
            raise DataError(
                f"{self.path}: frame {key} cannot be read ({error}); it is damaged, take it again.",
                value=key,
            ) from error
        if zlib.crc32(frame.tobytes()) != self._manifest[key]:
            raise DataError(
                f"{self.path}: frame {key} fails its crc32 check; it is damaged, take it again.",
                value=key,
            )
        return frame

    def bracket(self, role: str, take: int, incidence: int, *, channel: int = 0) -> Frame:
        """All exposures of one image, shape (exposures, rows, columns)."""
        n = len(self.metadata.plan.exposures_s)
        return np.stack([self.frame(role, take, incidence, k, channel=channel) for k in range(n)])

    def write(
        self,
        role: str,
        take: int,
        incidence: int,
        exposure: int,
        frame: Frame,
        *,
        channel: int = 0,
    ) -> None:
        """Write one frame to the disk and then acknowledge it in the manifest, both synced.

        Raises
        ------
        DataError
            If the disk cannot be written; the session keeps the frames acknowledged so far.
        """
        key = _key(role, take, incidence, exposure, channel)
        index = self._index(take, incidence, exposure, channel)
        camera = self.metadata.camera
        if frame.shape != (camera.rows, camera.columns) or frame.dtype != np.uint16:
            raise DataError(
                f"frame {key} is {frame.dtype} of shape {frame.shape}, not uint16 of "
                f"({camera.rows}, {camera.columns})."
            )
        try:
            self._array(role)[index] = frame
            _sync(self._chunk_path(role, index))
            crc = zlib.crc32(frame.tobytes())
            line = json.dumps({"frame": key, "crc32": crc}) + "\n"
            with (self.path / "manifest.jsonl").open("a", encoding="utf-8") as manifest:
                manifest.write(line)
                manifest.flush()
                os.fsync(manifest.fileno())
        except OSError as error:
            raise _refused(self.path, error) from error
        self._manifest[key] = crc

    def _array(self, role: str) -> Any:
        if role not in self._arrays:
            import zarr

            self._arrays[role] = zarr.open_array(self.path / "frames.zarr" / role, mode="r+")
        return self._arrays[role]

    def _index(self, take: int, incidence: int, exposure: int, channel: int) -> tuple[int, ...]:
        """Index of a frame in its role's array."""
        index = (take, incidence, exposure)
        return (channel, *index) if len(self.metadata.plan.channels) > 1 else index

    def _chunk_path(self, role: str, index: tuple[int, ...]) -> Path:
        return self.path.joinpath("frames.zarr", role, "c", *map(str, index), "0", "0")


def read_truth(path: str | Path) -> dict[str, Any] | None:
    """The truth of a simulated session, or None for a measured one; for comparison only."""
    file = Path(path) / "truth" / "truth.json"
    if not file.is_file():
        return None
    try:
        content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise DataError(f"{file}: not readable ({error}).", value=file) from None
    return content


def open_truth_images(path: str | Path) -> Any | None:
    """The zarr group of the true values of each pixel, or None if there is none.

    Its arrays are described in `gonio.instrument.truth`. For comparison only.
    """
    folder = Path(path) / "truth" / "images.zarr"
    if not folder.is_dir():
        return None
    import zarr

    return zarr.open_group(folder, mode="r")


def _can_become_session(path: Path) -> bool:
    """True for an empty folder, or one whose making was interrupted before its session.json."""
    if not path.is_dir():
        return False
    names = {entry.name for entry in path.iterdir() if not entry.name.startswith(".session.json.")}
    manifest = path / "manifest.jsonl"
    begun = manifest.is_file() and manifest.stat().st_size == 0
    return not names or (begun and names <= {"manifest.jsonl", "frames.zarr"})


def _create_arrays(path: Path, metadata: Metadata) -> None:
    import zarr
    from zarr.codecs import BloscCodec

    camera, plan = metadata.camera, metadata.plan
    group = zarr.open_group(path, mode="w", zarr_format=3)
    several = len(plan.channels) > 1
    for role in plan.roles:
        sizes = {
            **({"channel": len(plan.channels)} if several else {}),
            "take": plan.takes(role),
            "incidence": len(plan.incidences(role)),
            "exposure": len(plan.exposures_s),
        }
        group.create_array(
            role,
            shape=(*sizes.values(), camera.rows, camera.columns),
            chunks=(*(1 for _ in sizes), camera.rows, camera.columns),
            dtype="uint16",
            compressors=[BloscCodec(cname="lz4", clevel=1, shuffle="bitshuffle")],
            dimension_names=[*sizes, "row", "column"],
        )


def _read_manifest(path: Path, plan: Plan) -> dict[str, int]:
    """Acknowledged frames; a torn last line, left by a crash, is cut off."""
    if not path.is_file():
        raise DataError(f"{path}: the manifest is missing; the session cannot be trusted.")
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    formats = {
        _key(role, take, incidence, k, channel)
        for role, take, incidence in plan.images()
        for k in range(len(plan.exposures_s))
        for channel in range(len(plan.channels))
    }
    manifest = {}
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            entry = json.loads(line)
            key, crc = entry["frame"], int(entry["crc32"])
        except (ValueError, KeyError, TypeError):
            raise DataError(f"{path}: line {number} is not a frame's line.", value=path) from None
        if key not in formats:
            raise DataError(f"{path}: line {number}: frame {key!r} is not of the plan.", value=key)
        manifest[key] = crc
    if len(whole) < len(content):
        with path.open("r+b") as file:
            file.truncate(len(whole))
            os.fsync(file.fileno())
    return manifest


def _key(role: str, take: int, incidence: int, exposure: int, channel: int) -> str:
    """A frame's name in the manifest; that of the first channel does not tell the channel."""
    key = f"{role}/{take}/{incidence}/{exposure}"
    return f"{key}/c{channel}" if channel else key


def _sync(path: Path) -> None:
    # A chunk that holds only the fill value is not written; there is nothing to sync then.
    if path.exists():
        with path.open("rb") as file:
            os.fsync(file.fileno())
    nearest = next(parent for parent in path.parents if parent.exists())
    folder = os.open(nearest, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _refused(path: Path, error: OSError) -> DataError:
    return DataError(
        f"{path}: cannot be written ({error.strerror or error}); free space and run the same "
        "command again, frames already acknowledged are kept.",
        value=path,
    )
