"""Time and memory of a run."""

from __future__ import annotations

import numpy as np
import pytest

from conegraph.eval.run_metrics import cost_metrics


def test_cost_relates_time_spent_to_time_driven_and_to_laps() -> None:
    """100 s at 10 Hz; 20 ms a frame, but 30 in the second lap; 5 ms of detection."""
    stamps = 0.1 * np.arange(1001, dtype=np.float64)
    frame = np.where((stamps > 51.0) & (stamps <= 91.0), 30.0, 20.0)
    summary = {
        "laps": [
            {"end_s": 51.0, "duration_s": 50.0},
            {"end_s": 91.0, "duration_s": 40.0},
        ],
        "peak_memory_mb": 150.0,
    }
    timing = {"frame": frame, "detect": np.full(1001, 5.0), "update": frame}
    m = cost_metrics(stamps, timing, summary)
    assert m.log_s == pytest.approx(100.0)
    assert m.processing_s == pytest.approx(0.025 * 1001 + 0.01 * 400)
    assert m.real_time_factor == pytest.approx(100.0 / m.processing_s)
    assert m.lap_p99_ms == (20.0, 30.0)
    assert m.p99_growth == pytest.approx(1.5)
    assert m.peak_memory_mb == 150.0


def test_a_killed_run_has_what_it_wrote() -> None:
    m = cost_metrics(np.arange(5.0), {"frame": np.full(4, 10.0)}, {})
    assert (m.log_s, m.lap_p99_ms) == (4.0, ())
    assert m.real_time_factor == pytest.approx(100.0)
    assert np.isnan(m.p99_growth)
    assert np.isnan(m.peak_memory_mb)
    nothing = cost_metrics(np.zeros(0), {}, {})
    assert np.isnan(nothing.log_s)
    assert np.isnan(nothing.real_time_factor)
