"""``clampid report``: the report of a model from what was computed already."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from clampid.verbs.errors import CallError, is_wrong_input
from clampid.verbs.inputs import read_checked
from clampid.verbs.options import EffectsFrom, ModelFile, Quiet, Seed
from clampid.verbs.output import Output, output_file

__all__ = ["report"]

COMPARING_SHARE = 0.3  # of the time that a report takes


def report(
    model: ModelFile,
    campaign: Annotated[
        Path | None,
        typer.Argument(
            metavar="[CAMPAIGN]", help="A campaign folder.", show_default="the model's first, here or beside the model"
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE.html", help="File to write.", show_default="MODEL.html"),
    ] = None,
    seed: Seed = 0,
    effects_from: EffectsFrom = None,
    quiet: Quiet = False,
) -> None:
    """Write the report of a model and a campaign, with the diagnosis that ``diagnose`` or ``auto`` kept."""
    out = Output(quiet)
    target = output_file(model.with_suffix(".html") if output is None else output, "HTML")

    from clampid.comparison.compare import compare
    from clampid.loop.kept_diagnosis import kept_diagnosis, kept_file
    from clampid.models.model import load_model
    from clampid.progress import substep
    from clampid.report import write_report
    from clampid.screen import Next, Screen
    from clampid.verbs.next_step import free_name
    from clampid.verbs.screens import typed

    loaded = load_model(model)
    folder = _campaign_of(model, [s.name for s in loaded.sessions]) if campaign is None else campaign
    with out.working("reading"):
        (read,) = read_checked([folder], out)
    found = kept_diagnosis(model, read)
    with out.working("writing the report"):
        with substep("comparing", COMPARING_SHARE):
            compared = compare(loaded, read, seed=seed, user_effects=effects_from).to_json()
        try:
            write_report(target, loaded, read, comparison=compared, diagnosis=found, user_effects=effects_from)
        except (ArithmeticError, LookupError, TypeError, AttributeError, ValueError) as error:
            if found is None or is_wrong_input(error):
                raise
            raise CallError(  # it is a file like any other, and comes along with a model from somebody else
                f"{kept_file(model)}: expected a diagnosis as clampid diagnose keeps it, found another form "
                f"({type(error).__name__}: {error}); diagnose again"
            ) from error
    if found is not None:
        done = f"Wrote {target}, with the kept diagnosis of {model} on {folder}."
        table = shlex.join(["clampid", "export", "dh", str(model), "-o", str(free_name(Path("dh.csv")))])
        out.show(Screen(done, next=(Next("Next, export the corrected robot as a DH table:", table),)))
        return
    ask = typed("diagnose", model, folder, effects_from=effects_from)
    again = typed("report", model, folder, "-o", target, effects_from=effects_from)
    out.show(
        Screen(
            f"Wrote {target}, without a diagnosis: none of {model} on {folder} was computed yet.",
            next=(Next("Next, diagnose:", ask), Next("Then write the report again:", again)),
        )
    )


def _campaign_of(model: Path, names: list[str]) -> Path:
    """The folder of a model's first campaign: one of its name, here or beside the model."""
    for name in names[:1]:
        for folder in (Path(name), model.parent / name):
            if (folder / "campaign.toml").is_file():
                return folder
    raise CallError(f"expected CAMPAIGN: no folder {' or '.join(names[:1])} lies here or beside {model}")
