"""The report of a benchmark: what was run, who did better, and where it went wrong."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from conegraph.errors import FileFormatError
from conegraph.eval.document import (
    Block,
    Commands,
    Document,
    Gallery,
    Paragraph,
    Section,
)
from conegraph.eval.drawing import strokes
from conegraph.eval.html import html_text
from conegraph.eval.markdown import markdown_text
from conegraph.eval.overlay import KEY
from conegraph.eval.series_figures import (
    error_over_distance,
    latency_histogram,
    latency_over_laps,
    nees_over_time,
)
from conegraph.eval.suite_comparison import SuiteComparison, compare_suite
from conegraph.eval.suite_duels import BARS, RULE, duel_picture, duel_table
from conegraph.eval.suite_pictures import (
    Grouped,
    SeriesFolder,
    badness,
    by_contender,
    median_maps,
    sound_series,
    truth_notes,
    way_pictures,
    worst_maps,
)
from conegraph.eval.suite_rows import RESULTS, SuiteRow, read_results
from conegraph.eval.suite_tables import (
    contender_table,
    facts,
    failure_table,
    stream_table,
    worst_table,
)
from conegraph.io.plain import to_plain
from conegraph.io.run_writer import replace_text

SCHEMA_VERSION = 1
WORDS = (
    "Back ends ran over the same streams, so pairs of runs are compared. Map error: "
    "RMS distance of matched cones after the rotation and shift that fit best. Path "
    "error: RMS distance of the path while driving, from the first pose on. NEES: "
    "squared error over the covariance that the back end states. p99: 99 of 100 frames "
    "are faster. Times are of the machine at hand: read them as ratios."
)
MEDIAN = (
    "The middle one of all runs of each back end, of all tracks and sensors, in order "
    "of the map's error with failed runs last; of two in the middle the better one. "
    "Under it stands which drive it is: each back end may have another."
)
WORST_MAP = "The last one in the same order, a failed one if there is any:"
WORST = 10
"""As many of the worst runs are shown, with the commands that replay them."""


def write_suite_report(folder: Path) -> Path:
    """Write ``report.html``, ``report.md`` and ``report.json`` of a benchmark.

    The same results give the same bytes. Failed runs count as failures and not in
    medians; a run that another contender failed on is not paired.

    Args:
        folder: what ``conegraph bench`` wrote: ``results.parquet`` and ``series/``.

    Returns:
        The HTML file.

    Raises:
        ConegraphError: there are no results, or a file cannot be written.
    """
    rows = _in_order(read_results(folder))
    if not rows:
        raise FileFormatError(folder / RESULTS, "holds no run")
    comparison = compare_suite(rows)
    document = suite_document(rows, comparison, SeriesFolder(folder))
    plain = {
        "schema_version": SCHEMA_VERSION,
        "verdict": comparison.verdict,
        "warnings": document.warnings,
        **comparison.to_dict(),
    }
    page = folder / "report.html"
    replace_text(
        folder / "report.json",
        json.dumps(to_plain(plain), indent=2, allow_nan=False) + "\n",
    )
    replace_text(folder / "report.md", markdown_text(document))
    replace_text(page, html_text(document))
    return page


def suite_document(
    rows: Sequence[SuiteRow], comparison: SuiteComparison, series: SeriesFolder
) -> Document:
    """Return what there is to say of a benchmark's runs."""
    grouped = by_contender(rows)
    found: tuple[tuple[str, tuple[Block, ...]], ...] = (
        ("What was run", (facts(rows, grouped),)),
        ("Who is better", _duels(comparison)),
        ("Every back end by itself", _alone(comparison, grouped)),
        ("Maps over the truth", _maps(grouped, series)),
        ("Along the way", _along(grouped, series)),
        ("Worst runs", _worst(rows)),
        ("Every difference", tuple(duel_table(d) for d in comparison.duels)),
        ("What the words mean", (Paragraph(WORDS),)),
    )
    sections = tuple(Section(title, blocks) for title, blocks in found if blocks)
    first, *others = comparison.findings
    warnings = (*comparison.notes, *truth_notes(rows, series), *_missing(series))
    suites = ", ".join(sorted({row.suite for row in rows}))
    title = f"Benchmark {suites}: {len(rows)} runs"
    return Document(title, first, warnings, sections, tuple(others))


def _in_order(rows: Sequence[SuiteRow]) -> list[SuiteRow]:
    """Return the rows with default profiles first, which duels and tables follow."""
    return sorted(rows, key=lambda row: (row.profile != "default", row.contender))


def _missing(series: SeriesFolder) -> tuple[str, ...]:
    if not series.missing:
        return ()
    return (f"{series.missing} runs left no series: drawings are without them",)


def _duels(comparison: SuiteComparison) -> tuple[Block, ...]:
    stroke = strokes([contender.name for contender in comparison.contenders])
    drawn = [
        duel_picture(duel, f"duel-{number}", stroke)
        for number, duel in enumerate(comparison.duels, 1)
    ]
    pictures = tuple(picture for picture in drawn if picture is not None)
    return (Paragraph(f"{BARS} {RULE}"), Gallery(pictures)) if pictures else ()


def _alone(comparison: SuiteComparison, grouped: Grouped) -> tuple[Block, ...]:
    return (
        contender_table(comparison),
        failure_table(comparison, grouped),
        stream_table(grouped),
    )


def _maps(grouped: Grouped, series: SeriesFolder) -> tuple[Block, ...]:
    median, worst = median_maps(grouped, series), worst_maps(grouped, series)
    if not median:
        return ()
    return (
        Paragraph(KEY),
        Paragraph(MEDIAN),
        Gallery(median),
        Paragraph(WORST_MAP),
        Gallery(worst),
    )


def _along(grouped: Grouped, series: SeriesFolder) -> tuple[Block, ...]:
    errors = way_pictures(grouped, series, error_over_distance, "error-over-distance")
    nees = way_pictures(grouped, series, nees_over_time, "nees-over-time")
    sound = sound_series(grouped, series)
    times = (latency_histogram(sound), latency_over_laps(sound))
    drawn = (*errors, *nees, *(picture for picture in times if picture is not None))
    said = Paragraph("Runs that failed are left out of these drawings.")
    return (said, Gallery(drawn)) if drawn else ()


def _worst(rows: Sequence[SuiteRow]) -> tuple[Block, ...]:
    ranked = sorted(rows, key=badness, reverse=True)[:WORST]
    replays = [f"{row.command} --save-rrd" for row in ranked]
    first, run = ranked[0].command.split()[-1], ranked[0].contender.replace("/", "-")
    look = (f"conegraph view {first}", f"conegraph doctor {first}/{run}")
    title = (
        "Replay one of these, in the order of the table; then look at it in Rerun and "
        "ask what went wrong, here of the first:"
    )
    return (worst_table(ranked), Commands(title, (*replays, *look)))
