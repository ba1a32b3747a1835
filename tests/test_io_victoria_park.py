"""Victoria Park: steps to velocities that drive the same steps again."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from conegraph.errors import FileFormatError
from conegraph.geometry import constant_twist
from conegraph.io.victoria_park import STEP_S, read_victoria_park
from conegraph.types import ConeObservations, VelocityObservation

NOISE = "0.0001 0 0 4e-06 0 9e-06"
TEXT = f"""ODOMETRY 0 1 0.2 0.002 0.02 {NOISE}
LANDMARK 1 2 8 6 0.4 0.1 0.5
LANDMARK 9 2 8 6 0.4 0 0.4
LANDMARK 1 2 8 x 0.4 0 0.4
LANDMARK 1 2 8 6 0 0 0.4
VERTEX 1 2 3
ODOMETRY 1 3 -0.1 0 -0.01 {NOISE}
LANDMARK 0 4 1 2 0.4 0 0.4
"""

has_gtsam = pytest.mark.skipif(
    find_spec("gtsam") is None, reason="gtsam, which ships the file, is not installed"
)


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "park.txt"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_pose_is_a_frame(tmp_path: Path) -> None:
    read = read_victoria_park(write(tmp_path, TEXT))
    kinds = [(round(e.stamp_s, 9), type(e).__name__[:4]) for e in read.stream]
    assert kinds == [
        (0.0, "Cone"),
        (0.0, "Velo"),
        (0.2, "Velo"),
        (0.2, "Cone"),
        (0.2, "Velo"),
        (0.4, "Velo"),
        (0.4, "Cone"),
    ]
    frames = [e for e in read.stream if isinstance(e, ConeObservations)]
    assert [len(f) for f in frames] == [1, 1, 0]
    assert frames[1].truth_id is not None
    assert frames[1].truth_id.tolist() == [2]
    assert frames[1].cov_m2[0].tolist() == [[0.4, 0.1], [0.1, 0.5]]
    assert read.rejected == {
        "LANDMARK from an unknown pose": 1,
        "malformed LANDMARK": 2,
        "unknown tag": 1,
    }


def test_velocities_drive_the_step(tmp_path: Path) -> None:
    read = read_victoria_park(write(tmp_path, TEXT))
    first = read.stream[1]
    assert isinstance(first, VelocityObservation)
    assert constant_twist(first.u_mps, first.r_radps, STEP_S) == pytest.approx(
        [0.2, 0.002, 0.02], abs=1e-6
    )
    assert first.cov == pytest.approx(np.diag([1e-4, 9e-6]) / STEP_S**2)
    last = read.stream[5]
    assert isinstance(last, VelocityObservation)
    assert last.u_mps == pytest.approx(-0.5, rel=1e-4)


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        (f"ODOMETRY 0 1 1 0 0 {NOISE}\nODOMETRY 2 3 1 0 0 {NOISE}\n", 2, "continue"),
        (f"ODOMETRY 0 1 1 0 0 {NOISE}\nODOMETRY 1 0 1 0 0 {NOISE}\n", 2, "continue"),
        ("\nODOMETRY 0 1 1 0\n", 2, "malformed"),
        (f"ODOMETRY 0 1 nan 0 0 {NOISE}\n", 1, "malformed"),
        ("ODOMETRY 0 1 1 0 0 -1 0 0 1 0 1\n", 1, "malformed"),
        ("LANDMARK 1 2 8 6 0.4 0 0.4\n", None, "has no line"),
    ],
)
def test_a_broken_chain_is_an_error(
    tmp_path: Path, text: str, line: int | None, said: str
) -> None:
    with pytest.raises(FileFormatError, match=said) as caught:
        read_victoria_park(write(tmp_path, text))
    assert caught.value.line == line


@has_gtsam
def test_the_shipped_file() -> None:
    """6969 poses, 3640 sightings of 151 trees, 4026.6 m, as counted by hand."""
    read = read_victoria_park()
    frames = [e for e in read.stream if isinstance(e, ConeObservations)]
    speeds = [e.u_mps for e in read.stream if isinstance(e, VelocityObservation)]
    assert read.rejected == {}
    assert len(frames) == 6969
    assert sum(map(len, frames)) == 3640
    seen = {i for f in frames if f.truth_id is not None for i in f.truth_id.tolist()}
    assert len(seen) == 151
    assert frames[-1].stamp_s == pytest.approx(6968 * STEP_S)
    assert sum(speeds) * STEP_S / 2 == pytest.approx(4026.6, abs=2.0)
    assert read.sensor is not None
    assert read.sensor.floor_m == pytest.approx(np.sqrt(0.4))
    assert read.sensor.max_range_m == pytest.approx(20.731, abs=1e-3)
