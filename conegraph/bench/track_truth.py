"""Tracks whose boundaries are known, and ways to spoil their cone maps.

The order of the true boundaries comes from the line to drive (`driving_line`, which
sees the whole clean map and often the file's own centre line): each cone is put on
the side of it where it stands, in the order in which the line passes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from conegraph.errors import ConegraphError
from conegraph.geometry import rotation
from conegraph.io.cone_names import hard_class_prob
from conegraph.io.tracks import read_track
from conegraph.sim.driving_line import SPACING_M, closes, driving_line
from conegraph.sim.polyline import nearest, project, tangent
from conegraph.sim.skidpad import recognise_skidpad
from conegraph.sim.track_shapes import built_in_track
from conegraph.types import Array, ConeClass, ConeMap, IntArray, TrackLayout

LANE_REACH_M = 5.0
"""Cones farther from the line stand on the site and not on the track."""
NARROWEST_LANE_M = 2.0
"""Layouts with narrower lanes are no tracks that a car can drive."""
_FALSE_REACH_M = 8.0
_SIGMA_M = 0.05


@dataclass(frozen=True, slots=True)
class KnownTrack:
    """Cones with the boundaries they form.

    Attributes:
        name: of the layout.
        xy_m: (N, 2) cones.
        cone_class: (N,) of `ConeClass`.
        left: true left boundary as rows of ``xy_m``, in driving order.
        right: the same on the right.
        line_m: (K, 2) true centre line, about 0.25 m apart.
        closed: whether the track is a loop.
        given_line: whether the centre line came with the track.
    """

    name: str
    xy_m: Array
    cone_class: IntArray
    left: IntArray
    right: IntArray
    line_m: Array
    closed: bool
    given_line: bool

    def cone_map(self) -> ConeMap:
        """Return the cones as a mapper would hand them over."""
        n = len(self.xy_m)
        return ConeMap(
            np.arange(n),
            self.xy_m,
            np.broadcast_to(_SIGMA_M**2 * np.eye(2), (n, 2, 2)),
            hard_class_prob(self.cone_class),
            np.full(n, 10),
        )

    def pose_at(self, index: int) -> Array:
        """Return the pose (3,) on the centre line at one of its points."""
        forward = tangent(self.line_m, self.closed)[index]
        return np.array([*self.line_m[index], np.arctan2(forward[1], forward[0])])


def known_track(layout: TrackLayout) -> KnownTrack:
    """Return a layout with its true boundaries.

    Raises:
        SourceError: no lane can be made out.
    """
    line = driving_line(layout)
    closed = closes(line)
    index, across = project(layout.xy_m, line, closed)
    beside = np.abs(across) < LANE_REACH_M
    along = index + 0.0
    # Two cones beside one point of the line are told apart by where they project.
    forward = tangent(line, closed)[index]
    along += ((layout.xy_m - line[index]) * forward).sum(axis=1) / SPACING_M
    order = np.argsort(along, kind="stable")
    return KnownTrack(
        layout.name,
        np.asarray(layout.xy_m),
        np.asarray(layout.cone_class),
        order[beside[order] & (across[order] > 0)],
        order[beside[order] & (across[order] < 0)],
        line,
        closed,
        layout.centerline_m is not None,
    )


def closed_tracks(folder: Path) -> list[KnownTrack]:
    """Return the loops among the track files of a folder, by name.

    Files that are no track, open ones, skidpads and lanes that no car fits are left
    out.
    """
    found = []
    for path in sorted(folder.rglob("*")):
        if path.suffix not in (".yaml", ".csv") or not path.is_file():
            continue
        try:
            layout = read_track(path)
            if not layout.closed or recognise_skidpad(layout, 15.0, 1.0) is not None:
                continue
            track = known_track(layout)
        except ConegraphError:
            continue
        if track.closed and _lane_m(track) >= NARROWEST_LANE_M:
            found.append(track)
    return found


def random_tracks(seeds: Sequence[int]) -> list[KnownTrack]:
    """Return random courses from seeds, every other one turned and driven backwards."""
    tracks = []
    for seed in seeds:
        track = known_track(built_in_track("random", seed))
        track = replace(track, name=f"random {seed}")
        track = moved(track, 0.7 * seed, np.array([300.0, -200.0]))
        tracks.append(reverse(track) if seed % 2 else track)
    return tracks


def course_of(cones: int) -> KnownTrack:
    """Return a round course with a wavy lane of 3.5 m and so many cones."""
    per_side = cones // 2
    angle = 2 * np.pi * np.arange(per_side) / per_side
    radius = 3.5 * per_side / (2 * np.pi)
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    wave = radius + 0.05 * radius * np.sin(7 * angle)
    sides = [around * (wave + off)[:, None] for off in (-1.75, 1.75)]
    order = np.arange(2 * per_side)
    kind = np.repeat([ConeClass.BLUE, ConeClass.YELLOW], per_side).astype(np.int64)
    left, right = order[:per_side], order[per_side:]
    line = around * wave[:, None]
    return KnownTrack(
        f"{cones} cones", np.vstack(sides), kind, left, right, line, True, True
    )


def _lane_m(track: KnownTrack) -> float:
    away, _ = nearest(track.xy_m[track.left], track.xy_m[track.right])
    return float(np.median(away))


def moved(track: KnownTrack, yaw_rad: float, shift_m: Array) -> KnownTrack:
    """Return the track turned about the origin and then shifted."""
    R = rotation(yaw_rad)
    return replace(
        track, xy_m=track.xy_m @ R.T + shift_m, line_m=track.line_m @ R.T + shift_m
    )


def reverse(track: KnownTrack) -> KnownTrack:
    """Return the track as driven the other way round, with the colours swapped."""
    swap = np.array([1, 0, 2, 3, 4])
    return replace(
        track,
        cone_class=swap[track.cone_class],
        left=track.right[::-1],
        right=track.left[::-1],
        line_m=track.line_m[::-1],
    )


@dataclass(frozen=True, slots=True)
class Spoil:
    """How to spoil a map: shares of its cones, and a position error.

    Attributes:
        missing: share of cones that are left out.
        false: false cones added, as a share of the cones; blue or yellow, anywhere
            within 8 m of a true cone.
        flipped: share of blue and yellow cones with the other colour.
        noise_m: sigma of the error of each coordinate.
        colour: False makes every cone's class unknown.
    """

    missing: float = 0.0
    false: float = 0.0
    flipped: float = 0.0
    noise_m: float = 0.0
    colour: bool = True


def spoiled(track: KnownTrack, spoil: Spoil, rng: np.random.Generator) -> KnownTrack:
    """Return a track with a spoilt map, its boundaries those of the cones that stay.

    The rows are shuffled.
    """
    n = len(track.xy_m)
    keep = np.sort(rng.permutation(n)[: n - round(spoil.missing * n)])
    kind = track.cone_class.copy()
    coloured = np.flatnonzero(kind <= ConeClass.YELLOW)
    flip = rng.permutation(coloured)[: round(spoil.flipped * n)]
    kind[flip] = 1 - kind[flip]
    extra = round(spoil.false * n)
    near = track.xy_m[rng.integers(n, size=extra)]
    away = _FALSE_REACH_M * np.sqrt(rng.random(extra))[:, None]
    bearing = rng.uniform(0.0, 2 * np.pi, extra)
    false = near + away * np.column_stack([np.cos(bearing), np.sin(bearing)])
    xy = np.vstack([track.xy_m[keep], false])
    kinds = np.concatenate([kind[keep], rng.integers(2, size=extra)])
    shuffle = rng.permutation(len(xy))
    place = np.full(n, -1)
    place[keep] = np.argsort(shuffle)[: len(keep)]
    left, right = (place[side] for side in (track.left, track.right))
    xy = xy[shuffle] + spoil.noise_m * rng.standard_normal(xy.shape)
    kinds = kinds[shuffle] if spoil.colour else np.full(len(xy), ConeClass.UNKNOWN)
    return replace(
        track,
        xy_m=xy,
        cone_class=kinds.astype(np.int64),
        left=left[left >= 0],
        right=right[right >= 0],
    )


def window(track: KnownTrack, pose: Array, reach_m: float) -> KnownTrack:
    """Return what a car at a pose sees: cones ahead within reach.

    Boundaries are cut into what is seen of them; an edge between two cones that are
    neighbours in the cut list is right only if they are neighbours on the track, or
    if what stood between them is not seen.
    """
    away = track.xy_m - pose[:2]
    ahead = away @ [np.cos(pose[2]), np.sin(pose[2])]
    seen = (np.hypot(*away.T) < reach_m) & (ahead > -2.0)
    place = np.where(seen, np.cumsum(seen) - 1, -1)
    left, right = (place[side] for side in (track.left, track.right))
    return replace(
        track,
        xy_m=track.xy_m[seen],
        cone_class=track.cone_class[seen],
        left=left[left >= 0],
        right=right[right >= 0],
    )
