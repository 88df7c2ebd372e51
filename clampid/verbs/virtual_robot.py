"""``clampid virtual-robot``: a robot controller on sockets, with a virtual robot behind it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from clampid.verbs.errors import CallError
from clampid.verbs.options import Quiet, Seed
from clampid.verbs.output import Output

__all__ = ["virtual_robot"]

MAX_CONFIG = 1_000_000  # bytes of a config file; those that link-files writes have a few thousand


def virtual_robot(
    robot: Annotated[str, typer.Option(help="A bundled robot, or the path of a description.")] = "kuka_kr20_r1810",
    hide: Annotated[
        list[str] | None,
        typer.Option(
            metavar="EFFECT[@jointN][:MAGNITUDE],…",
            help="Effects to hide, with their places and sizes.",
            show_default=False,
        ),
    ] = None,
    seed: Seed = 0,
    session: Annotated[
        int, typer.Option(min=1, metavar="N", help="The robot of this seed on another day, measured from elsewhere.")
    ] = 1,
    listen: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="Motion on PORT, state on PORT + 1; port 0: two free ones.")
    ] = "127.0.0.1:54600",
    speed: Annotated[float, typer.Option(help="Simulated seconds in a second, up to 1000.")] = 1.0,
    faults: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE,…", help="What goes wrong: see the how-to page.", show_default=False),
    ] = None,
    tracker: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="An instrument that measures.", show_default=False)
    ] = None,
    operator: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="The person at the controller.", show_default=False)
    ] = None,
    varproxy: Annotated[str | None, typer.Option(metavar="HOST:PORT", help="KUKAVARPROXY.", show_default=False)] = None,
    files: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Config files to interpret, as link-files wrote them.", show_default=False),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(metavar="FILE.json", help="Where to write what is hidden and what moved.", show_default=False),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Play a robot's controller on sockets, with hidden errors, until interrupted."""
    from experiments.links.eki_config import config_text
    from experiments.links.schema import MOTION, STATE
    from experiments.targets import check_output
    from experiments.virtual_controller.errors import ControllerError
    from experiments.virtual_controller.running import Asked, play
    from kinematics.description import load_robot

    if truth is not None:
        check_output(truth, "JSON")
    texts = tuple(
        (f"{channel.name}.xml", config_text(channel) if files is None else _text(files / f"{channel.name}.xml"))
        for channel in (MOTION, STATE)
    )
    asked = Asked(
        robot=load_robot(robot),
        configs=texts,
        hide=tuple(part.strip() for text in hide or () for part in text.split(",") if part.strip()),
        seed=seed,
        session=session,
        speed=speed,
        listen=listen,
        besides={"tracker": tracker, "operator": operator, "varproxy": varproxy},
        faults=tuple(faults or ()),
        truth=truth,
    )
    out = Output(quiet)
    try:
        play(asked, out.say)
    except ControllerError as error:
        raise CallError(str(error)) from error


def _text(file: Path) -> str:
    from kinematics.reading import read_text

    try:
        return read_text(file, MAX_CONFIG)
    except (OSError, UnicodeDecodeError) as error:
        raise CallError(f"{file}: expected a config file that clampid link-files wrote: {error}") from None
