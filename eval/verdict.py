"""What one run of each back end allows to be said, and no more."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from conegraph.eval.judge import RunMetrics
from conegraph.eval.run_metrics import FRAME

SHOWN_RATIO = 1.1
"""Two errors closer than this are not told apart: another seed moves them more."""

SHOWN_M = 0.005
"""Nor are errors that differ by less than 5 mm, whatever their ratio."""

SHOWN_SHARE = 0.02
"""Shares of cones that differ by less say nothing: 2 of 100 cones."""

ONE_RUN = (
    "This is one run of each over one stream: it shows what happened here, not which "
    "is better in general."
)
MAPPING = {"inline": "in line", "process": "in a process of its own"}
"""Where a graph is solved: only in line a frame waits for it."""

_Values = dict[str, float]


def differ(a: float, b: float, unit: str, *, share: bool = False) -> bool:
    """Whether one run of each tells two figures apart.

    Args:
        a: the one.
        b: the other.
        unit: of both.
        share: whether they are shares of cones.
    """
    low, high = sorted((a, b))
    if share:
        return high - low >= SHOWN_SHARE
    return high > max(SHOWN_RATIO * low, low + SHOWN_M * (unit == "m"))


def findings(metrics: Mapping[str, RunMetrics]) -> tuple[str, ...]:
    """Return sentences: effect first, "no difference shown" where there is none."""
    if not metrics:
        return ("Nothing was run, so there is nothing to compare.",)
    judged = any(
        m.map is not None or m.trajectory is not None for m in metrics.values()
    )
    if not judged:
        return ("There is no truth to judge accuracy by.", *_speed(metrics))
    map_error = _values(metrics, lambda m: m.map.rmse_aligned_m if m.map else math.nan)
    recall = _values(metrics, lambda m: m.map.recall if m.map else math.nan)
    precision = _values(metrics, lambda m: m.map.precision if m.map else math.nan)
    path_error = _values(
        metrics, lambda m: m.trajectory.ate_se2.rmse_m if m.trajectory else math.nan
    )
    if len(metrics) == 1:
        alone = _alone(metrics, map_error, recall, precision, path_error)
        return (alone, *_speed(metrics))
    return _said(
        _without_map(metrics, map_error),
        _share_contest("misses the most cones", "recall", recall, _in_words(recall)),
        _extra_contest(
            "has the most cones that are not there",
            "false cones",
            {name: m.map.false_cones for name, m in metrics.items() if m.map},
            metrics,
        ),
        _extra_contest(
            "has the most cones twice",
            "duplicates",
            {name: m.map.duplicates for name, m in metrics.items() if m.map},
            metrics,
        ),
        _error_contest("map", "aligned RMSE", map_error),
        _error_contest("path", "aligned ATE while driving", path_error),
        *_speed(metrics),
        ONE_RUN,
    )


def _said(*sentences: str) -> tuple[str, ...]:
    return tuple(sentence for sentence in sentences if sentence)


def _values(
    metrics: Mapping[str, RunMetrics], figure: Callable[[RunMetrics], float]
) -> _Values:
    values = {name: figure(m) for name, m in metrics.items()}
    return {name: value for name, value in values.items() if math.isfinite(value)}


def _any_map(metrics: Mapping[str, RunMetrics]) -> bool:
    return any(m.map is not None for m in metrics.values())


def _without_map(metrics: Mapping[str, RunMetrics], map_error: _Values) -> str:
    names = [name for name in metrics if name not in map_error]
    if not names or not _any_map(metrics):
        return ""
    return f"{' and '.join(names)} made no map that fits the truth anywhere."


def _error_contest(what: str, measure: str, values: _Values) -> str:
    if len(values) < 2:
        return ""
    ranked = sorted(values.items(), key=lambda item: item[1])
    best, least = ranked[0]
    behind = [name for name, value in ranked if differ(least, value, "m")]
    level = [name for name, _ in ranked if name not in behind]
    figures = f"({measure}: {', '.join(f'{name} {v:.3f} m' for name, v in ranked)})"
    if not behind:
        return f"No difference shown in the {what} {figures}."
    if len(level) > 1:
        return (
            f"No difference shown in the {what} between {' and '.join(level)}; "
            f"{' and '.join(behind)} is farther from the truth {figures}."
        )
    percent = 100.0 * (1.0 - least / values[behind[0]])
    return (
        f"{best}'s {what} is {percent:.0f} % closer to the truth than {behind[0]}'s "
        f"{figures}."
    )


def _in_words(values: _Values) -> dict[str, str]:
    return {name: f"{value:.3f}" for name, value in values.items()}


def _extra_contest(
    claim: str,
    measure: str,
    extra: Mapping[str, int],
    metrics: Mapping[str, RunMetrics],
) -> str:
    """Compare the shares of the maps' cones that are too many in one way."""
    size = {name: m.map.estimated for name, m in metrics.items() if m.map}
    named = [name for name in extra if size[name]]
    return _share_contest(
        claim,
        measure,
        {name: 1.0 - extra[name] / size[name] for name in named},
        {name: f"{extra[name]} of {size[name]}" for name in named},
    )


def _share_contest(
    claim: str, measure: str, values: _Values, in_words: Mapping[str, str]
) -> str:
    """Name who has the least share, if that is shown to be less than the greatest."""
    if len(values) < 2:
        return ""
    ranked = sorted(values.items(), key=lambda item: item[1])
    if not differ(ranked[0][1], ranked[-1][1], "", share=True):
        return ""
    figures = ", ".join(f"{name} {in_words[name]}" for name, _ in ranked)
    return f"{ranked[0][0]} {claim} ({measure}: {figures})."


def _alone(
    metrics: Mapping[str, RunMetrics],
    map_error: _Values,
    recall: _Values,
    precision: _Values,
    path_error: _Values,
) -> str:
    (name,) = metrics
    parts = []
    if map_error:
        parts.append(
            f"the map is {map_error[name]:.3f} m off (aligned RMSE, recall "
            f"{recall[name]:.3f}, precision {precision[name]:.3f})"
        )
    elif _any_map(metrics):
        parts.append("the map does not fit the truth anywhere")
    if path_error:
        error_m = path_error[name]
        parts.append(f"the path is {error_m:.3f} m off (aligned ATE while driving)")
    return f"{name}: {' and '.join(parts)}." if parts else f"{name}: no figure."


def _speed(metrics: Mapping[str, RunMetrics]) -> tuple[str, ...]:
    """Return how long frames took: half of them, 99 of 100, and the longest."""
    said = []
    for name, m in metrics.items():
        if (ms := m.latency_ms.get(FRAME)) is not None:
            mapping = f", mapping {MAPPING[m.cost.mapping]}" if m.cost.mapping else ""
            said.append(
                f"{name} {ms.p50:.1f}, {ms.p99:.1f} and {ms.max:.1f} ms{mapping}"
            )
    return (f"Frames took (median, p99, longest): {'; '.join(said)}.",) if said else ()
