"""Depth moved from one eye to another, against closed forms."""

import numpy as np

from conegraph.camera import Camera
from conegraph.frontend.realsense_register import Registration

LENS = Camera(64, 48, 50.0, 50.0, 32.0, 24.0)
BENT = Camera(64, 48, 50.0, 50.0, 32.0, 24.0, (-0.06, 0.02, 4e-4, -3e-4, 0.0))


def test_a_wall_moves_by_its_disparity() -> None:
    """Disparity f b / z = 50 x 0.08 / 2 = 2 columns."""
    wall = np.full((48, 64), 2.0, dtype=np.float32)
    wall[10, 20] = 0.0
    moved = Registration.between(LENS, LENS, np.eye(3), np.array([0.0801, 0.0, 0.0]))
    depth = moved.moved(wall)
    assert depth[10, 22] == 0.0
    assert depth.shape == (48, 64)
    assert set(np.unique(depth)) <= {np.float32(0.0), np.float32(2.0)}
    assert not depth[24, :2].any()
    assert (depth[24, 2:-2] == 2.0).all()


def test_the_nearest_hides_the_others() -> None:
    """A near spot (1 m, 4 columns) lands where the far wall (4 m, 1 column) is."""
    depth = np.full((48, 64), 4.0, dtype=np.float32)
    depth[20:24, 30:34] = 1.0
    moved = Registration.between(LENS, LENS, np.eye(3), np.array([0.0801, 0.0, 0.0]))
    after = moved.moved(depth)
    assert (after[20:24, 34:38] == 1.0).all()
    assert (after[20:24, 25:30] == 4.0).all()


def test_half_the_resolution_leaves_no_holes() -> None:
    small = Camera(32, 24, 25.0, 25.0, 15.5, 11.5)
    moved = Registration.between(small, LENS, np.eye(3), np.zeros(3))
    after = moved.moved(np.full((24, 32), 3.0, dtype=np.float32))
    assert (after[2:-2, 2:-2] == 3.0).all()


def test_the_same_eye_keeps_every_pixel() -> None:
    """Also behind a bent lens, where rays are straightened and bent again."""
    shape = (48, 64)
    depth = np.random.default_rng(3).uniform(0.5, 9.0, shape).astype(np.float32)
    still = Registration.between(BENT, BENT, np.eye(3), np.full(3, 1e-4))
    inner = np.s_[2:-2, 2:-2]
    share = np.isclose(still.moved(depth)[inner], depth[inner], atol=2e-4).mean()
    assert share > 0.9


def test_what_is_behind_or_missing_lands_nowhere() -> None:
    turned = np.diag([-1.0, 1.0, -1.0])
    behind = Registration.between(LENS, LENS, turned, np.zeros(3))
    assert not behind.moved(np.full((48, 64), 2.0, dtype=np.float32)).any()
    still = Registration.between(LENS, LENS, np.eye(3), np.zeros(3))
    assert not still.moved(np.zeros((48, 64), dtype=np.float32)).any()
