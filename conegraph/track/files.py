"""What ``track`` writes: boundaries, triangles, centre line, GeoJSON, a summary."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from conegraph.errors import ConegraphError
from conegraph.io.csv_table import exact, format_rows
from conegraph.io.plain import to_plain
from conegraph.io.run_writer import MAP, format_map, replace_text
from conegraph.track.events import EventPlan
from conegraph.track.model import Track
from conegraph.track.shapes import geojson

SCHEMA_VERSION = 1
TRACK = "track"
"""Folder in a run's folder for what is written here."""

BOUNDARIES = "boundaries.csv"
TRIANGLES = "triangles.csv"
CENTERLINE = "centerline.csv"
GEOJSON = "track.geojson"
SUMMARY = "track.json"
PATH = "path.csv"
EVENT = "event.json"


def write_track(folder: Path, track: Track) -> None:
    """Write a track into a folder; files of an earlier one are replaced.

    Raises:
        ConegraphError: the folder or a file cannot be written.
    """
    _make(folder)
    replace_text(folder / BOUNDARIES, _boundaries(track))
    corners = track.triangle_id.astype(str)
    rows = format_rows([corners[:, k].tolist() for k in range(3)])
    replace_text(folder / TRIANGLES, "a,b,c\n" + rows)
    replace_text(folder / CENTERLINE, _centerline(track))
    shapes = json.dumps(to_plain(geojson(track)), allow_nan=False)
    replace_text(folder / GEOJSON, shapes + "\n")
    summary = json.dumps(to_plain(summarise(track)), indent=2, allow_nan=False)
    replace_text(folder / SUMMARY, summary + "\n")


def write_event(folder: Path, plan: EventPlan) -> None:
    """Write the map and the scripted path of an event into a folder.

    ``map.csv`` is for ``run --map map.csv --mode localize``; ``path.csv`` has the
    columns ``s,x,y``; ``event.json`` says where the timing lines are and where to stop.

    Raises:
        ConegraphError: the folder or a file cannot be written.
    """
    _make(folder)
    replace_text(folder / MAP, format_map(plan.cone_map))
    columns = (plan.s_m, plan.path_m[:, 0], plan.path_m[:, 1])
    replace_text(folder / PATH, "s,x,y\n" + format_rows([exact(c) for c in columns]))
    facts = {
        "schema_version": SCHEMA_VERSION,
        "stop_s_m": plan.stop_s_m,
        "timing_line": plan.line_pose,
        "finish_line": plan.finish_pose,
        "segments": plan.segments,
    }
    text = json.dumps(to_plain(facts), indent=2, allow_nan=False)
    replace_text(folder / EVENT, text + "\n")


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConegraphError(f"{folder}: cannot be made: {error.strerror}") from error


def summarise(track: Track) -> dict[str, object]:
    """Return what ``track.json`` holds; lengths in metres."""
    return {
        "schema_version": SCHEMA_VERSION,
        "closed": track.closed,
        "length_m": track.length_m,
        "lane_m": track.lane_m,
        "confidence": track.confidence,
        "reason": track.reason,
        "cones": len(track.id),
        "left": track.left_id,
        "right": track.right_id,
        "unused": track.unused,
        "relabelled": track.relabelled,
        "bridged": track.bridged,
    }


def _boundaries(track: Track) -> str:
    rows = []
    for side, chain in (("left", track.left), ("right", track.right)):
        rows.append(
            format_rows(
                [
                    [side] * len(chain),
                    [str(k) for k in range(len(chain))],
                    [str(i) for i in track.id[chain].tolist()],
                    exact(track.xy_m[chain, 0]),
                    exact(track.xy_m[chain, 1]),
                ]
            )
        )
    return "side,index,id,x,y\n" + "".join(rows)


def _centerline(track: Track) -> str:
    line = track.centerline
    table = np.column_stack([line.xy_m, line.right_m, line.left_m])
    columns = [[f"{v:.6f}" for v in table[:, k].tolist()] for k in range(4)]
    return "# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + format_rows(columns)
