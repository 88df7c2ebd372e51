"""Measures of the source, read as syntax trees: long modules, functions of many parameters, circles of imports.

``python tests/roles/source_measures.py`` prints them.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

PACKAGES = ("clampid", "experiments", "kinematics", "offline_ik")
MAX_LINES = 400
MAX_PARAMETERS = 8
VAGUE = ("STEPS", "FEWEST", "MOST", "FAR", "FIRST", "BEYOND", "APART", "CLOSE", "PASSES", "SHIFT", "SHORT", "STEP")
"""Words that were constants of a dozen modules with as many meanings; a constant says what it is of."""
COMMAND_LINES = ("clampid/verbs/", "offline_ik/verbs/")  # a verb's parameters are the options of its command line


def sources(root: Path) -> Iterator[tuple[str, str]]:
    """Path from the root, and text, of every module."""
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            yield path.relative_to(root).as_posix(), path.read_text(encoding="utf-8")


def long_modules(root: Path) -> dict[str, int]:
    """Module → lines, of those with more than `MAX_LINES`."""
    counts = {where: len(text.splitlines()) for where, text in sources(root)}
    return {where: lines for where, lines in counts.items() if lines > MAX_LINES}


def parameters_over(root: Path) -> dict[str, int]:
    """``file:function`` → parameters, of those with more than `MAX_PARAMETERS`, but for verbs."""
    found: dict[str, int] = {}
    for where, text in sources(root):
        if where.startswith(COMMAND_LINES):
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                own = node.args
                named = [a.arg for a in (*own.posonlyargs, *own.args, *own.kwonlyargs) if a.arg not in ("self", "cls")]
                count = len(named) + (own.vararg is not None) + (own.kwarg is not None)
                if count > MAX_PARAMETERS:
                    found[f"{where}:{node.name}"] = count
    return found


def shared_words(root: Path) -> dict[str, list[str]]:
    """Constant of one of `VAGUE` words → modules that define it."""
    found: dict[str, list[str]] = {}
    for where, text in sources(root):
        for node in ast.parse(text).body:
            targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
            for target in targets:
                if isinstance(target, ast.Name) and target.id.lstrip("_") in VAGUE:
                    found.setdefault(target.id, []).append(where)
    return found


def import_graph(root: Path) -> dict[str, set[str]]:
    """Module → modules of ours that it imports, at its top or within functions; not what is for type checking only."""
    texts = {
        where.removesuffix(".py").replace("/", ".").removesuffix(".__init__"): text for where, text in sources(root)
    }
    return {module: _imports(ast.parse(text), texts) - {module} for module, text in texts.items()}


def _imports(node: ast.AST, known: Mapping[str, str]) -> set[str]:
    found: set[str] = set()
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and isinstance(child.test, ast.Name) and child.test.id == "TYPE_CHECKING":
            continue
        if isinstance(child, ast.Import):
            found |= {alias.name for alias in child.names if alias.name in known}
        elif isinstance(child, ast.ImportFrom) and child.module is not None:
            for alias in child.names:  # a module of a package, or else a name in it
                name = f"{child.module}.{alias.name}"
                found |= {name if name in known else child.module} & known.keys()
        found |= _imports(child, known)
    return found


def cycles(graph: Mapping[str, set[str]]) -> list[list[str]]:
    """Circles of imports, as the modules in them sorted; one of each set that is joined by circles."""
    left, found = {m: set(to) for m, to in graph.items()}, []
    while True:
        try:
            TopologicalSorter(left).prepare()
        except CycleError as error:
            circle = sorted(set(error.args[1]))
            found.append(circle)
            for module in circle:
                left.pop(module, None)
            left = {m: to - set(circle) for m, to in left.items()}
        else:
            return found


if __name__ == "__main__":
    ROOT = Path(__file__).parents[2]
    print("modules over", MAX_LINES, "lines:", long_modules(ROOT) or "none")
    print("functions over", MAX_PARAMETERS, "parameters:", parameters_over(ROOT) or "none")
    print("constants of vague words:", shared_words(ROOT) or "none")
    print("circles of imports:", cycles(import_graph(ROOT)) or "none")
