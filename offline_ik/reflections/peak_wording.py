"""The words on a scattering point: whether its reflections agree, and which directions they do not determine."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from clampid.display import with_error
from offline_ik.reflections.bragg import FALSE_ALARM, SamplePosition

__all__ = ["LAB", "agreement", "undetermined_directions"]

LAB = ("across", "up", "along the beam")
"""The laboratory's axes, as the columns of :attr:`offline_ik.cell.coordinates.Convention.lab`."""

_ALIGNED = math.cos(math.radians(10.0))


def agreement(position: SamplePosition, names: Sequence[str]) -> tuple[str, ...]:
    """Whether the reflections, by their names, agree within their stated errors; if not, which one does not."""
    if not position.freedom:
        return ("no reflection is left over: nothing checks whether they agree",)
    test = (
        f"misfit {position.misfit:.2f} (chi-square {position.chi_square:.1f} with {position.freedom} degrees of "
        f"freedom, p = {position.p_value:.2g})"
    )
    if position.fits:
        return (f"{test}: the reflections agree within their stated errors",)
    said = (
        f"{test}: the reflections do not agree within their stated errors (said wrongly of {FALSE_ALARM:.0%} of tables "
        f"whose errors are right)",
        f"standard errors are multiplied by {position.misfit:.3g}",
    )
    suspects = [names[i] for i in position.suspects]
    if len(suspects) == 1:
        i = position.suspects[0]
        off = with_error(float(position.residuals[i]), float(position.stated[i]), "rad")
        return (*said, f"{suspects[0]} does not fit ({off}); without it the others agree")
    if suspects:
        which = ", ".join(suspects)
        return (
            *said,
            f"one of these does not fit the others, but not which one: {which}; without any of them the rest agree",
        )
    return (*said, "no single reflection is the reason: see to stated errors, convention, beam and mount")


def undetermined_directions(directions: npt.NDArray[np.float64]) -> tuple[str, ...]:
    """Of directions ``(k, 3)`` in the laboratory's axes."""
    return tuple(
        f"not determined by these reflections: the place {_words(direction)}; there the cell's sample is kept"
        for direction in directions.tolist()
    )


def _words(direction: Sequence[float]) -> str:
    for share, name in zip(direction, LAB, strict=True):
        if abs(share) > _ALIGNED:
            return name
    return "along " + ", ".join(f"{share:+.2f} {name}" for share, name in zip(direction, LAB, strict=True))
