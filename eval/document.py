"""What a report says, before it is known how it will be shown."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class TableRow:
    """A row: its title, a cell a column, and the cells that are best.

    Attributes:
        title: what the row is about.
        cells: as many as the table has columns.
        best: places of the cells to put in bold.
        group: rows of one group follow each other; empty for none.
    """

    title: str
    cells: tuple[str, ...]
    best: frozenset[int] = frozenset()
    group: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """Figures in rows and columns.

    Attributes:
        caption: what the table shows, and how to read it.
        columns: headings of the cells, without that of the rows' titles.
        rows: the rows.
        corner: heading of the rows' titles.
        words: places of the columns that hold words, not numbers.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[TableRow, ...]
    corner: str = ""
    words: frozenset[int] = frozenset()

    @property
    def marks_best(self) -> bool:
        """Whether any cell stands out."""
        return any(row.best for row in self.rows)


@dataclass(frozen=True, slots=True)
class Picture:
    """A drawing with the words that go with it.

    Attributes:
        name: short and unique in a document, for links: ``error-over-distance``.
        title: what is drawn.
        see: what one should see in it.
        svg: the drawing, an ``<svg>`` element.
    """

    name: str
    title: str
    see: str
    svg: str


@dataclass(frozen=True, slots=True)
class Gallery:
    """Pictures that stand beside each other where there is room."""

    pictures: tuple[Picture, ...]


@dataclass(frozen=True, slots=True)
class Paragraph:
    """A few sentences."""

    text: str


@dataclass(frozen=True, slots=True)
class Facts:
    """Names and what they stand for."""

    items: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Commands:
    """Lines to type into a shell, with a title."""

    title: str
    lines: tuple[str, ...]


Block = Table | Gallery | Paragraph | Facts | Commands


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and what stands under it."""

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Document:
    """A report: the verdict first.

    Attributes:
        title: what was judged.
        verdict: the finding in one sentence, effect first.
        warnings: what to beware of, in sentences.
        sections: the evidence.
        findings: what else was found, in sentences.
    """

    title: str
    verdict: str
    warnings: tuple[str, ...]
    sections: tuple[Section, ...]
    findings: tuple[str, ...] = ()
