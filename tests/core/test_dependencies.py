"""What is declared is imported, what is imported is declared, and the audit of versions says what it did."""

from __future__ import annotations

import ast
import importlib.util
import json
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
OWN = ("clampid", "experiments", "kinematics", "offline_ik", "appendix_data")
UNUSUAL = {"pinocchio": ["pin"], "coal": ["coal"]}
"""Distributions that install in a place of their own (cmeel), where nothing is recorded of their modules."""
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def plain(name: str) -> str:
    """A distribution's name as PEP 503 compares it, without version and extras."""
    return re.sub(r"[-_.]+", "-", re.split(r"[<>=!~;\[ ]", name)[0]).lower()


def imported() -> dict[str, str]:
    """Top-level modules that the installed packages import, each with one file that does."""
    found: dict[str, str] = {}
    for file in (file for package in OWN for file in (ROOT / package).rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and not node.level and node.module:
                names = [node.module]
            for name in names:
                found.setdefault(name.partition(".")[0], str(file.relative_to(ROOT)))
    return {k: v for k, v in found.items() if k not in sys.stdlib_module_names and k not in OWN}


def distributions() -> dict[str, list[str]]:
    """Distributions by the top-level modules that they bring."""
    return {**packages_distributions(), **UNUSUAL}


def test_nothing_is_imported_that_is_not_declared() -> None:
    every = [*PROJECT["dependencies"], *(name for extra in PROJECT["optional-dependencies"].values() for name in extra)]
    declared, of = {plain(name) for name in every}, distributions()
    modules = imported()
    assert len(modules) > 8
    undeclared = {
        module: file
        for module, file in modules.items()
        if not declared & {plain(name) for name in of.get(module, [module])}
    }
    assert not undeclared


def test_nothing_is_declared_that_is_not_imported() -> None:
    of, modules = distributions(), imported()
    brought = {plain(name) for module in modules for name in of.get(module, ())}
    assert not {plain(name) for name in PROJECT["dependencies"]} - brought


def test_every_version_of_what_is_declared_is_pinned() -> None:
    pinned = {plain(line) for line in (ROOT / "constraints.txt").read_text().splitlines() if not line.startswith("#")}
    assert not {plain(name) for name in PROJECT["dependencies"]} - pinned


@pytest.fixture(scope="module")
def audit() -> ModuleType:
    spec = importlib.util.spec_from_file_location("audit", ROOT / ".ci" / "audit.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


FINE = {"name": "numpy", "version": "2.4.6", "vulns": []}
BAD = {"name": "a", "version": "1.0", "vulns": [{"id": "CVE-2026-1", "fix_versions": ["1.1"]}]}
SKIPPED = {"name": "b", "skip_reason": "Dependency not found on PyPI and could not be audited: b (1)"}


@pytest.mark.parametrize(
    ("found", "code", "says"),
    [
        ([FINE], 0, "audited 1 of 1 packages: 0 known"),
        ([FINE, BAD], 1, "a 1.0: CVE-2026-1, mended in 1.1"),
        ([FINE, SKIPPED], 0, "not audited: b"),
        ([SKIPPED], 0, "NOT AUDITED"),
        ([BAD, SKIPPED], 1, "CVE-2026-1"),
    ],
)
def test_a_known_vulnerability_fails_and_what_was_not_looked_up_is_said(
    audit: ModuleType, found: list[dict], code: int, says: str
) -> None:
    ended, lines = audit.judged(json.dumps({"dependencies": found, "fixes": []}))
    assert ended == code
    assert any(says in line for line in lines)


def test_an_audit_without_an_answer_says_so_and_does_not_fail(audit: ModuleType, tmp_path: Path, capsys) -> None:
    assert audit.judged("")[0] == 0
    assert audit.main([str(tmp_path / "no-python"), "constraints.txt"]) == 0
    assert "NOT AUDITED" in capsys.readouterr().out
