"""What a suite shows, in sentences: effects first."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from conegraph.eval.paired import (
    NO_DIFFERENCE,
    Duel,
    Effect,
    least_to_show,
    rate_text,
    these_tracks,
)
from conegraph.eval.statistics import Rate
from conegraph.eval.suite_metrics import MAIN
from conegraph.eval.suite_rows import SuiteRow
from conegraph.eval.verdict import MAPPING
from conegraph.eval.words import counted

SHORT = {
    "map_rmse_aligned_m": "map error",
    "ate_start_m": "path error",
    "recall": "cones found",
    "frame_p99_ms": "slowest frames",
}
"""What a verdict calls the main metrics."""

LARGE = 2.0
"""Ratios from here on are said as such: 500 % higher is hard to imagine."""


def findings(
    rates: Mapping[str, Rate], duels: Sequence[Duel], rows: Sequence[SuiteRow]
) -> tuple[str, ...]:
    """Return sentences: the first two contenders, failures, times, the other duels.

    Args:
        rates: how often each contender failed.
        duels: every two of them.
        rows: all runs.
    """
    times = longest_frames(rows)
    if not duels:
        names = " and ".join(rates)
        return (f"{names} ran alone, so there is nothing to compare.", *times)
    first, *others = duels
    general = "This holds for tracks like these."
    if not first.general:
        these = these_tracks(first.tracks)
        general = f"This holds for {these} only: too few to speak of others."
    failed = ", ".join(f"{name} {rate_text(rate)}" for name, rate in rates.items())
    return (
        headline(first),
        general,
        f"Failed runs: {failed}.",
        *times,
        *(headline(duel) for duel in others),
    )


def longest_frames(rows: Sequence[SuiteRow]) -> tuple[str, ...]:
    """Return the longest frame of each contender, and where its graph was solved."""
    longest: dict[str, float] = {}
    for row in rows:
        ms = row.metrics["frame_max_ms"]
        if math.isfinite(ms):
            mapping = f", mapping {MAPPING[row.mapping]}" if row.mapping else ""
            name = f"{row.contender}{mapping}"
            longest[name] = max(longest.get(name, 0.0), ms)
    said = "; ".join(f"{name}: {ms:.0f} ms" for name, ms in longest.items())
    return (f"Longest frame of any run: {said}.",) if said else ()


def headline(duel: Duel) -> str:
    """Return what differs, by how much, and in what no difference is shown."""
    first, second = duel.names
    main = [e for e in duel.effects if e.metric.name in MAIN]
    differ = [_difference(effect) for effect in main if effect.shown]
    level = [_short(e) for e in main if not e.shown and e.enough]
    if duel.failures.shown:
        differ.insert(0, _failures(duel))
    elif duel.failures.enough:
        level.append("failures")
    parts = [", ".join(differ)] if differ else []
    parts += [f"{NO_DIFFERENCE} in {_listed(level)}"] if level else []
    parts += _unsure(duel, [e for e in main if not e.enough])
    parts += ["no drive that neither failed on"] if not main else []
    drives = counted(duel.streams, "drive")
    return f"{second} beside {first} over {drives}: {'; '.join(parts)}."


def _unsure(duel: Duel, few: Sequence[Effect]) -> list[str]:
    """Return in what no difference could be shown, however large it is."""
    names = [_short(effect) for effect in few]
    worth = min((e.worth for e in few), default=duel.streams)
    least = max((e.least for e in few), default=least_to_show(1))
    if not duel.failures.enough:
        names.append("failures")
    if not names:
        return []
    units = counted(worth, "track" if duel.general else "drive")
    return [f"{units} cannot show a difference in {_listed(names)} (it takes {least})"]


def _failures(duel: Duel) -> str:
    first, second = (rate.count for rate in duel.failures.rates)
    more = "more" if second > first else "fewer"
    return f"{more} failures ({second} against {first})"


def _short(effect: Effect) -> str:
    return SHORT[effect.metric.name]


def _difference(effect: Effect) -> str:
    label, size = _short(effect), effect.size
    low, high = size.interval.low, size.interval.high
    if effect.metric.effect == "difference":
        more = "more" if size.value > 0 else "fewer"
        ends = sorted((100.0 * abs(low), 100.0 * abs(high)))
        by = f"{100.0 * abs(size.value):.1f} in 100 {more}"
        return f"{label} {by} ({ends[0]:.1f} to {ends[1]:.1f})"
    if size.value >= LARGE:
        return f"{label} {size.value:.1f} times as large ({low:.1f} to {high:.1f})"
    higher = "higher" if size.value > 1.0 else "lower"
    ends = sorted((100.0 * abs(low - 1.0), 100.0 * abs(high - 1.0)))
    by = f"{100.0 * abs(size.value - 1.0):.0f} % {higher}"
    return f"{label} {by} ({ends[0]:.0f} to {ends[1]:.0f} %)"


def _listed(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if names[1:] else names)
