"""Effects that sit somewhere along a joint's angle and are nothing elsewhere, tried at every place that poses visited.

A place's column is what the joint's angle does to the measurement times the effect's shape about that place, so that
the effect is evaluated once and a place costs a sparse product. All places of all joints are in the dictionary: the
null takes their maximum along, over the very flips that the other candidates have, and of each joint the best place
becomes a candidate that pays, beside its amplitude, for having been chosen among all of that joint's places. A place
needs visits that tell it: what one visit shows is that visit's own.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
from scipy import sparse

from clampid.effect import Effect
from clampid.evidence.candidates import Candidate
from clampid.evidence.columns import Columns, channel_starts
from clampid.evidence.score import WEAK, Flips, Scored, Space, flip_signs, score, space_of, tails_of
from clampid.fitting.noise import Whitened
from clampid.fitting.solve import Estimate
from clampid.slots import Slot, Term
from clampid.stages import poses
from clampid.stages.experiment import parameter_of
from clampid.stages.rows import Array

__all__ = ["FEWEST_VISITS", "place_of", "scan"]

FEWEST_VISITS = 4  # that show half of a bump or more: a height, a middle and a width, and one that may contradict them
TABLE = 3600  # angles a turn at which a shape is tabulated
STEP = 2.0 / 3.0  # of a shape's width at half of its height, from place to place: at most a tenth of it is missed


@dataclass(frozen=True)
class _Tried:
    """Every place of one joint: values of its shapes, whitened columns ``(M, C)``, and their scores.

    Attributes
    ----------
    explained, log_p
        ``(C,)``: as of :class:`clampid.evidence.score.Scored`.
    parts
        ``(U, C)``: each unit's in the null.
    mean, variance
        ``(C,)``: moments of what is explained in the null.
    """

    effect: Effect
    joint: int
    shapes: tuple[Mapping[str, float], ...]
    columns: sparse.csc_matrix
    explained: Array
    parts: Array
    mean: Array
    variance: Array


def scan(
    estimate: Estimate, space: Space, effects: Mapping[str, Effect], flips: int, seed: int
) -> tuple[list[Scored], Flips]:
    """Each scanned effect at the best place of each joint that lacks it, and the maxima of all places in the null.

    Parameters
    ----------
    flips, seed
        Those of the named candidates: the same signs.
    """
    tried = _all_places(estimate, space, effects)
    if not tried:
        return [], Flips(np.zeros(flips))
    signs = flip_signs(space, flips, seed)
    maxima = np.zeros(flips)
    found = []
    for t in tried:
        flipped = (signs @ t.parts) ** 2
        maxima = np.maximum(maxima, -tails_of(t.mean, t.variance, flipped).min(axis=1))
        s = score(space, [_candidate(estimate, t, int(np.argmax(t.explained)))])[0]
        chosen = 2.0 * float(np.log(len(t.shapes)))
        found.append(replace(s, cost=s.cost + chosen, bic=s.bic - chosen))
    return found, Flips(maxima)


def place_of(estimate: Estimate, effect: Effect, place: str) -> dict[Slot, float]:
    """Shapes of an effect at the likeliest place of a joint, which an estimate leaves out; empty where none shows it."""
    tried = _all_places(estimate, space_of(estimate), {effect.name: effect}, (place,))
    if not tried:
        return {}
    best = tried[0].shapes[int(np.argmax(tried[0].explained))]
    return {Slot(effect.name, name, place): value for name, value in best.items()}


def _all_places(
    estimate: Estimate, space: Space, effects: Mapping[str, Effect], only: Iterable[str] | None = None
) -> list[_Tried]:
    """Every place of every joint at which a scanned effect is not active."""
    rows, stage = estimate.experiment.rows, estimate.experiment.stage
    wanted = [e for e in effects.values() if e.scanned is not None and stage in e.stages]
    if stage != "poses" or not wanted:
        return []
    theta, offsets = estimate.theta[: len(estimate.slots)], estimate.experiment.chain.offsets
    _, sensitivity = poses.by_station(rows, poses.evaluate(rows, estimate.experiment.chain, theta))
    unit = sensitivity[:, :, offsets["joint_angle"]]
    levers = estimate.noise.whiten(rows, np.zeros(unit.shape[:2]), unit)
    active = {(slot.effect, slot.place) for slot in estimate.slots}
    found = []
    for effect in wanted:
        tables = _tables(effect)
        for j, joint in enumerate(rows.robot.joints):
            place = f"joint{j + 1}"
            if (effect.name, place) in active or (only is not None and place not in only):
                continue
            if effect.tried_on in (None, joint.kind):
                tried = _places(estimate, space, effect, j, levers, tables)
                found += [] if tried is None else [tried]
    return found


def _tables(effect: Effect) -> list[tuple[Mapping[str, float], Array]]:
    """What a unit of the amplitude is over a turn ``(TABLE,)`` from its middle on, for each value of the other shapes."""
    shapes = [p for p in effect.parameters if p.shape and p.name != effect.scanned]
    amplitude = next(p for p in effect.parameters if not p.shape)
    angle = ca.DM(np.arange(TABLE) * 2.0 * np.pi / TABLE)
    out = []
    for values in product(*(p.grid for p in shapes)):
        chosen = dict(zip((p.name for p in shapes), values, strict=True))
        p: Any = SimpleNamespace(**{amplitude.name: 1.0, str(effect.scanned): 0.0, **chosen})
        deviation = effect.acts["joint_angle"](p, SimpleNamespace(q=angle))
        out.append((chosen, np.asarray(deviation, dtype=float).ravel()))
    return out


def _places(
    estimate: Estimate,
    space: Space,
    effect: Effect,
    j: int,
    levers: Whitened,
    tables: list[tuple[Mapping[str, float], Array]],
) -> _Tried | None:
    """All places of one joint; None where no pose shows any."""
    rows = estimate.experiment.rows
    at = np.rint(np.mod(rows.signals["q"][:, j], 2.0 * np.pi) * TABLE / (2.0 * np.pi)).astype(np.int64)
    lever = levers.jacobian[:, j]
    seen = np.zeros(len(rows), dtype=bool)
    seen[levers.entry[lever != 0.0]] = True
    _, visit = np.unique(rows.unit, return_inverse=True)
    shapes: list[Mapping[str, float]] = []
    functions = []
    for chosen, table in tables:
        half = np.abs(table) > 0.5 * np.abs(table).max()
        for k in range(0, TABLE, max(1, int(STEP * half.sum()))):
            near = seen & half[(at - k) % TABLE]
            if len(np.unique(visit[near])) >= FEWEST_VISITS:
                middle = float(np.remainder(2.0 * np.pi * k / TABLE + np.pi, 2.0 * np.pi) - np.pi)
                shapes.append({str(effect.scanned): middle, **chosen})
                functions.append(table[(at - k) % TABLE])
    if not shapes:
        return None
    D = (sparse.diags(lever) @ sparse.csr_matrix(np.array(functions).T)[levers.entry]).tocsc()
    absorbed = np.asarray(D.T @ space.basis[: space.rows])  # (C, r)
    gram = np.asarray(D.multiply(D).sum(axis=0)).ravel()
    left = gram - np.sum(absorbed**2, axis=1)
    able = np.flatnonzero(left > WEAK * np.maximum(gram, 1e-300))
    if not len(able):
        return None
    D, absorbed, left = D[:, able], absorbed[able], left[able]
    size = space.scale * np.sqrt(left)
    parts = np.asarray((space.by_unit.over(0, space.rows) @ D).todense()) - space.basis_by_unit @ absorbed.T
    parts[space.drawn] = -(space.told[:, None] * space.basis[space.rows :]) @ absorbed.T
    parts = parts / size
    squares = parts**2
    mean = squares.sum(axis=0)
    variance = 2.0 * (mean**2 - np.sum(squares[~space.drawn] ** 2, axis=0))
    explained = np.asarray((D.T @ space.residual[: space.rows]) / size) ** 2
    return _Tried(effect, j, tuple(shapes[k] for k in able), D, explained, parts, mean, variance)


def _candidate(estimate: Estimate, tried: _Tried, best: int) -> Candidate:
    """One place as a candidate."""
    effect, place, white = tried.effect, f"joint{tried.joint + 1}", estimate.whitened
    amplitude = next(p for p in effect.parameters if not p.shape)
    slot = Slot(effect.name, amplitude.name, place)
    parameter = parameter_of(slot, estimate.experiment.effects, estimate.experiment.rows.robot)
    column = np.asarray(tried.columns[:, best].todense())
    pieces = tuple((start, column[start:stop]) for start, stop in channel_starts(white))
    return Candidate(
        name=effect.name,
        family=effect.family,
        terms=(Term(effect.name, place),),
        slots=(slot,),
        shapes={Slot(effect.name, name, place): value for name, value in tried.shapes[best].items()},
        columns=Columns(pieces, 1),
        depends_on=(),
        places=(place,),
        reasonable=np.array([parameter.size]),
        units=(parameter.unit,),
    )
