"""A frame and a map: what is matched, what is born, what is tried again."""

from __future__ import annotations

import numpy as np
import pytest

from conegraph.backends.local_map import LocalMap
from conegraph.backends.pairing import RESCUE, ROLE_INDEX, FramePairer
from conegraph.config import AssociationConfig, Config
from conegraph.types import Array, ConeClass, ConeObservations, SensorModel

SENSOR = SensorModel(np.array([0.1, 0.0, 0.0]), 0.01, max_range_m=20.0)

R_M2 = 0.01
"""Variance of every report below."""

XY = np.array([[4.0, 1.5], [4.0, -1.5], [8.0, 1.5], [8.0, -1.5], [12.0, 2.5]])


def report(
    xy: Array, named: ConeClass = ConeClass.BLUE, ids: list[int] | None = None
) -> ConeObservations:
    prob = np.full((len(xy), 5), 0.025)
    prob[:, named] = 0.9
    truth = None if ids is None else np.array(ids)
    cov = np.tile(R_M2 * np.eye(2), (len(xy), 1, 1))
    return ConeObservations(0.0, xy, cov, prob, truth)


def mapped(config: Config, **kwargs: list[int]) -> LocalMap:
    map_ = LocalMap(config)
    map_.add(report(XY, ids=kwargs.get("ids")), 0.0)
    return map_


STILL = np.zeros((6, 6))


def test_classes_have_the_configured_roles() -> None:
    pairer = FramePairer(Config(), SENSOR)
    roles = pairer.roles(np.eye(5)).tolist()
    want = ["left", "right", "start", "start", "none"]
    assert roles == [ROLE_INDEX[name] for name in want]


def test_cones_in_their_places_match_and_nothing_is_born() -> None:
    config = Config()
    order = [3, 0, 4, 1, 2]
    pairs = FramePairer(config, SENSOR).pair(mapped(config), report(XY[order]), STILL)
    np.testing.assert_array_equal(pairs.slot, order)
    assert not pairs.birth.any()
    assert not pairs.ambiguous.any()
    assert pairs.n_known == 5
    np.testing.assert_array_equal(np.sort(pairs.visible), range(5))


@pytest.mark.parametrize(
    ("d2", "fate"), [(12.0, "match"), (20.0, "open"), (30.0, "new")]
)
def test_between_match_and_birth_lies_a_band_of_neither(d2: float, fate: str) -> None:
    # The fourth of five is off by what d2 = e^2 / S makes of it; the others fix the
    # car, which had no doubt to begin with. S is 0.01 of the report and of the map.
    config = Config()
    xy = XY.copy()
    xy[3, 1] -= np.sqrt(d2 * 2 * R_M2)
    pairs = FramePairer(config, SENSOR).pair(mapped(config), report(xy), STILL)
    np.testing.assert_array_equal(pairs.slot[[0, 1, 2, 4]], [0, 1, 2, 4])
    assert bool(pairs.matched[3]) == (fate == "match")
    assert bool(pairs.ambiguous[3]) == (fate == "open")
    assert bool(pairs.birth[3]) == (fate == "new")
    assert pairs.d2[3] == pytest.approx(d2)


def test_only_a_cone_that_comes_back_must_beat_a_new_one_by_a_margin() -> None:
    """With a margin that nothing beats, what still matches has none."""
    config = Config(association=AssociationConfig(new_margin=1000.0))
    map_, frame = mapped(config), report(XY)
    followed = np.array([0, 1, 2, 4])
    map_.book.hit(followed, frame.class_prob[followed], 10.0)
    pairs = FramePairer(config, SENSOR).pair(map_, frame, STILL)
    np.testing.assert_array_equal(np.flatnonzero(pairs.matched), followed)


def test_where_cones_stand_in_clusters_each_must_beat_a_new_one() -> None:
    config = Config(association=AssociationConfig(new_margin=1000.0))
    beside = XY[:2] + np.array([0.0, 0.5])
    map_ = mapped(config)
    map_.add(report(beside), 0.0)
    pairs = FramePairer(config, SENSOR).pair(map_, report(XY), STILL)
    assert not pairs.matched.any()


def test_a_car_that_jumped_is_found_by_doubting_its_motion() -> None:
    config = Config()
    map_ = mapped(config)
    noise = np.diag([0.02, 0.02, 1e-5, 0.0, 0.0, 0.0])
    before = map_.filter.vehicle_cov
    pairs = FramePairer(config, SENSOR).pair(map_, report(XY - [0.9, 0.0]), noise)
    np.testing.assert_array_equal(pairs.slot, range(5))
    # 0.9 m: d2 = 0.81 / 0.02 = 40 alone, 0.81 / (0.02 + 24 * 0.02) = 1.6 in doubt.
    np.testing.assert_allclose(map_.filter.vehicle_cov - before, RESCUE * noise)


def test_doubt_that_helps_nothing_is_taken_back() -> None:
    config = Config()
    map_ = mapped(config)
    before = map_.filter.vehicle_cov
    strange = np.array([[5.9, 0.4], [6.2, -0.3], [3.1, -0.4], [9.9, 0.2]])
    noise = np.diag([1e-6, 1e-6, 1e-8, 0.0, 0.0, 0.0])
    pairs = FramePairer(config, SENSOR).pair(map_, report(strange), noise)
    assert not pairs.matched.any()
    np.testing.assert_allclose(map_.filter.vehicle_cov, before, atol=1e-15)
    # Where the map is known and nothing fits, nothing is born either.
    assert pairs.n_known >= 2
    assert not pairs.birth.any()


@pytest.mark.parametrize("method", ["sequential", "one_to_one", "jcbb"])
def test_one_wrong_colour_keeps_no_cone_from_its_place(method: str) -> None:
    config = Config(association=AssociationConfig.model_validate({"method": method}))
    frame = report(XY)
    prob = frame.class_prob.copy()
    prob[2] = prob[2, [1, 0, 2, 3, 4]]
    odd = ConeObservations(0.0, frame.xy_m, frame.cov_m2, prob)
    map_ = mapped(config)
    pairs = FramePairer(config, SENSOR).pair(map_, odd, STILL)
    np.testing.assert_array_equal(pairs.slot, range(5))
    hard = {"method": method, "colour": "same_role"}
    strict = Config(association=AssociationConfig.model_validate(hard))
    pairs = FramePairer(strict, SENSOR).pair(map_, odd, STILL)
    np.testing.assert_array_equal(pairs.slot, [0, 1, -1, 3, 4])


def test_true_ids_are_matched_however_far_and_born_when_unseen() -> None:
    config = Config(association=AssociationConfig(method="known"))
    map_ = mapped(config, ids=[10, 11, 12, 13, 14])
    frame = report(XY[:3] + 5.0, ids=[12, 99, -1])
    pairs = FramePairer(config, SENSOR).pair(map_, frame, STILL)
    np.testing.assert_array_equal(pairs.slot, [2, -1, -1])
    np.testing.assert_array_equal(pairs.birth, [False, True, False])


def test_pairs_that_have_corrected_the_filter_are_fixed_and_exclusive() -> None:
    config = Config()
    pairs = FramePairer(config, SENSOR).pair(mapped(config), report(XY), STILL)
    used = pairs.with_used(np.array([0]), np.array([3]))
    # Row 0 has slot 3 now, and row 3, which had it, has none.
    np.testing.assert_array_equal(used.slot, [3, 1, 2, -1, 4])
    assert used.vague[0]
    assert not used.update[0]
    assert not used.birth[0]
