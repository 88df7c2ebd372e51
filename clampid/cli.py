"""The command ``clampid``: collects its verbs from the entry points ``clampid.verbs`` and turns errors into exit codes.

0: done. 2: the input or the call is wrong, one line on stderr. 1: anything else, with the kind of error.
"""

from __future__ import annotations

import contextlib
import difflib
import functools
import os
import re
import shutil
import sys
import traceback
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from copy import copy
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, TextIO

import typer

from clampid.screen import wrapped
from clampid.verbs.errors import is_wrong_input
from clampid.verbs.installed import BrokenPackageError, installed_verbs
from clampid.verbs.plain_help import PlainCommand
from clampid.verbs.streams import any_encoding
from experiments.targets import OutputError, one_call, real_path

__all__ = ["app", "main"]

LONGEST_LINE = 4000  # characters of an error: a file may bring names of any length
OUTPUTS = frozenset({"output", "out", "report", "plan", "svg", "json", "truth", "picture", "poni"})
"""Parameters of verbs that name what is written; files that others name are read."""
VERBS = {
    "demo": "Run the whole loop on a virtual robot: start here.",
    "check": "Read a campaign folder and say what it holds.",
    "identify": "Fit a model to a campaign.",
    "auto": "Identify, then find and add what is missing.",
    "compare": "Compare a model with measurements.",
    "diagnose": "Say where a model fails and which effect is missing.",
    "add": "Add effects to a model and fit again.",
    "history": "Show each round's effects, evidence and error.",
    "undo": "Take back the last round and fit again.",
    "report": "Write the report of a model and a campaign as HTML.",
    "export": "Write a DH table, URDF, KUKA machine data or dynamics.",
    "base": "Find the base frame from circles or from touches.",
    "effects": "Say in words what each effect is.",
    "effect": "Make an effect of your own.",
    "robots": "List bundled robots, or show how a description is read.",
    "simulate": "Measure a campaign on the virtual robot.",
    "import": "Make a campaign from tables of an instrument.",
    "plan": "Plan measurements that identify what is asked.",
    "run": "Run a measurement campaign on a robot.",
    "ik": "Give joint angles for a detector position.",
    "sample": "Find the scattering point from Bragg reflections.",
    "serve": "Answer detector positions over TCP; move the robot.",
    "studio": "Open the loop in a browser.",
    "link-files": "Write the files for a KUKA controller.",
    "virtual-robot": "Play a robot's controller on sockets.",
    "worked-example": "Repeat the worked example of the thesis.",
}
"""Verbs in the order in which one meets them, each with its line of ``clampid --help``; others follow by name.

A line has at most 58 characters: typer would cut a longer one off.
"""


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
    found = installed_verbs()
    order = [*(name for name in VERBS if name in found), *sorted(found.keys() - VERBS.keys())]
    for name in order:
        verb, broken = found[name]
        if isinstance(verb, typer.Typer):
            group = copy(verb)  # the verb itself stays as it is: a process may make the command more than once
            group.registered_commands = [copy(one) for one in verb.registered_commands]
            for one in group.registered_commands:
                one.cls = PlainCommand
                if one.callback is not None:
                    one.callback = _guarded(one.callback)
            command.add_typer(group, name=name, short_help=VERBS.get(name))
        else:
            settings = {"ignore_unknown_options": True, "allow_extra_args": True} if broken else {}
            command.command(name, cls=PlainCommand, short_help=VERBS.get(name), context_settings=settings)(
                _guarded(verb)
            )
    return command


def _guarded(verb: Callable[..., Any]) -> Callable[..., Any]:
    """The verb; while it runs, nothing is written onto what it was told to read."""

    @functools.wraps(verb)
    def guarded(**given: Any) -> Any:
        inputs: list[Path] = []
        outputs: dict[Path, str] = {}
        for name, value in given.items():
            several = value if isinstance(value, list | tuple) else [value]
            named = name in OUTPUTS  # what an input's text names is looked at only if it looks like a file
            paths = [
                Path(v)
                for v in several
                if isinstance(v, Path) or (isinstance(v, str) and v != "-" and (named or Path(v).suffix))
            ]
            if not named:
                inputs += paths
            for path in paths if named else ():
                other = outputs.setdefault(real_path(path), name)
                if other != name:
                    raise OutputError(f"{path}: expected two files, found one for both --{other} and --{name}")
        with one_call(inputs, _force.get()):
            return verb(**given)

    return guarded


_force: ContextVar[bool] = ContextVar("force", default=False)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"clampid {version('clampid')}")
        raise typer.Exit


def _common(
    debug: Annotated[
        bool, typer.Option("--debug", help="Show the traceback of an error; works after a verb too.")
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Let an output replace a file of another kind; works after a verb too.")
    ] = False,
    show: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Take the options that come before the verb; all have been seen to already."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command and exit with its code.

    Parameters
    ----------
    arguments
        As typed; those of the process by default.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # several BLAS threads slow a small fit down tenfold
    any_encoding()
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
    _force.set("--force" in arguments)
    try:
        code = app()(args=[a for a in arguments if a != "--force"], prog_name="clampid", standalone_mode=False)
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
        message = _with_choice(worded().replace(": Value error, ", ": ")) + _as_list(worded(), arguments)
        context = getattr(error, "ctx", None)
        verb = "clampid" if context is None else context.command_path
        return _fail(f"{message} (see {verb} --help)" if not message.endswith("?") else message, 2)
    if is_wrong_input(error):
        return _fail(str(error), 2)
    if type(error).__name__ == "Abort":
        return _fail("stopped", 130)
    if isinstance(error, BrokenPackageError):
        return _fail(str(error), 1)
    return _fail(f"{type(error).__name__}: {error} (clampid --debug … shows where)", 1)


def _with_choice(message: str) -> str:
    """The message, with what was probably meant where a value is none of an option's choices."""
    found = re.search(r"'([^']*)' is not one of (.*)", message)
    near = difflib.get_close_matches(found[1], re.findall(r"'([^']*)'", found[2]), 1) if found else []
    return f"{message.rstrip('.')}; did you mean {near[0]}?" if near else message


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
    from kinematics.escaping import for_terminal  # its package takes numpy with it, which help does without

    line = for_terminal(" ".join(message.split()))
    if len(line) > LONGEST_LINE:
        line = f"{line[: LONGEST_LINE // 2]} … {line[-LONGEST_LINE // 2 :]}"
    text = f"clampid: {line}"
    if sys.stderr is None:  # closed by who called: the code says it all the same
        return code
    if sys.stderr.isatty():  # elsewhere one line, for scripts
        text = "\n".join(wrapped(text, shutil.get_terminal_size().columns, rest="  "))
    try:
        print(text, file=sys.stderr, flush=True)
    except OSError:  # stderr itself cannot be written, such as on a full disk
        _give_up(sys.stderr)
    return code


def _give_up(stream: TextIO) -> None:
    """Keep the interpreter from ending with an exit code of its own when output cannot be written."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
