"""Each effect of the clamped stage, hidden in the virtual robot: whether it is named, and the springs' errors.

    python benchmarks/clamped_hidden.py [--seeds 3] [--first 1] [--only fixture_compliance …]

One line a case and seed: the verdict, the held-out error before, after adding what was named, and with the true effect
in the model from the start; and the springs' errors in standard errors before and after. The virtual robot shares no
code with the effects.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from coverage_table import TWO_SIDED_95

from clampid.catalogue import catalogue
from clampid.diagnosis.diagnose import diagnose
from clampid.diagnosis.stage import StageDiagnosis
from clampid.effect import EffectError
from clampid.identification.identify import identify
from clampid.loop.add import add
from clampid.models.model import Model
from experiments.campaign import Campaign
from experiments.simulate import measured_campaign
from experiments.virtual_robot import Hidden, Measured, measure
from kinematics.description import load_robot

STANDARD = ("joint_compliance", "backlash", "coulomb_friction")
WITHIN = 1.10  # of the held-out error that the true effect set reaches


@dataclass(frozen=True)
class Case:
    """What is hidden, and the effects of ours that are the true ones.

    Attributes
    ----------
    hidden
        As `clampid simulate --hide` has it.
    family
        What it must be called.
    truth
        Terms of the true effect; ``{place}`` is where it was hidden.
    watched
        Whether the fixture has a sensor.
    """

    hidden: str
    family: str
    truth: tuple[str, ...]
    watched: bool = False

    @property
    def label(self) -> str:
        """For tables."""
        return self.hidden + (", watched" if self.watched else "")


CASES: tuple[Case, ...] = (
    Case("nonlinear_stiffness", "nonlinear_stiffness", ("nonlinear_stiffness@{place}",)),
    Case("soft_near_zero", "nonlinear_stiffness", ("soft_near_zero@{place}",)),
    Case("hysteresis", "hysteresis", ("hysteresis@{place}",)),
    Case("cross_coupled_stiffness", "cross_coupled_stiffness", ("cross_coupled_stiffness@{place}",)),
    Case("fixture_compliance", "fixture_compliance", ("fixture_compliance",)),
    Case("fixture_compliance", "fixture_compliance", ("watched_fixture",), watched=True),
    Case("fixture_shift", "fixture_compliance", ("fixture_shift",)),
    Case("fixture_shift", "fixture_compliance", ("fixture_shift",), watched=True),
)


@dataclass(frozen=True)
class Outcome:
    """What became of one case: held-out errors in units of the noise, springs' errors in standard errors."""

    verdict: str
    named: bool
    found: str
    before: float
    after: float
    best: float
    springs_before: np.ndarray
    springs_after: np.ndarray

    @property
    def mended(self) -> bool:
        """Whether what was named is worth what the true effect is."""
        return self.after <= WITHIN * self.best

    @property
    def covered(self) -> int:
        """How many of the springs' intervals hold the truth."""
        return int((np.abs(self.springs_after) < TWO_SIDED_95).sum())


def campaign_of(measured: Measured, watched: bool) -> Campaign:
    """A measured campaign, the fixture's sensor taken off where nobody watched."""
    campaign = measured_campaign(measured, load_robot("kuka_kr20_r1810"))
    if watched:
        return campaign
    clamped = campaign.tables["clamped"]
    kept = clamped.drop(columns=[c for c in clamped.columns if c.startswith("fixture_")])
    return replace(campaign, tables={**campaign.tables, "clamped": kept})


def springs_off(model: Model, measured: Measured) -> np.ndarray:
    """Errors of the springs' compliances at the motors ``(n,)`` in standard errors."""
    stage, true = model.stages["clamped"], 1.0 / measured.truth.plant.drive.spring
    off = np.full(len(true), np.nan)
    for slot, value, std in zip(stage.slots, stage.theta, stage.std, strict=True):
        if slot.effect == "joint_compliance":
            j = int(slot.place.removeprefix("joint")) - 1
            off[j] = (value - true[j]) / std
    return off


def terms_of(found: StageDiagnosis) -> list[str]:
    """What `clampid add` is told after this verdict: what was confirmed, else the first of the alternatives."""
    named = [c for c in found.candidates if not c["alternative"]] or found.candidates[:1]
    out: list[str] = []
    for c in named:
        places = c["where"] if catalogue()[c["name"]].per != "robot" else []
        out += [f"clamped={c['name']}@{p}" for p in places] or [f"clamped={c['name']}"]
    return out


def outcome(case: Case, seed: int) -> Outcome:
    """Measure, identify, diagnose, add."""
    measured = measure(load_robot("kuka_kr20_r1810"), [Hidden.parse(case.hidden)], seed=seed, tables=("clamped",))
    campaign = campaign_of(measured, case.watched)
    model = identify(campaign, {"clamped": STANDARD})
    found = diagnose(model, campaign).stages["clamped"]
    first = found.candidates[0] if found.candidates else None
    alike = found.candidates if first and first["alternative"] else found.candidates[:1]
    mended, after = model, found.before
    told = [f"{c['name']}@{','.join(c['where'])}" + ("?" if c["alternative"] else "") for c in found.candidates]
    if found.candidates:
        try:
            mended, addition = add(model, campaign, terms_of(found))
            after = addition.stages["clamped"].after.heldout_rms
        except EffectError as error:
            told.append(f"({error})")
    place = measured.hidden[0]["where"]
    true_model = identify(campaign, {"clamped": (*STANDARD, *(t.format(place=place) for t in case.truth))})
    return Outcome(
        verdict=found.verdict,
        named=any(c["effect"] == case.family for c in alike),
        found=" ".join(told) + (f" left: {','.join(found.depends_on)}" if found.verdict == "unknown" else ""),
        before=found.before,
        after=after,
        best=true_model.ledger[-1].heldout_rms,
        springs_before=springs_off(model, measured),
        springs_after=springs_off(mended, measured),
    )


def show(case: Case, seed: int, o: Outcome) -> None:
    fine = o.named and o.mended
    print(
        f"{'ok    ' if fine else 'FAILED'} {case.label} seed {seed}: {o.verdict} [{o.found}] "
        f"{o.before:.3f} -> {o.after:.3f}, truth {o.best:.3f}; springs "
        f"{' '.join(f'{z:.1f}' for z in o.springs_before)} -> {' '.join(f'{z:.1f}' for z in o.springs_after)}",
        flush=True,
    )


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--only", nargs="*", help="labels that cases must contain")
    args = parser.parse_args(arguments)
    for case in CASES:
        if args.only and not any(part in case.label for part in args.only):
            continue
        for seed in range(args.first, args.first + args.seeds):
            show(case, seed, outcome(case, seed))


if __name__ == "__main__":
    main()
