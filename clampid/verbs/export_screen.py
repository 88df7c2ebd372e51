"""The screen of ``clampid export``: what was written, and what it leaves on its own of the whole model."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from clampid.display import error_text
from clampid.screen import Next, Screen
from clampid.verbs.next_step import free_name

if TYPE_CHECKING:
    import pandas as pd

    from clampid.exports.exported import Exported
    from clampid.exports.form_error import FormError, LeftOut, Measured
    from clampid.exports.kuka_export import KukaExport

__all__ = ["angles_screen", "dynamics_screen", "export_screen", "kuka_screen", "use_next"]

EXACT = 1e-9  # m: below it an export leaves nothing but rounding
SMALLEST_EFFECT_NAMED = 5e-6  # m: effects that are worth less are not named; the file and --json have them


def export_screen(kind: str, found: Exported, output: Path, next_steps: tuple[Next, ...] = ()) -> Screen:
    """What an export wrote, and the error of a controller that knows nothing else.

    Parameters
    ----------
    kind
        What the file is, such as ``DH table``.
    """
    fit = getattr(found, "fit", None)
    facts = []
    if fit is not None:
        own = error_text(fit.static.position_rms, "m")
        facts.append(("poses", f"{error_text(fit.best.position_rms, 'm')} rms where the model was measured "
                               f"({own} with the model's own geometry)"))  # fmt: skip
    facts += _left(found.left, found.measured)
    return Screen(
        f"Wrote {output}: the {kind} at {found.temperature:g} °C, without what changes with load or time.",
        facts=tuple(facts),
        verdict=_alone(kind, found.left.error, found.measured),
        notes=tuple(f"{note[0].upper()}{note[1:]}." for note in found.cautions),
        more=f"Read back within {_rounding(found.difference)}. Conditions and more digits: --json FILE.",
        next=next_steps,
    )


def _rounding(difference: float) -> str:
    """How far apart positions are that were read back, at least 1 nm: what is less is rounding."""
    return error_text(difference, "m") if difference > EXACT else "1 nm"


def kuka_screen(found: KukaExport, temperature: float, output: Path, next_steps: tuple[Next, ...] = ()) -> Screen:
    """How much of the geometry machine data can hold, and the error of a controller that knows only them."""
    form, nominal = (error_text(error.position_rms, "m") for error in (found.left, found.nominal))
    unattained = f"{form} rms that this form cannot hold; nominal machine data leave {nominal}"
    return Screen(
        f"Wrote {output}: KUKA machine data at {temperature:g} °C, without what changes with load or time.",
        facts=(("axes", unattained), *_left(found.whole, found.on_points)),
        verdict=_alone("file", found.whole.error, found.on_points),
        more="Conditions and more digits are in the file. It was not tried on a controller.",
        next=next_steps,
    )


def angles_screen(table: pd.DataFrame, output: Path, next_steps: tuple[Next, ...] = ()) -> Screen:
    """How large the errors of each joint's angle are over its range."""
    facts = []
    for joint, part in table.groupby("joint"):
        size, std = error_text(float(part["error_rad"].abs().max()), "rad"), part["std_error_rad"].max()
        far = float(part["extrapolated"].mean())
        beyond = f"; {far:.0%} of the range has no pose nearby" if far else ""
        facts.append((f"joint {joint}", f"at most {size}, standard error at most {error_text(std, 'rad')}{beyond}"))
    return Screen(
        f"Wrote {output}: errors of joint angles, arm less controller, with standard errors.",
        facts=tuple(facts),
        notes=("Add these errors to the angles before a DH table is used.",),
        next=next_steps,
    )


def dynamics_screen(lines: Sequence[str], count: int, output: Path, model: Path) -> Screen:
    """How many base parameters were written, and what a consistent arm is and costs."""
    command = ["clampid", "export", "dynamics", str(model), "--consistent", "-o", str(free_name(output))]
    bodies = Next("Next, find masses and inertias that bodies can have:", shlex.join(command))
    history = Next("Next, see how well each stage of the model fits:", shlex.join(["clampid", "history", str(model)]))
    return Screen(
        f"Wrote {output}: {count} base parameters with standard errors.",
        notes=tuple(lines),
        next=(history if lines else bodies,),
    )


def use_next(model: Path) -> tuple[Next, ...]:
    """The command that uses the whole model, not an export of a part."""
    command = shlex.join(["clampid", "ik", str(model), "--gamma", "0.3", "--delta", "0.2", "--r", "0.8"])
    return (Next("Next, get joint angles from the whole model:", command),)


def _left(left: LeftOut, measured: Measured | None) -> list[tuple[str, str]]:
    """The error with this file alone, over the workspace and on measured points, and the effects that it lacks."""
    error = left.error
    over = (
        f"{error_text(error.position_rms, 'm')} rms, {error_text(error.position_max, 'm')} at most; "
        f"{error_text(error.orientation_rms, 'rad')} rms"
    )
    if error.position_max < EXACT:
        over = "nothing beyond rounding"
    facts = [("workspace", over)]
    if measured is not None:
        m = measured
        facts.append(("measured", f"{error_text(m.mean, 'm')} mean, {error_text(m.largest, 'm')} at most, of {m.rows} "
                                  f"points ({m.table})"))  # fmt: skip
    worth = sorted(left.effects.items(), key=lambda item: -item[1])
    named = [f"{name.replace('_', ' ')} {error_text(rms, 'm')}" for name, rms in worth if rms >= SMALLEST_EFFECT_NAMED]
    return [*facts, ("not in it", ", ".join(named) or "nothing of this model")]


def _alone(kind: str, error: FormError, measured: Measured | None) -> str:
    """One sentence: the error of a controller that knows only this file."""
    if measured is None and error.position_max < EXACT:
        return f"The {kind} holds the whole model: nothing in it depends on posture, load or time."
    if measured is None:
        rms = error_text(error.position_rms, "m")
        return f"A controller that knows only this {kind} errs by {rms} (rms) over the workspace."
    return f"A controller that knows only this {kind} misses the measured points by {error_text(measured.mean, 'm')}."
