"""The ground is found exactly where it is exact, and not where there is none."""

from dataclasses import replace

import numpy as np
import pytest

from conegraph.camera import Camera, CameraMount, RgbdFrame
from conegraph.config import GroundConfig
from conegraph.frontend.camera import plane_of_mount, ray_grid
from conegraph.frontend.ground import GroundTracker
from conegraph.types import Array

LENS = Camera(640, 480, 465.0, 465.0, 321.3, 238.1, (-0.06, 0.02, 4e-4, -3e-4, 0.0))
MOUNT = CameraMount(height_m=0.9, pitch_rad=0.14)
NOISE_PER_M = 0.004


def inverse_ground(mount: CameraMount) -> Array:
    """Return 1/Z (H, W) of the ground, 0 or less above the horizon."""
    plane = plane_of_mount(mount)
    found: Array = ray_grid(LENS, 1).astype(np.float64) @ plane[:2] + plane[2]
    return found


def frame_of(inverse: Array, stamp_s: float = 0.0) -> RgbdFrame:
    seen = inverse > 1.0 / 18.0
    depth_m = np.where(seen, 1.0 / np.where(seen, inverse, 1.0), 0.0)
    color = np.zeros((480, 640, 3), dtype=np.uint8)
    return RgbdFrame(stamp_s, color, depth_m.astype(np.float32), LENS, MOUNT)


def test_an_exact_plane_is_found_exactly() -> None:
    leaning = replace(MOUNT, pitch_rad=0.155, roll_rad=-0.01, height_m=0.92)
    ground = GroundTracker(GroundConfig()).update(frame_of(inverse_ground(leaning)))
    assert ground.measured
    found = ground.mount(MOUNT)
    assert found.pitch_rad == pytest.approx(0.155, abs=2e-5)
    assert found.roll_rad == pytest.approx(-0.01, abs=2e-5)
    assert found.height_m == pytest.approx(0.92, abs=1e-4)


def test_things_on_the_ground_do_not_bend_it() -> None:
    inverse = inverse_ground(replace(MOUNT, pitch_rad=0.15))
    inverse[250:400, 50:200] += 0.15
    inverse[300:460, 400:600] += 0.3
    found = GroundTracker(GroundConfig()).update(frame_of(inverse)).mount(MOUNT)
    assert found.pitch_rad == pytest.approx(0.15, abs=1e-4)


def test_its_covariance_is_that_of_its_errors() -> None:
    rng = np.random.default_rng(5)
    true = plane_of_mount(MOUNT)
    exact = inverse_ground(MOUNT)
    nees = []
    for _ in range(25):
        noisy = frame_of(exact + NOISE_PER_M * rng.standard_normal(exact.shape))
        ground = GroundTracker(GroundConfig()).update(noisy)
        assert ground.noise_per_m == pytest.approx(NOISE_PER_M, rel=0.15)
        error = ground.plane - true
        nees.append(error @ np.linalg.solve(ground.cov, error) / 3.0)
    # Points are taken to err in groups: for independent noise that is 1.5^2 too wide.
    assert 0.5 < 1.5**2 * np.mean(nees) < 1.6


@pytest.mark.parametrize("kind", ["nothing", "a wall", "noise"])
def test_without_a_ground_the_mount_is_all_there_is(kind: str) -> None:
    inverse = np.zeros((480, 640))
    if kind == "a wall":
        inverse += 0.5
    elif kind == "noise":
        inverse = np.random.default_rng(1).uniform(0.06, 3.0, (480, 640))
    ground = GroundTracker(GroundConfig()).update(frame_of(inverse))
    assert not ground.measured
    assert ground.plane == pytest.approx(plane_of_mount(MOUNT))


def test_a_plane_is_kept_for_a_moment_and_then_forgotten() -> None:
    tracker = GroundTracker(GroundConfig(time_constant_s=0.2))
    leaning = replace(MOUNT, pitch_rad=0.16)
    tracker.update(frame_of(inverse_ground(leaning), 1.0))
    blind = np.zeros((480, 640))
    soon = tracker.update(frame_of(blind, 1.05))
    late = tracker.update(frame_of(blind, 9.0))
    assert soon.mount(MOUNT).pitch_rad == pytest.approx(
        0.14 + 0.02 * np.exp(-0.25), abs=5e-4
    )
    assert late.mount(MOUNT).pitch_rad == pytest.approx(0.14, abs=1e-6)
    assert np.trace(late.cov) > np.trace(soon.cov)


def test_the_mount_is_trusted_where_it_shall_be() -> None:
    leaning = frame_of(inverse_ground(replace(MOUNT, pitch_rad=0.16)))
    ground = GroundTracker(GroundConfig(fit=False)).update(leaning)
    assert ground.plane == pytest.approx(plane_of_mount(MOUNT))


def test_a_mount_that_is_wrong_is_found_out() -> None:
    tracker = GroundTracker(GroundConfig())
    really = replace(MOUNT, pitch_rad=0.14 + 0.12, height_m=0.98)
    frames = [frame_of(inverse_ground(really), 0.1 * k) for k in range(12)]
    planes = [tracker.update(frame) for frame in frames]
    assert not planes[0].measured
    assert planes[0].mount(MOUNT).pitch_rad == pytest.approx(0.14)
    assert planes[-1].mount(MOUNT).pitch_rad == pytest.approx(0.26, abs=1e-4)
    assert planes[-1].mount(MOUNT).height_m == pytest.approx(0.98, abs=1e-3)


def test_a_wall_never_becomes_the_ground() -> None:
    tracker = GroundTracker(GroundConfig())
    wall = np.full((480, 640), 0.5)
    for k in range(20):
        ground = tracker.update(frame_of(wall, 0.1 * k))
    assert not ground.measured
