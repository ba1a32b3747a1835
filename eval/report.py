"""The comparison as a table on the terminal, and as files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from conegraph.eval.comparison import Comparison, compare
from conegraph.eval.judge import RunMetrics, Truth
from conegraph.io.plain import to_plain
from conegraph.io.run_folder import RunFolder
from conegraph.io.run_writer import replace_text

SCHEMA_VERSION = 1


def render_table(comparison: Comparison) -> Table:
    """Return one table with a column a run and the best value of each row in bold."""
    table = Table(caption="bold: best", caption_justify="left")
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


def markdown_text(comparison: Comparison, title: str) -> str:
    """Return ``report.md``: verdict first, then the table with the best in bold."""
    lines = [f"# {title}", "", comparison.verdict, ""]
    lines += [f"> {warning}" for warning in comparison.warnings]
    lines += ["", f"| | {' | '.join(comparison.names)} |"]
    lines += ["|---|" + "---:|" * len(comparison.names)]
    for row in comparison.rows:
        cells = [
            f"**{cell}**" if i in row.best else cell for i, cell in enumerate(row.cells)
        ]
        lines.append(f"| {row.figure.group}: {row.title} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


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
    # Drawing costs most of a second to import, which a table does not need.
    from conegraph.eval.html import html_text
    from conegraph.eval.overlay import draw_overlays

    comparison = compare(metrics)
    overlays = draw_overlays(runs, truth, metrics)
    replace_text(folder / "report.json", json_text(comparison, metrics))
    replace_text(folder / "report.md", markdown_text(comparison, title))
    replace_text(folder / "report.html", html_text(comparison, overlays, title))
    return comparison
