"""Structure that a probe finds in the final residual: it changes the verdict, or is a note.

A probe that is significant and lowers the held-out error has found a real error; its size decides whether the verdict
names it. It does if the held-out error is significantly above the noise floor (one-sided, :data:`CLEARLY`, with the
degrees of freedom of both), or if the probe lowers it by at least the size that a diagnosis promises to find
(:data:`MATTERS`). Otherwise it is a note with its size: the held-out error equals the noise floor with and without it.

The noise floor of poses comes from repeated poses and from the instrument, independently of any model: a held-out error
at the floor contains no error that matters. The floor of a log comes from the fit's own residual and may contain
missing effects. So for logs the size of the probe is compared with the noise of its motor: it is a note if it is
significantly smaller (one-sided, :data:`CLEARLY`). Where the readings of a log wander, that alone keeps the held-out
error above the floor; so only the size decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from clampid.diagnosis.candidate_scores import CandidateScores, standing_out_of
from clampid.diagnosis.confirm import Fall, cross_fitted_fall
from clampid.diagnosis.drift import blocks_of_visits
from clampid.diagnosis.entries import variables_of
from clampid.diagnosis.falls import FallTest
from clampid.diagnosis.few_rows import expected_over_noise
from clampid.diagnosis.held_out import HELD_OUT_RATE, HeldOut
from clampid.diagnosis.linear_refit import at_fit
from clampid.diagnosis.noise_beside import with_equal_weights
from clampid.display import error_text
from clampid.evidence.score import Scored
from clampid.fitting.solve import Estimate
from clampid.stages.rows import Rows

__all__ = ["CLEARLY", "MATTERS", "Remains", "above_the_floor", "remains_of"]

CLEARLY = 0.05  # chance that an error at the floor is said to be above it
MATTERS = 0.4  # noise floors, rms: from this size on what is missing is found in 95 % (DIAGNOSIS' acceptance)
MOST_PROBES = 5  # that are tried, the best first


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
        rms of the part of the held-out error that the probe explains, in the stage's unit: of poses, or of its motor.
    p
        One-sided, of the fall of the whitened errors.
    matters
        Whether the verdict names it.
    probe
        What finds it.
    """

    depends_on: tuple[str, ...]
    where: tuple[str, ...]
    size: float
    p: float
    matters: bool
    probe: Scored

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


def remains_of(scores: CandidateScores, estimate: Estimate, held_out: HeldOut, falls: FallTest) -> Remains | None:
    """The structure of the best significant probe that lowers the held-out error; None if none does.

    Stability over five parts is not required: with errors of several joints each part of the rows may show another
    joint's share best.
    """
    found = _confirmed(scores, estimate, falls)
    if found is None:
        return None
    probe, fall = found
    where, poses = probe.candidate.places, estimate.problem.kind.points

    def size_of(share: float) -> float:
        return float(np.sqrt(max(share, 0.0) * _per_motor(held_out.rows, where))) * held_out.rms

    explained = fall if poses else _plain_fall(probe, estimate, falls.seed)
    size = size_of(explained.share)
    if poses:
        large = size >= MATTERS * held_out.floor.norm > 0.0 and held_out.rms > held_out.floor.norm
    else:
        large = size_of(explained.share + float(stats.norm.isf(CLEARLY)) * explained.error) >= MATTERS
    variables, wanders = variables_of(scores.seen_by(probe)), scores.wander is not None and not poses
    expected = expected_over_noise(estimate, falls.verification is not None)
    matters = large or (not wanders and above_the_floor(held_out, CLEARLY, expected))
    return Remains(tuple(variables), where, size, fall.p, matters, probe)


def _confirmed(scores: CandidateScores, estimate: Estimate, falls: FallTest) -> tuple[Scored, Fall] | None:
    """The first significant probe, the best first, by which the held-out error falls.

    The best one may have so many columns that it predicts nothing. The k-th one tried is tested at the k-th part of the
    rate (Bonferroni).
    """
    if not scores.fires or scores.probe is None:
        return None
    others = sorted(standing_out_of(scores.free, scores.free_null), key=lambda s: -s.bic)
    tried = [scores.probe, *(s for s in others if s.candidate.label != scores.probe.candidate.label)]
    for number, probe in enumerate(tried[:MOST_PROBES], start=1):
        fall = falls.of_probe(probe, estimate)
        if fall.p <= HELD_OUT_RATE / number:
            return probe, fall
    return None


def _per_motor(rows: Rows, where: tuple[str, ...]) -> float:
    """Numbers of all motors over numbers of the motor to which a torque probe belongs; for poses 1.

    An error of one motor is compared with that motor's noise, for any number of motors.
    """
    motors = {f"motor{k + 1}": int(count) for k, count in enumerate(rows.used.sum(axis=0))}
    if rows.kind.points or not set(where) <= set(motors):
        return 1.0
    return sum(motors.values()) / max(sum(motors[place] for place in where), 1)


def _plain_fall(probe: Scored, estimate: Estimate, seed: int) -> Fall:
    """Fall of the errors of a log by a probe, all rows of a motor with equal weights.

    A pattern has a size in Nm. Whitened, one that is as slow as the noise is small, and a quick one is large.
    """
    plain = with_equal_weights(estimate)
    return cross_fitted_fall(plain, at_fit(plain, probe), seed)


def above_the_floor(held_out: HeldOut, rate: float, expected: float = 1.0) -> bool:
    """Whether a held-out error is significantly above the noise floor, at that false-alarm rate.

    The variance of the mean square is that of the units' sums (visits, blocks of a log). That of the floor follows from
    its degrees of freedom. If the floor is only the instrument's stated noise, the robot's usual repeatability is
    added.

    Parameters
    ----------
    expected
        Held-out error of a right model over the floor: what the errors of its estimates add.
    """
    squares, (counts, width) = held_out.squares, _counted(held_out)
    _, unit = np.unique(blocks_of_visits(held_out.rows, held_out.block), return_inverse=True)
    total, number = np.bincount(unit, squares), np.bincount(unit, counts)
    mean = float(total.sum() / max(number.sum(), 1.0))
    variance = float(np.sum((total - mean * number) ** 2)) / max(float(number.sum()), 1.0) ** 2
    floor, level = held_out.floor, 1.0  # torques are in units of it
    if held_out.rows.kind.points:
        level = floor.norm**2 if floor.source == "replicates" else floor.most**2
    level *= expected**2
    known = 2.0 * level**2 / (width * floor.freedom) if floor.freedom else 0.0
    return bool(mean - level > stats.norm.isf(rate) * np.sqrt(variance + known))


def _counted(held_out: HeldOut) -> tuple[np.ndarray, int]:
    """Number of errors of each row ``(N,)``, and number of coordinates of a pose's error."""
    if held_out.rows.kind.points:
        return held_out.rows.used.any(axis=1).astype(float), 3
    return held_out.rows.used.sum(axis=1).astype(float), 1
