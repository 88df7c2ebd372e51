"""The command ``clampid`` in processes of their own that need not import it: a call costs its own work alone.

A server imports the program once and forks a child for each call. The child gets the caller's arguments, folder,
environment and streams, and goes on as the installed command does. The command that is called in the place of that
one (`forked_program`) hands all that over and ends with the child's code; if it is killed, so is the child.

What differs from the installed command: modules are imported already, all children hash strings alike, streams are
UTF-8, and signals do not reach the child. What tests one of these calls the installed command itself (`INSTALLED`).
"""

from __future__ import annotations

import atexit
import os
import select
import shlex
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

__all__ = ["INSTALLED", "forked_program"]

INSTALLED = Path(sys.executable).with_name("clampid")
"""The command as the package installs it."""
PACKAGES = ("kinematics", "experiments", "clampid", "offline_ik")
OPTIONAL = ("offline_ik.beamline", "clampid.__main__")
"""What needs extras, or runs when it is imported."""
LATE_IMPORTS = (
    "matplotlib.backends.backend_svg", "matplotlib.figure", "pinocchio", "pyarrow.pandas_compat", "pyarrow.parquet",
    "pydantic", "rich.console", "scipy.optimize", "scipy.stats",
)  # fmt: skip
"""What some verbs import of others only when they run."""
CALLER = """
import os, socket, sys
with socket.socket(socket.AF_UNIX) as server:
    server.connect(sys.argv[1])
    parts = ["\\0".join(sys.argv[2:]), os.getcwd(), "\\0".join(f"{k}={v}" for k, v in os.environ.items())]
    sent = [os.fsencode(part) for part in parts]
    head = b"".join(len(part).to_bytes(8, "big") for part in sent)
    opened = []
    for number in range(3):
        try:
            opened.append(os.dup(number))
        except OSError:  # closed by who called
            opened.append(os.open(os.devnull, os.O_RDWR))
    socket.send_fds(server, [head], opened)
    server.sendall(b"".join(sent))
    code = server.recv(1)
os._exit(code[0] if code else 1)
"""


@contextmanager
def forked_program() -> Iterator[Path]:
    """Give a command to call in the place of `INSTALLED`, where the system can do it (Linux), or that one itself."""
    if not hasattr(os, "pidfd_open"):
        yield INSTALLED
        return
    with tempfile.TemporaryDirectory(prefix="clampid") as place:
        folder = Path(place)
        (folder / "caller.py").write_text(CALLER)
        program = folder / "clampid"
        words = [sys.executable, "-IS", str(folder / "caller.py"), str(folder / "socket")]
        program.write_text(f'#!/bin/sh\nexec {shlex.join(words)} "$@"\n')
        program.chmod(0o755)
        paths = os.pathsep.join(filter(None, [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH", "")]))
        single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        with subprocess.Popen(
            [sys.executable, __file__, str(folder / "socket")],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, env={**os.environ, **single, "PYTHONPATH": paths},
        ) as server:  # fmt: skip
            assert server.stdin is not None
            assert server.stdout is not None
            assert server.stdout.readline() == b"ready\n"
            yield program
            server.stdin.close()  # which it listens to: it ends with us, however we end


def serve(address: str) -> list[str]:
    """Take calls until the standard input ends. Returns in each child alone: the arguments of its call."""
    import gc
    import importlib
    import pkgutil
    import socket

    import typer

    from clampid.cli import app

    typer.main.get_command(app())
    packages = [importlib.import_module(name) for name in PACKAGES]
    own = [one.name for p in packages for one in pkgutil.walk_packages(p.__path__, f"{p.__name__}.")]
    for name in (*LATE_IMPORTS, *(name for name in own if not name.startswith(OPTIONAL))):
        importlib.import_module(name)
    gc.freeze()  # no child looks at what was imported, which would copy its pages
    listener = socket.socket(socket.AF_UNIX)
    listener.bind(address)
    listener.listen()
    running: dict[int, tuple[int, socket.socket]] = {}  # by a descriptor that tells of a child's end
    callers: dict[socket.socket, int] = {}
    print("ready", flush=True)
    while True:
        ready, _, _ = select.select([listener, 0, *running, *callers], [], [])
        if 0 in ready:
            os._exit(0)
        for caller in callers.keys() & set(ready):  # it says nothing more: it is gone
            os.kill(callers.pop(caller), signal.SIGKILL)
        for watched in running.keys() & set(ready):
            child, caller = running.pop(watched)
            callers.pop(caller, None)
            code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            with suppress(OSError), caller:
                caller.sendall(bytes([code if code >= 0 else 128 - code]))
            os.close(watched)
        if listener not in ready:
            continue
        caller, _ = listener.accept()
        parts, opened = received(caller)
        child = os.fork()
        if child == 0:
            for one in (listener, caller, *callers):
                one.close()
            return as_called(parts, opened)
        for number in opened:
            os.close(number)
        running[os.pidfd_open(child)] = child, caller
        callers[caller] = child


def received(caller: Any) -> tuple[list[str], list[int]]:
    """Arguments, folder and environment of a call, and its standard streams."""
    import socket

    head, opened, _, _ = socket.recv_fds(caller, 24, 3)
    parts = []
    for k in range(3):
        length, part = int.from_bytes(head[8 * k : 8 * k + 8], "big"), b""
        while len(part) < length:
            part += caller.recv(length - len(part))
        parts.append(os.fsdecode(part))
    return parts, list(opened)


def as_called(parts: list[str], opened: list[int]) -> list[str]:
    """Make this process one that was called so; its arguments."""
    for number, own in enumerate(opened):
        os.dup2(own, number)
        os.close(own)
    arguments, folder, environment = parts
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(pair.split("=", 1) for pair in environment.split("\0"))
    sys.stdin = os.fdopen(0, encoding="utf-8", closefd=False)
    sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
    sys.stderr = os.fdopen(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False, buffering=1)
    return arguments.split("\0") if arguments else []


def end(code: int) -> None:
    """End as an interpreter does, but for taking to pieces what was imported, which takes longer than most calls."""
    threading._shutdown()
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


if __name__ == "__main__":
    sys.argv[1:] = serve(sys.argv[1])
    from clampid.cli import main

    try:
        main()
    except SystemExit as ended:
        end(ended.code if isinstance(ended.code, int) else 1)
