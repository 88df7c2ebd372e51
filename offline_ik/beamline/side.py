"""The common part of the Tango and EPICS sides: separate processes that are clients of ``clampid serve``.

Neither Tango nor EPICS brings a secret along. Such a side listens on the loopback, where it has the server's token at
hand. One that a network reaches is locked: it answers, and moves nothing before somebody has given it the token.
"""

from __future__ import annotations

import argparse
import os
import sys
import threading
from dataclasses import replace
from pathlib import Path

from offline_ik.beamline.line_client import Line, RefusedError, Server
from offline_ik.errors import DetectorError

__all__ = ["LENGTHS", "add_arguments", "follow_parent", "lock_of", "server_of", "token_of"]

LENGTHS = {"mm": 1e-3, "m": 1.0, "um": 1e-6}
"""Units of the radius, m."""

MAX_TOKEN = 256  # characters
LOCKED = "locked: a network reaches this side; unlock it with the token of --token-file"
CLOSED = "locked: a network reaches this side, and the server has no --token-file; it only answers"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What every side is told."""
    parser.add_argument("--server", required=True, help="HOST:PORT of the line protocol")
    parser.add_argument("--token-file", type=Path)
    parser.add_argument("--lock", choices=("no", "token", "closed"), default="no")


def server_of(given: argparse.Namespace, name: str) -> tuple[Server, str]:
    """The server, and why nothing may be moved there (empty: it may)."""
    host, _, port = given.server.rpartition(":")
    token = None if given.token_file is None else token_of(given.token_file)
    server = Server(host.strip("[]"), int(port), name, token, greets=given.lock == "no")
    return server, {"no": "", "token": LOCKED, "closed": CLOSED}[given.lock]


def lock_of(server: Server, locked: str, token: str) -> tuple[Server, str]:
    """The server with a token that it accepts, and no lock any more.

    Raises
    ------
    RefusedError
        The server does not know the token, or knows none.
    LostError
        It cannot be reached.
    """
    if locked == CLOSED:
        raise RefusedError(CLOSED)
    if not locked:
        return server, locked
    opened = replace(server, token=token, greets=True)
    line = Line(opened)
    try:
        line.ask("help")
    finally:
        line.close()
    return opened, ""


def token_of(path: Path) -> str:
    """What stands in a file, blanks at its ends aside.

    Raises
    ------
    DetectorError
        It cannot be read.
    """
    try:
        return path.read_text(encoding="ascii")[: MAX_TOKEN + 3].strip()
    except (OSError, UnicodeDecodeError) as error:
        raise DetectorError(f"--token-file {path}: cannot be read: {error}") from None


def follow_parent() -> None:
    """End when the server has ended that started this process: then nobody writes to its input any more."""

    def watch() -> None:
        sys.stdin.buffer.read()
        os._exit(0)

    threading.Thread(target=watch, name="parent", daemon=True).start()
