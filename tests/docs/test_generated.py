"""Generated pages are what their generators write today, and pages read easily."""

from __future__ import annotations

import pydoc
import re
import runpy
from pathlib import Path
from typing import Any

import pytest
import typer

from clampid.catalogue import catalogue
from clampid.cli import app

DOCS = Path(__file__).parents[2] / "docs"


def script(name: str) -> dict[str, Any]:
    return runpy.run_path(str(DOCS / name))


@pytest.mark.parametrize("name", ["make_effects.py", "make_folders.py", "make_verbs.py"])
def test_a_generated_page_is_up_to_date(name: str) -> None:
    made = script(name)
    assert made["PAGE"].read_text(encoding="utf-8") == made["page"]()


def test_every_verb_and_option_that_a_page_names_exists() -> None:
    verbs, options = set[str](), {"--help"}
    for name, verb in script("make_verbs.py")["commands"]():
        verbs.add(name.split()[0])
        options |= {option for parameter in verb.params for option in parameter.opts}
    options |= {option for parameter in typer.main.get_command(app()).params for option in parameter.opts}
    wrong = []
    for page in [DOCS.parent / "README.md", *DOCS.rglob("*.md")]:
        text = page.read_text(encoding="utf-8").replace("\\\n", "")
        for command in re.findall(r"(?:^\$ |`|^  |first: |&& )clampid ([^`\n]*)", text, re.MULTILINE):
            words = command.split("#")[0].split(" && ")[0].split()
            named = [w.split("=")[0] for w in words if re.match(r"--[a-z]", w)]
            if words and re.fullmatch(r"[a-z-]+", words[0]) and not words[0].startswith("-"):
                wrong += [f"{page.name}: {words[0]}"] if words[0] not in verbs else []
            wrong += [f"{page.name}: {option}" for option in named if option.rstrip(",.") not in options]
    assert wrong == []


def test_every_function_on_the_way_from_a_row_to_a_verdict_exists() -> None:
    text = (DOCS / "explanation" / "from-a-row-to-a-verdict.md").read_text(encoding="utf-8")
    names = set(re.findall(r"`((?:clampid|experiments|kinematics|offline_ik)\.[\w.]+)`", text))
    assert len(names) > 15
    assert [name for name in names if pydoc.locate(name) is None] == []


def test_every_effect_has_words_on_its_signature() -> None:
    made = script("make_effects.py")
    keys = {effect.family for effect in catalogue().values()}
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
