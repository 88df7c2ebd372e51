"""Assumptions of an answer: defaults for what a cell does not state, and inputs that the model does not use."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from offline_ik.arm.identified import IdentifiedArm
from offline_ik.cell.cell import Cell

if TYPE_CHECKING:
    from offline_ik.inverse.detector import Detector

__all__ = ["assumed_in_words", "assumptions", "moves_by", "notes_of", "time_effects"]

Array = npt.NDArray[np.float64]

SHIFT_SECONDS = 8 * 3600.0  # s
_FIRST_NAMED = ("sample", "tool at the flange")  # what moves a detector position most


def assumptions(detector: Detector) -> tuple[str, ...]:
    """What a cell does not state, each with the value that is assumed."""
    cell, convention = detector.cell, detector.cell.convention
    base, radii = cell.world.radii(detector.robot)
    values = {
        "convention": convention.name,
        "sample": f"{_listed(convention.sample, 6)} m",
        "beam": _listed(convention.beam),
        "tool as heavy as the campaign says": f"{detector.arm.tool[0]:g} kg",
        "gravity": f"{_listed(cell.gravity)} m/s2",
        "link radii from the arm's reach": f"{_listed(radii)} m",
        "base radius from the arm's reach": f"{base:.3g} m",
    }
    return tuple(f"{what}: {values[what]}" if what in values else what for what in cell.assumed)


def assumed_in_words(assumed: Sequence[str]) -> str:
    """How many quantities are assumed, in one sentence; those that matter most are named.

    Parameters
    ----------
    assumed
        Of :func:`assumptions`; not empty.
    """
    named = [name for name in _FIRST_NAMED if any(text.partition(":")[0] == name for text in assumed)]
    such = f", such as {' and '.join(name.partition(' ')[0] for name in named)}," if named else ""
    if len(assumed) == 1:
        return f"1 quantity is assumed{such} because no cell file states it."
    return f"{len(assumed)} quantities are assumed{such} because no cell file states them."


def _listed(values: Iterable[float], digits: int = 3) -> str:
    return ", ".join(f"{value:.{digits}g}" for value in values)


def notes_of(arm: IdentifiedArm, cell: Cell) -> tuple[str, ...]:
    """Notes on inputs that the model does not use, and on a running time that it needs and the cell does not state."""
    read = {signal for slot in arm.slots for signal in arm.effects[slot.effect].needs}
    given = {"link": cell.link_temperature, "motor": cell.motor_temperature}
    said = [
        f"the {name} temperatures are not used: no effect of this model depends on them"
        for name, values in given.items()
        if values is not None and f"{name}_temperature" not in read
    ]
    timed = time_effects(arm)
    if cell.running is not None and not timed:
        said.append("the running time is not used: no effect of this model depends on it")
    if cell.running is None and timed:
        said.append(
            f"no running time is stated: 0 s is assumed, as at a campaign's first row. It matters for "
            f"{', '.join(timed)}"
        )
    return tuple(said)


def time_effects(arm: IdentifiedArm) -> tuple[str, ...]:
    """The model's effects that depend on the time for which the robot has been running."""
    return tuple(dict.fromkeys(s.effect for s in arm.slots if "elapsed" in arm.effects[s.effect].needs))


def moves_by(detector: Detector, q: Array) -> float:
    """How far the detector moves at a posture ``(n,)`` within :data:`SHIFT_SECONDS` from now on, m."""
    later = replace(detector.still, elapsed=detector.still.elapsed + SHIFT_SECONDS)
    return float(np.linalg.norm((detector.pose(q[None], later) - detector.pose(q[None]))[0, :3, 3]))
