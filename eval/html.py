"""A report as one HTML file that needs no network."""

from __future__ import annotations

import re
from html import escape
from itertools import groupby

from conegraph.eval.document import (
    Block,
    Commands,
    Document,
    Facts,
    Gallery,
    Paragraph,
    Picture,
    Section,
    Table,
    TableRow,
)
from conegraph.eval.style import CSS


def html_text(document: Document) -> str:
    """Return the page: verdict, what to beware of, where to find what, evidence."""
    title = escape(document.title)
    return "\n".join(
        [
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{title}</title>\n<style>{CSS}</style>\n</head>\n<body>",
            f'<header>\n<h1>{title}</h1>\n<p class="verdict">'
            f"{_words(document.verdict)}</p>\n"
            f"{_listed(document.findings, 'findings')}\n</header>",
            _listed(document.warnings, "warnings"),
            _contents(document.sections),
            "<main>",
            *(_section(section) for section in document.sections),
            "</main>\n</body>\n</html>\n",
        ]
    )


def anchor(title: str) -> str:
    """Return a name for links, made from a title."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def _words(text: str) -> str:
    """Escape, and keep numbers with their units and intervals on one line."""
    kept = re.sub(r"(\d) (%|m\b|ms\b|s\b)", r"\1&nbsp;\2", escape(text))
    return re.sub(r"\[[^\]]*\]", lambda m: m[0].replace(" ", "&nbsp;"), kept)


def _listed(sentences: tuple[str, ...], kind: str) -> str:
    if not sentences:
        return ""
    items = "".join(f"<li>{_words(sentence)}</li>" for sentence in sentences)
    return f'<ul class="{kind}">{items}</ul>'


def _contents(sections: tuple[Section, ...]) -> str:
    links = "".join(
        f'<a href="#{anchor(s.title)}">{escape(s.title)}</a> ' for s in sections
    )
    return f'<nav aria-label="Contents">{links}</nav>' if len(sections) > 1 else ""


def _section(section: Section) -> str:
    name = anchor(section.title)
    blocks = "\n".join(_block(block) for block in section.blocks)
    return (
        f'<section aria-labelledby="{name}">\n'
        f'<h2 id="{name}">{escape(section.title)}</h2>\n{blocks}\n</section>'
    )


def _block(block: Block) -> str:
    match block:
        case Table():
            return _table(block)
        case Gallery():
            figures = "\n".join(_figure(picture) for picture in block.pictures)
            wide = "" if len(block.pictures) % 3 == 0 else " wide"
            return f'<div class="gallery{wide}">\n{figures}\n</div>'
        case Paragraph():
            return f"<p>{_words(block.text)}</p>"
        case Facts():
            items = "".join(
                f"<dt>{escape(name)}</dt><dd>{_words(what)}</dd>"
                for name, what in block.items
            )
            return f"<dl>{items}</dl>"
        case Commands():
            lines = escape("\n".join(block.lines))
            return (
                f'<div class="commands"><p>{_words(block.title)}</p>'
                f'<pre tabindex="0"><code>{lines}</code></pre></div>'
            )


def _figure(picture: Picture) -> str:
    label = escape(f"{picture.title}. {picture.see}")
    drawing = picture.svg.replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)
    return (
        f'<figure id="{picture.name}">\n{drawing}\n<figcaption>'
        f"<strong>{_words(picture.title)}</strong>"
        f"<span>{_words(picture.see)}</span></figcaption></figure>"
    )


def _table(table: Table) -> str:
    head = "".join(
        f'<th scope="col"{_class(i in table.words, "words")}>{_words(c)}</th>'
        for i, c in enumerate(table.columns)
    )
    bodies = "\n".join(
        _body(group, list(rows), table)
        for group, rows in groupby(table.rows, key=lambda row: row.group)
    )
    caption = f"{table.caption} Bold: best." if table.marks_best else table.caption
    # A box that scrolls must be reachable without a mouse.
    return (
        f'<div class="scroll" tabindex="0" role="region" '
        f'aria-label="{escape(table.caption)}">\n'
        f'<table style="--columns:{len(table.columns)}">\n'
        f"<caption>{_words(caption)}</caption>\n"
        f'<thead><tr><th scope="col">{escape(table.corner)}</th>{head}</tr></thead>\n'
        f"{bodies}\n</table>\n</div>"
    )


def _body(group: str, rows: list[TableRow], table: Table) -> str:
    span = len(table.columns) + 1
    head = f'<tr><th scope="rowgroup" colspan="{span}">{_words(group)}</th></tr>\n'
    lines = "\n".join(_row(row, table.words) for row in rows)
    return f"<tbody>\n{head if group else ''}{lines}\n</tbody>"


def _row(row: TableRow, words: frozenset[int]) -> str:
    cells = "".join(
        f"<td{_class(i in row.best, 'best') or _class(i in words, 'words')}>"
        f"{_words(cell)}</td>"
        for i, cell in enumerate(row.cells)
    )
    return f'<tr><th scope="row">{_words(row.title)}</th>{cells}</tr>'


def _class(given: bool, name: str) -> str:
    return f' class="{name}"' if given else ""
