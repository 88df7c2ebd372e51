"""Generated pages are what their generators write today, and pages read easily."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

from clampid.catalogue import catalogue

DOCS = Path(__file__).parents[2] / "docs"


def script(name: str) -> dict[str, Any]:
    return runpy.run_path(str(DOCS / name))


@pytest.mark.parametrize("name", ["make_effects.py", "make_verbs.py"])
def test_a_generated_page_is_up_to_date(name: str) -> None:
    made = script(name)
    assert made["PAGE"].read_text(encoding="utf-8") == made["page"]()


def test_every_effect_has_words_on_its_signature() -> None:
    made = script("make_effects.py")
    keys = {made["family_of"](effect) for effect in catalogue().values()}
    assert keys == set(made["SIGNATURE"]) == {key for group in made["GROUPS"].values() for key in group}


def test_the_documentation_reads_easily() -> None:
    made = script("check_sentences.py")
    pages = [DOCS.parent / "README.md", *sorted(DOCS.rglob("*.md"))]
    assert made["complaints"](pages) == []


@pytest.mark.parametrize(
    ("text", "lengths"),
    [
        ("One two three. Four `five six` seven!", [3, 3]),
        ("# A heading\n\nOne two\nthree.\n\n| a | table |\n|---|---|\n", [3]),
        ("* One two.\n* Three, e.g. four.\n\n```console\n$ not counted\n```\n", [2, 3]),
        ("[A link of five words](x.md) follows. See 3.5 mm.", [6, 3]),
    ],
)
def test_sentences_are_counted_without_code_and_tables(text: str, lengths: list[int], tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(text)
    assert [s.words for s in script("check_sentences.py")["sentences"](page)] == lengths


def test_long_sentences_and_long_how_to_pages_are_named(tmp_path: Path) -> None:
    made = script("check_sentences.py")
    (tmp_path / "how-to").mkdir()
    page = tmp_path / "how-to" / "page.md"
    page.write_text(" ".join(["word"] * 36) + ". " + "Few words here. " * 300)
    found = made["complaints"]([page])
    assert any("36 words" in text for text in found)
    assert any("900 words" in text for text in found)
