"""What a recording's file tells before it is played: how much of it is there."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from conegraph.camera import CameraMount
from conegraph.errors import FileFormatError
from conegraph.io.camera_toml import CAMERA_TOML, read_camera_toml

_SQLITE = b"SQLite format 3\0"
_HEAD_BYTES = 100


def frames_in(path: Path) -> int | None:
    """Return how many colour pictures a ``.db3`` was recorded with.

    None for files that do not tell, or that cannot be read as a database.

    Raises:
        FileFormatError: the file cannot be read, or its end is missing: then the
            text says how much of it is there.
    """
    if path.suffix != ".db3":
        return None
    _check_length(path)
    count = (
        "SELECT count(*) FROM messages JOIN topics ON topic_id = topics.id "
        "WHERE topics.name LIKE '%/Color_%/image/data%'"
    )
    try:
        # A file name with ? or # would end the path of a plain URI.
        name = f"{path.resolve().as_uri()}?mode=ro"
        with closing(sqlite3.connect(name, uri=True)) as db:
            (frames,) = db.execute(count).fetchone()
    except sqlite3.Error:
        return None
    return int(frames)


def _check_length(path: Path) -> None:
    """Compare the file's length with the one in the database's head.

    The head holds the size of a page at byte 16 and their number at byte 28.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
        there = path.stat().st_size
    except OSError as error:
        raise FileFormatError(path, f"cannot be read: {error.strerror}") from error
    if len(head) < _HEAD_BYTES or not head.startswith(_SQLITE):
        return
    page = int.from_bytes(head[16:18], "big")
    whole = (65536 if page == 1 else page) * int.from_bytes(head[28:32], "big")
    if there < whole:
        raise FileFormatError(
            path,
            f"is cut off: {there / 2**20:.1f} of {whole / 2**20:.1f} MiB are there, "
            f"and the library plays no part of it",
        )


def mount_beside(path: Path) -> CameraMount:
    """Return the mount that a ``camera.toml`` beside a recording gives, else default.

    Raises:
        FileFormatError: the file is there and cannot be read.
    """
    about = path.with_name(CAMERA_TOML)
    mount = read_camera_toml(about).mount if about.is_file() else None
    return mount or CameraMount()
