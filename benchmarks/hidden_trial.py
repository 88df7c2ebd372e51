"""One trial of the benchmark of hidden effects: simulate, identify, diagnose, compare the verdict with the truth."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import process_time
from typing import Any

from hidden_cases import NOTHING, Case, start_model
from hidden_worlds import World

from clampid.catalogue import catalogue
from clampid.diagnosis.diagnose import diagnose
from clampid.effect import EffectError, Stage
from clampid.loop.add import add
from clampid.models.model import Model
from experiments.campaign import Campaign

MOST_ALTERNATIVES = 3
CONFUSABLE = 0.8
EVERYWHERE = "all"  # the second world's place of what all motors show


def hidden_trial(world: World, case: Case, size: float, seed: int, poses: int, best: bool = True) -> dict[str, Any]:
    """Hide a case's effects at a size each, and judge the stage's verdict."""
    with tempfile.TemporaryDirectory() as folder:
        bench = world.bench(case, seed, poses, Path(folder) / "arm")
        found = [bench.magnitude(name, size) for name in case.hidden]
        campaign = bench.campaign([m for m, _ in found])
        truth = truth_of(case, bench.places())
    model = start_model(case, campaign)
    start = process_time()
    verdict = diagnose(model, campaign, stages=[case.stage]).to_json()["stages"][case.stage]
    seconds = process_time() - start
    out = {"kind": "outside" if case.depends_on else ("single" if len(case.hidden) == 1 else "several")}
    out |= {"case": case.label, "stage": case.stage, "size": size, "seed": seed, **bench.setup}
    out |= {"sizes": [s for _, s in found], "magnitudes": [m for m, _ in found], "truth": truth}
    out |= told_by(verdict) | {"seconds": seconds, "rows": rows_of(campaign, case.stage)}
    if case.depends_on:
        wanted = bench.depends_on()
        right = verdict["verdict"] == "unknown" and bool(set(verdict["depends_on"]) & set(wanted))
        return out | {"right": right, "wanted": list(wanted)}
    reached = best_possible(model, campaign, case.stage, truth) if best else None
    return out | judged(verdict, truth, bench.present) | {"best": reached}


def clean_trial(world: World, seed: int, poses: int, stages: Sequence[str]) -> list[dict[str, Any]]:
    """Hide nothing: a verdict of every stage that is asked for."""
    with tempfile.TemporaryDirectory() as folder:
        bench = world.bench(NOTHING, seed, poses, Path(folder) / "arm")
        campaign = bench.campaign([])
    model = start_model(NOTHING, campaign)
    out = []
    for stage in [s for s in model.stages if s in stages]:
        start = process_time()
        verdict = diagnose(model, campaign, stages=[stage]).to_json()["stages"][stage]
        row = {"kind": "clean", "case": f"nothing/{stage}", "stage": stage, "size": 0.0, "seed": seed, **bench.setup}
        row |= told_by(verdict) | {"seconds": process_time() - start, "rows": rows_of(campaign, stage)}
        named, sets = confirmed_and_sets(verdict, bench.present)
        true_of_it = verdict["verdict"] in ("missing", "ambiguous") and not named and not sets
        out.append(row | {"right": verdict["verdict"] == "adequate" or true_of_it})
    return out


def rows_of(campaign: Campaign, stage: Stage) -> int:
    """How many rows a stage has."""
    tables = {"free_air": ("free_air", "wrist"), "clamped": ("clamped",), "poses": ("poses",)}[stage]
    return sum(len(campaign.tables[t]) for t in tables if t in campaign.tables)


def truth_of(case: Case, places: Sequence[str]) -> list[dict[str, str]]:
    """Family, name and place of each hidden effect; place ``""`` where it sits in one place only or everywhere."""
    known = catalogue()
    out = []
    for name, where in zip(case.names, places, strict=True):
        if name not in known:  # outside the library
            continue
        nowhere = where == EVERYWHERE or known[name].per == "robot" or known[name].search.scope == "jointly"
        place = "" if nowhere else where
        if place:
            place = known[name].per + place.lstrip("abcdefghijklmnopqrstuvwxyz")
        out.append({"name": name, "family": known[name].family, "where": place})
    return out


def told_by(verdict: Mapping[str, Any]) -> dict[str, Any]:
    """What a verdict says, as far as it is judged."""
    keys = ("effect", "name", "where", "alternative", "p_familywise", "confusable_with")
    return {
        "verdict": verdict["verdict"],
        "candidates": [{k: c[k] for k in keys} | {"group": c.get("group", 0)} for c in verdict["candidates"]],
        "depends_on": verdict["depends_on"],
        "before": verdict["heldout_rms_before"],
        "after": verdict["heldout_rms_after"],
        "floor": verdict["noise_floor"],
    }


def confirmed_and_sets(
    verdict: Mapping[str, Any], present: frozenset[str]
) -> tuple[list[Mapping[str, Any]], list[list[Mapping[str, Any]]]]:
    """The confirmed names and the sets of alternatives, without those that are true of the robot in any case."""
    confirmed = [c for c in verdict["candidates"] if not c["alternative"] and c["name"] not in present]
    by_group: dict[int, list[Mapping[str, Any]]] = {}
    for c in verdict["candidates"]:
        if c["alternative"]:
            by_group.setdefault(c["group"], []).append(c)
    return confirmed, [one for one in by_group.values() if not any(c["name"] in present for c in one)]


def judged(
    verdict: Mapping[str, Any], truth: Sequence[Mapping[str, str]], present: frozenset[str] = frozenset()
) -> dict[str, Any]:
    """First name right, all found, exact set.

    Right: `missing` with a true effect at its true place first, or `ambiguous` with it in the first set, of at most
    three whose members these rows really cannot distinguish. `top1`: the first name of either is a true effect's. Names
    of effects that the robot has without being asked (`present`) are true, and no answer to what was hidden: they, and
    sets with one of them, do not count.
    """
    confirmed, sets = confirmed_and_sets(verdict, present)
    small = [one for one in sets if len(one) <= MOST_ALTERNATIVES]
    candidates = [*confirmed, *(c for one in sets for c in one)]

    def hits(c: Mapping[str, Any], t: Mapping[str, str]) -> bool:
        return c["effect"] == t["family"] and (not t["where"] or not c["where"] or t["where"] in c["where"])

    def one_of(chosen: Sequence[Mapping[str, Any]], t: Mapping[str, str]) -> bool:
        return any(hits(c, t) for c in chosen)

    if not candidates:
        right = False
    elif verdict["verdict"] == "missing":
        right = any(hits(confirmed[0], t) for t in truth)
    elif verdict["verdict"] == "ambiguous":
        first_said = confirmed[:1] or next(iter(sets))
        right = any(one_of(first_said, t) for t in truth) and len(first_said) <= MOST_ALTERNATIVES
    else:
        right = False
    found = [one_of(confirmed, t) or any(one_of(one, t) for one in small) for t in truth]
    extra = [c for c in confirmed if not any(hits(c, t) for t in truth)]
    first = candidates[0]["effect"] if candidates else verdict["verdict"]
    named = verdict["verdict"] in ("missing", "ambiguous") and bool(candidates)
    top1 = named and any(hits(candidates[0], t) for t in truth)
    return {"right": right, "top1": top1, "found": sum(found), "exact": all(found) and not extra, "first": first}


def best_possible(model: Model, campaign: Campaign, stage: Stage, truth: Sequence[Mapping[str, str]]) -> float | None:
    """The held-out error once the true effects are fitted."""
    terms = [f"{stage}={t['name']}" + (f"@{t['where']}" if t["where"] else "") for t in truth]
    try:
        _, addition = add(model, campaign, terms)
    except EffectError:  # nothing can be determined about it from these rows
        return None
    return addition.stages[stage].after.heldout_rms
