"""``clampid worked-example``: the thesis' example and tables, from a campaign simulated with its printed constants."""

from __future__ import annotations

import shlex
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from clampid.display import quantity
from clampid.verbs.errors import CallError
from clampid.verbs.options import Json, Quiet, Seed, Verbose
from clampid.verbs.output import Output
from experiments.targets import check_folder

if TYPE_CHECKING:
    from clampid.loop.worked_example import WorkedExample
    from clampid.screen import Screen

__all__ = ["worked_example"]


def worked_example(
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep the campaign in this folder.", show_default=False)
    ] = None,
    seed: Seed = 0,
    json: Json = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Repeat the worked example of the thesis on a virtual robot with its printed springs: 183.12 and 183.15 µm."""
    output = Output(quiet, json, verbose)
    if out is not None:
        if out.is_dir() and any(out.iterdir()):
            raise CallError(f"{out}: expected a new or empty folder, found something there")
        check_folder(out)

    from clampid.loop.worked_example import worked_example as work_out
    from clampid.verbs.show import show_drives

    with tempfile.TemporaryDirectory() as scratch:
        result = work_out(out or Path(scratch) / "campaign", seed, working=output.working)
    _show_springs(result, output)
    show_drives(result.drives, output)
    _show_example(result, output)
    output.show(_screen(result, out))
    output.result(result.to_json())


def _screen(result: WorkedExample, kept: Path | None) -> Screen:
    """The springs and the displacement, printed and found."""
    from clampid.screen import Next, Screen
    from clampid.verbs.next_step import free_name

    facts = []
    for j, printed in enumerate(result.printed_spring):
        found, error, _ = quantity(float(result.drives.stiffness[j]), float(result.drives.stiffness_std[j]), "")
        facts.append((f"spring {j + 1}", f"thesis {printed:g}, found {found} ± {error} Nm/rad at the motor"))
    for what, printed, (value, std) in (
        ("spring 5 alone", result.printed_alone, result.alone),
        ("whole matrix", result.printed_full, result.full),
    ):
        facts.append((what, f"thesis {1e6 * printed:.2f}, found {1e6 * value:.2f} ± {1e6 * std:.2f} µm"))
    again = shlex.join(["clampid", "worked-example", "--out", str(free_name(Path("thesis")))])
    look = shlex.join(["clampid", "check", str(kept)])
    return Screen(
        "Simulated a clamped campaign with the thesis' springs, and worked its example out from what was identified.",
        facts=tuple(facts),
        more="Clearances, friction and the compliance matrix: --verbose, --json FILE.",
        next=(Next("Next, keep the campaign:", again) if kept is None else Next("Next, see what it holds:", look),),
    )


def _show_springs(result: WorkedExample, out: Output) -> None:
    rows = []
    for j, printed in enumerate(result.printed_spring):
        found, std, _ = quantity(float(result.drives.stiffness[j]), float(result.drives.stiffness_std[j]), "")
        rows.append((f"{j + 1}", f"{printed:g}", f"{found} ± {std}"))
    out.table("springs at the motor", ("axis", "printed [Nm/rad]", "found [Nm/rad]"), rows)


def _show_example(result: WorkedExample, out: Output) -> None:
    from clampid.loop.worked_example import FRICTION, LEVER

    rows = []
    for what, printed, (value, std) in (
        ("spring 5 alone", result.printed_alone, result.alone),
        ("the whole matrix", result.printed_full, result.full),
    ):
        rows.append((what, f"{1e6 * printed:.2f}", f"{1e6 * value:.2f} ± {1e6 * std:.2f}"))
    title = f"displacement by {FRICTION:g} Nm on the arm's side of axis 5, at {1e3 * LEVER:g} mm"
    out.table(title, ("", "by printed constants [µm]", "found [µm]"), rows)
