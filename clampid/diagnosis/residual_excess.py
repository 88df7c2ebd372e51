"""A held-out error above the noise floor without a confirmed effect: its size, unobservable effects, and reasons.

Also joints that were approached or moved from one side only: direction-dependent effects cannot be identified there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from clampid.diagnosis.candidate_scores import ABLE
from clampid.display import counted, number
from clampid.effect import Effect
from clampid.evidence.score import Scored
from clampid.signals import SIGNALS
from clampid.stages.rows import Rows

__all__ = ["EXCESS_FACTOR", "OneSided", "excess_over_floor", "one_sided", "one_sided_words", "unseen_by_probes"]

EXCESS_FACTOR = 1.3  # noise floors: above this, two fifths of the squared error are not noise
LEAST_VISITS_OF_A_SIDE = 3  # visits or blocks from a side: fewer do not show a direction-dependent error
SIDES = frozenset(name for name, known in SIGNALS.items() if known.sided)
WHY_FLOOR = {
    "replicates": "returns to a pose within minutes repeat better than the robot does over a session",
    "instrument": "the floor is the instrument's stated noise alone, and may be too low: measure some poses again "
    "later, from the same side",
    "repeated_runs": "runs of the same motion repeat better than the model predicts them, so that the model lacks an "
    "effect that these rows determine",
    "regression": "a regression on rigid-body dynamics and friction predicts these torques better than the model does, "
    "so that the model lacks an effect that these rows determine",
    "log": "the floor is the noise from row to row alone; slower noise is not in it",
}


@dataclass(frozen=True)
class OneSided:
    """A joint that came, or moved, from one side only.

    Attributes
    ----------
    joint
        From 1.
    side
        +1 or -1; 0 where none was recorded.
    other
        How many visits or blocks there are from the other side, fewer than :data:`LEAST_VISITS_OF_A_SIDE`.
    """

    joint: int
    side: int
    other: int

    def to_json(self) -> dict[str, int]:
        """For programs."""
        return {"joint": self.joint, "side": self.side, "from_the_other": self.other}


def one_sided(rows: Rows) -> list[OneSided]:
    """The joints of used rows that came, or moved, from one side only; of those that moved at all."""
    name = rows.kind.side
    if name is None or name not in rows.signals:
        return []
    used = rows.used.any(axis=1)
    sign, unit = np.sign(rows.signals[name][used]), rows.unit[used]
    found = []
    for j in range(sign.shape[1]):
        counts = [len(np.unique(unit[sign[:, j] == side])) for side in (1.0, -1.0)]
        if min(counts) >= LEAST_VISITS_OF_A_SIDE or (rows.kind.moving and max(counts) == 0):
            continue
        side = 0 if max(counts) == 0 else 1 if counts[0] >= counts[1] else -1
        found.append(OneSided(j + 1, side, min(counts)))
    return found


def one_sided_words(found: Sequence[OneSided], rows: Rows, effects: Mapping[str, Effect]) -> str:
    """For people: the joints, and which effects depend on the side, so that they are not identifiable there; or empty.

    A side that all joints have in common is stated once.
    """
    if not found:
        return ""
    names = sorted(n for n, e in effects.items() if rows.kind.has(e) and SIDES & set(e.needs))
    what = rows.kind.words.moved
    many, was = ("s", "were") if len(found) > 1 else ("", "was")
    said = {1: "+", -1: "-", 0: "not recorded"}
    if {f.side for f in found} == {0}:
        joints, why = ", ".join(str(f.joint) for f in found), "whose directions were not recorded"
        mend = f"record {rows.kind.words.record}"
    else:
        joints = ", ".join(f"{f.joint} ({said[f.side]})" for f in found)
        why, mend = f"which {was} {what} from one side only", "measure from the other side, too"
    return (
        f"Direction-dependent effects ({', '.join(names).replace('_', ' ')}) cannot be identified at joint{many} "
        f"{joints}, {why}: {mend}."
    )


def unseen_by_probes(free: Sequence[Scored]) -> dict[str, list[str]]:
    """Place → variables whose dependence there is not observable, because the model absorbs nearly all of it."""
    able: dict[str, set[str]] = {}
    blind: dict[str, dict[str, None]] = {}
    for s in free:
        for place in s.candidate.places[:1]:
            if s.state in ABLE and s.state != "weak":
                able.setdefault(place, set()).update(s.candidate.depends_on)
            else:
                blind.setdefault(place, {}).update(dict.fromkeys(s.candidate.depends_on))
    left = {place: [v for v in variables if v not in able.get(place, set())] for place, variables in blind.items()}
    return {place: variables for place, variables in left.items() if variables}


def excess_over_floor(
    after: float, floor: float, source: str, outliers: int, free: Sequence[Scored], few: float = 1.0
) -> dict[str, Any] | None:
    """Excess of a held-out error over its floor, with possible reasons; None where there is none.

    Parameters
    ----------
    after, floor
        In the stage's unit.
    source
        Where the floor is known from.
    outliers
        How many rows were rejected.
    free
        The probes, scored on what the fit leaves.
    few
        The error over the floor that errors of the estimates alone explain, for few rows.
    """
    if not after > EXCESS_FACTOR * floor or not floor > 0:
        return None
    reasons = [WHY_FLOOR[source], "robot or instrument may have drifted, or noise may be larger in some places"]
    if few > 1.0:
        reasons.insert(
            0, f"the poses are few: the error of the estimates alone brings the floor to {number(few, 2)} times itself"
        )
    if outliers:
        kind = "an outlier" if outliers == 1 else "outliers"
        reasons.append(f"{counted(outliers, 'row', 'was')} rejected as {kind}, and others may be wrong by less")
    reasons.append("effects below their detection limits, or that cannot be tested here, may add up")
    return {
        "times_floor": after / floor,
        "share_of_square": max(1.0 - (few * floor / after) ** 2, 0.0),
        "reasons": reasons,
        "unseen": unseen_by_probes(free),
    }
