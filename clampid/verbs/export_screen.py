"""The screen of ``clampid export``: what was written, and what it leaves on its own of the whole model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from clampid.display import error_text
from clampid.screen import Next, Screen

if TYPE_CHECKING:
    from clampid.exports.exported import Exported

__all__ = ["export_screen"]

SEEN = 5e-6  # m: effects that are worth less are not named; the file and --json have them


def export_screen(kind: str, found: Exported, output: Path, next_steps: tuple[Next, ...] = ()) -> Screen:
    """What an export wrote, and what a controller that knows nothing else would err.

    Parameters
    ----------
    kind
        What the file is, such as ``DH table``.
    """
    error, fit = found.left.error, getattr(found, "fit", None)
    facts = []
    if fit is not None:
        own = error_text(fit.static.position_rms, "m")
        facts.append(("poses", f"{error_text(fit.best.position_rms, 'm')} rms where the model was measured "
                               f"({own} with the model's own geometry)"))  # fmt: skip
    facts.append(
        (
            "workspace",
            f"{error_text(error.position_rms, 'm')} rms, {error_text(error.position_max, 'm')} at most; "
            f"{error_text(error.orientation_rms, 'rad')} rms",
        )
    )
    if found.measured is not None:
        m = found.measured
        facts.append(("measured", f"{error_text(m.mean, 'm')} mean, {error_text(m.largest, 'm')} at most, of {m.rows} "
                                  f"points ({m.table})"))  # fmt: skip
    worth = sorted(found.left.effects.items(), key=lambda item: -item[1])
    named = [f"{name.replace('_', ' ')} {error_text(rms, 'm')}" for name, rms in worth if rms >= SEEN]
    facts.append(("not in it", ", ".join(named) or "nothing of this model"))
    on_its_own = error.position_rms if found.measured is None else found.measured.mean
    of = "the whole model over the workspace" if found.measured is None else "the measured points"
    return Screen(
        f"Wrote {output}: the {kind} at {found.temperature:g} °C, without what changes with load or time.",
        facts=tuple(facts),
        verdict=f"On its own the {kind} leaves {error_text(on_its_own, 'm')} of {of}.",
        notes=tuple(f"{note[0].upper()}{note[1:]}." for note in found.cautions),
        more=f"Read back within {found.difference:.1e} m. Conditions and more digits: --json FILE.",
        next=next_steps,
    )
