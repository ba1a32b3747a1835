"""The report as one HTML file that needs no network."""

from __future__ import annotations

import re
from collections.abc import Mapping
from html import escape
from string import Template

from conegraph.eval.comparison import Comparison, Row
from conegraph.eval.overlay import ERROR_COLOUR, Overlay

_PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1c1c1c; background: #fff;
  max-width: 72rem; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.1rem; color: #555; font-weight: 600; margin: 0; }
h2 { font-size: 1.1rem; margin: 2rem 0 .5rem; }
.verdict { font-size: 1.25rem; line-height: 1.4; margin: .5rem 0 1rem; }
.warnings { background: #fff6dc; border-left: 4px solid #e0b000; margin: 1rem 0;
  padding: .5rem 1rem .5rem 2rem; }
.maps { display: grid; gap: 1rem;
  grid-template-columns: repeat(auto-fit, minmax(min(26rem, 100%), 1fr)); }
figure { margin: 0; border: 1px solid #ddd; border-radius: 6px; padding: .5rem; }
figure svg { width: 100%; height: auto; display: block; }
figcaption { font-size: .9rem; }
.key { font-size: .85rem; color: #444; margin: .25rem 0 1rem; }
.key b { color: $error; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .9rem;
  font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .6rem; text-align: right; white-space: nowrap; }
th:first-child { text-align: left; font-weight: normal; white-space: normal; }
thead th { border-bottom: 2px solid #888; }
tbody tr:first-child th { font-weight: 600; padding-top: .8rem; }
td.best { font-weight: 700; }
tbody tr + tr { border-top: 1px solid #eee; }
</style>
</head>
<body>
<h1>$title</h1>
<p class="verdict">$verdict</p>
$warnings
<h2>Maps over the truth</h2>
<p class="key">Each run is turned and shifted to fit the truth best. Rings: true cones.
Dots: the map. Grey line: true path. Black line: estimated path.
<b>Lines</b>: errors of the map, stretched as stated. <b>&times;</b>: missed.
+: no such cone. &#9633;: duplicate. Axes in metres.</p>
<div class="maps">
$maps
</div>
<h2>Figures</h2>
<div class="scroll">
<table>
<thead><tr><th></th>$names</tr></thead>
$groups
</table>
</div>
<p class="key">Bold: best. Aligned: after the rotation and shift that fit best. ATE:
absolute trajectory error, RMS. RPE: relative pose error. Lenient: from each cone of
the map to the nearest true one, so that missing cones cost nothing.</p>
</body>
</html>
""")


def html_text(
    comparison: Comparison, overlays: Mapping[str, Overlay], title: str
) -> str:
    """Return ``report.html``: verdict, what to beware of, maps, all figures."""
    return _PAGE.substitute(
        title=escape(title),
        error=ERROR_COLOUR,
        verdict=_keep_units(escape(comparison.verdict)),
        warnings=_warnings(comparison.warnings),
        maps="\n".join(_figure(name, overlay) for name, overlay in overlays.items()),
        names="".join(f'<th scope="col">{escape(n)}</th>' for n in comparison.names),
        groups="\n".join(_groups(comparison)),
    )


def _keep_units(text: str) -> str:
    """Keep a number and its unit on one line."""
    return re.sub(r"(\d) (%|m\b|ms\b)", r"\1&nbsp;\2", text)


def _warnings(warnings: tuple[str, ...]) -> str:
    if not warnings:
        return ""
    items = "".join(f"<li>{escape(warning)}</li>" for warning in warnings)
    return f'<ul class="warnings">{items}</ul>'


def _figure(name: str, overlay: Overlay) -> str:
    drawing = overlay.svg.replace(
        "<svg ", f'<svg role="img" aria-label="map of {escape(name)}" ', 1
    )
    cones = "cone" if overlay.outside == 1 else "cones"
    outside = f", {overlay.outside} {cones} outside" if overlay.outside else ""
    return (
        f"<figure><figcaption><strong>{escape(name)}</strong>: "
        f"errors &times; {overlay.stretch}{outside}</figcaption>\n{drawing}</figure>"
    )


def _groups(comparison: Comparison) -> list[str]:
    bodies: dict[str, list[str]] = {}
    span = len(comparison.names) + 1
    for row in comparison.rows:
        group = row.figure.group
        head = f'<tr><th scope="rowgroup" colspan="{span}">{escape(group)}</th></tr>'
        bodies.setdefault(group, [head]).append(_row(row))
    return [f"<tbody>\n{chr(10).join(rows)}\n</tbody>" for rows in bodies.values()]


def _row(row: Row) -> str:
    cells = "".join(
        f'<td class="best">{cell}</td>' if i in row.best else f"<td>{cell}</td>"
        for i, cell in enumerate(row.cells)
    )
    return f'<tr><th scope="row">{escape(row.title)}</th>{cells}</tr>'
