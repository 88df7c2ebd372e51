"""Write docs/reference/command-line.md from the verbs' own help: ``python docs/make_verbs.py``."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import typer

from clampid.cli import app

PAGE = Path(__file__).parent / "reference" / "command-line.md"
HEAD = """# Command line

<!-- Written by docs/make_verbs.py from the verbs' own help; do not edit. -->

`clampid VERB --help` prints the same. What a verb prints is on [its own page](screens.md).

* **Screen.** Every verb ends in at most 24 lines of 80 columns. The next command stands last. `--verbose` prints the
  tables before it. Colours appear on a terminal only, and not with `NO_COLOR`.
* **Programs.** `--json FILE` writes the whole result. With `--json -`, stdout carries nothing else. `--quiet` silences
  progress. Equal input and equal `--seed` give equal numbers.
* **Exit codes.** 0: done. 2: the input or the call is wrong; one line on stderr says what was expected and what was
  found. 1: anything else; `clampid --debug VERB …` shows where.
* **Files.** Results are written whole or not at all. An output is never a file that the same call reads. A file of
  another kind is replaced only with `--force`. `-o /dev/null` works.
* **Tab completion.** `clampid --install-completion`.

```console
$ clampid --version
$ clampid effects --json effects.json
$ clampid identify --help
```

A package of your own adds a verb by an entry point in the group `clampid.verbs`. It names a function whose arguments
are typer's, or a `typer.Typer` for a group of verbs.
"""


def commands() -> Iterator[tuple[str, Any]]:
    """Every verb with its name as typed."""
    program: Any = typer.main.get_command(app())
    for name, verb in program.commands.items():
        if hasattr(verb, "commands"):
            yield from ((f"{name} {inner}", one) for inner, one in verb.commands.items())
        else:
            yield name, verb


def cell(text: str) -> str:
    """Text for a cell of a table."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def option(parameter: Any) -> str:
    """A row of a verb's table: how it is typed, and what it is for."""
    if parameter.param_type_name == "argument":
        return f"| `{cell(parameter.metavar or parameter.name.upper())}` | {cell(parameter.help or '')} |"
    name = ", ".join(sorted(parameter.opts, key=len, reverse=True))
    default = parameter.default
    choices = "\\|".join(str(one.value) for one in type(default)) if isinstance(default, Enum) else ""
    shown = parameter.show_default is not False and default not in (None, False, ()) and not callable(default)
    said = f" Default: {getattr(default, 'value', default)}." if shown else ""
    typed = f"{name} {choices or cell(parameter.metavar or '')}".strip()
    return f"| `{typed}` | {cell((parameter.help or '') + said)} |"


def page() -> str:
    """The page, from the verbs."""
    lines = [HEAD]
    for name, verb in commands():
        lines += [f"## {name}", "", inspect.cleandoc(verb.help or "").split("\f")[0].strip(), ""]
        shown = [p for p in verb.params if p.name not in ("help", "quiet", "json", "verbose") and not p.hidden]
        arguments = [p for p in shown if p.param_type_name == "argument"]
        options = [p for p in shown if p.param_type_name != "argument"]
        rows = [option(p) for p in (*arguments, *options)]
        if rows:
            lines += ["| argument or option | meaning |", "|---|---|", *rows, ""]
    return "\n".join(lines)


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
