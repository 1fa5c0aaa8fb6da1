"""Rig folders and picture files for the tests of the import."""

from __future__ import annotations

import re
import shutil
import struct
from importlib import resources
from pathlib import Path

import cv2
import numpy as np

DEMO = Path(str(resources.files("gonio.data"))) / "demo_rig"
THETA_I, EXPOSURES_MS = (0, 30), (4, 32, 256)
ROLES = {"background": "dark", "standard": "white", "sample": "sample"}
SMALL_PLAN = """[plan]
theta_i_deg = [0.0, 30.0]
rotations_deg = [0.0]
exposures_s = [0.004, 0.032, 0.256]
"""


def small_rig(folder: Path) -> Path:
    """A part of the demo: two incidences, one rotation, one take, three exposures, 18 frames."""
    for theta_i in THETA_I:
        for ms in EXPOSURES_MS:
            for name in ("dark", "white"):
                copy(folder, f"{name}/{theta_i}_{ms}_1.png")
            copy(folder, f"sample/{theta_i}_0_{ms}.png")
    text = (DEMO / "session.toml").read_text(encoding="utf-8")
    text = re.sub(r"\[plan\]\n.*?\n\n", f"{SMALL_PLAN}\n", text, flags=re.DOTALL)
    (folder / "session.toml").write_text(text, encoding="utf-8")
    return folder


def copy(folder: Path, name: str) -> None:
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(DEMO / name, folder / name)


def change(rig: Path, *pairs: tuple[str, str]) -> None:
    """Replace pieces of session.toml, each of which must be there."""
    path = rig / "session.toml"
    text = path.read_text(encoding="utf-8")
    for old, new in pairs:
        assert old in text, old
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")


def pixels(path: Path) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(path.read_bytes(), np.uint8), cv2.IMREAD_UNCHANGED)


def write(path: Path, image: np.ndarray) -> None:
    """A picture in the format of its ending."""
    path.parent.mkdir(parents=True, exist_ok=True)
    ok, data = cv2.imencode(path.suffix, image)
    assert ok
    path.write_bytes(data.tobytes())


def convert(rig: Path, ending: str, to=lambda image: image) -> None:
    """All frames in another format, their numbers by `to`."""
    for path in sorted(rig.rglob("*.png")):
        image = to(pixels(path))
        path.unlink()
        write(path.with_suffix(ending), image)
    change(rig, (".png", ending))


# ---------------------------------------------------------------- files byte by byte


def tiff(
    pages: list[dict[int, tuple[str, list[int]]]], data: bytes = b"", order: str = "<"
) -> bytes:
    """A TIFF with these tags in each page; tag 273 (where the pixels are) is filled in."""
    head = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 8)
    kinds = {"B": 1, "H": 3, "I": 4, "r": 10, "s": 2}
    out, at = b"", 8
    starts, lengths = [], []
    for tags in pages:
        starts.append(at)
        lengths.append(2 + 12 * len(tags) + 4)
        at += lengths[-1] + sum(len(body) for body in bodies(tags, order).values() if len(body) > 4)
    for k, tags in enumerate(pages):
        beside, extra = starts[k] + lengths[k], b""
        entries = struct.pack(order + "H", len(tags))
        for tag, body in sorted(bodies(tags, order).items()):
            kind, values = tags[tag]
            if tag == 273:
                body = struct.pack(order + "I", at)
            elif len(body) > 4:
                extra, body = extra + body, struct.pack(order + "I", beside + len(extra))
            entries += struct.pack(order + "HHI", tag, kinds[kind], len(values)) + body.ljust(
                4, b"\0"
            )
        last = k + 1 == len(pages)
        out += entries + struct.pack(order + "I", 0 if last else starts[k + 1]) + extra
    return head + out + data


def bodies(tags: dict[int, tuple[str, list[int]]], order: str) -> dict[int, bytes]:
    found = {}
    for tag, (kind, values) in tags.items():
        if kind == "s":
            body = bytes(values)
        elif kind == "r":
            body = b"".join(struct.pack(order + "ii", value, 10_000) for value in values)
        else:
            body = struct.pack(f"{order}{len(values)}{kind}", *values)
        found[tag] = body + b"\0" * (len(body) % 2 if len(body) > 4 else 0)
    return found


def grey(rows: int = 4, columns: int = 6, **other: tuple[str, list[int]]) -> dict:
    """Tags of a page of 16-bit grey; `t277=("H", [3])` changes one."""
    tags = {
        256: ("I", [columns]),
        257: ("I", [rows]),
        258: ("H", [16]),
        259: ("H", [1]),
        262: ("H", [1]),
        273: ("I", [0]),
        277: ("H", [1]),
        278: ("I", [rows]),
        279: ("I", [2 * rows * columns]),
    }
    return tags | {int(name[1:]): value for name, value in other.items()}


def dng(counts: np.ndarray, black: int = 64, white: int = 4095) -> bytes:
    """A raw file as a digital camera writes it: an uncompressed mosaic with filters RGGB."""
    rows, columns = counts.shape
    text = [*b"Test\0\0"]
    tags = grey(
        rows, columns,
        t254=("I", [0]), t262=("H", [32803]), t271=("s", text), t272=("s", text), t274=("H", [1]),
        t33421=("H", [2, 2]), t33422=("B", [0, 1, 1, 2]), t50706=("B", [1, 4, 0, 0]),
        t50707=("B", [1, 1, 0, 0]), t50708=("s", text), t50714=("H", [black]),
        t50717=("I", [white]), t50721=("r", [10_000, 0, 0, 0, 10_000, 0, 0, 0, 10_000]),
        t50778=("H", [21]),
    )  # fmt: skip
    return tiff([tags], counts.astype("<u2").tobytes())


def png_header(columns: int, rows: int, bits: int, colour: int) -> bytes:
    ihdr = struct.pack(">IIBB", columns, rows, bits, colour) + bytes(3)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + b"IHDR" + ihdr + bytes(4)


def exr_header(channels: dict[str, int], columns: int = 6, rows: int = 4, flags: int = 0) -> bytes:
    """Magic and header of an EXR with these channels (0 integer, 1 half, 2 float)."""
    listed = b"".join(
        name.encode() + b"\0" + struct.pack("<iIii", kind, 0, 1, 1)
        for name, kind in channels.items()
    )
    window = struct.pack("<4i", 0, 0, columns - 1, rows - 1)
    attributes = [
        (b"channels", b"chlist", listed + b"\0"),
        (b"compression", b"compression", b"\0"),
        (b"dataWindow", b"box2i", window),
    ]
    return (
        b"\x76\x2f\x31\x01"
        + bytes([2, flags, 0, 0])
        + b"".join(n + b"\0" + t + b"\0" + struct.pack("<I", len(v)) + v for n, t, v in attributes)
        + b"\0"
    )
