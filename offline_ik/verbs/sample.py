"""``clampid sample``: the scattering point from reflections found at known detector positions."""

from __future__ import annotations

import math
import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clampid.screen import Next, Screen
from clampid.verbs.options import EffectsFrom, Json, ModelFile, Quiet, Verbose
from clampid.verbs.output import Output
from clampid.verbs.units import Degrees, Millimetres, Units
from offline_ik.verbs.options import CellFile, Robot, Running, numbers, opened, say_assumed

if TYPE_CHECKING:
    from offline_ik.reflections.peaks import SampleFound

__all__ = ["sample"]


def sample(
    model: ModelFile,
    peaks: Annotated[
        Path, typer.Argument(metavar="PEAKS.csv", help="The reflections found, one a row.", show_default=False)
    ],
    cell: CellFile = None,
    robot: Robot = None,
    running: Running = None,
    energy: Annotated[
        float | None, typer.Option(metavar="KEV", help="Photon energy, if the table has spacings.")
    ] = None,
    wavelength: Annotated[float | None, typer.Option(metavar="ANGSTROM", help="Or the wavelength.")] = None,
    near: Annotated[
        str | None,
        typer.Option(
            metavar="Q1,Q2,…", help="The posture before the first row, where rows are gamma, delta, r.",
            show_default=False,
        ),
    ] = None,
    repeatability: Annotated[
        float, typer.Option(metavar="M", help="The robot's repeatability, a standard deviation in each direction.")
    ] = 0.0,
    deg: Degrees = False,
    mm: Millimetres = False,
    effects_from: EffectsFrom = None,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:  # fmt: skip
    """Find the scattering point from Bragg reflections found on the detector, with its standard errors."""
    out = Output(quiet, json, verbose, copied=True)
    os.environ.setdefault("CLAMPID_COMPILER", "none")  # a few postures come sooner than a compiled kernel
    from offline_ik.errors import TargetError
    from offline_ik.reflections.peak_table import read_peaks, wavelength_of
    from offline_ik.reflections.peaks import sample_from_peaks

    units = Units(deg, mm)
    of_photons, given = wavelength_of(energy, wavelength), numbers("--near", near)
    before = None if given is None else [units.radians(angle) for angle in given]
    detector = opened(model, cell, robot, effects_from, running)
    found = read_peaks(peaks, detector.arm.n, detector.cell.pixel, of_photons)
    with out.working("solving"):
        try:
            result = sample_from_peaks(detector, found, near=before, repeatability=units.metres(repeatability))
        except TargetError as error:
            raise TargetError(f"{peaks}: {error}") from None
    say_assumed(detector, out)
    for note in result.notes:
        out.warn(f"note: {note}")
    _show(result, units, model, cell, out)
    out.result(result.to_json())


def _show(result: SampleFound, units: Units, model: Path, cell: Path | None, out: Output) -> None:
    from offline_ik.reflections.peak_wording import LAB

    position, convention = result.position, result.convention
    shown = zip(
        result.names, position.residuals.tolist(), position.stated.tolist(), position.checks.tolist(), strict=True
    )
    out.table(
        "", ("reflection", "residual / µrad", "stated error / µrad", "off from the others / σ"),
        [(name, f"{1e6 * left:.1f}", f"{1e6 * std:.1f}", "–" if math.isnan(off) else f"{off:.1f}")
         for name, left, std, off in shown],
    )  # fmt: skip
    shift = [value - given for value, given in zip(position.sample.tolist(), convention["sample_m"], strict=True)]
    facts = []
    for axis, at, moved, std in zip("xyz", position.sample.tolist(), shift, position.std.tolist(), strict=True):
        place = f"{1e3 * at:.4f} mm" if units.millimetres else f"{at:.7f} m"
        facts.append((axis, f"{place}; {1e3 * moved:+.4f} ± {1e3 * std:.4f} mm from the cell's"))
    facts += [
        (axis, f"{1e3 * moved:+.4f} ± {1e3 * std:.4f} mm from the cell's")
        for axis, moved, std in zip(LAB, result.shift.tolist(), result.std.tolist(), strict=True)
    ]
    facts += [("cell file" if k == 0 else "", line) for k, line in enumerate(result.cell_lines)]
    agree = bool(position.fits and position.freedom)
    first, *further = result.agreement  # the further ones may begin with the name of a reflection
    words = ["clampid", "ik", str(model), "--gamma", "0.3", "--delta", "0.2", "--r", "0.8"]
    point = shlex.join([*words, *([] if cell is None else ["--cell", str(cell)])])
    out.show(
        Screen(
            f"Found the scattering point from {len(result.points)} reflections, in the frame {convention['frame']}.",
            facts=tuple(facts),
            verdict=f"{first[0].upper()}{first[1:]}.",
            tone="good" if agree else "open",
            notes=tuple(f"{text}." for text in further),
            more="Each reflection: --verbose, --json FILE.",
            next=(Next("Next, put the lines above into the cell file, then point the detector:", point),),
        )
    )
