"""What is declared is imported, what is imported is declared, and the audit of versions says what it did."""

from __future__ import annotations

import ast
import contextlib
import importlib.util
import json
import re
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path
from types import ModuleType

import pytest
from packaging.requirements import Requirement

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


LOCKS = {name: (ROOT / "lock" / f"{name}.txt").read_text(encoding="utf-8") for name in ("run", "develop")}
EXTRAS = re.search(r"^EXTRAS := (\S+)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
"""Extras that ``make`` installs for development."""


def extras() -> list[str]:
    """What the extras for development need; one that names extras of the project itself stands for those."""
    assert EXTRAS is not None
    found, left = [], EXTRAS[1].split(",")
    while left:
        for line in PROJECT["optional-dependencies"][left.pop()]:
            own = plain(line) == PROJECT["name"]
            left += sorted(Requirement(line).extras) if own else []
            found += [] if own else [line]
    return found


def needed(names: list[str]) -> set[str]:
    """Distributions that these need here, themselves among them, as what is installed says."""
    found: dict[str, set[str]] = {}
    left = [Requirement(name) for name in names]
    while left:
        one = left.pop()
        name = plain(one.name)
        if name in found and one.extras <= found[name]:
            continue
        found[name] = found.get(name, set()) | one.extras
        with contextlib.suppress(PackageNotFoundError):
            left += [
                part
                for part in map(Requirement, requires(one.name) or ())
                if part.marker is None or any(part.marker.evaluate({"extra": extra}) for extra in ("", *one.extras))
            ]
    return set(found)


@pytest.mark.parametrize("name", LOCKS)
def test_what_is_locked_is_what_is_pinned_with_hashes_and_without_a_host(name: str) -> None:
    lock = ci_script("lock")
    pinned, pins = lock.pins((ROOT / "constraints.txt").read_text()), lock.pins(LOCKS[name])
    assert {key: pinned.get(key) for key in pins} == pins
    blocks = re.split(r"\n(?=\S)", LOCKS[name].removeprefix(lock.HEAD).strip())
    assert len(blocks) == len(pins)
    for block in blocks:
        assert re.fullmatch(r"[^\s\\]+==[^\s\\]+( ; [^\\]+)?( \\\n {4}--hash=sha256:[0-9a-f]{64})+", block), block
    assert "://" not in LOCKS[name]


def test_a_change_of_what_is_needed_or_pinned_needs_new_locks() -> None:
    """``make lock`` makes them."""
    lock = ci_script("lock")
    run, develop = lock.pins(LOCKS["run"]), lock.pins(LOCKS["develop"])
    builds = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    declared = [*PROJECT["dependencies"], *builds]
    assert not {plain(line) for line in declared} - run.keys()
    assert not {plain(line) for line in extras()} - develop.keys()
    for line, version in [(line, develop[plain(line)]) for line in (*declared, *extras())]:
        assert Requirement(line).specifier.contains(version), line
    assert run.items() <= develop.items()
    assert lock.pins((ROOT / "constraints.txt").read_text()) == develop


def test_pins_are_added_and_removed_and_the_rest_stays() -> None:
    lock = ci_script("lock")
    text = "# Head\nB_b==2\na==1\ngone==3\n"
    assert lock.tidied(text, {"a": "1", "b-b": "2", "Zz": "5"}) == "# Head\na==1\nB_b==2\nZz==5\n"
    assert lock.pins(text) == {"b-b": "2", "a": "1", "gone": "3"}


def test_nothing_is_installed_that_nothing_imported_needs() -> None:
    of, modules = distributions(), imported()
    brought = sorted({plain(name) for module in modules for name in of.get(module, ())})
    lines = [line for line in PROJECT["dependencies"] if plain(line) in brought]
    always = {plain(m[1]) for m in re.finditer(r"^([A-Za-z0-9._-]+)==\S+ \\$", LOCKS["run"], re.MULTILINE)}
    assert len(always) > 30
    builds = needed(tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"])
    assert not always - needed(lines) - builds


FOLDERS = ("tests", "docs", "benchmarks", *OWN)  # an extra may be for a part of the program
TOOLS = {
    "pytest-xdist": ("Makefile", "--dist worksteal"), "pytest-timeout": ("pyproject.toml", "timeout = 900"),
    "ruff": ("Makefile", "/ruff"), "mypy": ("Makefile", "/mypy"), "import-linter": ("Makefile", "/lint-imports"),
    "pandas-stubs": ("pyproject.toml", "[tool.mypy]"), "mkdocs": ("Makefile", "/mkdocs"),
    "mkdocs-material": ("mkdocs.yml", "name: material"), "mkdocstrings": ("mkdocs.yml", "mkdocstrings"),
}  # fmt: skip
"""What development uses without importing it, and where."""


def test_nothing_is_installed_for_development_that_is_not_used() -> None:
    text = "\n".join(p.read_text() for folder in FOLDERS for p in (ROOT / folder).rglob("*.py"))
    modules = set(re.findall(r"^\s*(?:(?:from|import) |.*importorskip\(\")(\w+)", text, re.MULTILINE))
    brought_by = distributions()  # once: it reads the records of every installed package
    used = {plain(name) for module in modules for name in brought_by.get(module, ())}
    for line in extras():
        file, words = TOOLS.get(plain(line), ("", ""))
        assert plain(line) in used or (file and words in (ROOT / file).read_text()), line


def ci_script(name: str) -> ModuleType:
    """A script of .ci as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / ".ci" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def audit() -> ModuleType:
    return ci_script("audit")


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
