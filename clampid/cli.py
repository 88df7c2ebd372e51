"""The command ``clampid``: collects its verbs from the entry points ``clampid.verbs`` and turns errors into exit codes.

0: done. 2: the input or the call is wrong, one line on stderr. 1: anything else, with the kind of error.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
import traceback
from collections.abc import Sequence
from importlib.metadata import entry_points, version
from typing import Annotated

import typer

from clampid.screen import wrapped
from clampid.verbs.errors import is_wrong_input

__all__ = ["app", "main"]

GROUP = "clampid.verbs"
ORDER = (
    "demo", "check", "identify", "auto", "compare", "diagnose", "add", "history", "undo", "export", "base", "effects",
    "effect", "simulate", "plan", "run", "ik", "sample", "serve", "studio", "virtual-robot",
)  # fmt: skip
"""Verbs in the order in which one meets them; others follow by name."""


def app() -> typer.Typer:
    """The command with every verb that an installed package declares."""
    command = typer.Typer(
        name="clampid",
        help="Finds out why one particular industrial robot is inaccurate, and mends it.",
        no_args_is_help=True,
        add_completion=True,
        rich_markup_mode=None,
    )
    command.callback()(_common)
    found = {point.name: point for point in entry_points(group=GROUP)}
    for name in sorted(found, key=lambda name: (ORDER.index(name) if name in ORDER else len(ORDER), name)):
        verb = found[name].load()
        if isinstance(verb, typer.Typer):
            command.add_typer(verb, name=name)
        else:
            command.command(name)(verb)
    return command


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"clampid {version('clampid')}")
        raise typer.Exit


def _common(
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the traceback of an error; works after a verb too.")
    ] = False,
    show: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Take the options that come before the verb; both have been seen to already."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and exit with its code.

    Parameters
    ----------
    arguments
        As typed; those of the process by default.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # BLAS threads that fight cost a small fit a factor of ten
    given = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in given
    sys.exit(run([a for a in given if a != "--debug"], debug))


def run(arguments: Sequence[str], debug: bool = False) -> int:
    """Run the command and give its exit code.

    Parameters
    ----------
    arguments
        As typed, without the name of the program.
    debug
        Show the traceback of an error.
    """
    try:
        code = app()(args=list(arguments), prog_name="clampid", standalone_mode=False)
    except KeyboardInterrupt:
        return _fail("stopped", 130)
    except BrokenPipeError:  # the reader of our output had enough, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except Exception as error:  # the program's outermost boundary: every error becomes one line and a code
        return _failed(error, debug, arguments)
    return code if isinstance(code, int) else 0


def _failed(error: Exception, debug: bool, arguments: Sequence[str]) -> int:
    if debug:
        traceback.print_exc()
    worded = getattr(error, "format_message", None)  # typer's own errors: a wrong option, a missing argument
    if worded is not None:
        if type(error).__name__ == "NoArgsIsHelpError":
            typer.echo(worded(), err=True)
            return 2
        message = worded() + _as_list(worded(), arguments)
        return _fail(f"{message} (see clampid --help)" if not message.endswith("?") else message, 2)
    if is_wrong_input(error):
        return _fail(str(error), 2)
    if type(error).__name__ == "Abort":
        return _fail("stopped", 130)
    return _fail(f"{type(error).__name__}: {error} (clampid --debug … shows where)", 1)


def _as_list(message: str, arguments: Sequence[str]) -> str:
    """A hint where the values of an option were written with spaces instead of commas; else nothing."""
    extra = re.search(r"unexpected extra argument(?:s|\(s\))? \(([^)]*)\)", message)
    rest = extra[1].split() if extra else []
    for k in range(2, len(arguments)):
        option, value = arguments[k - 2 : k]
        if rest and arguments[k] == rest[0] and option.startswith("--") and not value.startswith("-"):
            return f"; did you mean {option} {','.join([value, *rest])}?"
    return ""


def _fail(message: str, code: int) -> int:
    text = "clampid: " + " ".join(message.split())
    if sys.stderr.isatty():  # elsewhere one line, for scripts
        text = "\n".join(wrapped(text, shutil.get_terminal_size().columns, rest="  "))
    print(text, file=sys.stderr)
    return code
