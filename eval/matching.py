"""One-to-one matching of estimated cones to true cones."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from conegraph.eval.align import align_se2
from conegraph.geometry import to_parent
from conegraph.types import Array, IntArray, Mask

TWIN_DISTANCE_M = 0.15
"""A cone's base is 0.228 m wide: two this close cannot both stand, so a file errs."""

MAX_ALIGN_ROUNDS = 20

DEFAULT_GATE_M = 1.0
"""Farthest pair that still counts as the same cone.

A Formula Student track is at least 3 m wide, so a pair this near never takes a cone
of the other boundary; and a cone that is off by more than 1 m is of no use to a
planner, so counting it as missed and false is honest.
"""


@dataclass(frozen=True, slots=True)
class Matching:
    """Who was paired with whom, as row indices into the two sets.

    Attributes:
        estimate: (K,) rows of the estimate that have a true cone.
        truth: (K,) rows of the truth, paired with `estimate`.
        distance_m: (K,) how far apart each pair is.
        duplicate: rows of the estimate without a partner whose true cone, within
            the gate, is already taken.
        false: rows of the estimate with no true cone within the gate.
        missed: rows of the truth without a partner.
    """

    estimate: IntArray
    truth: IntArray
    distance_m: Array
    duplicate: IntArray
    false: IntArray
    missed: IntArray

    def __len__(self) -> int:
        return len(self.estimate)

    def subset(self, keep: Mask) -> Matching:
        """Return the matching with only the pairs (K,) that ``keep`` selects."""
        return replace(
            self,
            estimate=self.estimate[keep],
            truth=self.truth[keep],
            distance_m=self.distance_m[keep],
        )


def match_cones(
    estimate_xy_m: Array, truth_xy_m: Array, max_distance_m: float = DEFAULT_GATE_M
) -> Matching:
    """Pair as many cones as the gate allows, then with the least squared distance.

    Classes play no part, so that a wrong colour is a colour error and not a missed
    cone plus a false one. An unpaired estimate within the gate of a true cone is a
    duplicate: had that cone been free, the two would be a pair.

    Args:
        estimate_xy_m: (N, 2) positions, in the truth's frame.
        truth_xy_m: (M, 2) positions.
        max_distance_m: the gate.

    Source: linear assignment (H. Kuhn, 1955) as solved by scipy (D. Crouse, 2016).
    """
    n, m = len(estimate_xy_m), len(truth_xy_m)
    offset = estimate_xy_m.reshape(n, 1, 2) - truth_xy_m.reshape(1, m, 2)
    d = np.hypot(offset[..., 0], offset[..., 1])
    inside = d <= max_distance_m
    # One pair more must outweigh every distance that the gate can hold.
    outside_cost = max_distance_m**2 * (min(n, m) + 1)
    rows, columns = linear_sum_assignment(np.where(inside, d**2, outside_cost))
    kept = inside[rows, columns]
    rows, columns = rows[kept].astype(np.int64), columns[kept].astype(np.int64)
    unpaired = np.setdiff1d(np.arange(n), rows)
    near = inside[unpaired].any(axis=1)
    return Matching(
        estimate=rows,
        truth=columns,
        distance_m=d[rows, columns],
        duplicate=unpaired[near],
        false=unpaired[~near],
        missed=np.setdiff1d(np.arange(m), columns),
    )


def align_and_match(
    estimate_xy_m: Array, truth_xy_m: Array, initial_pose: Array, max_distance_m: float
) -> tuple[Array, Matching]:
    """Match, align to the matched pairs, and repeat until the pairs stay the same.

    Iterative closest point, with one-to-one pairs inside a gate (P. Besl and
    N. McKay, "A method for registration of 3-D shapes", IEEE PAMI 14(2), 1992).

    Returns:
        The estimate's frame in the truth's (3,), and the matching under it.
    """
    pose = initial_pose
    matching = match_cones(to_parent(pose, estimate_xy_m), truth_xy_m, max_distance_m)
    for _ in range(MAX_ALIGN_ROUNDS):
        if len(matching) < 2:
            break
        matched = estimate_xy_m[matching.estimate]
        pose = align_se2(matched, truth_xy_m[matching.truth]).pose
        placed = to_parent(pose, estimate_xy_m)
        previous = matching
        matching = match_cones(placed, truth_xy_m, max_distance_m)
        if np.array_equal(previous.estimate, matching.estimate) and np.array_equal(
            previous.truth, matching.truth
        ):
            break
    return pose, matching


def best_match(
    estimate_xy_m: Array,
    truth_xy_m: Array,
    initial_poses: tuple[Array, ...],
    max_distance_m: float = DEFAULT_GATE_M,
) -> tuple[Array, Matching]:
    """Align and match from several first guesses; most pairs win, then least error."""
    found = [
        align_and_match(estimate_xy_m, truth_xy_m, p, max_distance_m)
        for p in initial_poses
    ]
    return min(found, key=lambda f: (-len(f[1]), float(np.sum(f[1].distance_m ** 2))))


def find_twins(truth_xy_m: Array) -> IntArray:
    """Return the rows (K, 2) of true cones that stand implausibly close together."""
    pairs = KDTree(truth_xy_m.reshape(-1, 2)).query_pairs(
        TWIN_DISTANCE_M, output_type="ndarray"
    )
    return pairs[np.lexsort(pairs.T[::-1])].astype(np.int64)


def one_row_each(n: int, twins: IntArray) -> IntArray:
    """Return (n,) the row that stands for each true cone: of twins, the first.

    Args:
        n: true cones in all.
        twins: (K, 2) rows of those that stand implausibly close together.
    """
    links = coo_array((np.ones(len(twins)), (twins[:, 0], twins[:, 1])), (n, n))
    _, group = connected_components(links, directed=False)
    first = np.unique(group, return_index=True)[1]
    return first[group].astype(np.int64)
