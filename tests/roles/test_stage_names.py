"""A stage is a value: outside ``clampid/stages`` nothing decides by a stage's name, and literal names become fewer."""

from __future__ import annotations

import ast
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from clampid.effect import STAGES

ROOT = Path(__file__).parents[2]
PACKAGES = ("clampid", "offline_ik")
EXEMPT = ("clampid/stages/", "clampid/effects/", "clampid/standard_sets.py")
"""The stages themselves; effects, which say where they act; and the sets that name the stages."""
DECIDING: dict[str, int] = {
    "clampid/own_effect.py": 2,  # which stations and signals a stage has, below the layer that has stages
    "clampid/diagnosis/dependence.py": 2,  # the vocabulary of `effect-new`: names of columns and places by stage
}
"""File → how many decisions by a stage's name it may still hold, with the reason."""
ALLOWED: dict[str, int] = json.loads((Path(__file__).parent / "stage_names_left.json").read_text())
"""File → literal names left, most of them names of tables. Only lower these figures."""
TABLES = ("table", "tables", "kind")
"""What holds names of a campaign's tables, or of plans: the file format's words, some of which are also stages'."""


def names_in(node: ast.AST) -> bool:
    """Whether an expression is a literal name of a stage, or a collection of literals that has one."""
    if isinstance(node, ast.Tuple | ast.List | ast.Set):
        return any(names_in(item) for item in node.elts)
    return isinstance(node, ast.Constant) and node.value in STAGES


def of_tables(node: ast.AST) -> bool:
    """Whether an expression is a table's or a plan's name, or the tables of a campaign."""
    named = node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
    return named in TABLES


def decisions(source: str) -> Iterator[int]:
    """Lines that compare with a stage's name, match it, or look something up by two or more such names."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Compare):
            sides = (node.left, *node.comparators)
            if any(map(names_in, sides)) and not any(map(of_tables, sides)):
                yield node.lineno
        elif isinstance(node, ast.MatchValue) and names_in(node.value):
            yield node.value.lineno
        elif isinstance(node, ast.Dict):
            keys = [key.value for key in node.keys if isinstance(key, ast.Constant)]
            if len(keys) > 1 and set(keys) <= set(STAGES):
                yield node.lineno


def literals(source: str) -> int:
    """How many string constants of a module are a stage's name."""
    return sum(isinstance(node, ast.Constant) and node.value in STAGES for node in ast.walk(ast.parse(source)))


def modules() -> Iterator[tuple[str, str]]:
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            where = path.relative_to(ROOT).as_posix()
            if not where.startswith(EXEMPT):
                yield where, path.read_text(encoding="utf-8")


def test_nothing_decides_by_the_name_of_a_stage() -> None:
    found = {where: lines for where, text in modules() if len(lines := list(decisions(text))) > DECIDING.get(where, 0)}
    assert not found, "ask for a trait, a word or a function of clampid.stages.stage_kind.StageKind"


def test_literal_names_of_stages_only_become_fewer() -> None:
    found = {where: literals(text) for where, text in modules()}
    assert not {where: count for where, count in found.items() if count > ALLOWED.get(where, 0)}


def test_files_still_allowed_stage_names_exist() -> None:
    assert not [where for where in (*ALLOWED, *DECIDING) if not (ROOT / where).is_file()]


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ('if rows.stage == "poses": pass', 1),
        ('if stage in ("free_air", "clamped"): pass', 1),
        ('match stage:\n    case "poses":\n        pass', 1),
        ('{"poses": 1, "clamped": 2}[stage]', 1),
        ('if "poses" in stages: pass', 1),
        ('if "poses" in campaign.tables: pass', 0),
        ('if visit.table == "poses": pass', 0),
        ("if rows.kind.points: pass", 0),
        ('{"poses": frame, "verification": table}', 0),
    ],
)
def test_decisions_are_seen_in_the_syntax_tree(source: str, count: int) -> None:
    assert len(list(decisions(source))) == count
