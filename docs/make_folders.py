"""Write docs/reference/folders.md from the packages' own docstrings: ``python docs/make_folders.py``."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = Path(__file__).parent / "reference" / "folders.md"
PACKAGES = ("kinematics", "experiments", "clampid", "offline_ik")  # from the lowest layer up
HEAD = """# The folders

<!-- Written by docs/make_folders.py from the packages' docstrings; do not edit. -->

Each package imports only from packages above it on this page. `lint-imports` checks that. It also checks the order of
the layers inside `clampid` and `offline_ik`. A page leads through the code once:
[From a row to a verdict](../explanation/from-a-row-to-a-verdict.md).

The number after a folder is how many modules it holds.
"""


def sentence(package: Path) -> str:
    """The first sentence of a package's docstring.

    Raises
    ------
    ValueError
        It has none.
    """
    text = ast.get_docstring(ast.parse((package / "__init__.py").read_text(encoding="utf-8")))
    if not text:
        raise ValueError(f"{package}: expected a docstring that says what the package is for, found none")
    first = " ".join(text.split("\n\n")[0].split())
    return first if ". " not in first else first[: first.index(". ") + 1]


def folders(package: Path, depth: int = 0) -> Iterator[tuple[int, Path]]:
    """A package and those in it, with how deep each lies."""
    yield depth, package
    for inner in sorted(package.iterdir()):
        if (inner / "__init__.py").is_file():
            yield from folders(inner, depth + 1)


def row(depth: int, package: Path) -> str:
    """A folder's line of the list."""
    count = sum(1 for module in package.glob("*.py") if module.name != "__init__.py")
    return f"{'    ' * depth}* `{package.name}/` ({count}): {sentence(package)}"


def page() -> str:
    """The page's text."""
    parts = [HEAD]
    for name in PACKAGES:
        parts.append("\n".join(row(depth, package) for depth, package in folders(ROOT / name)) + "\n")
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
