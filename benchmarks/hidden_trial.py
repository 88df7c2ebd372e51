"""One trial of the benchmark of hidden effects: simulate, identify, diagnose; the verdict is held against the truth."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from time import process_time
from typing import Any

from hidden_cases import Bench, Case, start_model

from clampid.catalogue import catalogue
from clampid.diagnosis.diagnose import diagnose
from clampid.effect import EffectError, Stage
from clampid.identification.identify import identify
from clampid.loop.add import add
from clampid.models.model import Model
from experiments.campaign import Campaign, read_campaign
from experiments.simulate import hidden_file, simulate

MOST_ALTERNATIVES = 3
CONFUSABLE = 0.8


def hidden_trial(case: Case, size: float, seed: int, poses: int, best: bool = True) -> dict[str, Any]:
    """Hide a case's effects at a size each, and judge the stage's verdict."""
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(case, seed, poses, Path(folder) / "arm")
        found = [bench.magnitude(name, size) for name in case.hidden]
        campaign = bench.campaign([m for m, _ in found])
        told = [] if case.lacking else json.loads(hidden_file(bench.folder).read_text())
    model = start_model(case, campaign)
    start = process_time()
    verdict = diagnose(model, campaign, stages=[case.stage]).to_json()["stages"][case.stage]
    seconds = process_time() - start
    truth = truth_of(case, told)
    out = {"kind": "outside" if case.depends_on else ("single" if len(case.hidden) == 1 else "several")}
    out |= {"case": case.label, "stage": case.stage, "size": size, "seed": seed}
    out |= {"sizes": [s for _, s in found], "magnitudes": [m for m, _ in found], "truth": truth}
    out |= told_by(verdict) | {"seconds": seconds, "rows": rows_of(campaign, case.stage)}
    if case.depends_on:
        right = verdict["verdict"] == "unknown" and bool(set(verdict["depends_on"]) & set(case.depends_on))
        return out | {"right": right}
    reached = best_possible(model, campaign, case.stage, truth) if best else None
    return out | judged(verdict, truth) | {"best": reached}


def clean_trial(seed: int, poses: int) -> list[dict[str, Any]]:
    """Hide nothing: a verdict of every stage."""
    with tempfile.TemporaryDirectory() as folder:
        simulate(Path(folder) / "arm", seed=seed, poses=poses)
        campaign = read_campaign(Path(folder) / "arm")
    model = identify(campaign)
    out = []
    for stage in model.stages:
        start = process_time()
        verdict = diagnose(model, campaign, stages=[stage]).to_json()["stages"][stage]
        row = {"kind": "clean", "case": f"nothing/{stage}", "stage": stage, "size": 0.0, "seed": seed}
        row |= told_by(verdict) | {"seconds": process_time() - start, "rows": rows_of(campaign, stage)}
        out.append(row | {"right": verdict["verdict"] == "adequate"})
    return out


def rows_of(campaign: Campaign, stage: Stage) -> int:
    """How many rows a stage has."""
    tables = {"free_air": ("free_air", "wrist"), "clamped": ("clamped",), "poses": ("poses",)}[stage]
    return sum(len(campaign.tables[t]) for t in tables if t in campaign.tables)


def truth_of(case: Case, told: Sequence[Mapping[str, Any]]) -> list[dict[str, str]]:
    """Family, name and place of each hidden effect; place ``""`` where it sits in one place only or everywhere."""
    known = catalogue()
    out = []
    for k, name in enumerate(case.names):
        if name not in known:  # outside the library
            continue
        place = "" if case.lacking or known[name].per == "robot" or known[name].tried == "jointly" else told[k]["where"]
        if place:
            place = known[name].per + place.lstrip("abcdefghijklmnopqrstuvwxyz")
        out.append({"name": name, "family": known[name].family, "where": place})
    return out


def told_by(verdict: Mapping[str, Any]) -> dict[str, Any]:
    """What a verdict says, as far as it is judged."""
    keys = ("effect", "name", "where", "alternative", "p_familywise", "confusable_with")
    return {
        "verdict": verdict["verdict"],
        "candidates": [{k: c[k] for k in keys} for c in verdict["candidates"]],
        "depends_on": verdict["depends_on"],
        "before": verdict["heldout_rms_before"],
        "after": verdict["heldout_rms_after"],
        "floor": verdict["noise_floor"],
    }


def judged(verdict: Mapping[str, Any], truth: Sequence[Mapping[str, str]]) -> dict[str, Any]:
    """First name right, all found, exact set.

    Right: `missing` with a true effect at its true place first, or `ambiguous` with it in a set of at most three whose
    members these rows really cannot tell apart.
    """
    candidates = verdict["candidates"]
    confirmed = [c for c in candidates if not c["alternative"]]
    alternatives = [c for c in candidates if c["alternative"]]

    def hits(c: Mapping[str, Any], t: Mapping[str, str]) -> bool:
        return c["effect"] == t["family"] and (not t["where"] or not c["where"] or t["where"] in c["where"])

    def one_of(chosen: Sequence[Mapping[str, Any]], t: Mapping[str, str]) -> bool:
        return any(hits(c, t) for c in chosen)

    few = 0 < len(alternatives) <= MOST_ALTERNATIVES
    if verdict["verdict"] == "missing":
        right = any(hits(confirmed[0], t) for t in truth)
    elif verdict["verdict"] == "ambiguous":
        right = any(hits(confirmed[0], t) for t in truth) if confirmed else any(one_of(alternatives, t) for t in truth)
        right = right and (few or bool(confirmed))
    else:
        right = False
    found = [one_of(confirmed, t) or (few and one_of(alternatives, t)) for t in truth]
    extra = [c for c in confirmed if not any(hits(c, t) for t in truth)]
    first = candidates[0]["effect"] if candidates else verdict["verdict"]
    return {"right": right, "found": sum(found), "exact": all(found) and not extra, "first": first}


def best_possible(model: Model, campaign: Campaign, stage: Stage, truth: Sequence[Mapping[str, str]]) -> float | None:
    """The held-out error once the true effects are fitted."""
    terms = [f"{stage}={t['name']}" + (f"@{t['where']}" if t["where"] else "") for t in truth]
    try:
        _, addition = add(model, campaign, terms)
    except EffectError:  # nothing can be told about it from these rows
        return None
    return addition.stages[stage].after.heldout_rms
