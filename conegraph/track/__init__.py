"""Track detection: from a cone map to boundaries, road and centre line."""

from conegraph.track.detect import detect_track
from conegraph.track.model import (
    Bridge,
    CenterLine,
    Relabelled,
    Track,
    Unused,
)

__all__ = [
    "Bridge",
    "CenterLine",
    "Relabelled",
    "Track",
    "Unused",
    "detect_track",
]
