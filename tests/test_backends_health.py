"""When an estimate is trusted, doubted and given up."""

from __future__ import annotations

import numpy as np
import pytest

from conegraph.backends.health import MEMORY_S, HealthMonitor
from conegraph.config import StatusConfig
from conegraph.types import Status

CONFIG = StatusConfig(
    degraded_after_s=0.5, lost_after_s=2.0, min_matched_share=0.5, init_frames=3
)
NEVER = float("-inf")


def healthy(until_s: float = 1.0) -> HealthMonitor:
    monitor = HealthMonitor(CONFIG)
    for stamp in np.linspace(0.0, until_s, 11).tolist():
        monitor.frame(stamp, 5, 5)
    return monitor


def test_starts_in_init_until_enough_frames_matched() -> None:
    monitor = HealthMonitor(CONFIG)
    seen = []
    for n in range(5):
        seen.append(monitor.judge(0.1 * n, NEVER)[0])
        # The third frame shows nothing that matches: it does not count.
        monitor.frame(0.1 * n, 0 if n == 2 else 4, 4)
    seen.append(monitor.judge(0.5, NEVER)[0])
    assert seen == [Status.INIT] * 4 + [Status.OK] * 2
    assert HealthMonitor(CONFIG).judge(0.0, NEVER)[1].startswith("0 frames")


def test_without_matches_the_status_falls_with_time() -> None:
    monitor = healthy(1.0)
    assert monitor.judge(1.0, NEVER) == (Status.OK, "")
    assert monitor.judge(1.49, NEVER)[0] == Status.OK
    status, reason = monitor.judge(1.61, NEVER)
    assert status == Status.DEGRADED
    assert reason == "no cone matched for 0.6 s"
    assert monitor.judge(2.99, NEVER)[0] == Status.DEGRADED
    status, reason = monitor.judge(3.1, NEVER)
    assert status == Status.LOST
    assert reason == "no cone matched for 2.1 s, no odometry"


def test_odometry_keeps_the_car_from_being_lost() -> None:
    monitor = healthy(1.0)
    assert monitor.judge(5.0, 4.9)[0] == Status.DEGRADED
    # Odometry older than half a second is no odometry.
    assert monitor.judge(5.0, 4.4)[0] == Status.LOST


def test_frames_without_matches_do_not_count_as_matches() -> None:
    monitor = healthy(1.0)
    monitor.frame(4.0, 0, 0)
    assert monitor.judge(4.0, NEVER)[0] == Status.LOST
    monitor.frame(4.1, 3, 3)
    assert monitor.judge(4.1, NEVER)[0] == Status.OK


def test_a_falling_share_of_matches_degrades_and_recovers() -> None:
    monitor = healthy(1.0)
    shares = []
    share = 1.0
    for n in range(1, 11):
        monitor.frame(1.0 + 0.1 * n, 1, 5)
        # A low pass with a time constant of half a second.
        share += 0.1 / MEMORY_S * (0.2 - share)
        shares.append(share)
        status, reason = monitor.judge(1.0 + 0.1 * n, NEVER)
        assert (status == Status.OK) == (share >= 0.5)
        if status == Status.DEGRADED:
            assert reason == f"only {100 * share:.0f} % of cones match"
    assert shares[0] > 0.5 > shares[-1]
    for n in range(1, 20):
        monitor.frame(2.0 + 0.1 * n, 5, 5)
    assert monitor.judge(3.9, NEVER)[0] == Status.OK


def test_frames_of_unknown_country_do_not_lower_the_share() -> None:
    monitor = healthy(1.0)
    for n in range(1, 5):
        monitor.frame(1.0 + 0.1 * n, 0, 0)
    assert monitor.judge(1.4, NEVER)[0] == Status.OK


@pytest.mark.parametrize("frames", [0, 1])
def test_no_frames_are_asked_for_when_none_are_configured(frames: int) -> None:
    monitor = HealthMonitor(StatusConfig(init_frames=frames))
    if frames:
        monitor.frame(0.0, 1, 1)
    assert monitor.judge(0.0, NEVER)[0] == Status.OK
