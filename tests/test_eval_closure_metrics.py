"""Loop closures and laps against what was driven."""

from __future__ import annotations

import numpy as np
import pytest

from conegraph.eval.closure_metrics import closure_metrics
from conegraph.io.run_folder import AssociationRows
from conegraph.types import Lap

LAPS = (Lap(1, 1.0, 21.0), Lap(2, 21.0, 41.0), Lap(3, 41.0, 61.0))


def closure(stamp_s: float, accepted: bool = True) -> dict[str, object]:
    return {"stamp_s": stamp_s, "accepted": accepted, "reason": "r"}


def counted(end_s: float, duration_s: float) -> dict[str, object]:
    return {"number": 1, "end_s": end_s, "duration_s": duration_s}


def test_delays_are_from_the_true_crossing_to_the_first_closure() -> None:
    """Seen 2 s ahead, then 0.5 s late and again later, then 4 s late."""
    stamps = (19.0, 41.5, 44.0, 65.0)
    summary = {"loop_closures": [closure(s) for s in stamps]}
    m = closure_metrics(summary, LAPS)
    assert m.laps_true == 3
    assert m.in_time == 2
    assert m.delay_s == pytest.approx(0.5)
    assert m.delay_max_s == pytest.approx(4.0)
    assert np.isnan(m.precision)


def test_a_lap_without_a_closure_is_not_in_time() -> None:
    m = closure_metrics({"loop_closures": [closure(10.0), closure(60.0)]}, LAPS)
    assert (m.in_time, m.laps_true, m.accepted) == (1, 3, 2)
    assert m.delay_s == pytest.approx(-1.0)
    none = closure_metrics({}, LAPS)
    assert (none.in_time, none.laps_true) == (0, 3)
    assert np.isnan(none.delay_s)


def test_a_closure_that_was_taken_back_closes_nothing() -> None:
    summary = {
        "loop_closures": [closure(20.0), closure(20.0, False), closure(23.0, False)]
    }
    m = closure_metrics(summary, LAPS)
    assert (m.accepted, m.rejected, m.undone, m.in_time) == (1, 2, 1, 0)


def rows_of(frames: dict[float, list[tuple[str, int]]]) -> AssociationRows:
    made = [(t, i, *row) for t, rows in frames.items() for i, row in enumerate(rows)]
    stamp, index, status, landmark = zip(*made, strict=True)
    return AssociationRows(
        np.array(stamp),
        np.array(index),
        np.array(status),
        np.array(landmark),
        np.full(len(made), np.nan),
    )


def test_a_closure_is_right_if_most_of_its_frame_shows_its_own_cones() -> None:
    """Cones 10, 11, 12 are landmarks 0, 1, 2; the second closure takes 31, 32 for two.

    A frame without any match speaks neither for nor against the third.
    """
    rows = rows_of(
        {
            0.0: [("new", 0), ("new", 1), ("new", 2)],
            0.1: [("matched", 0), ("matched", 1), ("matched", 2)],
            20.123456789: [("matched", 0), ("matched", 1), ("new", 3)],
            40.0: [("matched", 0), ("matched", 1), ("matched", 2)],
            60.0: [("ambiguous", -1)],
        }
    )
    ids = np.array([10, 11, 12, 10, 11, 12, 10, 11, 30, 31, 32, 12, 10])
    stamps = (20.1234567891234, 40.0, 60.0)
    summary = {"loop_closures": [closure(s) for s in stamps]}
    assert closure_metrics(summary, LAPS, rows, ids).precision == 0.5
    ids[9] = 10
    assert closure_metrics(summary, LAPS, rows, ids).precision == 1.0


def test_lap_times_are_compared_with_the_lap_that_ended_then() -> None:
    """Lap 1 was not counted; the others are 0.3 s short and 0.4 s long."""
    summary = {"laps": [counted(41.2, 19.7), counted(61.1, 20.4)]}
    m = closure_metrics(summary, LAPS)
    assert (m.laps, m.lap_times_s) == (2, (19.7, 20.4))
    assert m.lap_time_error_s == pytest.approx(np.sqrt((0.09 + 0.16) / 2))
    nowhere = closure_metrics({"laps": [counted(50.0, 20.0)]}, LAPS)
    assert np.isnan(nowhere.lap_time_error_s)


def test_a_summary_that_says_little_is_read_as_far_as_it_goes() -> None:
    summary = {
        "laps": [{"number": 1}, {"number": 2, "end_s": "late"}],
        "loop_closures": [{"accepted": True}, 7],
    }
    m = closure_metrics(summary, LAPS)
    assert (m.laps, m.lap_times_s, m.accepted, m.rejected) == (2, (), 1, 0)
    assert np.isnan(m.lap_time_error_s)
    assert closure_metrics({"laps": 4}).laps == 4
