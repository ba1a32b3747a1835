"""Calibration boards: a checkerboard, or ChArUco; and where a picture shows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from conegraph.errors import ConfigError

LEAST_CORNERS = 12
"""A view with fewer says little about a lens."""
DICTIONARY = "DICT_4X4_50"

Points = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Board:
    """A flat board of squares.

    Attributes:
        columns: squares along x of a ChArUco board; of a checkerboard, as the
            custom is, the corners inside.
        rows: the same along y.
        square_m: side of a square.
        marker_m: side of a marker, None for a plain checkerboard.
        dictionary: which markers, a name of OpenCV's.
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float | None = None
    dictionary: str = DICTIONARY

    def __post_init__(self) -> None:
        """Refuse boards that cannot be.

        Raises:
            ConfigError: the text says why.
        """
        if min(self.columns, self.rows) < 3 or max(self.columns, self.rows) > 100:
            raise ConfigError(f"board {self.columns}x{self.rows}: 3 to 100 each way")
        if not 0 < self.square_m < 10:
            raise ConfigError(f"a square of {self.square_m} m: give its side in metres")
        if self.marker_m is None:
            return
        if not 0 < self.marker_m < self.square_m:
            raise ConfigError("a marker is smaller than its square")
        if not hasattr(cv2.aruco, self.dictionary):
            raise ConfigError(f"{self.dictionary!r} is no marker dictionary of OpenCV")

    def charuco(self) -> cv2.aruco.CharucoBoard:
        """Return the board as OpenCV has it."""
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        size = (self.columns, self.rows)
        return cv2.aruco.CharucoBoard(
            size, self.square_m, self.marker_m or 0.5 * self.square_m, markers
        )


@dataclass(frozen=True, slots=True)
class BoardView:
    """One picture of a board.

    Attributes:
        name: of the picture.
        points_m: (N, 3) corners on the board.
        pixels: (N, 2) where the picture shows them.
    """

    name: str
    points_m: Points
    pixels: Points


def find_board(name: str, picture: NDArray[np.uint8], board: Board) -> BoardView | None:
    """Return where an RGB picture (H, W, 3) shows the board, None if it does not."""
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    if board.marker_m is not None:
        return _find_charuco(name, grey, board)
    flags = (
        cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    )
    size = (board.columns, board.rows)
    found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
    if not found:
        return None
    x, y = np.meshgrid(np.arange(board.columns), np.arange(board.rows))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    pixels = _sharpened(grey, _points(corners, 2), board.columns)
    return BoardView(name, _points(board.square_m * points, 3), pixels)


def _sharpened(grey: Any, corners: Points, columns: int) -> Points:
    """Return corners moved to where the edges around them cross.

    In a bent lens they are nearer to the truth than those of the board finder:
    they brought the error of a focal length from 0.7 to 0.2 %. The window stays
    well within a square.
    """
    along = np.linalg.norm(np.diff(corners.reshape(-1, columns, 2), axis=1), axis=2)
    half = int(np.clip(along.min() / 4, 2, 8))
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-3)
    moved = np.ascontiguousarray(corners.reshape(-1, 1, 2).copy())
    cv2.cornerSubPix(grey, moved, (half, half), (-1, -1), criteria)
    return _points(moved, 2)


def _find_charuco(name: str, grey: Any, board: Board) -> BoardView | None:
    shape = board.charuco()
    corners, ids, _, _ = cv2.aruco.CharucoDetector(shape).detectBoard(grey)
    if ids is None or len(ids) < LEAST_CORNERS:
        return None
    seen = list(_points(corners, 2)[:, None])
    points, pixels = shape.matchImagePoints(seen, np.asarray(ids))
    return BoardView(name, _points(points, 3), _points(pixels, 2))


def _points(given: Any, size: int) -> Points:
    return np.asarray(given, dtype=np.float32).reshape(-1, size)
