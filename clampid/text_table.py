"""Tables for people in plain text: no wider than the screen where that is possible, and no word broken."""

from __future__ import annotations

from collections.abc import Sequence

from clampid.screen import wrapped

__all__ = ["table_lines"]

GAP = "  "
NARROW = 12  # columns of text that may be wrapped keep at least so much, or their longest word


def table_lines(columns: Sequence[str], rows: Sequence[Sequence[str]], left: int, width: int) -> list[str]:
    """A table's lines: heads, a rule, and the rows, of which a long text goes on below itself.

    Parameters
    ----------
    columns
        Heads.
    rows
        Cells; a row may be shorter than the heads.
    left
        So many columns are text, on the left; the others are numbers, on the right, and are not wrapped. A last column
        without a head is text as well.
    width
        Columns of the screen. A table whose longest words do not fit is wider.
    """
    count = max([len(columns), *map(len, rows)])
    table = [[*row, *([""] * (count - len(row)))] for row in (columns, *rows)]
    text = [k < left or (k == count - 1 and not table[0][k]) for k in range(count)]
    sizes = [max(len(row[k]) for row in table) for k in range(count)]
    words = [max(len(word) for row in table for word in (row[k].split() or [""])) for k in range(count)]
    heads = [max([len(word) for word in table[0][k].split()], default=0) for k in range(count)]
    least = [
        max(words[k], min(sizes[k], NARROW)) if text[k] else max([heads[k], *(len(row[k]) for row in table[1:])])
        for k in range(count)
    ]
    spare = sum(sizes) + len(GAP) * (count - 1) - width
    while spare > 0:  # from the column with most room first
        k = max(range(count), key=lambda k: sizes[k] - least[k])
        if sizes[k] <= least[k]:
            break
        sizes[k] -= 1
        spare -= 1
    head, *body = (_row(row, sizes, text) for row in table)
    rule = GAP.join("─" * size for size in sizes).rstrip()
    return [*head, rule, *(line for row in body for line in row)]


def _row(cells: Sequence[str], sizes: Sequence[int], text: Sequence[bool]) -> list[str]:
    """The lines of one row."""
    parts = [wrapped(cell, max(size, 1)) or [""] for cell, size in zip(cells, sizes, strict=True)]
    out = []
    for k in range(max(map(len, parts))):
        line = [
            (part[k] if k < len(part) else "").ljust(size) if left else (part[k] if k < len(part) else "").rjust(size)
            for part, size, left in zip(parts, sizes, text, strict=True)
        ]
        out.append(GAP.join(line).rstrip())
    return out
