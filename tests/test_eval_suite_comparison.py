"""What is said of two back ends follows from their rows, and failures count."""

from __future__ import annotations

import math

import numpy as np
import pytest

from conegraph.eval.paired import Effect, duel, least_to_show
from conegraph.eval.statistics import signed_rank
from conegraph.eval.suite_comparison import compare_suite, compare_versions
from conegraph.eval.suite_metrics import METRICS
from conegraph.eval.suite_rows import SuiteRow

TRACKS, SEEDS = 10, 3


def row(backend: str, track: int, seed: int, **given: object) -> SuiteRow:
    """A run whose figures are 1 but for those given."""
    reason = str(given.pop("reason", ""))
    code_version = str(given.pop("code_version", "1"))
    metrics = {metric.name: 1.0 for metric in METRICS}
    return SuiteRow(
        suite="quick",
        track=f"random:{track}",
        sensor="lidar",
        odometry=True,
        faults="",
        seed=seed,
        laps=2,
        backend=backend,
        profile="default",
        settings="",
        stream=f"sim:random:{track}?seed={seed}",
        command="",
        config_hash=backend,
        code_version=code_version,
        status="ok",
        reason=reason,
        metrics={**metrics, **{k: float(str(v)) for k, v in given.items()}},
    )


def both(factor: float, spread: float, tracks: int = TRACKS) -> list[SuiteRow]:
    """Back ends whose map errors differ by a factor, and vary alike by stream."""
    rng, rows = np.random.default_rng(0), []
    for track in range(tracks):
        for seed in range(SEEDS):
            hard = float(np.exp(rng.normal()))
            mine = hard * factor * float(np.exp(rng.normal(0.0, spread)))
            rows.append(row("ekf", track, seed, map_rmse_aligned_m=hard))
            rows.append(row("isam2", track, seed, map_rmse_aligned_m=mine))
    return rows


def effect_of(rows: list[SuiteRow], name: str) -> Effect:
    (one,) = compare_suite(rows).duels
    (found,) = (e for e in one.effects if e.metric.name == name)
    return found


def test_a_paired_difference_far_below_the_spread_of_streams_is_shown() -> None:
    found = effect_of(both(0.9, 0.05), "map_rmse_aligned_m")
    assert found.size.value == pytest.approx(0.9, abs=0.03)
    assert found.size.interval.excludes(1.0)
    assert found.better == "isam2"
    # 10 tracks on one side, of four figures.
    assert found.p == pytest.approx(4 * 2 / 2**10)
    assert found.size.general
    assert found.sentence.startswith("map RMSE, aligned: isam2/ekf 0.9")
    assert found.sentence.endswith("isam2 is better")


def test_noise_is_called_no_difference() -> None:
    rows = both(1.0, 0.3)
    found = effect_of(rows, "map_rmse_aligned_m")
    assert not found.shown
    assert found.sentence.endswith("no difference shown")
    said = compare_suite(rows).verdict
    assert "no difference shown in map error" in said
    assert "better" not in said


def test_few_tracks_hold_for_themselves_only() -> None:
    (one,) = compare_suite(both(0.8, 0.05, tracks=4)).duels
    assert not one.general
    assert one.scope.endswith("it holds for these 4 tracks only")
    (large,) = compare_suite(both(0.8, 0.05)).duels
    assert large.scope.endswith("it holds for tracks like these 10")


def test_failures_are_counted_and_not_paired() -> None:
    rows = both(0.9, 0.05)
    failed = [
        r.model_copy(update={"reason": "diverged"})
        if r.backend == "ekf" and r.seed == 0
        else r
        for r in rows
    ]
    comparison = compare_suite(failed)
    (one,) = comparison.duels
    assert one.streams == TRACKS * SEEDS
    assert one.left_out == TRACKS
    assert one.effects[0].size.count == TRACKS * (SEEDS - 1)
    assert one.failures.only == (TRACKS, 0)
    assert one.failures.p == pytest.approx(2 / 2**TRACKS)
    assert one.failures.shown
    assert "ekf failed in 10 of 30" in one.failures.sentence
    assert "10 of them left out" in one.scope
    ekf = next(c for c in comparison.contenders if c.name == "ekf")
    assert (ekf.failures.count, ekf.failures.of) == (10, 30)


def test_a_figure_without_a_logarithm_is_left_out_and_counted() -> None:
    rows = both(0.9, 0.05)
    rows[0] = row("ekf", 0, 0, map_rmse_aligned_m=math.nan)
    rows[2] = row("ekf", 0, 1, map_rmse_aligned_m=0.0)
    found = effect_of(rows, "map_rmse_aligned_m")
    assert found.left_out == 2
    assert found.size.count == TRACKS * SEEDS - 2


def test_shares_differ_by_their_difference() -> None:
    rows = [
        row(b, t, s, recall=0.9 if b == "ekf" else 0.95)
        for b in ("ekf", "isam2")
        for t in range(TRACKS)
        for s in range(SEEDS)
    ]
    found = effect_of(rows, "recall")
    assert found.size.value == pytest.approx(0.05)
    assert found.none == 0.0
    assert found.better == "isam2"


def test_one_pair_is_too_few() -> None:
    one = duel(("a", "b"), [(row("a", 0, 0), row("b", 0, 0))])
    said = one.effects[0].sentence
    assert said.endswith(": 1 drive cannot show a difference: it takes 8")
    nothing = duel(("a", "b"), [])
    assert nothing.effects == ()
    assert "0 of 0" in nothing.failures.sentence


@pytest.mark.parametrize("tests", range(1, 40))
def test_no_fewer_drives_could_show_a_difference(tests: int) -> None:
    least = least_to_show(tests)
    one_sided = np.arange(1, least + 1, dtype=np.float64)
    p = signed_rank(one_sided, least * [""], "mean")
    assert p == pytest.approx(2.0 ** (1 - least))
    assert tests * 2.0 ** (1 - least) < 0.05 <= tests * 2.0 ** (2 - least)


def test_too_few_drives_are_not_called_no_difference() -> None:
    """Even if all of seven are on one side, one of four figures shows nothing."""
    assert least_to_show(1) == 6
    assert least_to_show(4) == 8
    said = compare_suite(both(0.5, 0.01, tracks=2)).verdict
    assert "no difference shown in failures" in said
    assert "6 drives cannot show a difference in map error" in said
    assert "slowest frames (it takes 8)" in said
    said = compare_suite(both(0.5, 0.01, tracks=1)).verdict
    assert "no difference" not in said
    assert "slowest frames and failures (it takes 8)" in said
    assert "map error 50 % lower" in compare_suite(both(0.5, 0.01, tracks=3)).verdict


def test_every_two_of_three_are_compared() -> None:
    rows = [*both(0.9, 0.05), *(row("third", t, 0) for t in range(TRACKS))]
    comparison = compare_suite(rows)
    assert [d.names for d in comparison.duels] == [
        ("ekf", "isam2"),
        ("ekf", "third"),
        ("isam2", "third"),
    ]
    assert comparison.duels[1].streams == TRACKS


def test_one_config_beside_another_is_named_by_its_settings() -> None:
    old = both(1.0, 0.1, tracks=1)
    new = [r.model_copy(update={"settings": "association.gate_d2=9"}) for r in old]
    found = compare_versions(old, new)
    assert found.duels[0].names == ("ekf (as shipped)", "ekf (association.gate_d2=9)")
    assert found.duels[0].scope.endswith("it holds for this track only")


def test_versions_are_paired_by_stream_and_contender() -> None:
    old = both(1.0, 0.1)
    new = [
        r.model_copy(
            update={
                "code_version": "2",
                "config_hash": "other",
                "metrics": {
                    **r.metrics,
                    "map_rmse_aligned_m": 0.9 * r.metrics["map_rmse_aligned_m"],
                },
            }
        )
        if r.backend == "ekf"
        else r.model_copy(update={"metrics": {**r.metrics, "wall_s": 9.0}})
        for r in old
    ]
    found = compare_versions(old[2:], [*new[:-1], row("isam2", 99, 0)])
    assert [d.names for d in found.duels] == [
        ("ekf (old)", "ekf (new)"),
        ("isam2 (old)", "isam2 (new)"),
    ]
    assert found.duels[0].effects[0].size.value == pytest.approx(0.9)
    assert found.duels[0].effects[0].better == "ekf (new)"
    assert found.only_old == (f"sim:random:9?seed={SEEDS - 1} isam2",)
    assert found.only_new == (
        "sim:random:0?seed=0 ekf",
        "sim:random:0?seed=0 isam2",
        "sim:random:99?seed=0 isam2",
    )
    # A run that only took longer is the same run.
    assert found.same == TRACKS * SEEDS - 2
    assert found.notes == ("new: the rows are of 2 versions: 1, 2",)
