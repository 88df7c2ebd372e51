"""What a fresh clone must have: our packages under generic names, verbs that load, nothing tied to one machine."""

from __future__ import annotations

import ast
import importlib
import re
import sys
import tomllib
from importlib.metadata import distributions, entry_points
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", ["appendix_data", "kinematics", "experiments", "clampid", "offline_ik"])
def test_the_imported_package_is_ours(name: str) -> None:
    assert Path(str(importlib.import_module(name).__file__)).is_relative_to(ROOT)


def test_every_declared_verb_loads() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["clampid.verbs"]
    installed = {point.name: point for point in entry_points(group="clampid.verbs")}
    assert declared.keys() <= installed.keys()
    for name in declared:
        assert callable(installed[name].load())


@pytest.mark.parametrize(
    "name",
    [
        "Makefile",
        ".ci/run",
        "constraints.txt",
        "pyproject.toml",
        "mkdocs.yml",
        "lock/run.txt",
        "lock/develop.txt",
        ".ci/lock.py",
    ],
)
def test_nothing_is_tied_to_one_machine_or_host(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    assert not re.search(r"https?://|/home/|/work/|/opt/|/tmp/", text)


def test_constraints_are_names_and_versions() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    assert all(re.fullmatch(r"#.*|[A-Za-z0-9_.-]+==[^\s@]+", line) for line in lines)


def test_what_is_installed_takes_the_oldest_python_that_we_name() -> None:
    named = SpecifierSet(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"])
    (oldest,) = (part.version for part in named if part.operator == ">=")
    needs = {found.name: SpecifierSet(found.metadata["Requires-Python"] or "") for found in distributions()}
    assert not [name for name, need in needs.items() if not need.contains(f"{oldest}.0")]


INSTALLED = ("appendix_data", "kinematics", "experiments", "clampid", "offline_ik")
MODULES = {"pin": "pinocchio", "pytango": "tango", "ophyd-async": "ophyd_async", "event-model": "event_model"}
"""Distributions whose import name is another."""


def imported() -> set[str]:
    """Top-level names that the installed packages import, ours and the standard library's aside."""
    found: set[str] = set()
    for package in INSTALLED:
        for file in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Import):
                    found |= {alias.name.partition(".")[0] for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.level == 0:
                    found.add((node.module or "").partition(".")[0])
    return found - set(sys.stdlib_module_names) - set(INSTALLED)


def test_what_is_imported_is_declared_and_the_other_way_round() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    lines = [*project["dependencies"], *(line for name in ("tango", "bluesky", "epics") for line in extras[name])]
    declared = {re.split(r"[<>=!~ \[]", line)[0] for line in lines}
    assert {MODULES.get(name, name) for name in declared} == imported()
