"""The description of the files names every column that is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from conegraph.eval.suite_metrics import METRICS
from conegraph.eval.suite_rows import SuiteRow
from conegraph.io.run_writer import HEADERS

TEXT = (Path(__file__).resolve().parents[1] / "docs" / "files.md").read_text("utf-8")


@pytest.mark.parametrize("name", HEADERS)
def test_every_table_of_a_run_is_described(name: str) -> None:
    (line,) = (line for line in TEXT.splitlines() if line.startswith(f"| `{name}`"))
    assert f"`{HEADERS[name].strip()}`" in line


def test_every_column_of_the_results_is_described() -> None:
    for metric in METRICS:
        assert f"| `{metric.name}` | {metric.label}" in TEXT
        assert f"`{metric.path}` |" in TEXT
    described = TEXT[TEXT.index("Columns of `results.parquet`") :]
    for name in {*SuiteRow.model_fields, "failed", "series"} - {"metrics"}:
        assert f"`{name}`" in described
