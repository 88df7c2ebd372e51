"""The core knows roles, not names: literal names of the catalogue outside ``clampid/effects`` only become fewer."""

from __future__ import annotations

import ast
import json
from collections import Counter
from pathlib import Path

import pytest

from clampid.catalogue import catalogue

ROOT = Path(__file__).parents[2]
PACKAGES = ("clampid", "experiments", "kinematics", "offline_ik")
EXEMPT = (
    "clampid/effects/",
    "clampid/standard_sets.py",
    "experiments/virtual_robot/",
    "experiments/second_world/",
)  # physics; the truth's kinds
ALLOWED: dict[str, int] = json.loads((Path(__file__).parent / "names_left.json").read_text())
"""File → how many literal names it may still hold. Only lower these figures; remove a file that has none left."""


def literal_names(source: str, names: frozenset[str]) -> int:
    """How many string constants of a module are the name of an effect, as the syntax tree says."""
    return sum(
        isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value in names
        for node in ast.walk(ast.parse(source))
    )


def counted() -> dict[str, int]:
    """File → literal names in it, of all files that must have none in the end."""
    names, found = frozenset(catalogue()), Counter[str]()
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            where = path.relative_to(ROOT).as_posix()
            if not where.startswith(EXEMPT):
                found[where] = literal_names(path.read_text(encoding="utf-8"), names)
    return {where: count for where, count in found.items() if count}


def test_names_of_effects_outside_their_files_only_become_fewer() -> None:
    more = {where: count for where, count in counted().items() if count > ALLOWED.get(where, 0)}
    assert not more, "ask for a role, a family or a field of the effect; or name it in the effect's own file"


def test_files_still_allowed_names_exist() -> None:
    gone = [where for where in ALLOWED if not (ROOT / where).is_file()]
    assert not gone


@pytest.mark.parametrize(
    ("source", "count"),
    [('x = "backlash"', 1), ('if name in ("gravity", "backlash"): pass', 2), ("backlash = 1", 0), ('"no backlash"', 0)],
)
def test_names_are_counted_in_the_syntax_tree(source: str, count: int) -> None:
    assert literal_names(source, frozenset({"backlash", "gravity"})) == count
