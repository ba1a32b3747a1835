"""The doctor's benchmark: what counts as right, and a trial from end to end."""

from __future__ import annotations

import pytest

from conegraph.bench.doctor import (
    INJECTIONS,
    Injection,
    Outcome,
    Trial,
    doctor_figures,
    is_right,
    mistakes,
    trials,
    try_one,
)
from conegraph.eval.doctor import HEALTHY
from conegraph.sources import parse_sim_query


def outcome(cause: str, said: str, *, map_m: float = 0.01, alone: str = "") -> Outcome:
    injection = next(i for i in INJECTIONS if i.cause == cause)
    trial = Trial(injection, "oval", 3, "camera", "ekf")
    return Outcome(trial, said, alone or said, map_m, 0.05, 1.0)


def test_every_cause_can_be_brought_about() -> None:
    planned = trials(["oval"], [0, 1], ["camera"], ["ekf"])
    assert len(planned) == 2 * len(INJECTIONS)
    for trial in planned:
        parse_sim_query(trial.source.partition("?")[2])
    assert len({trial.command for trial in planned}) == len(planned)


def test_healthy_is_right_only_of_a_run_that_took_no_harm() -> None:
    healthy = outcome(HEALTHY, HEALTHY)
    assert is_right(outcome("drift", "drift", map_m=5.0), healthy)
    assert is_right(outcome("drift", HEALTHY, map_m=0.03), healthy)
    assert not is_right(outcome("drift", HEALTHY, map_m=0.1), healthy)
    assert not is_right(outcome("drift", "scale"), healthy)
    assert not is_right(outcome(HEALTHY, "drift"), healthy)


def test_without_truth_the_scale_is_enough() -> None:
    healthy = outcome(HEALTHY, HEALTHY)
    blamed = outcome("wheel_scale", "range_scale", map_m=1.0, alone="scale")
    assert is_right(blamed, healthy, truth=False)
    assert not is_right(blamed, healthy)


def test_figures_count_what_is_right_and_mistakes_can_be_repeated() -> None:
    wrong = outcome("drift", "scale", map_m=1.0)
    outcomes = [outcome(HEALTHY, HEALTHY), wrong, outcome("drift", "drift")]
    with_truth, without = doctor_figures(outcomes)
    assert with_truth.values["mean"] == without.values["mean"] == pytest.approx(2 / 3)
    assert with_truth.met is False
    (line,) = mistakes(outcomes)
    assert line.startswith(
        "conegraph run 'sim:oval?laps=2&seed=3&sensor=camera&odometry=off&missed=0.6' "
        "--backend ekf: scale instead of drift"
    )


def test_a_trial_is_driven_and_diagnosed() -> None:
    trial = Trial(
        Injection("sensor_yaw", ("sensor_yaw=0.05",)), "acceleration", 5, "lidar", "ekf"
    )
    made = try_one(trial)
    assert (made.cause, made.without_truth) == ("sensor_yaw", "sensor_yaw")
    assert made.trial is trial
    assert made.ate_m > 0.0
