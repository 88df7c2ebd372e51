"""The screen of ``ik``: the angles, how far off the detector may be, and whether the way there is safe."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from clampid.display import length, readable
from clampid.screen import Next, Screen, Tone

if TYPE_CHECKING:
    from clampid.verbs.units import Units
    from offline_ik.inverse.answer import Answer
    from offline_ik.inverse.detector import Detector
    from offline_ik.motion.ways import Way, Ways

__all__ = ["ik_screen"]


def ik_screen(
    detector: Detector,
    ways: Ways,
    asked: str,
    call: Sequence[str | Path],
    notes: Sequence[str],
    assumed: Sequence[str],
    approach: bool,
    units: Units,
) -> Screen:
    """What ``ik`` found.

    Parameters
    ----------
    asked
        The detector position, in words.
    call
        The arguments of the same call, to be repeated with another option.
    notes
        What the solver remarked.
    assumed
        What no cell file states, with the values that are taken.
    approach
        Whether an intermediate point was asked for.
    units
        Of what is printed; joint angles come in both.
    """
    from offline_ik.inverse.assumed import assumed_in_words

    done = f"{detector.robot.name}: {asked}, convention {ways.answer.convention['name']}."
    said = list(notes)
    if assumed:
        said.append(assumed_in_words(assumed))
    again = shlex.join(["clampid", "ik", *map(str, call)])
    if not ways.answer.reachable:
        return Screen(
            done,
            None,
            _nearest(ways.answer, units),
            "The robot cannot put the detector there.",
            "bad",
            (*ways.answer.reasons, *said),
            "What is assumed: --verbose.",
            (),
        )
    way = ways.chosen[0]
    u = way.solution.uncertainty
    facts = [
        (f"joint {k}", f"{q:10.6f} rad = {math.degrees(q):9.4f} deg; motor {units.angle(motor, 4)}")
        for k, (q, motor) in enumerate(zip(way.solution.q.tolist(), way.solution.motor.tolist(), strict=True), 1)
    ]
    stated = u.stated()
    facts.append(
        (
            "1 σ",
            f"{length(u.tangential_m)} across the line of sight, {length(stated['radial_std_m'])} along it, "
            f"{readable(u.std_rad, 'microrad')} in orientation",
        )
    )
    verdict, tone = f"The detector is within {length(u.radius95_m)} of the position asked for (95 %)", "good"
    if not way.path.safe:
        verdict, tone = f"{verdict}, but the move is not safe.", "bad"
        said = [f"refused: {'; '.join(way.path.reasons)}.", *said]
    elif way.checked != "way":
        verdict, tone = f"{verdict}; the path to it was not checked.", "open"
        said = ["Path not checked: give the starting posture with --near Q1,Q2,….", *said]
    else:
        verdict = f"{verdict}; the move is safe."
    if way.solution.singular:
        said.append(f"near a singularity: {', '.join(way.solution.singular)}.")
    if way.solution.extrapolating:
        said.append(f"extrapolating: {_beyond(way)}.")
    meant: Tone = "bad" if tone == "bad" else "open" if tone == "open" else "good"
    other = Next("Next, all postures, each with its check:", f"{again} --branch all --verbose")
    closer = Next("Next, approach so that play lies on a known side:", f"{again} --approach")
    step = other if not way.path.safe or approach else closer
    return Screen(
        done, None, tuple(facts), verdict, meant, tuple(said), "Status and turn, path, assumptions: --verbose.", (step,)
    )


def _nearest(answer: Answer, units: Units) -> tuple[tuple[str, str], ...]:
    n = answer.nearest
    if n is None:
        return ()
    angles = f"gamma {units.angle(n['gamma_rad'])}, delta {units.angle(n['delta_rad'])}"
    where = f"{angles}, r {units.distance(n['r_m'])}"
    return (("nearest", f"{where}, {length(n['distance_m'])} away"),)


def _beyond(way: Way) -> str:
    from clampid.verbs.findings import extrapolating_text

    return extrapolating_text([beyond.to_json() for beyond in way.solution.extrapolating])
