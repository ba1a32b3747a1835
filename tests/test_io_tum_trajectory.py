"""TUM trajectories: an exact round trip, and errors that name the line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from conegraph.errors import FileFormatError
from conegraph.io.tum_trajectory import read_tum, write_tum
from conegraph.types import Trajectory

length = st.floats(-1e6, 1e6)
rows = st.lists(
    st.tuples(
        st.floats(0.0, 2e9),
        length,
        length,
        st.floats(-np.pi, np.pi, exclude_min=True),
    ),
    min_size=1,
    max_size=8,
)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(rows)
def test_round_trip(
    tmp_path: Path, poses: list[tuple[float, float, float, float]]
) -> None:
    table = np.array(sorted(poses))
    path = tmp_path / "t.tum"
    write_tum(path, Trajectory(table[:, 0], table[:, 1:]))
    read = read_tum(path)
    assert np.array_equal(read.stamp_s, table[:, 0])
    assert np.array_equal(read.pose[:, :2], table[:, 1:3])
    turned = np.abs(read.pose[:, 2] - table[:, 3])
    assert np.all(np.minimum(turned, 2 * np.pi - turned) < 1e-12)
    assert np.all((read.pose[:, 2] > -np.pi) & (read.pose[:, 2] <= np.pi))


def test_closed_form(tmp_path: Path) -> None:
    path = tmp_path / "t.tum"
    half = np.sqrt(0.5)
    path.write_text(
        f"# comment\n\n1.5 2 -3 9 0 0 {half} {half}\n2 0 0 0 0 0 1 0\n",
        encoding="utf-8",
    )
    read = read_tum(path)
    assert read.stamp_s.tolist() == [1.5, 2.0]
    assert read.pose[0] == pytest.approx([2.0, -3.0, np.pi / 2], abs=1e-15)
    assert read.pose[1] == pytest.approx([0.0, 0.0, np.pi])


def test_a_pose_in_space_keeps_its_heading(tmp_path: Path) -> None:
    """Yaw 0.3 followed by pitch 0.2: q = (cos, 0, 0, sin) (cos, 0, sin, 0)."""
    cy, sy, cp, sp = np.cos(0.15), np.sin(0.15), np.cos(0.1), np.sin(0.1)
    q = (-sy * sp, cy * sp, sy * cp, cy * cp)
    path = tmp_path / "t.tum"
    path.write_text("0 0 0 0 " + " ".join(map(str, q)), encoding="utf-8")
    assert read_tum(path).pose[0, 2] == pytest.approx(0.3, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("0 0 0 0 0 0 0 1\n1 0 0\n", 2, "3 numbers"),
        ("#\n0 0 0 0 0 0 x 1\n", 2, "not finite numbers"),
        ("0 nan 0 0 0 0 0 1\n", 1, "not finite numbers"),
        ("0 0 0 0 0 0 0 0\n", 1, "unit quaternion"),
        ("1 0 0 0 0 0 0 1\n\n0 0 0 0 0 0 0 1\n", 3, "backwards"),
        ("# nothing\n", None, "no pose"),
    ],
)
def test_errors_name_the_line(
    tmp_path: Path, text: str, line: int | None, said: str
) -> None:
    path = tmp_path / "t.tum"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError, match=said) as caught:
        read_tum(path)
    assert caught.value.line == line
