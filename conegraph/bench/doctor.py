"""How often the doctor names what was done to a run."""

from __future__ import annotations

import multiprocessing
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from itertools import product
from pathlib import Path

from rich.table import Table

from conegraph.bench.figure import Figure, at_least
from conegraph.config import load_config
from conegraph.eval.doctor import HEALTHY, diagnose
from conegraph.pipeline import Pipeline

LAPS = 2
TARGET = 0.9

EITHER = {"wheel_scale": "scale", "range_scale": "scale"}
"""What the doctor can say at best where it has no truth."""

AS_GOOD, AS_GOOD_M = 2.0, 0.02
"""A run is unharmed if its errors are up to so many times the healthy run's, and
this, and its map holds as many cones to within `FEWER`."""

FEWER = 0.02


@dataclass(frozen=True, slots=True)
class Injection:
    """A cause, and how it is put into a drive.

    Attributes:
        cause: what the doctor should say.
        queries: of the simulator; a seed takes one of them.
        settings: overrides of the configuration.
    """

    cause: str
    queries: tuple[str, ...] = ("",)
    settings: tuple[str, ...] = ()

    def query(self, seed: int) -> str:
        """Return the query of a seed."""
        return self.queries[seed % len(self.queries)]


INJECTIONS = (
    Injection(HEALTHY),
    Injection("yaw_rate_bias", ("yaw_bias=0.1", "yaw_bias=-0.1")),
    Injection("wheel_scale", ("wheel_scale=0.95", "wheel_scale=1.05")),
    Injection("range_scale", ("range_scale=0.95", "range_scale=1.05")),
    Injection("sensor_yaw", ("sensor_yaw=-0.05", "sensor_yaw=0.05")),
    Injection("stamp_offset", ("stamp_offset=0.1", "stamp_offset=0.2")),
    Injection("sensor_noise", ("noise_scale=2.5", "noise_scale=3")),
    Injection("wrong_colours", ("wrong_colour=0.4", "wrong_colour=0.5")),
    Injection("few_sights", ("missed=0.9", "missed=0.6")),
    Injection("colourless_map", ("unknown_colour=1",)),
    Injection("false_detections", ("false_cones=0.3", "false_cones=0.25")),
    Injection("false_closure", ("false_start=1",), ("start_line.forced=true",)),
    Injection("starved_associations", settings=("association.gate_d2=1",)),
    Injection("drift", ("odometry=off&missed=0.6",)),
    Injection("missed_closure", settings=("start_line.min_closure_m=1000",)),
)
"""The causes that the simulator and the configuration can bring about."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One drive with one fault through one back end."""

    injection: Injection
    track: str
    seed: int
    sensor: str
    backend: str

    @property
    def source(self) -> str:
        """The SOURCE of the drive."""
        base = f"sim:{self.track}?laps={LAPS}&seed={self.seed}&sensor={self.sensor}"
        query = self.injection.query(self.seed)
        return f"{base}&{query}" if query else base

    @property
    def command(self) -> str:
        """What repeats it."""
        sets = "".join(f" --set {setting}" for setting in self.injection.settings)
        return f"conegraph run '{self.source}' --backend {self.backend}{sets}"

    @property
    def drive(self) -> tuple[str, int, str, str]:
        """What it has in common with the healthy run that it is compared with."""
        return self.track, self.seed, self.sensor, self.backend


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a trial.

    Attributes:
        trial: the trial.
        cause: the first diagnosis.
        without_truth: the first diagnosis from the run's folder alone.
        map_rmse_m: aligned error of the map.
        ate_m: aligned error of the causal path.
        found: the lesser of the map's precision and recall.
    """

    trial: Trial
    cause: str
    without_truth: str
    map_rmse_m: float
    ate_m: float
    found: float

    def unharmed(self, healthy: Outcome) -> bool:
        """Whether the fault left map and path as good as those of a healthy run."""
        return (
            self.map_rmse_m <= AS_GOOD * healthy.map_rmse_m + AS_GOOD_M
            and self.ate_m <= AS_GOOD * healthy.ate_m + AS_GOOD_M
            and self.found >= healthy.found - FEWER
        )


def trials(
    tracks: Sequence[str],
    seeds: Sequence[int],
    sensors: Sequence[str],
    backends: Sequence[str],
) -> list[Trial]:
    """Return every cause on every track with every seed, sensor and back end."""
    mixed = product(INJECTIONS, tracks, seeds, sensors, backends)
    return [Trial(*which) for which in mixed]


def try_all(
    planned: Sequence[Trial], jobs: int, done: Callable[[int], None]
) -> list[Outcome]:
    """Make the trials, so many at once; tell how many are done."""
    found: dict[Trial, Outcome] = {}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=context) as pool:
        for future in as_completed([pool.submit(try_one, trial) for trial in planned]):
            outcome = future.result()
            found[outcome.trial] = outcome
            done(len(found))
    return [found[trial] for trial in planned]


def try_one(trial: Trial) -> Outcome:
    """Drive, run, and ask the doctor with and without truth."""
    settings = (f"source={trial.source}", *trial.injection.settings)
    with tempfile.TemporaryDirectory(prefix="conegraph-doctor-") as folder:
        config = load_config(None, settings, backend=trial.backend)
        result = Pipeline(config).run(Path(folder))
    if result.folder is None or result.metrics is None:
        raise RuntimeError(f"{trial.source}: wrote nothing")
    path, cones = result.metrics.trajectory, result.metrics.map
    if path is None or cones is None:
        raise RuntimeError(f"{trial.source}: has no truth")
    return Outcome(
        trial,
        diagnose(result.folder, result.truth.trajectory).cause,
        diagnose(result.folder).cause,
        cones.rmse_aligned_m,
        path.ate_se2.rmse_m,
        min(cones.precision, cones.recall),
    )


def is_right(outcome: Outcome, healthy: Outcome, *, truth: bool = True) -> bool:
    """Whether the first diagnosis is right.

    It names the cause, or says healthy of a run that the fault left unharmed: a
    fault that an estimator took in its stride is none of the run.

    Args:
        outcome: the trial's.
        healthy: that of the same drive without a fault.
        truth: whether the doctor knew the truth.
    """
    cause = outcome.trial.injection.cause
    said = outcome.cause if truth else outcome.without_truth
    asked = cause if truth else EITHER.get(cause, cause)
    return said == asked or (said == HEALTHY and outcome.unharmed(healthy))


def healthy_runs(
    outcomes: Sequence[Outcome],
) -> dict[tuple[str, int, str, str], Outcome]:
    """Return the runs without a fault by their drive."""
    return {o.trial.drive: o for o in outcomes if o.trial.injection.cause == HEALTHY}


def doctor_figures(outcomes: Sequence[Outcome]) -> list[Figure]:
    """Return the shares of right first diagnoses, by back end, sensor and truth."""
    healthy, figures = healthy_runs(outcomes), []
    kinds = dict.fromkeys((o.trial.backend, o.trial.sensor) for o in outcomes)
    for (backend, sensor), truth in product(kinds, (True, False)):
        right = [
            float(is_right(o, healthy[o.trial.drive], truth=truth))
            for o in outcomes
            if (o.trial.backend, o.trial.sensor) == (backend, sensor)
        ]
        known = "with" if truth else "without"
        title = f"{backend}, {sensor}: right first diagnosis {known} truth"
        figures.append(at_least(title, right, TARGET))
    return figures


def mistakes(outcomes: Sequence[Outcome]) -> list[str]:
    """Return a line for each run that was misjudged with truth."""
    healthy = healthy_runs(outcomes)
    return [
        f"{o.trial.command}: {o.cause} instead of {o.trial.injection.cause} "
        f"(map {o.map_rmse_m:.3f} m, path {o.ate_m:.2f} m off)"
        for o in outcomes
        if not is_right(o, healthy[o.trial.drive])
    ]


def confusion(outcomes: Sequence[Outcome]) -> Table:
    """Return a table: what was done, and how often the doctor said what."""
    healthy = healthy_runs(outcomes)
    table = Table(title="What was done, and what the doctor says first")
    for heading in ("injected", "runs", "unharmed", "said with truth", "said without"):
        table.add_column(heading, overflow="fold")
    for injection in INJECTIONS:
        some = [o for o in outcomes if o.trial.injection == injection]
        if some:
            table.add_row(
                injection.cause,
                str(len(some)),
                str(sum(o.unharmed(healthy[o.trial.drive]) for o in some)),
                _counted([o.cause for o in some]),
                _counted([o.without_truth for o in some]),
            )
    return table


def _counted(said: Sequence[str]) -> str:
    return ", ".join(f"{name} {n}" for name, n in Counter(said).most_common())
