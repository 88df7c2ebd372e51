"""One screen for a person: what was done, the errors of each stage, the verdict, and the command to type next.

A verb makes a :class:`Screen`; :func:`laid_out` turns it into lines, here and nowhere else. There are at most 24 lines
of 80 columns. Words are never broken. What does not fit is left out, and the screen says so.
"""

from __future__ import annotations

import re
import shlex
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from clampid.display import true_minus

__all__ = ["HEIGHT", "WIDTH", "Errors", "Line", "Next", "Screen", "Tone", "command_lines", "laid_out", "wrapped"]

WIDTH = 80
HEIGHT = 24
_MOST_COMMANDS = 3
_MOST_COMMAND_LINES = 6
"""Of all commands together; of several, the first is always shown."""

_UNIT = r"(?:[nµm]?m|[mµ]?rad|deg|°|°?C|K|k?Nm?|k?g|m?s|min|h|k?Hz|[kMG]i?B|keV|ppm|[mk]?[AV]|σ|%)"
_VALUE = re.compile(rf"[-−+]?\d[^\s]* (?:± \d[^\s]* )?{_UNIT}(?:[²³]|[/·]{_UNIT}[²³]?)*(?![\w/·])")
"""A number with its unit, which one line keeps together: ``12.3 ± 0.4 µm``, ``9.0 h``."""
_KEPT = "\0"  # a control: no text that is printed has it

Tone = Literal["", "good", "open", "bad", "title", "quiet", "command"]
"""How a line is meant; the terminal's colour follows from it."""


@dataclass(frozen=True)
class Line:
    """One line of the screen."""

    text: str
    tone: Tone = ""


@dataclass(frozen=True)
class Errors:
    """The errors of the stages: one row for each, such as nominal → this model → noise floor.

    Attributes
    ----------
    title
        What kind of error it is.
    heads
        What each number is, in the order in which the error falls.
    rows
        Stage, its numbers with their units, and a word on it, such as its verdict.
    """

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...], str], ...]


@dataclass(frozen=True)
class Next:
    """A command to type next, and what it is for."""

    purpose: str
    command: str


@dataclass(frozen=True)
class Screen:
    """What a verb says to a person.

    Attributes
    ----------
    done
        What was done, in a sentence.
    errors
        The errors of the stages.
    facts
        Name and content, one below the other.
    verdict, tone
        One sentence of at most 25 words, and how it is meant.
    notes
        What else a person must know, the most important first.
    more
        What ``--verbose`` prints in addition.
    next
        Commands that can be copied, the best first.
    """

    done: str
    errors: Errors | None = None
    facts: tuple[tuple[str, str], ...] = ()
    verdict: str = ""
    tone: Tone = ""
    notes: tuple[str, ...] = ()
    more: str = ""
    next: tuple[Next, ...] = ()


def wrapped(text: str, width: int = WIDTH, first: str = "", rest: str = "") -> list[str]:
    """Lines of whole words, each after its indent; a word that is longer than a line has one of its own.

    A number stays on the line of its unit, where a line has room for both. Its minus is a true one.
    """
    text = true_minus(text)
    room = width - max(len(first), len(rest))
    whole = _VALUE.sub(lambda value: value[0].replace(" ", _KEPT) if len(value[0]) <= room else value[0], text)
    lines = textwrap.wrap(
        whole, width, initial_indent=first, subsequent_indent=rest, break_long_words=False, break_on_hyphens=False
    )
    return [line.replace(_KEPT, " ") for line in lines]


def laid_out(screen: Screen, width: int = WIDTH, height: int = HEIGHT) -> list[Line]:
    """The lines of a screen, at most ``height`` of at most ``width`` columns.

    Notes go first where the space is short, then facts; errors, verdict and the first command always stay.
    """
    width = min(width, WIDTH)
    head = [Line(text, "title") for text in wrapped(screen.done, width)]
    errors = [] if screen.errors is None else _errors(screen.errors, width)
    verdict = [Line(text, screen.tone) for text in wrapped(screen.verdict, width)]
    tail = _commands(screen.next, width)
    more = [Line(text, "quiet") for text in wrapped(screen.more, width)]
    fixed = sum(map(len, (head, errors, verdict, tail, more))) + sum(map(bool, (errors, verdict or screen.notes, tail)))
    room = height - fixed - bool(screen.facts)
    facts, left = _fitting(_facts(screen.facts, width), room, width)
    notes, _ = _fitting([_note(text, width) for text in screen.notes], left, width)
    out: list[Line] = head
    for block in (errors, facts, [*verdict, *notes], tail if not more else []):
        out = [*out, *([Line("")] if block and out else []), *block]
    return out if not more else [*out, *more, *([Line(""), *tail] if tail else [])]


def _fitting(items: Sequence[list[Line]], room: int, width: int) -> tuple[list[Line], int]:
    """As many items as fit, and the room that is left; where some do not, the last line says how many."""
    if sum(map(len, items)) <= room:
        lines = [line for item in items for line in item]
        return lines, room - len(lines)
    out: list[Line] = []
    for k, item in enumerate(items):
        if len(out) + len(item) > room - 1:
            rest = [] if room < 1 else [Line(f"  … and {len(items) - k} more: --verbose"[:width], "quiet")]
            return [*out, *rest], 0
        out += item
    return out, 0


def _note(text: str, width: int) -> list[Line]:
    return [Line(line) for line in wrapped(text, width, "- ", "  ")]


def _facts(facts: Sequence[tuple[str, str]], width: int) -> list[list[Line]]:
    broad = max((len(name) for name, _ in facts), default=0) + 4
    return [[Line(t) for t in wrapped(text, width, f"  {name}".ljust(broad), " " * broad)] for name, text in facts]


def _errors(errors: Errors, width: int) -> list[Line]:
    """A title, the names of the numbers, and for each stage one line with arrows between the numbers."""
    table = [("", errors.heads), *((name, numbers) for name, numbers, _ in errors.rows)]
    broad = max(len(name) for name, _ in table)
    sizes = [max(len(numbers[k]) for _, numbers in table) for k in range(len(errors.heads))]
    lines = [Line(text, "quiet") for text in wrapped(errors.title, width)]
    for k, (name, numbers) in enumerate(table):
        between = "     " if k == 0 else "  →  "
        cells = between.join(number.rjust(size) for number, size in zip(numbers, sizes, strict=True))
        remark = errors.rows[k - 1][2] if k else ""
        text = f"  {name.ljust(broad)}  {cells}"
        whole = f"{text}   {remark}".rstrip()
        lines.append(Line(whole if len(whole) <= width else text, "" if k else "quiet"))
    return lines


def _commands(commands: Sequence[Next], width: int) -> list[Line]:
    """Each command below what it is for; later ones only as far as there is room."""
    out: list[Line] = []
    used = 0
    for k, step in enumerate(commands[:_MOST_COMMANDS]):
        lines = command_lines(step.command, width)
        if k and used + len(lines) > _MOST_COMMAND_LINES:
            break
        used += len(lines)
        out += [Line(text) for text in wrapped(step.purpose, width)]
        out += [Line(text, "command") for text in lines]
    return out


def command_lines(command: str, width: int = WIDTH) -> list[str]:
    r"""A shell command on lines that end in ``\`` where it goes on: copied as a whole, it runs as it stands.

    A list of terms that is too long for a line goes on after a comma, in the first column of the next line, where a
    shell joins the two. A word that cannot be cut, such as a long path, is kept whole.
    """
    lines: list[str] = []
    line = " "
    for word in shlex.split(command):
        text = shlex.quote(word)
        if len(line) + 1 + len(text) <= width - 2:
            line += f" {text}"
            continue
        if len(text) + 4 > width - 2 and text == word and "," in word:
            if len(line) + 1 + text.index(",") > width - 4:
                lines, line = [*lines, line], "   "
            start, *cut = _cut(text, width - 1, len(line) + 1)
            lines += [f"{line} {start}", *cut[:-1]]
            line = cut[-1]
            continue
        if line.strip():
            lines.append(line)
        line = f"    {text}"
    lines.append(line)
    return [f"{text} \\" if not text.endswith("\\") else text for text in lines[:-1]] + lines[-1:]


def _cut(text: str, width: int, taken: int) -> list[str]:
    """A list of terms, cut after commas; the pieces but the last end in a backslash."""
    pieces, piece = [], ""
    room = width - taken
    parts = [f"{part}," for part in text.split(",")]
    parts[-1] = parts[-1][:-1]
    for part in parts:
        if piece and len(piece) + len(part) > room - 1:
            pieces.append(f"{piece}\\")
            piece, room = "", width
        piece += part
    return [*pieces, piece]
