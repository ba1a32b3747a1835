"""How near the track that a run found is to the true one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import shapely
from shapely import LineString
from shapely.geometry.base import BaseGeometry

from conegraph.eval.align import rms
from conegraph.eval.colour_metrics import ORANGES
from conegraph.eval.matching import find_twins, match_cones, one_row_each
from conegraph.eval.record import Record
from conegraph.eval.written_track import WrittenTrack
from conegraph.geometry import to_parent
from conegraph.io.cone_names import hard_class_prob
from conegraph.track import detect_track
from conegraph.types import Array, ConeMap, IntArray, TruthMap

SURE = 0.99
"""A true layout whose track is less certain is no lane to judge by."""

LAYOUT_SIGMA_M = 0.01
"""How well a layout is taken to say where its cones stand."""

NO_CONE = -1
"""Stands for a cone of the map that is none."""

_NAN = float("nan")


@dataclass(frozen=True, slots=True)
class TrackMetrics(Record):
    """The track in a run's ``track`` folder against that of the true layout.

    The true track is what track detection makes of the true cones where it is in no
    doubt; skidpads and landmarks without a lane have none. The run's track is put
    where the map fits the truth best.

    Attributes:
        found: whether the run found a road.
        closed_right: whether it is a loop exactly if the true track is.
        edges: directed edges between neighbours on the boundaries found.
        edges_right: share of them that join neighbours of the same true boundary in
            driving order. Cones that the map lacks are no neighbours, and start cones
            that one of the two tracks leaves beside the boundary break no edge.
        edges_found: right edges / true edges between cones of the map.
        road_iou: area of the intersection of both roads / area of their union.
        lateral_rmse_m: RMS distance of the centre line's points from the true centre
            line, m.
        lateral_max_m: the greatest, m.

    Source: intersection over union is the Jaccard index (P. Jaccard, 1912).
    """

    found: bool
    closed_right: bool
    edges: int
    edges_right: float
    edges_found: float
    road_iou: float
    lateral_rmse_m: float
    lateral_max_m: float


def true_track(truth: TruthMap, start_pose: Array | None) -> WrittenTrack | None:
    """Return the track between the true cones, None where that is in doubt.

    Args:
        truth: the true cones.
        start_pose: (3,) the true car at its start, if known: it says which way to go.
    """
    n = len(truth)
    cones = ConeMap(
        truth.id,
        truth.xy_m,
        np.tile(LAYOUT_SIGMA_M**2 * np.eye(2), (n, 1, 1)),
        hard_class_prob(truth.cone_class),
        np.ones(n, dtype=np.int64),
    )
    track = detect_track(cones, start_pose)
    return WrittenTrack.of(track) if track.confidence >= SURE else None


def track_metrics(
    track: WrittenTrack,
    cone_map: ConeMap,
    truth: TruthMap,
    true: WrittenTrack,
    pose: Array,
    max_distance_m: float,
) -> TrackMetrics:
    """Compare a run's track with the true one.

    Args:
        track: what the run wrote.
        cone_map: the map that it was found in.
        truth: the true cones.
        true: the true track.
        pose: (3,) the run's world in the truth's frame.
        max_distance_m: farthest pair of estimated and true cone.
    """
    edges = _Edges.of(cone_map, truth, pose, max_distance_m)
    counts = [
        edges.count(found, track.closed, chain, true.closed)
        for found, chain in ((track.left, true.left), (track.right, true.right))
    ]
    right, joined, due = np.sum(counts, axis=0).tolist()
    off_m = _off_line(to_parent(pose, track.line_m), true.line_m)
    road = shapely.transform(track.road, lambda xy: to_parent(pose, xy))
    return TrackMetrics(
        found=not track.road.is_empty,
        closed_right=track.closed == true.closed,
        edges=joined,
        edges_right=right / joined if joined else _NAN,
        edges_found=right / due if due else _NAN,
        road_iou=_iou(road, true.road),
        lateral_rmse_m=rms(off_m),
        lateral_max_m=float(off_m.max()) if len(off_m) else _NAN,
    )


@dataclass(frozen=True, slots=True)
class _Edges:
    """What it takes to judge edges.

    Attributes:
        one_id: the id that stands for each true cone: of twins, the first's.
        shown: of each cone of the map that has a true one, what stands for that.
        gate: ids of start cones.
    """

    one_id: dict[int, int]
    shown: dict[int, int]
    gate: set[int]

    @classmethod
    def of(
        cls, cone_map: ConeMap, truth: TruthMap, pose: Array, max_distance_m: float
    ) -> Self:
        """Match the map, put where the pose (3,) says, to the truth."""
        placed = to_parent(pose, cone_map.xy_m)
        pairs = match_cones(placed, truth.xy_m, max_distance_m)
        stands = truth.id[one_row_each(len(truth), find_twins(truth.xy_m))]
        own, true = cone_map.id[pairs.estimate], stands[pairs.truth]
        return cls(
            dict(zip(truth.id.tolist(), stands.tolist(), strict=True)),
            dict(zip(own.tolist(), true.tolist(), strict=True)),
            set(truth.id[np.isin(truth.cone_class, ORANGES)].tolist()),
        )

    def count(
        self, found: IntArray, closed: bool, chain: IntArray, true_closed: bool
    ) -> tuple[int, int, int]:
        """Return how many edges of a boundary are right, it has, and should have.

        Args:
            found: ids of the map along the boundary that was found.
            closed: whether it is a loop.
            chain: ids of the truth along the true boundary.
            true_closed: whether that is one.
        """
        seen = [self.shown.get(i, NO_CONE) for i in found.tolist()]
        true = [self.one_id[i] for i in chain.tolist()]
        beside = self.gate - set(true)
        held = set(self.shown.values()) - (self.gate - set(seen))
        edges = _neighbours([i for i in seen if i not in beside], closed)
        due = set(_neighbours([i for i in true if i in held], true_closed))
        return sum(edge in due for edge in edges), len(edges), len(due)


def _neighbours(chain: list[int], closed: bool) -> list[tuple[int, int]]:
    """Return the edges of a chain; a cone next to itself, as twins are, is one."""
    following = chain[1:] + (chain[:1] if closed else [])
    edges = zip(chain, following, strict=False)
    return [(a, b) for a, b in edges if a != b or a == NO_CONE]


def _iou(road: BaseGeometry, true: BaseGeometry) -> float:
    # A road that crosses itself is no polygon before it is cleaned.
    road, true = road.buffer(0), true.buffer(0)
    union = float(road.union(true).area)
    return float(road.intersection(true).area) / union if union > 0 else _NAN


def _off_line(xy_m: Array, line_m: Array) -> Array:
    """Return the distances (N,) of points from a line."""
    if len(line_m) < 2:
        return np.full(len(xy_m), np.nan)
    return np.asarray(shapely.distance(shapely.points(xy_m), LineString(line_m)))
