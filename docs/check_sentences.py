"""Check that the documentation reads easily: ``make docs`` and the tests run it.

Over all pages of docs/ and README.md a sentence has at most 18 words on average, and none has more than 35. A page of
docs/how-to has at most 900 words, a decision record 120. Code, tables, headings, captions of images and comments
are left out.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

DOCS = Path(__file__).parent
MEAN_WORDS = 18.0
MOST_WORDS = 35
HOW_TO_WORDS = 900
DECISION_WORDS = 120

FENCE = re.compile(r"^(?P<indent> *)```.*?^(?P=indent)```[^\n]*$", re.DOTALL | re.MULTILINE)
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
DIRECTIVE = re.compile(r"^:::.*(?:\n    .*)*", re.MULTILINE)
ITEM = re.compile(r"^(?:[-*+]|\d+\.)\s+")
BOUNDARY = re.compile(r"(?<=[.!?])[)*\"”]*\s+(?=[*(\[\"“`]*[A-Z0-9ΔΘθτσA-ZÄÖÜ`])")
ABBREVIATION = re.compile(r"\b(?:e\.g|i\.e|et al|vs|cf|Fig|Eq|No|approx|incl)\.$")
RECORD = re.compile(r"^\*\*\d+\. .*?(?=\n\n|\Z)", re.DOTALL | re.MULTILINE)
WORD = re.compile(r"\w")


@dataclass(frozen=True)
class Sentence:
    """A sentence of a page, without its markup."""

    page: Path
    text: str

    @property
    def words(self) -> int:
        """How many words it has; code counts as one."""
        return sum(WORD.search(word) is not None for word in self.text.split())


def paragraphs(markdown: str) -> Iterator[str]:
    """Running text: paragraphs and items of lists, each in one line."""
    text = DIRECTIVE.sub("", COMMENT.sub("", FENCE.sub("", markdown)))
    now: list[str] = []
    blank, in_list = True, False
    for raw in [*text.splitlines(), ""]:
        line = raw.strip()
        code = blank and not in_list and raw.startswith("    ")
        item = ITEM.match(line)
        left_out = not line or line.startswith(("#", "|", "![", "<", "!!!", "---")) or code
        if (left_out or item) and now:
            yield " ".join(now)
            now = []
        if not left_out:
            now.append(line[item.end() :] if item else line)
        if item:
            in_list = True
        elif line and not raw.startswith(" "):
            in_list = False
        blank = not line or (blank and code)
    if now:
        yield " ".join(now)


def plain(text: str) -> str:
    """A paragraph without markup: a link is its text, a piece of code one word."""
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)(?:\{[^}]*\})?", r"\1", text)
    text = re.sub(r"`[^`]*`", "Code", text)
    return text.replace("**", "").replace("*", "")


def sentences(page: Path) -> list[Sentence]:
    """All sentences of a page."""
    out: list[Sentence] = []
    for paragraph in paragraphs(page.read_text(encoding="utf-8")):
        pieces: list[str] = []
        for piece in BOUNDARY.split(plain(paragraph)):
            if pieces and ABBREVIATION.search(pieces[-1]):
                pieces[-1] += f" {piece}"
            else:
                pieces.append(piece)
        out += [sentence for piece in pieces if (sentence := Sentence(page, piece)).words]
    return out


def complaints(pages: list[Path]) -> list[str]:
    """What does not hold, in words; nothing if all is well."""
    found = {page: sentences(page) for page in pages}
    every = [sentence for page in pages for sentence in found[page]]
    out = [f"{s.page.name}: {s.words} words: {s.text}" for s in every if s.words > MOST_WORDS]
    mean = sum(s.words for s in every) / max(len(every), 1)
    if mean > MEAN_WORDS:
        out.append(f"mean length of a sentence: expected at most {MEAN_WORDS:g} words, found {mean:.1f}")
    for page, own in found.items():
        words = sum(s.words for s in own)
        if page.parent.name == "how-to" and words > HOW_TO_WORDS:
            out.append(f"{page.name}: expected at most {HOW_TO_WORDS} words on a how-to page, found {words}")
        if page.stem == "decisions":
            for record in RECORD.findall(page.read_text(encoding="utf-8")):
                if (words := len(record.split())) > DECISION_WORDS:
                    out.append(f"{page.name}: expected at most {DECISION_WORDS} words, found {words}: {record[:60]}")
    return out


def main() -> int:
    """Print what does not hold; the exit code says whether anything does not."""
    pages = [DOCS.parent / "README.md", *sorted(DOCS.rglob("*.md"))]
    out = complaints(pages)
    print("\n".join(out), file=sys.stderr)
    if "--pages" in sys.argv:
        for page in pages:
            own = sentences(page)
            words = sum(s.words for s in own)
            print(f"{words:6d} words {words / max(len(own), 1):5.1f} {page.relative_to(DOCS.parent)}")
    return 1 if out else 0


if __name__ == "__main__":
    sys.exit(main())
