"""How a report looks on a phone, a desk, at night and on paper."""

CSS = """
:root { color-scheme: light dark; --ink: #1b1b1f; --soft: #54545c; --paper: #fff;
  --line: #d5d5da; --stripe: #f5f5f7; --warn: #fff4d6; --edge: #b98900; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #ececf0; --soft: #b0b0ba; --paper: #17171a; --line: #44444c;
    --stripe: #222227; --warn: #3a3115; --edge: #d9a92b; } }
* { box-sizing: border-box; }
body { font: 16px/1.5 system-ui, sans-serif; color: var(--ink);
  background: var(--paper); max-width: 76rem; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1rem; color: var(--soft); font-weight: 600; margin: 0;
  overflow-wrap: anywhere; }
h2 { font-size: 1.25rem; margin: 2.5rem 0 .5rem; padding-top: .5rem;
  border-top: 2px solid var(--ink); }
.verdict { font-size: clamp(1.2rem, 1rem + 1.2vw, 1.65rem); line-height: 1.35;
  font-weight: 600; margin: .5rem 0 1rem; max-width: 60rem; }
.findings { padding-left: 1.2rem; max-width: 60rem; }
.findings li { margin: .2rem 0; }
.warnings { background: var(--warn); border-left: 4px solid var(--edge);
  margin: 1rem 0; padding: .5rem 1rem .5rem 2rem; }
p, dl, figcaption, caption { overflow-wrap: anywhere; }
p { max-width: 46rem; }
nav { font-size: .95rem; margin: 1rem 0; }
nav a { display: inline-block; padding: .3rem .9rem .3rem 0; color: inherit; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .15rem 1rem;
  margin: .5rem 0; }
dt { color: var(--soft); }
dd { margin: 0; }
.gallery { display: grid; gap: 1rem; margin: 1rem 0; align-items: start;
  grid-template-columns: repeat(auto-fill, minmax(min(23rem, 100%), 1fr)); }
.gallery.wide {
  grid-template-columns: repeat(auto-fill, minmax(min(26rem, 100%), 1fr)); }
figure { margin: 0; border: 1px solid var(--line); border-radius: 6px;
  overflow: hidden; break-inside: avoid; }
figure svg { width: 100%; height: auto; display: block; background: #fff; }
figcaption { font-size: .95rem; padding: .5rem .75rem; }
figcaption span { display: block; color: var(--soft); }
.scroll { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .9rem;
  font-variant-numeric: tabular-nums; }
caption { text-align: left; padding: 0 0 .4rem; color: var(--soft);
  position: sticky; left: 0; max-width: min(46rem, 100vw - 2rem); }
th, td { padding: .3rem .7rem; text-align: right; white-space: nowrap; }
th[scope=row], th[scope=rowgroup], thead th:first-child, .words {
  text-align: left; }
th[scope=row] { font-weight: normal; min-width: 8rem; white-space: normal;
  position: sticky; left: 0; background: inherit; }
td.words { white-space: normal; min-width: 12rem; }
thead th { border-bottom: 2px solid var(--soft); vertical-align: bottom; }
th[scope=rowgroup] { padding-top: .9rem; }
td.best { font-weight: 700; }
tbody tr { background: var(--paper); }
tbody tr:nth-child(even) { background: var(--stripe); }
@media (max-width: 40rem) {
  table, caption, thead, tbody { display: block; }
  table { font-size: .75rem; }
  caption { font-size: .9rem; }
  tr { display: grid; padding: .2rem 0;
    grid-template-columns: repeat(var(--columns), minmax(0, 1fr)); }
  th, td, td.words { padding: 0 .2rem; white-space: normal; min-width: 0;
    overflow-wrap: anywhere; }
  th[scope=row], th[scope=rowgroup], thead th:first-child { grid-column: 1 / -1;
    position: static; font-size: .85rem; }
  thead th:first-child:empty { display: none; } }
.commands { margin: 1rem 0; break-inside: avoid; }
.commands p { margin: 0 0 .2rem; }
pre { background: var(--stripe); border: 1px solid var(--line); border-radius: 6px;
  padding: .6rem .8rem; margin: 0; font-size: .85rem; overflow-x: auto; }
@media print {
  :root { --ink: #000; --soft: #333; --paper: #fff; --line: #999; --stripe: #fff;
    --warn: #fff; }
  @page { margin: 14mm; }
  body { font-size: 10.5pt; padding: 0; max-width: none; }
  nav { display: none; }
  h2, caption { break-after: avoid; }
  tr { break-inside: avoid; }
  .scroll { overflow: visible; }
  pre { white-space: pre-wrap; overflow-wrap: anywhere; }
  table { font-size: 8.5pt; }
  th, td { padding: .15rem .35rem; white-space: normal; }
  .gallery, .gallery.wide { grid-template-columns: 1fr 1fr; }
}
"""
