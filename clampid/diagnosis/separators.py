"""The measurement that distinguishes two effects which the same rows cannot distinguish.

:mod:`clampid.diagnosis.propose` computes whether more rows of the same kind would. If they would not, the effects' own
files name a measurement for the pair; else it is a sensor where only one of the two acts, or another experiment.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations

from clampid.effect import STAGES, Effect, Stage
from clampid.search_policy import Separator
from clampid.stages.stage_kind import kind_of

__all__ = ["separating_measurement", "something_else"]

_SENSORS: Mapping[str, str] = {
    "base_twist": "an inclinometer or a target on the base plate",
    "fixture": "a target on the block that holds the flange",
    "measurement": "a certified distance between two targets",
    "link_twist": "a target on the link itself",
}
"""Station → a sensor that sees a deviation there and at no other station."""


def _separators(effects: Mapping[str, Effect]) -> dict[frozenset[str], Separator]:
    """Two families → the measurement that separates them, from the effects' own files."""
    return {frozenset((e.family, s.family)): s for e in effects.values() for s in e.search.separators}


def separating_measurement(families: Iterable[str], effects: Mapping[str, Effect], stage: Stage) -> str:
    """A sentence on what to measure next in a stage, so that effects of these families can be distinguished."""
    known = _separators(effects)
    pairs = (frozenset(p) for p in combinations(sorted(set(families)), 2))
    found = [known[p].measurement for p in pairs if p in known]
    if found:
        return "; ".join(dict.fromkeys(found))
    return kind_of(stage).words.more


def something_else(pair: Sequence[str], effects: Mapping[str, Effect], stage: Stage) -> str:
    """A sentence on how to distinguish two effects, given by name, if no measurement of a stage does."""
    a, b = (effects[name] for name in pair)
    separator = _separators(effects).get(frozenset((a.family, b.family)))
    if separator is not None and not separator.same_stage:
        return separator.measurement
    said = []
    for station, sensor in _SENSORS.items():
        if (station in a.acts) != (station in b.acts):
            said.append(f"{sensor}, which sees {(a if station in a.acts else b).name} alone")
    for other in STAGES:
        if other != stage and (kind_of(other).has(a)) != (kind_of(other).has(b)):
            said.append(
                f"{kind_of(other).words.measurement}, in which {(a if kind_of(other).has(a) else b).name} alone acts"
            )
    if not said:
        return f"{a.name} and {b.name} act at the same place in the same experiments, and either may be added"
    return f"{a.name} from {b.name}: {', or '.join(said)}"
