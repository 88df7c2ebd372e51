"""Further results of ``ik``: a picture of the move, what a pixel sees, a file for pyFAI."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from clampid.display import readable
from clampid.verbs.output import output_file
from offline_ik.errors import DetectorError
from offline_ik.verbs.options import numbers

if TYPE_CHECKING:
    from clampid.verbs.units import Units
    from offline_ik.inverse.detector import Detector
    from offline_ik.motion.simulation import Simulation

__all__ = ["Picture", "Pixel", "Pixels", "Poni", "Preview", "check_previews", "previewed"]

Picture = Annotated[
    Path | None,
    typer.Option(metavar="FILE.svg", help="Draw the move from --near, or the place.", show_default=False),
]
Poni = Annotated[
    Path | None, typer.Option(metavar="FILE.poni", help="Write the geometry for pyFAI.", show_default=False)
]
Pixel = Annotated[
    str | None,
    typer.Option(metavar="I,J", help="Say which gamma and delta a pixel (row, column) sees.", show_default=False),
]
Pixels = Annotated[
    str | None,
    typer.Option(metavar="ROWS,COLUMNS", help="The detector's pixels; without it, the cell's.", show_default=False),
]


class Preview(NamedTuple):
    """What was asked for."""

    picture: Path | None
    poni: Path | None
    pixel: str | None
    pixels: str | None


def check_previews(picture: Path | None, poni: Path | None) -> None:
    """Check that the files can be written, before the work.

    Raises
    ------
    OutputError
        One cannot.
    """
    if picture is not None:
        output_file(picture, "a picture (SVG)")
    if poni is not None:
        output_file(poni, "a geometry for pyFAI")


def previewed(
    detector: Detector, simulation: Simulation, preview: Preview, units: Units
) -> tuple[list[str], dict[str, Any]]:
    """Write the files, and say what was found: lines for people, members for programs.

    Raises
    ------
    DetectorError
        A pixel is none, nobody says how many there are, or the position cannot be reached.
    """
    from experiments.outputs import write_text
    from offline_ik.reflections.seen import check_pixels, pixel_of, poni_text

    said: list[str] = []
    data: dict[str, Any] = {}
    if preview.poni is None and preview.pixel is None:
        _draw(preview, simulation, said)
        return said, data
    answer, given = simulation.ways.answer, numbers("--pixels", preview.pixels)
    try:
        pixels = check_pixels(detector.cell.pixels if given is None else given)
    except DetectorError as error:
        raise DetectorError(
            str(error).replace("pixels=ROWS", "--pixels ROWS").replace("pixels:", "--pixels:")
        ) from None
    at = numbers("--pixel", preview.pixel)
    if at is not None and len(at) != 2:
        raise DetectorError(f"--pixel: expected I,J, found {preview.pixel!r}")
    if at is not None and answer.reachable:
        covariance = answer.solutions[0].uncertainty.covariance
        seen = pixel_of(detector, answer.target, covariance, (at[0], at[1]), pixels)
        data["pixel"] = {"pixel": at, "pixels": list(pixels), **seen.to_json()}
        said.append(
            f"Pixel ({at[0]:g}, {at[1]:g}) sees gamma {units.angle(seen.gamma)} ± "
            f"{readable(seen.spread.gamma, 'microrad')}, delta {units.angle(seen.delta)} ± "
            f"{readable(seen.spread.delta, 'microrad')}, 2θ {units.angle(seen.two_theta)} ± "
            f"{readable(seen.two_theta_std, 'microrad')}."
        )
    if preview.poni is not None and answer.reachable:
        write_text(preview.poni, poni_text(detector.cell.convention, answer.target, detector.cell.pixel, pixels))
        said.append(f"For pyFAI: {preview.poni}.")
    _draw(preview, simulation, said)
    return said, data


def _draw(preview: Preview, simulation: Simulation, said: list[str]) -> None:
    from experiments.outputs import write_text
    from offline_ik.motion.picture import picture_of

    if preview.picture is not None:
        write_text(preview.picture, picture_of(simulation))
        said.append(f"Picture: {preview.picture}.")
