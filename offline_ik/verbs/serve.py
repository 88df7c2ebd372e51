"""``clampid serve``: answers detector commands over TCP."""

from __future__ import annotations

import os
import sys
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Annotated, cast

import typer

from clampid.verbs.options import EffectsFrom, ModelFile, Quiet
from clampid.verbs.output import Output
from offline_ik.errors import DetectorError
from offline_ik.verbs.options import CellFile, Robot, Running, opened, say_assumed

if TYPE_CHECKING:
    from offline_ik.link import RobotLink

__all__ = ["LINKS", "serve"]

LINKS = "clampid.robot_links"
"""Entry points that make a :class:`offline_ik.link.RobotLink` from HOST and PORT: ``connect(host, port)``."""


def serve(
    model: ModelFile,
    listen: Annotated[str, typer.Option(metavar="HOST:PORT", help="Where to listen; port 0: any.")] = "127.0.0.1:7310",
    link: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="The robot to move.", show_default=False)
    ] = None,
    cell: CellFile = None,
    robot: Robot = None,
    running: Running = None,
    effects_from: EffectsFrom = None,
    quiet: Quiet = False,
) -> None:
    """Answer where detector positions lie, one request a line, one JSON answer a line, until interrupted."""
    out = Output(quiet)
    from offline_ik.protocol import Speaker
    from offline_ik.server import is_loopback, parse_address, take
    from offline_ik.server import serve as serve_forever

    host, port = parse_address(listen)
    taken = take(host, port)  # before the compiling: a port in use is said at once
    linked = None if link is None else _linked(link)
    with out.working("compiling"):
        detector = opened(model, cell, robot, effects_from, running)
        speaker = Speaker(detector, linked)
        detector.warm_up()
        _ = detector.twin  # the server's, warmed up as it is made
    say_assumed(detector, out)
    for note in detector.notes:
        out.warn(note)
    if not is_loopback(host):
        out.warn(f"anyone who reaches {host} can ask, and move a linked robot: there is no password")
    if not serve_forever(speaker, host, port, out.say, taken):
        # The interpreter would wait for the computation to end. Nothing is written here that could be lost.
        sys.stdout.flush()
        os._exit(0)


def _linked(address: str) -> RobotLink:
    from offline_ik.server import parse_address

    host, port = parse_address(address)
    found = list(entry_points(group=LINKS))
    if not found:
        raise DetectorError(f"--link {address}: no robot link is installed (entry points {LINKS})")
    return cast("RobotLink", found[0].load()(host, port))
