"""A lens is found again from pictures that it took; poor pictures are refused."""

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from conegraph.camera import Camera, CameraMount
from conegraph.cli import main
from conegraph.errors import ConfigError
from conegraph.frontend.board import Board, BoardView, find_board
from conegraph.frontend.calibration import (
    CalibrationError,
    calibrate,
    draw_coverage,
    tilt_spread,
)
from conegraph.io.camera_toml import CameraFile, format_camera_toml, read_camera_toml
from conegraph.types import Array

LENS = Camera(640, 480, 520.0, 515.0, 310.0, 245.0, (-0.21, 0.07, 8e-4, -5e-4, 0.0))
CHECKERS = Board(9, 6, 0.03)
CHARUCO = Board(8, 6, 0.04, 0.03)
PX_PER_M = 2000
EDGE_M = 0.03


def printed(board: Board) -> NDArray[np.uint8]:
    """Return the board as it is printed, with a white edge."""
    edge = round(EDGE_M * PX_PER_M)
    if board.marker_m is not None:
        wide = round(board.columns * board.square_m * PX_PER_M)
        tall = round(board.rows * board.square_m * PX_PER_M)
        inner = np.asarray(board.charuco().generateImage((wide, tall)), np.uint8)
    else:
        side = round(board.square_m * PX_PER_M)
        v, u = np.mgrid[0 : (board.rows + 1) * side, 0 : (board.columns + 1) * side]
        inner = np.where((u // side + v // side) % 2, 255, 0).astype(np.uint8)
    return np.pad(inner, edge, constant_values=255)


@lru_cache(maxsize=4)
def fine_rays() -> tuple[Array, Array]:
    """Return slopes of rays, 2 x 2 to a pixel."""
    steps = (np.arange(2) - 0.5) / 2
    u = (np.arange(640)[:, None] + steps).ravel()
    v = (np.arange(480)[:, None] + steps).ravel()
    grid = np.stack(np.meshgrid(u, v), -1).reshape(-1, 1, 2)
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 40, 1e-9)
    lens = np.array(LENS.distortion)
    flat = cv2.undistortPoints(
        grid, LENS.matrix, lens, R=np.eye(3), P=np.eye(3), criteria=criteria
    )
    slopes = np.asarray(flat, dtype=np.float64).reshape(len(v), len(u), 2)
    return slopes[..., 0], slopes[..., 1]


def photograph(board: Board, turn: Array, place: Array) -> NDArray[np.uint8]:
    """Return the picture of a board: its middle at a place, turned, in this lens."""
    sheet = printed(board)
    rotation = cv2.Rodrigues(np.asarray(turn, dtype=np.float64))[0]
    x, y = fine_rays()
    rays = np.stack([x, y, np.ones_like(x)], -1) @ rotation
    start = -np.asarray(place) @ rotation
    reach = -start[2] / rays[..., 2]
    on_board = start[:2] + rays[..., :2] * reach[..., None]
    uv = on_board * PX_PER_M + np.array(sheet.shape[::-1]) / 2 - 0.5
    seen = cv2.remap(
        sheet,
        uv[..., 0].astype(np.float32),
        uv[..., 1].astype(np.float32),
        cv2.INTER_LINEAR,
        borderValue=(90,),
    )
    grey = cv2.resize(seen, (640, 480), interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(0).normal(0, 1.5, grey.shape)
    shown = np.clip(grey * 0.8 + 20 + noise, 0, 255).astype(np.uint8)
    return np.dstack([shown] * 3)


PLACES = [
    ((0.0, 0.0, 0.0), (0.0, 0.0, 0.55)),
    ((0.4, 0.1, 0.0), (-0.15, -0.08, 0.6)),
    ((-0.4, 0.2, 0.1), (0.14, 0.08, 0.6)),
    ((0.1, 0.5, 0.0), (0.12, -0.09, 0.6)),
    ((0.1, -0.5, -0.1), (-0.12, 0.1, 0.62)),
    ((0.3, 0.3, 0.2), (0.0, 0.1, 0.5)),
    ((-0.3, -0.3, 0.1), (0.0, -0.1, 0.5)),
    ((0.0, 0.35, 0.0), (0.2, 0.0, 0.65)),
]


@lru_cache(maxsize=2)
def pictures_of(board: Board) -> tuple[NDArray[np.uint8], ...]:
    return tuple(photograph(board, np.array(t), np.array(p)) for t, p in PLACES)


@lru_cache(maxsize=2)
def views_of(board: Board) -> tuple[BoardView, ...]:
    views = []
    for k, picture in enumerate(pictures_of(board)):
        view = find_board(f"{k}.png", picture, board)
        assert view is not None, k
        views.append(view)
    return tuple(views)


@pytest.mark.parametrize("board", [CHECKERS, CHARUCO], ids=["checkers", "charuco"])
def test_the_lens_that_took_the_pictures_is_found(board: Board) -> None:
    result = calibrate(views_of(board), (640, 480))
    lens = result.camera
    assert result.rms_px < 0.2
    assert (result.view_rms_px < 0.3).all()
    assert len(result.view_rms_px) == len(PLACES)
    assert lens.fx_px == pytest.approx(520.0, rel=4e-3)
    assert lens.fy_px == pytest.approx(515.0, rel=4e-3)
    assert lens.cx_px == pytest.approx(310.0, abs=1.5)
    assert lens.cy_px == pytest.approx(245.0, abs=1.5)
    # What counts of the distortion is where it moves pixels to.
    rng = np.random.default_rng(0)
    slopes = np.column_stack([rng.uniform(-0.45, 0.45, (100, 2)), np.ones(100)])
    none = np.zeros(3)
    true, found = (
        cv2.projectPoints(slopes, none, none, c.matrix, np.array(c.distortion))[0]
        for c in (LENS, lens)
    )
    assert np.linalg.norm(true - found, axis=2).max() < 1.5
    assert result.left_out == ()


def test_a_view_that_does_not_fit_is_left_out_and_named() -> None:
    views = list(views_of(CHECKERS))
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 6.0, views[2].pixels.shape).astype(np.float32)
    views[2] = BoardView("shaken.png", views[2].points_m, views[2].pixels + noise)
    result = calibrate(views, (640, 480))
    assert [name for name, _ in result.left_out] == ["shaken.png"]
    assert result.camera.fx_px == pytest.approx(520.0, rel=4e-3)


def test_too_few_views_are_refused() -> None:
    with pytest.raises(CalibrationError, match="too few views: 5 pictures"):
        calibrate(views_of(CHECKERS)[:5], (640, 480))


def test_views_that_are_too_alike_are_refused() -> None:
    rng = np.random.default_rng(0)
    pictures = [
        photograph(
            CHECKERS, 0.02 * rng.standard_normal(3), np.array([0.02 * k, 0, 0.5])
        )
        for k in range(6)
    ]
    views = [find_board(str(k), p, CHECKERS) for k, p in enumerate(pictures)]
    assert all(view is not None for view in views)
    with pytest.raises(CalibrationError, match="the views are too alike"):
        calibrate([view for view in views if view is not None], (640, 480))


def test_a_board_in_the_middle_only_is_refused() -> None:
    far = [(turn, (0.3 * x, 0.3 * y, 1.6)) for turn, (x, y, _) in PLACES]
    views = []
    for k, (turn, place) in enumerate(far):
        picture = photograph(CHECKERS, np.array(turn), np.array(place))
        view = find_board(str(k), picture, CHECKERS)
        assert view is not None
        views.append(view)
    with pytest.raises(CalibrationError, match=r"seen in \d+% of the picture only"):
        calibrate(views, (640, 480))


def test_a_picture_without_a_board_is_no_view() -> None:
    noise = np.random.default_rng(0).integers(0, 255, (480, 640, 3), dtype=np.uint8)
    assert find_board("noise", noise, CHECKERS) is None
    assert find_board("noise", noise, CHARUCO) is None


def test_the_spread_of_tilts_is_the_largest_angle() -> None:
    angles = np.radians([0.0, 10.0, 35.0])
    normals = np.column_stack([np.sin(angles), np.zeros(3), np.cos(angles)])
    assert np.degrees(tilt_spread(normals)) == pytest.approx(35.0)


def test_coverage_shows_corners_and_empty_cells() -> None:
    result = calibrate(views_of(CHECKERS), (640, 480))
    drawn = draw_coverage(result)
    assert drawn.shape == (480, 640, 3)
    u, v = np.round(result.views[0].pixels[0]).astype(int)
    assert drawn[v, u, 1] > 150
    empty = (drawn == (90, 30, 30)).all(axis=2).mean()
    assert empty == pytest.approx(1 - result.coverage, abs=0.03)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ((2, 6, 0.03), "board 2x6"),
        ((9, 6, 30.0), "a square of 30.0 m"),
        ((9, 6, 0.03, 0.04), "a marker is smaller"),
        ((9, 6, 0.03, 0.02, "DICT_9"), "'DICT_9' is no marker dictionary"),
    ],
)
def test_a_board_that_cannot_be_says_why(
    given: tuple[int, int, float], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        Board(*given)


def run(*arguments: object) -> object:
    with pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    return ended.value.code


def test_the_command_writes_a_lens_and_keeps_the_mount(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "pictures"
    folder.mkdir()
    for k, picture in enumerate(pictures_of(CHECKERS)):
        cv2.imwrite(str(folder / f"view{k}.png"), picture)
    cv2.imwrite(str(folder / "wall.png"), np.full((480, 640, 3), 99, np.uint8))
    (folder / "text.png").write_text("hello", encoding="utf-8")
    out = tmp_path / "camera.toml"
    mount = CameraMount(height_m=0.77)
    out.write_text(format_camera_toml(CameraFile(LENS, mount)), encoding="utf-8")
    assert run("calibrate", folder, "--out", out, "--square", "0.03") == 0
    said = capsys.readouterr()
    assert "view0.png" in said.out
    assert "no board seen in" in said.err
    assert "text.png: is no picture" in said.err
    written = read_camera_toml(out)
    assert written.mount == mount
    assert written.camera.fx_px == pytest.approx(520.0, rel=4e-3)
    assert (tmp_path / "camera_coverage.png").stat().st_size > 1000


def test_the_command_refuses_pictures_of_two_sizes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for k, side in enumerate((480, 490)):
        cv2.imwrite(str(tmp_path / f"{k}.png"), np.zeros((side, 640, 3), np.uint8))
    assert run("calibrate", tmp_path, "--out", tmp_path / "c.toml") == 1
    assert "one camera, one size" in capsys.readouterr().err
    assert run("calibrate", tmp_path / "0.png", "--out", tmp_path / "c.toml") == 1
    assert "too few views: 0 pictures" in capsys.readouterr().err
