"""Arguments that ``ik`` and ``serve`` share."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from offline_ik.errors import DetectorError

if TYPE_CHECKING:
    from offline_ik.detector import Detector

__all__ = ["CellFile", "Robot", "numbers", "opened"]

CellFile = Annotated[
    Path | None,
    typer.Option("--cell", metavar="CELL.toml", help="Convention, mount, temperatures, obstacles.", show_default=False),
]
Robot = Annotated[
    str | None,
    typer.Option(metavar="NAME|FILE", help="The nominal robot; must be the model's.", show_default=False),
]


def numbers(name: str, text: str | None) -> list[float] | None:
    """Numbers separated by commas, or None.

    Raises
    ------
    DetectorError
        One of them is no number.
    """
    if text is None:
        return None
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise DetectorError(f"{name}: expected numbers separated by commas, found {text!r}") from None


def opened(model: Path, cell: Path | None, robot: str | None, effects_from: Path | None) -> Detector:
    """The model in its cell."""
    from offline_ik.detector import open_detector

    return open_detector(model, cell, robot=robot, user_effects=effects_from)
