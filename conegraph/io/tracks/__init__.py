"""Track layouts in the formats of the simulators that teams use.

`read_track` tells the format by what is in the file, never by its name.
"""

from __future__ import annotations

from pathlib import Path

from conegraph.errors import FileFormatError
from conegraph.io.csv_table import header_columns, read_text, text_lines
from conegraph.io.tracks import cone_map_csv, epfl, eufs, fsds, fssim, pacsim
from conegraph.io.tracks.strict_yaml import MAX_YAML_BYTES, parse_yaml
from conegraph.types import TrackLayout

__all__ = ["read_track"]

KNOWN = "PacSim or fssim yaml, EUFS, EPFL, FSDS or map csv"


def read_track(path: Path) -> TrackLayout:
    """Read a track file of any known format.

    PacSim yaml, AMZ fssim yaml, EUFS csv, EPFL ``*_cones.csv``, FSDS csv, and our
    own ``map.csv``. Rows that are no cone (start poses, time keeping, decoys),
    malformed ones and exact duplicates are counted in `dropped`. The order of the
    file is kept.

    Raises:
        FileFormatError: unreadable, of no known format, or without a cone.
    """
    csv_tracks = (eufs.read_eufs, epfl.read_epfl, cone_map_csv.read_map_track)
    text = read_text(path)
    lines = [line for line in text_lines(text) if line.strip()]
    if not lines:
        raise FileFormatError(path, "is empty")
    header = set(header_columns(lines[0]))
    for columns, read in zip(
        (eufs.COLUMNS, epfl.COLUMNS, cone_map_csv.COLUMNS), csv_tracks, strict=True
    ):
        if header.issuperset(columns):
            return read(path)
    if fsds.looks_like_fsds(lines):
        return fsds.read_fsds(path)
    return _read_yaml_track(path, text)


def _read_yaml_track(path: Path, text: str) -> TrackLayout:
    is_yaml = path.suffix.lower() in (".yaml", ".yml")
    if not is_yaml and len(text) > MAX_YAML_BYTES:
        raise FileFormatError(path, f"is not a track of a known format ({KNOWN})")
    try:
        document = parse_yaml(path, text)
    except FileFormatError:
        if is_yaml:
            raise
        document = None
    if isinstance(document, dict) and "track" in document:
        return pacsim.layout(path, document["track"])
    if isinstance(document, dict) and fssim.CONE_LISTS.keys() & document.keys():
        return fssim.layout(path, document)
    raise FileFormatError(path, f"is not a track of a known format ({KNOWN})")
