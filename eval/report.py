"""The comparison as a table on the terminal, and as files."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping
from pathlib import Path

from rich.markup import escape
from rich.table import Table as TerminalTable

from conegraph.eval.comparison import Comparison, compare
from conegraph.eval.document import (
    Block,
    Commands,
    Document,
    Gallery,
    Paragraph,
    Section,
    Table,
    TableRow,
)
from conegraph.eval.html import html_text
from conegraph.eval.judge import RunMetrics, Truth
from conegraph.eval.markdown import markdown_text
from conegraph.io.plain import to_plain
from conegraph.io.run_folder import RunFolder
from conegraph.io.run_writer import replace_text

SCHEMA_VERSION = 1
REPORT_JSON = "report.json"

WORDS = (
    "Aligned: after the rotation and shift that fit best. ATE: absolute trajectory "
    "error, RMS. RPE: relative pose error. Lenient: from each cone of the map to the "
    "nearest true one, so that missing cones cost nothing."
)


def render_table(comparison: Comparison) -> TerminalTable:
    """Return one table with a column a run and the best value of each row in bold."""
    stands_out = any(row.best for row in comparison.rows)
    caption = (
        "bold: best, where one run of each shows a difference" if stands_out else None
    )
    table = TerminalTable(caption=caption, caption_justify="left")
    table.add_column("")
    for name in comparison.names:
        table.add_column(escape(name), justify="right")
    group = ""
    for row in comparison.rows:
        if row.figure.group != group:
            if group:
                table.add_section()
            group = row.figure.group
            table.add_row(f"[italic]{group}[/italic]")
        cells = [
            f"[bold]{cell}[/bold]" if i in row.best else cell
            for i, cell in enumerate(row.cells)
        ]
        table.add_row(f"  {escape(row.title)}", *cells)
    return table


def json_text(comparison: Comparison, metrics: Mapping[str, RunMetrics]) -> str:
    """Return ``report.json``: the verdict and all figures of each run."""
    plain = to_plain(
        {
            "schema_version": SCHEMA_VERSION,
            "verdict": comparison.verdict,
            "warnings": comparison.warnings,
            "runs": {name: m.to_dict() for name, m in metrics.items()},
        }
    )
    return json.dumps(plain, indent=2, allow_nan=False) + "\n"


def write_report(
    folder: Path,
    runs: Mapping[str, RunFolder],
    metrics: Mapping[str, RunMetrics],
    truth: Truth,
    *,
    title: str = "Comparison",
) -> Comparison:
    """Write ``report.json``, ``report.md`` and ``report.html`` into a folder.

    Args:
        folder: where to write; it must exist.
        runs: the runs by name.
        metrics: what the judge found out about each of them, same names.
        truth: what they were compared with.
        title: the headline.

    Raises:
        ConegraphError: a file cannot be written.
    """
    comparison = compare(metrics)
    document = Document(
        title,
        comparison.findings[0],
        comparison.warnings,
        _sections(comparison, runs, metrics, truth),
        comparison.findings[1:],
    )
    replace_text(folder / REPORT_JSON, json_text(comparison, metrics))
    replace_text(folder / "report.md", markdown_text(document))
    replace_text(folder / "report.html", html_text(document))
    return comparison


def _sections(
    comparison: Comparison,
    runs: Mapping[str, RunFolder],
    metrics: Mapping[str, RunMetrics],
    truth: Truth,
) -> tuple[Section, ...]:
    # Drawing costs most of a second to import, which a table does not need.
    from conegraph.eval.overlay import KEY, draw_overlays
    from conegraph.eval.series import placed_map, run_series
    from conegraph.eval.series_figures import (
        error_over_distance,
        latency_histogram,
        latency_over_laps,
        nees_over_time,
    )

    maps = {name: placed_map(run, truth, metrics[name]) for name, run in runs.items()}
    series = {name: [run_series(run, truth)] for name, run in runs.items()}
    found: list[tuple[str, tuple[Block, ...]]] = []
    if maps:
        drawn = Gallery(draw_overlays(maps, {name: name for name in maps}))
        found.append(("Maps over the truth", (Paragraph(KEY), drawn)))
    drawn_along = (
        error_over_distance(series),
        nees_over_time(series),
        latency_histogram(series),
        latency_over_laps(series),
    )
    along = tuple(picture for picture in drawn_along if picture is not None)
    if along:
        found.append(("Along the way", (Gallery(along),)))
    found.append(("All figures", (figure_table(comparison), Paragraph(WORDS))))
    recorded = tuple(run.folder for run in runs.values() if run.folder.is_dir())
    if recorded:
        found.append(("Look closer", (_replay(recorded),)))
    return tuple(Section(title, blocks) for title, blocks in found)


def figure_table(comparison: Comparison) -> Table:
    """Return all figures with a column a run."""
    rows = tuple(
        TableRow(row.title, row.cells, row.best, row.figure.group)
        for row in comparison.rows
    )
    return Table("Every figure of each run.", comparison.names, rows)


def _replay(folders: tuple[Path, ...]) -> Commands:
    lines = []
    for folder in folders:
        again = str(folder.with_name(f"{folder.name}-again"))
        settings = str(folder / "config.toml")
        lines += [
            ("conegraph", "doctor", str(folder)),
            ("conegraph", "run", "-c", settings, "--save-rrd", "--out", again),
            ("conegraph", "view", again),
        ]
    return Commands(
        "Ask what went wrong; run it again with a recording, and open that in Rerun:",
        tuple(shlex.join(line) for line in lines),
    )
