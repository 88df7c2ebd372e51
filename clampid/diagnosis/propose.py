"""Chooses the next measurements: to distinguish candidates, or to test parameters that the rows test too weakly."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from clampid.diagnosis.next_measurement import ENOUGH, SAME, Gain, NextPlan
from clampid.diagnosis.parting import Showing, part, show
from clampid.diagnosis.pools import Pool, seen_of
from clampid.diagnosis.refit_signals import Rivals
from clampid.effect import Parameter
from clampid.evidence.candidates import Candidate
from clampid.evidence.score import Scored
from clampid.fitting.solve import Estimate

__all__ = ["PoolOf", "Weak", "parting_aim", "propose_parting", "propose_testing"]

PoolOf = Callable[[Sequence[Candidate], str], Pool]
"""The pool of a stage, given the candidates and whether the robot is ``warm`` or ``cold``."""


@dataclass(frozen=True)
class Weak:
    """A parameter that the rows test too weakly.

    Attributes
    ----------
    scored, index
        The candidate, and which of its slots.
    noncentrality
        The noncentrality that is found with 90 % power.
    parameter
        With its size for this robot.
    aim
        The size that is to be found, parameter units.
    """

    scored: Scored
    index: int
    noncentrality: float
    parameter: Parameter
    aim: float


def propose_parting(
    pool_of: PoolOf, estimate: Estimate, rivals: Sequence[Scored], scale: float, states: Sequence[str]
) -> NextPlan | None:
    """Choose measurements that distinguish candidates; None if fewer than two of them have a size.

    If these rows were expected to distinguish them and did not, which happens in 1 of 10 campaigns, the same amount of
    evidence is aimed at again.

    Parameters
    ----------
    scale
        Standard deviation of the whitened residual.
    states
        In which the robot may be measured, the more convenient first.
    """
    wanted = [s for s in rivals if s.freedom]
    if len(wanted) < 2:
        return None
    candidates = [s.candidate for s in wanted]
    seen = seen_of(estimate, candidates)
    prior = np.zeros((seen.nuisance.shape[1],) * 2)  # it is among the rows
    best: NextPlan | None = None
    for state in states:
        pool = pool_of(candidates, state)
        choose = partial(
            part,
            Rivals(seen.nuisance / scale, [D / scale for D in seen.columns], [s.value for s in wanted], prior),
            pool.nuisance / scale,
            [D / scale for D in pool.columns],
            batch=pool.batch,
            most=pool.most,
            cost=pool.cost,
        )
        found = choose(enough=ENOUGH)
        if not found.chosen and found.before >= ENOUGH:
            found = choose(enough=found.before + ENOUGH)
        helps = found.after >= ENOUGH
        wished = parting_aim("; ".join(c.label for c in candidates), found.before, found.after)
        new = NextPlan(
            aim="parting",
            chosen=found.chosen,
            tried=len(pool),
            state=state,
            what=pool.what,
            words=pool.words(found.chosen) if helps else "",
            plan=pool.plan(found.chosen, wished) if helps else None,
            before=found.before,
            after=found.after,
            shared=found.shared,
            never=tuple((candidates[a].label, candidates[b].label, share, left) for a, b, share, left in found.never),
        )
        if best is None or _better(new, best):
            best = new
    return best


def parting_aim(parts: str, before: float, after: float) -> dict[str, float | int | str]:
    """The aim of a plan that distinguishes candidates, in words: which, and the evidence without and with it."""
    return {"parts": parts, "evidence_before": before, "evidence_after": after, "evidence_needed": SAME}


def _better(new: NextPlan, best: NextPlan) -> bool:
    """Whether one proposal is to be preferred to an earlier one."""
    if new.helps != best.helps:
        return new.helps
    if len(new.never) != len(best.never):
        return len(new.never) < len(best.never)
    if not new.helps:
        return new.after > best.after
    if new.plan is None or best.plan is None or len(new.chosen) != len(best.chosen):
        return len(new.chosen) < len(best.chosen)
    return new.plan.duration < best.plan.duration - 1.0


def propose_testing(
    pool_of: PoolOf, estimate: Estimate, weak: Sequence[Weak], scale: float, states: Sequence[str]
) -> NextPlan | None:
    """Choose measurements that test parameters which these rows test too weakly; None where there are none."""
    if not weak:
        return None
    scored = list({id(w.scored): w.scored for w in weak}.values())
    candidates = [s.candidate for s in scored]
    seen = seen_of(estimate, candidates)
    at = [next(k for k, s in enumerate(scored) if s is w.scored) for w in weak]
    signals = [seen.columns[k][:, w.index] * (w.aim / scale) for k, w in zip(at, weak, strict=True)]
    best: NextPlan | None = None
    for state in states:
        pool = pool_of(candidates, state)
        more = [pool.columns[k][..., w.index] * (w.aim / scale) for k, w in zip(at, weak, strict=True)]
        enough = [
            w.noncentrality * _shared_noise(w, seen.nuisance / scale, y) for w, y in zip(weak, signals, strict=True)
        ]
        found = show(
            seen.nuisance / scale,
            signals,
            pool.nuisance / scale,
            more,
            enough,
            batch=pool.batch,
            most=pool.most,
            cost=pool.cost,
        )
        new = _tested(pool, state, weak, signals, more, found, np.array(enough))
        if best is None or _reached(new) > _reached(best):
            best = new
    return best


def _shared_noise(w: Weak, nuisance: np.ndarray, signal: np.ndarray) -> float:
    """Variance of an amplitude with noise that a unit's entries share, over that with independent noise."""
    limit = float(w.scored.unit_limit[w.index]) if len(w.scored.unit_limit) > w.index else np.inf
    if not np.isfinite(limit):
        return 1.0
    left = signal - nuisance @ np.linalg.lstsq(nuisance, signal, rcond=None)[0]
    return max(float((limit / w.aim) ** 2 * (left @ left)), 1.0)


def _reached(found: NextPlan) -> tuple[int, int]:
    return sum(g.possible and g.after <= g.aim for g in found.gains), -len(found.chosen)


def _tested(
    pool: Pool,
    state: str,
    weak: Sequence[Weak],
    signals: Sequence[np.ndarray],
    more: Sequence[np.ndarray],
    found: Showing,
    enough: np.ndarray,
) -> NextPlan:
    """The proposal with its gain, parameter by parameter."""
    chosen = list(found.chosen)
    gains = []
    for k, w in enumerate(weak):
        whole = float(signals[k] @ signals[k])
        with_plan = whole + float(np.sum(more[k][chosen] ** 2))

        def limit(left: float, k: int = k, aim: float = w.aim) -> float:
            return float(aim * np.sqrt(enough[k] / left)) if left > 1e-9 * enough[k] else float("inf")

        gains.append(
            Gain(
                name=w.scored.candidate.slots[w.index].label,
                unit=w.parameter.unit,
                size=w.parameter.size,
                before=limit(found.before[k]),
                after=limit(found.after[k]),
                best=limit(found.most[k]),
                aim=w.aim,
                retained=(_share(found.before[k], whole), _share(found.after[k], with_plan)),
            )
        )
    wished: dict[str, float | int | str] = {"tests": "; ".join(g.name for g in gains if g.possible)}
    return NextPlan(
        aim="testing",
        chosen=found.chosen,
        tried=len(pool),
        state=state,
        what=pool.what,
        words=pool.words(chosen) if chosen else "",
        plan=pool.plan(chosen, wished) if chosen else None,
        gains=tuple(gains),
    )


def _share(left: float, whole: float) -> float:
    return float(np.clip(left / whole, 0.0, 1.0)) if whole > 0.0 else 0.0
