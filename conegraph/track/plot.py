"""A picture of a track: cones, boundaries, road and centre line."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from conegraph.errors import ConegraphError
from conegraph.track.model import Track
from conegraph.types import ConeClass, ConeMap

_CONE_COLOUR = {
    ConeClass.BLUE: "#1f5fbf",
    ConeClass.YELLOW: "#e0b000",
    ConeClass.ORANGE: "#f07818",
    ConeClass.BIG_ORANGE: "#b84800",
    ConeClass.UNKNOWN: "#808080",
}
_WIDTH_IN = 9.0


def plot_track(path: Path, track: Track, cone_map: ConeMap) -> None:
    """Write a picture; its format is by the name's ending, PNG or SVG.

    Raises:
        ConegraphError: it cannot be written.
    """
    figure = Figure(figsize=(_WIDTH_IN, _WIDTH_IN), layout="constrained")
    axes = figure.add_subplot()
    corners = track.xy_m[track.triangles]
    road = PolyCollection(
        list(corners), facecolor="#dfe6dc", edgecolor="#b9c6b4", linewidth=0.5
    )
    axes.add_collection(road)
    sides = ((track.left_m, ConeClass.BLUE), (track.right_m, ConeClass.YELLOW))
    for xy, kind in sides:
        ring = np.vstack([xy, xy[:1]]) if track.closed else xy
        axes.plot(ring[:, 0], ring[:, 1], color=_CONE_COLOUR[kind], lw=1.2)
    line = track.centerline.xy_m
    if track.closed:
        line = np.vstack([line, line[:1]])
    axes.plot(line[:, 0], line[:, 1], color="#30343a", lw=0.9, ls="--")
    finite = np.isfinite(cone_map.xy_m).all(axis=1)
    for kind in ConeClass:
        xy = cone_map.xy_m[finite & (cone_map.cone_class == kind)]
        axes.scatter(xy[:, 0], xy[:, 1], s=12, color=_CONE_COLOUR[kind], zorder=3)
    unused = np.isin(cone_map.id, [u.id for u in track.unused]) & finite
    axes.scatter(
        cone_map.xy_m[unused, 0],
        cone_map.xy_m[unused, 1],
        s=50,
        marker="x",
        color="#d0006f",
        zorder=4,
        label="on no boundary",
    )
    shape = "closed" if track.closed else "open"
    doubt = f" ({track.reason})" if track.reason else ""
    axes.set_title(
        f"{shape}, {track.length_m:.0f} m, confidence {track.confidence:.2f}{doubt}",
        fontsize=10,
    )
    axes.set_aspect("equal")
    axes.margins(0.05)
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.grid(color="#ececec", lw=0.6)
    axes.set_axisbelow(True)
    if unused.any():
        axes.legend(loc="best", fontsize=8)
    try:
        with mpl.rc_context({"svg.hashsalt": "conegraph"}):
            figure.savefig(path, dpi=130)
    except OSError as error:
        raise ConegraphError(f"{path}: cannot be written: {error.strerror}") from error
