"""A report as Markdown: everything but the drawings."""

from __future__ import annotations

from conegraph.eval.document import (
    Block,
    Commands,
    Document,
    Facts,
    Gallery,
    Paragraph,
    Table,
    TableRow,
)


def markdown_text(document: Document) -> str:
    """Return the report: verdict first, tables with the best in bold."""
    lines = [f"# {document.title}", "", document.verdict, ""]
    lines += [*(f"- {sentence}" for sentence in document.findings), ""]
    lines += [line for warning in document.warnings for line in (f"> {warning}", ">")]
    for section in document.sections:
        shown = [_block(block) for block in section.blocks]
        lines += ["", f"## {section.title}", "", *"\n\n".join(shown).splitlines()]
    return "\n".join(lines).rstrip() + "\n"


def _block(block: Block) -> str:
    match block:
        case Table():
            return _table(block)
        case Gallery():
            return "\n".join(
                f"- [{p.title}](report.html#{p.name}): {p.see}" for p in block.pictures
            )
        case Paragraph():
            return block.text
        case Facts():
            return "\n".join(f"- {name}: {what}" for name, what in block.items)
        case Commands():
            return "\n".join([f"{block.title}\n", "```sh", *block.lines, "```"])


def _table(table: Table) -> str:
    places = range(len(table.columns))
    rules = [":---" if i in table.words else "---:" for i in places]
    lines = [
        f"{table.caption} Bold: best." if table.marks_best else table.caption,
        "",
        _line(table.corner, table.columns),
        _line("---", rules),
        *(_line(_title(row), _cells(row)) for row in table.rows),
    ]
    return "\n".join(lines)


def _title(row: TableRow) -> str:
    return f"{row.group}: {row.title}" if row.group else row.title


def _cells(row: TableRow) -> list[str]:
    return [f"**{c}**" if i in row.best else c for i, c in enumerate(row.cells)]


def _line(title: str, cells: list[str] | tuple[str, ...]) -> str:
    return (
        "| " + " | ".join(cell.replace("|", "\\|") for cell in (title, *cells)) + " |"
    )
