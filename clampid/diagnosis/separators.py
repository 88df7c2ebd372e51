"""What parts look-alikes: for pairs of effects that the same rows cannot tell apart, the measurement that would.

Whether more of the same would is worked out from the rows (:mod:`clampid.diagnosis.propose`). Where that is not so, it
takes something else: what is known of a pair, or else a sensor where only one of the two acts, or another experiment.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

from clampid.effect import STAGES, Effect, Stage

__all__ = ["separating_measurement", "something_else"]

_SEPARATORS: dict[frozenset[str], str] = {
    frozenset(pair): text
    for pair, text in (
        (("base_tilt", "bearing_tilt"), "no pose separates a tilt of joint 1's bearing from a tilt of the base: put an "
         "inclinometer or a target on the base plate"),
        (("thermal_expansion", "base_tilt"), "restart cold and measure the same poses in another order"),
        (("gear_eccentricity", "coupling_ratio_error"), "poses over the full range of the joint"),
        (("gear_eccentricity", "gravity_compensator"), "a log of torques in free air: a balancer's torque shows there, "
         "a gear's error does not"),
        (("joint_compliance", "link_bending"), "loaded poses with the arm folded, or the same poses with two payloads"),
        (("joint_compliance", "bearing_tilt"), "the same poses with two payloads, joint 4 turned between"),
        (("joint_compliance", "base_tilt"), "poses at other angles of joint 1 with equal loads on joint 2, or a target "
         "on the base plate"),
        (("asymmetric_friction", "torque_offset"), "nothing on one axis, where they are the same: a torque reading "
         "with the brakes on gives the offset"),
        (("gravity", "payload"), "the same program with and without the tool"),
        (("payload", "joint_compliance"), "the same poses without the tool"),
        (("instrument_scale", "geometry"), "a certified distance between two targets"),
        (("joint_compliance", "fixture_compliance"), "a target on the fixture's block, or the same sweeps in a second "
         "posture"),
        (("fixture_compliance", "cross_coupled_stiffness"), "a target on the fixture's block"),
        (("stribeck_friction", "viscous_friction"), "five speeds, evenly spread in their logarithm, down to creeping"),
        (("nonlinear_stiffness", "backlash"), "amplitudes below 10 % and above 50 % of the rated torque in one run"),
        (("hysteresis", "backlash"), "nested small loops: at least two amplitudes of reversal"),
        (("hysteresis", "load_dependent_friction"), "the same sweep at two loads with free-air logs at both"),
    )
}  # fmt: skip

_WITHIN: frozenset[frozenset[str]] = frozenset(
    frozenset(pair)
    for pair in (
        ("thermal_expansion", "base_tilt"),
        ("gear_eccentricity", "coupling_ratio_error"),
        ("joint_compliance", "base_tilt"),
        ("stribeck_friction", "viscous_friction"),
        ("nonlinear_stiffness", "backlash"),
        ("hysteresis", "backlash"),
    )
)
"""Pairs whose separator is more of the same measurement, which is worked out and not looked up."""

_SENSORS: Mapping[str, str] = {
    "base_twist": "an inclinometer or a target on the base plate",
    "fixture": "a target on the block that holds the flange",
    "measurement": "a certified distance between two targets",
    "link_twist": "a target on the link itself",
}
"""Station → what sees a deviation there, and no other's."""

_ELSEWHERE: Mapping[Stage, str] = {
    "free_air": "a log of torques in free air",
    "clamped": "sweeps against a clamped flange",
    "poses": "measured poses",
}


_MORE: dict[Stage, str] = {
    "poses": "more poses, spread over the joints' full ranges, with other loads and temperatures than these",
    "free_air": "a longer log over the joints' full ranges, with other loads, speeds and temperatures than this one",
    "clamped": "more sweeps, in other postures, with other amplitudes and temperatures than these",
}


def separating_measurement(effects: Iterable[str], stage: Stage) -> str:
    """A sentence on what to measure next in a stage, so that these effects can be told apart."""
    found = [_SEPARATORS[frozenset(p)] for p in combinations(sorted(set(effects)), 2) if frozenset(p) in _SEPARATORS]
    if found:
        return "; ".join(dict.fromkeys(found))
    return _MORE[stage]


def something_else(pair: Sequence[str], effects: Mapping[str, Effect], stage: Stage) -> str:
    """A sentence on what parts two effects, given by name, where no measurement of a stage does."""
    a, b = (effects[name] for name in pair)
    families = frozenset((a.family, b.family))
    if families in _SEPARATORS and families not in _WITHIN:
        return _SEPARATORS[families]
    said = []
    for station, sensor in _SENSORS.items():
        if (station in a.acts) != (station in b.acts):
            said.append(f"{sensor}, which sees {(a if station in a.acts else b).name} alone")
    for other in STAGES:
        if other != stage and (other in a.stages) != (other in b.stages):
            said.append(f"{_ELSEWHERE[other]}, in which {(a if other in a.stages else b).name} alone acts")
    if not said:
        return f"{a.name} and {b.name} act at the same place in the same experiments, and either may be added"
    return f"{a.name} from {b.name}: {', or '.join(said)}"
