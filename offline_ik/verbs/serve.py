"""``clampid serve``: answers detector commands over TCP."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import stat
import sys
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clampid.verbs.options import EffectsFrom, ModelFile, Quiet
from clampid.verbs.output import Output
from offline_ik.errors import DetectorError
from offline_ik.verbs.options import CellFile, Robot, Running, opened, say_assumed

if TYPE_CHECKING:
    from offline_ik.beamline.options import Given
    from offline_ik.exchange.link import LinkedRobot
    from offline_ik.inverse.detector import Detector

__all__ = ["linked_robot", "serve"]

MAX_TOKEN = 256  # characters


def serve(
    model: ModelFile,
    listen: Annotated[str, typer.Option(metavar="HOST:PORT", help="Where to listen; port 0: any.")] = "127.0.0.1:7310",
    link: Annotated[
        str | None,
        typer.Option(
            metavar="SCHEME://HOST:PORT", help="The robot to move; without a scheme eki://.", show_default=False
        ),
    ] = None,
    token_file: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="A file with the token that hello has to bring along.", show_default=False),
    ] = None,
    tango: Annotated[
        str | None,
        typer.Option(metavar="SERVER/INSTANCE", help="Also answer as a Tango device.", show_default=False),
    ] = None,
    tango_listen: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="Where the Tango device listens.")
    ] = "127.0.0.1:7311",
    epics: Annotated[
        str | None, typer.Option(metavar="PREFIX", help="Also answer as EPICS motor records.", show_default=False)
    ] = None,
    epics_listen: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="Where the EPICS server listens.")
    ] = "127.0.0.1:5064",
    radius_unit: Annotated[str, typer.Option(metavar="mm|m|um", help="Unit of the radius for Tango and EPICS.")] = "mm",
    cell: CellFile = None,
    robot: Robot = None,
    running: Running = None,
    effects_from: EffectsFrom = None,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="List what is assumed.", show_default=False)] = False,
    quiet: Quiet = False,
) -> None:
    """Answer detector positions over TCP: one request a line, one JSON answer a line, until interrupted."""
    out = Output(quiet)
    from offline_ik.beamline.options import Given, sides_of
    from offline_ik.exchange.address import is_loopback, parse_address
    from offline_ik.server.protocol import Speaker
    from offline_ik.server.server import serve as serve_forever
    from offline_ik.server.server import take

    try:
        host, port = parse_address(listen)
    except DetectorError as error:
        raise DetectorError(f"--listen: {error}") from None
    given = Given(tango, tango_listen, epics, epics_listen, radius_unit, token_file)
    beside = sides_of(given, link is not None, out)
    token = None if token_file is None else _token(token_file, out)
    taken = take(host, port)  # before the compiling: a port in use is said at once
    with contextlib.ExitStack() as until_ready:
        _end_with_0(until_ready)
        for one in taken:
            until_ready.callback(one.close)
        _refuse_taken(given)
        linked = None if link is None else linked_robot(link, out)
        if linked is not None:
            until_ready.callback(linked.close)
        with out.working("compiling"):
            detector = opened(model, cell, robot, effects_from, running)
            closed = token is None and not is_loopback(host)
            speaker = Speaker(detector, linked, token=token, answers_only=closed)
            detector.warm_up()
            _ = detector.twin  # the server's, warmed up as it is made
        _say_ready(model, detector, linked is not None, verbose, out)
        for note in detector.notes:
            out.warn(note)
        if not is_loopback(host):
            moves = "; nothing moves: there is no --token-file" if token is None else "; the token is sent in clear"
            out.warn(f"anyone who reaches {host} can ask{moves}")
        until_ready.pop_all()
    ended = serve_forever(speaker, host, port, out.say, taken, beside, out.warn)
    if linked is not None:
        linked.close()
    if not ended:
        # The interpreter would wait for the computation to end. Nothing is written here that could be lost.
        sys.stdout.flush()
        os._exit(0)


def _say_ready(model: Path, detector: Detector, linked: bool, verbose: bool, out: Output) -> None:
    """What answers, whether it moves a robot, and how much of its cell is assumed; stdout is left to the addresses."""
    from offline_ik.inverse.assumed import assumed_in_words, assumptions

    out.step(f"{model} answers for {detector.robot.name}{'' if linked else '; nothing moves: there is no --link'}.")
    out.step("Requests are lines in rad and m, such as: where gamma=0.3 delta=0.2 r=0.8")
    if verbose:
        say_assumed(detector, out)
    elif assumed := assumptions(detector):
        out.warn(f"{assumed_in_words(assumed)} --verbose lists them.")


def _refuse_taken(given: Given) -> None:
    """Refuse addresses of sides that cannot be listened on, which their processes would find after the compiling.

    Raises
    ------
    DetectorError
        One is in use, by one of the other sides, say; not of this machine, or not permitted.
    """
    from offline_ik.beamline.options import listens_on
    from offline_ik.server.server import take

    asked = [("--tango-listen", given.tango_listen)] * (given.tango is not None)
    asked += [("--epics-listen", given.epics_listen)] * (given.epics is not None)
    with contextlib.ExitStack() as opened:
        for option, text in asked:
            try:
                for one in take(*listens_on(option, text)):
                    opened.callback(one.close)
            except DetectorError as error:
                raise DetectorError(f"{option}: {error}") from None


def _end_with_0(until_ready: contextlib.ExitStack) -> None:
    """SIGTERM while the server is made ready ends it with exit code 0; later its loop handles signals."""
    if threading.current_thread() is not threading.main_thread():  # signals are not this thread's
        return

    def end(*_: object) -> None:
        raise SystemExit(0)

    until_ready.callback(signal.signal, signal.SIGTERM, signal.signal(signal.SIGTERM, end))


def _token(path: Path, out: Output) -> str:
    """The token in a file, stripped of blanks."""
    try:
        with open(
            os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)), "rb"
        ) as file:  # a pipe keeps nobody waiting
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise DetectorError(f"--token-file {path}: expected a regular file")
            text = file.read(MAX_TOKEN + 3).decode("ascii").strip()
            readable = os.fstat(file.fileno()).st_mode & (stat.S_IRGRP | stat.S_IROTH)
    except OSError as error:
        raise DetectorError(f"--token-file {path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        text = ""
    if len(text) > MAX_TOKEN or not re.fullmatch(r"[!-~]+", text):
        raise DetectorError(
            f"--token-file {path}: expected 1 to {MAX_TOKEN} printable ASCII characters without blanks, found others"
        )
    if readable and os.name == "posix":
        out.warn(f"--token-file {path}: other users of this machine can read the token (chmod 600 {path})")
    return text


def linked_robot(address: str, out: Output) -> LinkedRobot:
    """The robot. If it still moves for a server or client that is gone, it is stopped: nobody else can."""
    from experiments.links.address import open_link
    from experiments.links.protocol import LinkError
    from offline_ik.exchange.link import LinkedRobot

    try:
        robot = LinkedRobot(open_link(address), address)
    except LinkError as error:
        raise DetectorError(f"--link {address}: {error}") from None
    question = robot.link.open_question()
    if question is not None and robot.link.capabilities.stops:
        try:
            robot.stop()
        except DetectorError as error:
            out.warn(f"--link {address}: {question}; it could not be stopped: {error}")
        else:
            out.warn(f"--link {address}: {question}; it was stopped. Look at the robot, then send confirm")
    return robot
