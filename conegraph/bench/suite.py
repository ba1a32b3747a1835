"""What a suite runs: tracks, sensors, faults, back ends and seeds, each with each."""

from __future__ import annotations

import hashlib
import shlex
from dataclasses import dataclass
from itertools import product

from conegraph.bench.streams import Stream
from conegraph.config import config_to_toml, load_config
from conegraph.eval.row import Row
from conegraph.eval.suite_rows import row_key, short_name
from conegraph.simulated import parse_sim_query, track_layout

NO_FAULTS = "none"


class SuiteJob(Row):
    """One run to make.

    Attributes:
        suite: name of the suite.
        stream: the drive, without its faults.
        faults: what goes wrong, as in ``missed=0.1&wrong_colour=0.02``.
        backend: kind, or ``kind/profile``.
        settings: ``KEY=VALUE`` overrides of its configuration.
        config_hash: SHA-256 of its configuration.
    """

    suite: str
    stream: Stream
    faults: str
    backend: str
    settings: tuple[str, ...]
    config_hash: str

    @property
    def source(self) -> str:
        """The SOURCE that gives the stream."""
        return self.stream.source + (f"&{self.faults}" if self.faults else "")

    @property
    def key(self) -> str:
        """That of its row."""
        return row_key(self.source, self.backend, self.config_hash)

    @property
    def command(self) -> str:
        """What runs it again, with everything written down."""
        words = ["conegraph", "compare", self.source, "--backends", self.backend]
        for setting in self.settings:
            words += ["--set", setting]
        return shlex.join([*words, "--out", f"out/replay/{short_name(self.key)}"])


@dataclass(frozen=True, slots=True)
class Suite:
    """A benchmark; every combination of what it lists is a run.

    Attributes:
        name: what it is called.
        tracks: track files, built-in names, ``random:SEED``.
        sensors: ``camera``, ``lidar``.
        odometry: with, without, or both.
        faults: what goes wrong in the stream, ``none`` for nothing.
        backends: kinds, each with its profile if wanted.
        seeds: how many drives in each way.
        laps: laps a drive.
        settings: overrides of every configuration.
    """

    name: str
    tracks: tuple[str, ...]
    sensors: tuple[str, ...] = ("camera", "lidar")
    odometry: tuple[bool, ...] = (True,)
    faults: tuple[str, ...] = (NO_FAULTS,)
    backends: tuple[str, ...] = ("ekf", "isam2")
    seeds: int = 5
    laps: int = 2
    settings: tuple[str, ...] = ()

    def chains(self) -> list[list[SuiteJob]]:
        """Return the jobs of each stream, one for each back end.

        Raises:
            ConfigError: a back end or a setting does not exist.
            SourceError: nor does a track or a fault.
            FileFormatError: a track file cannot be read.
        """
        for track in self.tracks:
            track_layout(track)
        hashes = {
            backend: config_hash(backend, self.settings) for backend in self.backends
        }
        for fault in self.faults:
            parse_sim_query(_query(fault))
        ways = product(
            range(self.seeds), self.tracks, self.sensors, self.odometry, self.faults
        )
        return [
            [
                SuiteJob(
                    suite=self.name,
                    stream=Stream(
                        track=track,
                        seed=seed,
                        laps=self.laps,
                        sensor=sensor,
                        odometry=odometry,
                    ),
                    faults=_query(fault),
                    backend=backend,
                    settings=self.settings,
                    config_hash=hashes[backend],
                )
                for backend in self.backends
            ]
            for seed, track, sensor, odometry, fault in ways
        ]


QUICK = Suite("quick", ("oval", "random:5", "random:11", "random:13"))
FULL = Suite(
    "full",
    ("autocross", "oval", *(f"random:{seed}" for seed in range(1, 11))),
    odometry=(True, False),
    faults=(
        NO_FAULTS,
        "wrong_colour=0.02&unknown_colour=0.2&missed=0.1&false_cones=0.02",
    ),
    backends=("ekf", "isam2", "ekf/thesis"),
    laps=3,
)
SUITES = {suite.name: suite for suite in (QUICK, FULL)}


def config_hash(backend: str, settings: tuple[str, ...]) -> str:
    """Return the SHA-256 of a configuration with all its defaults, without a source.

    Raises:
        ConfigError: there is no such back end or setting.
    """
    toml = config_to_toml(load_config(None, settings, backend=backend))
    return hashlib.sha256(toml.encode()).hexdigest()


def _query(fault: str) -> str:
    return "" if fault == NO_FAULTS else fault
