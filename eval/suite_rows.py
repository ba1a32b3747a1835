"""The results of a benchmark suite: one row a run, as Parquet."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from conegraph.errors import FileFormatError
from conegraph.eval.row import Number, Row
from conegraph.eval.suite_metrics import METRICS

if TYPE_CHECKING:
    import pyarrow as pa

RESULTS = "results.parquet"
MAX_ROWS = 1_000_000


class SuiteRow(Row):
    """One run of one back end over one stream.

    Attributes:
        suite: name of the suite that asked for it.
        track: track file or built-in name.
        sensor: ``camera`` or ``lidar``.
        odometry: whether the stream has wheels and gyro.
        faults: what goes wrong in the stream, ``KEY=SHARE`` joined by ``&``; empty
            for nothing.
        seed: of everything random in the stream.
        laps: laps asked for.
        backend: kind of back end.
        profile: its profile.
        settings: overrides of its configuration, ``KEY=VALUE`` joined by spaces.
        stream: the SOURCE that gives the same stream again.
        command: what runs it again.
        config_hash: SHA-256 of its resolved configuration.
        code_version: version of the code that ran it.
        status: ``ok`` if it came to its end.
        reason: why it counts as failed, empty if it does not.
        metrics: by the names of `METRICS`, NaN where there is none.
    """

    suite: str
    track: str
    sensor: str
    odometry: bool
    faults: str
    seed: int
    laps: int
    backend: str
    profile: str
    settings: str
    stream: str
    command: str
    config_hash: str
    code_version: str
    status: Literal["ok", "failed"]
    reason: str
    metrics: dict[str, Number]

    @property
    def failed(self) -> bool:
        """Whether it broke off, diverged, has a false map or missed a lap."""
        return bool(self.reason)

    @property
    def broke_off(self) -> bool:
        """Whether it did not come to its end."""
        return self.status == "failed"

    @property
    def contender(self) -> str:
        """What is compared: ``ekf``, or ``ekf/thesis`` with another profile."""
        named = self.backend
        return named if self.profile == "default" else f"{named}/{self.profile}"

    @property
    def mapping(self) -> str:
        """Where iSAM2's graph was solved, ``inline`` or ``process``; else empty."""
        beside = "backend.mapping=process" in self.settings.split()
        return ("process" if beside else "inline") * (self.backend == "isam2")

    @property
    def key(self) -> str:
        """What tells it from all other rows of a folder."""
        return row_key(self.stream, self.contender, self.config_hash)

    @property
    def series(self) -> str:
        """The file with what happened along the way, in the results' folder."""
        return f"series/{short_name(self.key)}.npz"


_OWN = tuple(name for name in SuiteRow.model_fields if name != "metrics")


def row_key(stream: str, contender: str, config_hash: str) -> str:
    """Return the key of a run of a contender, so configured, over a stream."""
    return f"{stream} {contender} {config_hash}"


def short_name(key: str) -> str:
    """Return what files and folders of the row with this key are called."""
    return hashlib.sha256(key.encode()).hexdigest()[:16]


def write_results(path: Path, rows: Sequence[SuiteRow]) -> None:
    """Write rows as Parquet, sorted by key; the same rows give the same bytes.

    The file appears under its name only when it is complete. The metrics are columns
    of their own; ``failed`` and ``series`` are columns too.
    """
    import pyarrow as pa
    from pyarrow import parquet

    flat = [
        {
            **row.model_dump(exclude={"metrics"}),
            "failed": row.failed,
            "series": row.series,
            **row.metrics,
        }
        for row in sorted(rows, key=lambda row: row.key)
    ]
    part = path.with_name(f"{path.name}.part")
    parquet.write_table(pa.Table.from_pylist(flat, schema=_schema()), part)
    part.replace(path)


def read_results(path: Path) -> tuple[SuiteRow, ...]:
    """Read ``results.parquet``, or the one in a folder, in the order of the keys.

    Raises:
        FileFormatError: there is none, or it holds something else.
    """
    import pyarrow as pa
    from pyarrow import parquet
    from pydantic import ValidationError

    file = path / RESULTS if path.is_dir() else path
    if not file.is_file():
        raise FileFormatError(file, "no such file: give a folder that bench wrote")
    try:
        with parquet.ParquetFile(file) as table:
            if table.metadata.num_rows > MAX_ROWS:
                raise FileFormatError(file, f"has more than {MAX_ROWS} rows")
            flat = table.read().to_pylist()
        rows = [_unflattened(cells) for cells in flat]
    except (pa.ArrowException, KeyError, ValidationError) as error:
        reason = f"holds no results of a suite: {' '.join(str(error).split())[:200]}"
        raise FileFormatError(file, reason) from None
    return tuple(rows)


def _unflattened(cells: Mapping[str, Any]) -> SuiteRow:
    """Take a row apart; a figure that it lacks is of a version that had none."""
    metrics = {metric.name: cells.get(metric.name) for metric in METRICS}
    return SuiteRow.model_validate(
        {**{name: cells[name] for name in _OWN}, "metrics": metrics}
    )


def _schema() -> pa.Schema:
    import pyarrow as pa

    columns: dict[str, pa.DataType] = {name: pa.string() for name in _OWN}
    columns |= {"odometry": pa.bool_(), "seed": pa.int64(), "laps": pa.int64()}
    columns |= {"failed": pa.bool_(), "series": pa.string()}
    columns |= {metric.name: pa.float64() for metric in METRICS}
    return pa.schema(columns)
