"""Pictures from files: what a file claims to be is checked before it is decoded.

A few kilobytes can claim a picture of gigabytes, so that the size is read from the
file's head first. Those of PNG, JPEG, BMP, WebP and PNM files are known.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from conegraph.errors import FileFormatError

MAX_PIXELS = 50_000_000
MAX_BYTES = 256 * 2**20
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".webp", ".ppm", ".pgm")

_JPEG_SIZES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_JPEG_SCAN, _JPEG_END = 0xDA, b"\xff\xd9"
_JPEG_BARE = frozenset(range(0xD0, 0xD9)) | {0x01}
_PNM = re.compile(rb"P[1-6]\s+(?:#[^\n]*\s+)*(\d{1,9})\s+(?:#[^\n]*\s+)*(\d{1,9})\s")


def read_color(path: Path) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3) as RGB, whatever its file holds.

    Raises:
        FileFormatError: missing, no picture, damaged, or too large.
    """
    import cv2

    shown = np.asarray(_decoded(path, cv2.IMREAD_COLOR), dtype=np.uint8)
    return np.asarray(cv2.cvtColor(shown, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def read_depth(path: Path) -> NDArray[np.uint16]:
    """Return a picture (H, W) of 16-bit numbers, as depth is stored.

    Raises:
        FileFormatError: missing, no picture, damaged, too large, or not of one
            16-bit channel.
    """
    import cv2

    stored = _decoded(path, cv2.IMREAD_UNCHANGED)
    if stored.dtype != np.uint16 or stored.ndim != 2:
        channels = 1 if stored.ndim == 2 else stored.shape[2]
        kind = f"{channels} x {stored.dtype} a pixel"
        raise FileFormatError(path, f"is {kind}, but depth is one uint16")
    return np.asarray(stored, dtype=np.uint16)


def _decoded(path: Path, flag: int) -> NDArray[np.generic]:
    import cv2

    try:
        if path.stat().st_size > MAX_BYTES:
            raise FileFormatError(path, f"is larger than {MAX_BYTES >> 20} MiB")
        data = path.read_bytes()
    except OSError as error:
        raise FileFormatError(path, f"cannot be read: {error.strerror}") from error
    size = claimed_size(data)
    if size is None:
        raise FileFormatError(path, "is no picture that can be read here")
    if not 0 < size[0] * size[1] <= MAX_PIXELS:
        raise FileFormatError(
            path,
            f"claims {size[0]} x {size[1]} pixels; up to {MAX_PIXELS / 1e6:.0f} "
            f"million are read",
        )
    if _is_cut_off(data):
        raise FileFormatError(path, "is cut off: the picture's end is missing")
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), flag)
    except cv2.error:
        picture = None
    if picture is None:
        raise FileFormatError(path, "is damaged: the picture cannot be decoded")
    return np.asarray(picture)


def claimed_size(data: bytes) -> tuple[int, int] | None:
    """Return width and height from a picture's head, None where it has none."""
    if data.startswith(b"\x89PNG\r\n\x1a\n") and len(data) >= 24:
        width, height = struct.unpack(">II", data[16:24])
        return int(width), int(height)
    if data.startswith(b"\xff\xd8"):
        return _jpeg_size(data)
    if data.startswith(b"BM") and len(data) >= 26:
        width, height = struct.unpack("<ii", data[18:26])
        return abs(int(width)), abs(int(height))
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP" and len(data) >= 30:
        return _webp_size(data)
    head = _PNM.match(data[:4096])
    return (int(head[1]), int(head[2])) if head else None


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    at = _jpeg_marker(data, _JPEG_SIZES)
    if at is None:
        return None
    height, width = struct.unpack(">HH", data[at + 5 : at + 9])
    return int(width), int(height)


def _jpeg_marker(data: bytes, wanted: frozenset[int]) -> int | None:
    """Return where the first of some markers is, thumbnails inside others skipped."""
    at = 2
    while at + 9 < len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in wanted:
            return at
        if marker == 0xFF:
            at += 1
        elif marker in _JPEG_BARE:
            at += 2
        else:
            at += 2 + max(int.from_bytes(data[at + 2 : at + 4], "big"), 2)
    return None


def _webp_size(data: bytes) -> tuple[int, int] | None:
    kind = data[12:16]
    if kind == b"VP8X":
        width, height = data[24:27], data[27:30]
        return (
            1 + int.from_bytes(width, "little"),
            1 + int.from_bytes(height, "little"),
        )
    if kind == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    if kind == b"VP8 ":
        width, height = struct.unpack("<HH", data[26:30])
        return width & 0x3FFF, height & 0x3FFF
    return None


def _is_cut_off(data: bytes) -> bool:
    """Return whether the end of a PNG or JPEG is missing: half would be decoded.

    Cameras append things of their own behind it, such as a film.
    """
    if data.startswith(b"\x89PNG"):
        return not _png_has_end(data)
    if data.startswith(b"\xff\xd8"):
        scan = _jpeg_marker(data, frozenset({_JPEG_SCAN}))
        return scan is None or data.find(_JPEG_END, scan) < 0
    return False


def _png_has_end(data: bytes) -> bool:
    at = 8
    while at + 12 <= len(data):
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at += 12 + int.from_bytes(data[at : at + 4], "big")
    return False
