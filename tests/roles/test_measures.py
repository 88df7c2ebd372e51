"""How large modules and functions are, and that no package imports in a circle, from the source as syntax trees."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from source_measures import (
    MAX_LINES,
    MAX_PARAMETERS,
    PACKAGES,
    cycles,
    import_graph,
    long_modules,
    parameters_over,
    shared_words,
)

ROOT = Path(__file__).parents[2]


def test_no_module_is_longer_than_a_reader_holds() -> None:
    assert long_modules(ROOT) == {}


def test_no_function_has_more_parameters_than_a_reader_holds() -> None:
    assert parameters_over(ROOT) == {}, f"more than {MAX_PARAMETERS} parameters: make what belongs together a value"


def test_constants_say_what_they_are_of() -> None:
    assert shared_words(ROOT) == {}


def test_no_package_imports_in_a_circle() -> None:
    assert cycles(import_graph(ROOT)) == []


def test_measures_see_what_they_forbid(tmp_path: Path) -> None:
    for package in PACKAGES:
        (tmp_path / package).mkdir()
    (tmp_path / "clampid" / "a.py").write_text("from clampid import b\n" + "x = 1\n" * MAX_LINES)
    (tmp_path / "clampid" / "b.py").write_text(
        "STEP: float = 1.0\n\ndef f(a, b, c, d, e, f, g, h, i):\n    import clampid.a\n"
    )
    assert shared_words(tmp_path) == {"STEP": ["clampid/b.py"]}
    assert long_modules(tmp_path) == {"clampid/a.py": MAX_LINES + 1}
    assert parameters_over(tmp_path) == {"clampid/b.py:f": 9}
    assert cycles(import_graph(tmp_path)) == [["clampid.a", "clampid.b"]]


@pytest.mark.parametrize("source", ["if TYPE_CHECKING:\n    import clampid.b", "import numpy", "from clampid import a"])
def test_type_checking_and_other_packages_are_no_circle(source: str, tmp_path: Path) -> None:
    (tmp_path / "clampid").mkdir()
    (tmp_path / "clampid" / "a.py").write_text(source)
    (tmp_path / "clampid" / "b.py").write_text("import clampid.a")
    assert ast.parse(source)
    assert cycles(import_graph(tmp_path)) == []
