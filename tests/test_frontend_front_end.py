"""Rendered pictures through the whole front end, and what bad ones do to it."""

from dataclasses import replace

import numpy as np
import pytest

from conegraph.camera import Camera, RgbdFrame
from conegraph.config import load_config
from conegraph.frontend import make_front_end
from conegraph.sim.render import D435, FrameTruth, draw_light, make_scene, render_frame
from conegraph.types import ConeClass, TruthMap

CONES = TruthMap(
    np.arange(6),
    np.array([[4, 1.6], [4, -1.6], [8, 1.7], [9, -1.8], [6.5, 0.1], [14, 1.5]]),
    np.array([0, 1, 0, 1, 3, 2]),
)


@pytest.fixture(scope="module")
def rendered() -> tuple[RgbdFrame, FrameTruth]:
    rng = np.random.default_rng(11)
    scene = make_scene(CONES, rng, light=draw_light(rng, "bright"), clutter=0)
    return render_frame(scene, np.zeros(3), rng)


def test_every_cone_is_found_where_it_is(
    rendered: tuple[RgbdFrame, FrameTruth],
) -> None:
    frame, truth = rendered
    seen = make_front_end(load_config()).examine(frame)
    cones = seen.observations
    assert len(cones) == len(seen.box_px) == len(seen.score) == len(truth) == 6
    away = np.linalg.norm(cones.xy_m[:, None] - truth.xy_m[None], axis=2)
    row = away.argmin(axis=1)
    assert sorted(row.tolist()) == list(range(6))
    range_m = np.hypot(*truth.xy_m[row].T)
    assert (away.min(axis=1) < 0.02 + 0.002 * range_m**2).all()
    assert cones.class_prob.argmax(axis=1).tolist() == truth.cone_class[row].tolist()
    error = cones.xy_m - truth.xy_m[row]
    d2 = np.einsum("ni,nij,nj->n", error, np.linalg.inv(cones.cov_m2), error)
    assert d2.max() < 16.0
    big = cones.class_prob.argmax(axis=1) == ConeClass.BIG_ORANGE
    assert seen.height_m[big] == pytest.approx([0.505], abs=0.03)


def test_the_same_frames_give_the_same_cones(
    rendered: tuple[RgbdFrame, FrameTruth],
) -> None:
    first, second = (
        make_front_end(load_config()).detect(rendered[0]) for _ in range(2)
    )
    assert first.xy_m.tobytes() == second.xy_m.tobytes()
    assert first.cov_m2.tobytes() == second.cov_m2.tobytes()


@pytest.mark.parametrize(
    ("factor", "reason"),
    [
        (0.0, "depth picture that is empty"),
        (1000.0, "depth picture that looks like millimetres"),
    ],
)
def test_without_depth_cones_are_found_with_more_doubt(
    rendered: tuple[RgbdFrame, FrameTruth], factor: float, reason: str
) -> None:
    frame, _ = rendered
    front_end = make_front_end(load_config())
    with_depth = make_front_end(load_config()).detect(frame)
    blind = front_end.detect(replace(frame, depth_m=frame.depth_m * np.float32(factor)))
    assert front_end.rejected == {reason: 1}
    assert len(blind) >= 4
    near, nearest = blind.xy_m[:, 0].argmin(), with_depth.xy_m[:, 0].argmin()
    assert np.trace(blind.cov_m2[near]) > 4 * np.trace(with_depth.cov_m2[nearest])


def test_broken_depth_is_counted_and_not_used(
    rendered: tuple[RgbdFrame, FrameTruth],
) -> None:
    frame, _ = rendered
    holes = frame.depth_m.copy()
    holes[::3] = np.nan
    holes[1::3] = -1.0
    front_end = make_front_end(load_config())
    cones = front_end.detect(replace(frame, depth_m=holes))
    assert np.isfinite(cones.xy_m).all()
    assert np.isfinite(cones.cov_m2).all()


@pytest.mark.parametrize("size", [(1, 1), (8, 6), (64, 48)])
@pytest.mark.parametrize("profile", ["default", "thesis"])
def test_pictures_of_any_size_are_looked_at(
    size: tuple[int, int], profile: str
) -> None:
    width, height = size
    lens = Camera(width, height, 60.0, 60.0, width / 2, height / 2)
    rng = np.random.default_rng(1)
    color = rng.integers(0, 256, (height, width, 3), np.uint8)
    depth_m = rng.uniform(0, 9, (height, width)).astype(np.float32)
    frame = RgbdFrame(0.0, color, depth_m, lens, D435.mount)
    config = load_config(None, [f"detector.profile={profile}"])
    cones = make_front_end(config).detect(frame)
    assert np.isfinite(cones.xy_m).all()
    assert (np.linalg.eigvalsh(cones.cov_m2) > 0).all()


def test_confetti_takes_no_time_to_speak_of() -> None:
    rng = np.random.default_rng(4)
    color = rng.integers(0, 256, (480, 640, 3), np.uint8)
    depth_m = rng.uniform(0.3, 9, (480, 640)).astype(np.float32)
    frame = RgbdFrame(0.0, color, depth_m, D435.camera, D435.mount)
    front_end = make_front_end(load_config())
    cones = front_end.detect(frame)
    assert len(cones) < 100
    assert np.isfinite(cones.xy_m).all()


def test_what_is_refused_is_counted_by_reason(
    rendered: tuple[RgbdFrame, FrameTruth],
) -> None:
    front_end = make_front_end(load_config(None, ["detector.max_range_m=6"]))
    cones = front_end.detect(rendered[0])
    assert np.hypot(*cones.xy_m.T).max() < 6.1
    assert front_end.refused["out of range"] >= 1
    assert not front_end.rejected
