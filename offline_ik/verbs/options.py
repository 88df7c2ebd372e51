"""Arguments that ``ik`` and ``serve`` share."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from offline_ik.errors import DetectorError

if TYPE_CHECKING:
    from clampid.verbs.output import Output
    from offline_ik.inverse.detector import Detector

__all__ = ["CellFile", "Robot", "Running", "numbers", "opened", "say_assumed", "seconds"]

CellFile = Annotated[
    Path | None,
    typer.Option("--cell", metavar="CELL.toml", help="Convention, mount, temperatures, obstacles.", show_default=False),
]
Robot = Annotated[
    str | None,
    typer.Option(metavar="NAME|FILE", help="The nominal robot; must be the model's.", show_default=False),
]

Running = Annotated[
    str | None,
    typer.Option(
        "--running",
        metavar="TIME",
        help="For how long the robot has been running, as 90min, 2.5h or 5400s; the cell file's, or 0, without.",
        show_default=False,
    ),
]
_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def seconds(name: str, text: str | None) -> float | None:
    """A time with its unit, s, or None.

    Raises
    ------
    DetectorError
        It is none.
    """
    if text is None:
        return None
    found = re.fullmatch(r"([0-9.eE+-]+) ?(s|min|h)", text.strip())
    try:
        return float(found[1]) * _UNITS[found[2]] if found else float("")
    except ValueError:
        raise DetectorError(f"{name}: expected a time with its unit, as 90min, 2.5h or 5400s, found {text!r}") from None


def numbers(name: str, text: str | None) -> list[float] | None:
    """Numbers separated by commas, as screens print them, too, or None.

    Raises
    ------
    DetectorError
        One of them is no number.
    """
    if text is None:
        return None
    try:
        return [float(part) for part in text.replace("−", "-").split(",")]
    except ValueError:
        raise DetectorError(f"{name}: expected numbers separated by commas, found {text!r}") from None


def opened(
    model: Path, cell: Path | None, robot: str | None, effects_from: Path | None, running: str | None = None
) -> Detector:
    """The model in its cell, the robot running for so long."""
    from offline_ik.inverse.opening import open_detector

    time = seconds("--running", running)
    detector = open_detector(model, cell, robot=robot, user_effects=effects_from)
    return detector if time is None else detector.at_running(time)


def say_assumed(detector: Detector, out: Output) -> None:
    """List what no cell file states, with the assumed values."""
    from offline_ik.inverse.assumed import assumptions

    assumed = assumptions(detector)
    if assumed:
        out.warn("\n  ".join(["assumed, because no cell file states it:", *assumed]))
