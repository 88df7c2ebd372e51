"""What a probe still finds in a fit's residual: structure that matters, or a note.

A probe that fires, and lowers the error of rows that no fit has seen, has found something that is there. Whether a
verdict has to say so is a matter of size. It matters where the held-out error is clearly above the noise floor (one
sided, :data:`CLEARLY`, both known only so well as units of noise and returns tell them), or where the probe lowers it
by at least what a diagnosis promises to find (:data:`MATTERS`). Else it is a note with its size: the held-out error is
the noise floor's with it or without it.

The floor of poses comes from returns and from the instrument, which no model has shaped: an error at or below it has
no room for anything that matters. A log's is taken from what a fit leaves and may hold some of what the fit lacks, so
that there the probe's size beside the noise of its motor decides: a note is what is clearly smaller than that (one
sided, :data:`CLEARLY`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from clampid.diagnosis.candidate_scores import CandidateScores
from clampid.diagnosis.confirm import Fall, cross_fitted_fall, probe_held_out_fall
from clampid.diagnosis.drift import blocks_of_visits
from clampid.diagnosis.entries import variables_of
from clampid.diagnosis.held_out import HELD_OUT_RATE, HeldOut, either_p
from clampid.display import error_text
from clampid.evidence.score import Scored
from clampid.fitting.solve import Estimate
from clampid.stages.rows import Rows

__all__ = ["CLEARLY", "MATTERS", "Remains", "above_the_floor", "remains_of"]

CLEARLY = 0.05  # chance that an error at the floor is said to be above it
MATTERS = 0.4  # noise floors, rms: from this size on what is missing is found in 95 % (DIAGNOSIS' acceptance)


@dataclass(frozen=True)
class Remains:
    """Structure that a probe finds.

    Attributes
    ----------
    depends_on
        Recorded variables.
    where
        The joint, frame or motor.
    size
        rms of what the probe takes from the held-out error, in the stage's unit: of poses, or of the motor where it is.
    p
        One-sided, of that fall.
    matters
        Whether the verdict is to say so.
    """

    depends_on: tuple[str, ...]
    where: tuple[str, ...]
    size: float
    p: float
    matters: bool

    def to_json(self, unit: str) -> dict[str, Any]:
        """For programs."""
        return {
            "depends_on": list(self.depends_on),
            "where": list(self.where),
            "size": self.size,
            "unit": unit,
            "p_held_out": self.p,
        }

    def sentence(self, unit: str, floor: float) -> str:
        """For people, where it does not matter."""
        size, at = error_text(self.size, unit), f" at {', '.join(self.where)}" if unit == "sigma" else ""
        return (
            f"A pattern of {size} rms{at} is left that depends on {', '.join(self.depends_on)}. Compared with the "
            f"noise floor of {error_text(floor, unit)} it is too small to change the verdict."
        )


def remains_of(
    scores: CandidateScores, estimate: Estimate, held_out: HeldOut, verification: Rows | None, seed: int
) -> Remains | None:
    """What the best probe finds, if it fires and lowers the error of rows that no fit has seen; else None.

    Which probe is first without a fifth of the rows is not asked: of an error of several joints, each part of the rows
    may show another joint's share best.
    """
    if not scores.fires or scores.probe is None:
        return None
    fall = _fall(scores.probe, estimate, verification, seed)
    if fall.p > HELD_OUT_RATE:
        return None
    where, poses = scores.probe.candidate.places, estimate.problem.kind.points

    def size_of(share: float) -> float:
        return float(np.sqrt(max(share, 0.0) * _per_motor(held_out.rows, where))) * held_out.rms

    size = size_of(fall.share)
    if poses:
        large = size >= MATTERS * held_out.floor.norm > 0.0 and held_out.rms > held_out.floor.norm
    else:
        large = size_of(fall.share + float(stats.norm.isf(CLEARLY)) * fall.error) >= MATTERS
    found = variables_of(scores)
    return Remains(tuple(found), where, size, fall.p, large or above_the_floor(held_out, CLEARLY))


def _per_motor(rows: Rows, where: tuple[str, ...]) -> float:
    """How many times as many numbers the rows have as the motor to which a probe of torques belongs; of poses 1.

    What one motor shows matters beside that motor's noise, however many others there are.
    """
    motors = {f"motor{k + 1}": int(count) for k, count in enumerate(rows.used.sum(axis=0))}
    if rows.kind.points or not set(where) <= set(motors):
        return 1.0
    return sum(motors.values()) / max(sum(motors[place] for place in where), 1)


def _fall(probe: Scored, estimate: Estimate, verification: Rows | None, seed: int) -> Fall:
    """What a probe takes from rows that no fit has seen: as a name's, on the verification table or on the poses.

    Where the table alone, of a few visits, does not tell, the poses may, at the other half of the rate; the table's own
    error has to fall in any case. Of what swings in time a table measured later knows nothing.
    """
    if verification is None or probe.candidate.depends_on == ("time",):
        return cross_fitted_fall(estimate, probe, seed)
    fall = probe_held_out_fall(estimate, verification, probe.candidate, seed)
    if fall.p <= 0.5 * HELD_OUT_RATE or fall.share <= 0.0:
        return fall
    return replace(fall, p=either_p(fall.p, cross_fitted_fall(estimate, probe, seed).p))


def above_the_floor(held_out: HeldOut, rate: float) -> bool:
    """Whether a held-out error is above the noise floor by more than chance, at that rate.

    The mean square's variance is that of the units' sums (visits, blocks of a log); the floor's is that of its returns,
    or, of a log, that of as many rows. Where only the instrument's maker says what the floor is, the robot's usual
    repeatability comes on top.
    """
    squares, (counts, width) = held_out.squares, _counted(held_out)
    _, unit = np.unique(blocks_of_visits(held_out.rows, held_out.block), return_inverse=True)
    total, number = np.bincount(unit, squares), np.bincount(unit, counts)
    mean = float(total.sum() / max(number.sum(), 1.0))
    variance = float(np.sum((total - mean * number) ** 2)) / max(float(number.sum()), 1.0) ** 2
    if not held_out.rows.kind.points:
        return bool(mean - 1.0 > stats.norm.isf(rate) * np.sqrt(2.0 * variance))
    floor = held_out.floor
    level = floor.norm**2 if floor.source == "replicates" else floor.most**2
    known = 2.0 * level**2 / (width * floor.freedom) if floor.freedom else 0.0
    return bool(mean - level > stats.norm.isf(rate) * np.sqrt(variance + known))


def _counted(held_out: HeldOut) -> tuple[np.ndarray, int]:
    """How many errors each row has ``(N,)``, and of how many coordinates a pose's is."""
    if held_out.rows.kind.points:
        return held_out.rows.used.any(axis=1).astype(float), 3
    return held_out.rows.used.sum(axis=1).astype(float), 1
