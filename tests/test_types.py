"""Values are checked at the edge and cannot be changed afterwards."""

from collections.abc import Callable
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from conegraph.types import (
    CLASS_LABELS,
    Associations,
    ConeClass,
    ConeMap,
    ConeObservations,
    Estimate,
    Lap,
    MatchStatus,
    Recording,
    Source,
    TrackLayout,
    Trajectory,
    TruthMap,
    VelocityObservation,
)


def observations(n: int = 3) -> ConeObservations:
    return ConeObservations(
        1.5,
        np.arange(2.0 * n).reshape(n, 2),
        np.tile(np.eye(2), (n, 1, 1)),
        np.eye(5)[np.arange(n) % 5],
        np.arange(n) + 10,
    )


def test_class_labels_are_the_names_that_files_use() -> None:
    assert CLASS_LABELS == ("blue", "yellow", "orange", "big_orange", "unknown")
    assert [c.value for c in ConeClass] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        (
            "xy_m",
            np.zeros((3, 3)),
            r"xy_m must have shape \('N', 2\), but got \(3, 3\)",
        ),
        ("cov_m2", np.zeros((2, 2, 2)), r"cov_m2 must have shape \(3, 2, 2\)"),
        ("class_prob", np.zeros((3, 4)), r"class_prob must have shape \(3, 5\)"),
        ("truth_id", np.zeros(4), r"truth_id must have shape \(3,\), but got \(4,\)"),
    ],
)
def test_wrong_shapes_are_named(
    field: str, value: np.typing.NDArray[np.float64], message: str
) -> None:
    good = observations()
    parts = {name: getattr(good, name) for name in good.__dataclass_fields__}
    with pytest.raises(ValueError, match=message):
        ConeObservations(**{**parts, field: value})


@pytest.mark.parametrize("name", ["stamp_s", "xy_m"])
def test_fields_cannot_be_replaced(name: str) -> None:
    with pytest.raises(FrozenInstanceError):
        setattr(observations(), name, 2.0)


def test_arrays_cannot_be_written() -> None:
    cones = observations()
    with pytest.raises(ValueError, match="read-only"):
        cones.xy_m[0, 0] = 7.0


def test_freezing_leaves_the_callers_array_writeable() -> None:
    mine = np.zeros((2, 2))
    VelocityObservation(0.0, 1.0, 0.0, mine)
    mine[0, 0] = 1.0
    assert mine[0, 0] == 1.0


def test_nothing_seen_keeps_the_columns() -> None:
    none = np.zeros(0)
    frame = ConeObservations(0.0, none, none, none, none.astype(np.int64))
    assert frame.xy_m.shape == (0, 2)
    assert frame.cov_m2.shape == (0, 2, 2)
    assert frame.class_prob.shape == (0, 5)
    assert len(frame) == len(ConeMap.empty()) == 0
    assert ConeMap.empty().cov_m2.shape == (0, 2, 2)


def test_a_map_s_subset_keeps_every_column_of_its_rows() -> None:
    n = np.arange(3)
    whole = ConeMap(
        n + 5,
        np.array([[0.5, 0.5], [1.5, -0.5], [2.5, -1.5]]),
        (n + 1.0)[:, None, None] * np.eye(2),
        np.eye(5)[:3],
        n + 7,
    )
    part = whole.subset(np.array([2, 0]))
    for name in ("id", "xy_m", "cov_m2", "class_prob", "observations"):
        column = getattr(whole, name)
        np.testing.assert_array_equal(getattr(part, name), column[[2, 0]])
    assert len(whole.subset(np.zeros(3, dtype=bool))) == 0


def test_subset_takes_masks_and_indices_row_by_row() -> None:
    cones = observations()
    by_mask = cones.subset(np.array([True, False, True]))
    by_index = cones.subset(np.array([0, 2]))
    for part in (by_mask, by_index):
        np.testing.assert_array_equal(part.xy_m, [[0, 1], [4, 5]])
        assert part.truth_id is not None
        assert part.truth_id.tolist() == [10, 12]
        assert part.stamp_s == cones.stamp_s
    blind = ConeObservations(0.0, cones.xy_m, cones.cov_m2, cones.class_prob)
    assert blind.subset(np.array([1])).truth_id is None


def test_cone_class_of_a_map_is_the_most_probable() -> None:
    prob = np.array([[0.1, 0.7, 0.0, 0.1, 0.1], [0.0, 0.0, 0.0, 0.4, 0.6]])
    ids = np.arange(2)
    cones = ConeMap(ids, np.zeros((2, 2)), np.zeros((2, 2, 2)), prob, ids)
    assert cones.cone_class.tolist() == [ConeClass.YELLOW, ConeClass.UNKNOWN]


@pytest.mark.parametrize(
    "build",
    [
        lambda: Estimate(0.0, np.zeros(2), np.eye(3), np.zeros(2)),
        lambda: Trajectory(np.zeros(2), np.zeros((3, 3))),
        lambda: TruthMap(np.arange(2), np.zeros((3, 2)), np.arange(2)),
        lambda: TrackLayout("t", np.zeros((2, 2)), np.arange(2), np.zeros(2)),
        lambda: Associations(0.0, (MatchStatus.NEW,), np.arange(2), np.zeros(1)),
    ],
    ids=["estimate", "trajectory", "truth map", "layout", "associations"],
)
def test_lengths_must_agree(build: Callable[[], object]) -> None:
    with pytest.raises(ValueError, match="must have shape"):
        build()


def test_a_recording_is_a_source_and_counts_its_frames() -> None:
    velocity = VelocityObservation(1.0, 2.0, 0.0, np.eye(2))
    source: Source = Recording("r", (velocity, observations(), observations()))
    assert source.n_frames == 2
    assert list(source.events()) == list(source.events())
    assert next(source.events()) is velocity


def test_lap_time() -> None:
    assert Lap(1, 10.0, 32.5).duration_s == 22.5
