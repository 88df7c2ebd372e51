"""The shape of an unexplained error: its dependence on the variables that the verdict names, with a confidence band.

The shape is the effect that ``clampid effect new`` would write for these variables at this place, fitted to the
residual in one linear step together with all active parameters. The score-BIC selects its order of harmonics or powers.
The band is simultaneous: with 95 % probability it contains the whole curve. Its width follows from the scatter of the
residuals from unit to unit (poses, blocks of a log), so it needs no noise model.

Source of the covariance: White, Econometrica 48, 1980, with units for rows (Liang and Zeger, Biometrika 73, 1986) and
MacKinnon and White's jackknife (J. Econometrics 29, 1985); of the band: the maximum of a Gaussian process over the
curve, by simulation.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np

from clampid.diagnosis.dependence import Dependence, Variable, dependence
from clampid.diagnosis.effect_new import JOINTS, effect_module, effect_text
from clampid.effect import EffectError
from clampid.evidence.candidates import Candidate, named_candidates
from clampid.evidence.columns import Columns
from clampid.evidence.score import Scored, score
from clampid.evidence.space import Space
from clampid.fitting.solve import Estimate
from clampid.stages.rows import Array, Rows

__all__ = ["shape_of"]

FINEST = (8, 3)  # orders tried of one variable, and of each of two
MOST_VARIABLES = 2  # variables; a shape over more of them cannot be drawn
GRID_POINTS = 61
COVERED = 0.95
BAND_DRAWS = 4000
SINGULAR = 1e-6  # of a direction that only one unit determines
EDGES = (0.01, 0.99)  # of a variable's values: beyond them there are hardly any rows
SECTIONS = (0.1, 0.5, 0.9)  # of the second variable, at which the curve over the first is drawn


@dataclass(frozen=True)
class _Fitted:
    """Factors of the terms ``(k,)`` with a root of their covariance ``(k, f)``."""

    orders: int
    module: ModuleType
    scored: Scored
    factors: Array
    root: Array


def shape_of(
    estimate: Estimate, space: Space, probe: Scored, depends_on: Sequence[str], seed: int
) -> dict[str, Any] | None:
    """The shape of a probe's error, as in the JSON of ``diagnose``; None where there is none to show.

    Parameters
    ----------
    space
        The residual, and the columns of the active parameters, which can absorb parts of it.
    probe
        The best probe: its place is where the shape sits.
    depends_on
        Variables by column name; of more than two the probe's own go first.
    """
    found = _dependence(estimate, probe, depends_on)
    if found is None:
        return None
    fitted = _fit(estimate, space, found)
    if fitted is None:
        return None
    names = [v.name for v in found.variables]
    name = fitted.module.EFFECT.name
    command = f"clampid effect new {name} --depends-on {','.join(names)} --at {found.place.name}"
    joints = estimate.problem.rows.robot.n
    command += f" --joints {joints}" if joints > JOINTS else ""
    return {
        "name": name,
        "at": found.place.name,
        "depends_on": names,
        "orders": fitted.orders,
        "explained": fitted.scored.explained,
        "share": float(np.sum(fitted.scored.amplitude**2) / max(float(space.residual @ space.residual), 1e-300)),
        "band": "95 %, simultaneous",
        "curves": list(_curves(estimate.problem.rows, found, fitted, seed)),
        "command": f"{command} --stage {found.stage} --orders {fitted.orders}",
    }


def _dependence(estimate: Estimate, probe: Scored, depends_on: Sequence[str]) -> Dependence | None:
    """The probe's place and at most two variables; None where nothing can act there as an effect of its own."""
    own = probe.candidate.depends_on
    if len(probe.candidate.places) != 1:
        return None
    names = list(dict.fromkeys([*own, *depends_on]))[: max(MOST_VARIABLES, 1)]
    try:
        return dependence(names, probe.candidate.places[0], estimate.problem.stage)
    except EffectError:
        return None


def _fit(estimate: Estimate, space: Space, found: Dependence) -> _Fitted | None:
    """Fit the finest shape's terms at once, and keep the orders whose score-BIC is best."""
    known = estimate.problem.effects
    name = next(n for k in range(1, 100) if (n := f"unknown_{found.place.name}{f'_{k}' if k > 1 else ''}") not in known)
    names = [v.name for v in found.variables]

    def module_of(orders: int) -> ModuleType:
        return effect_module(effect_text(name, names, found.place.name, stage=found.stage, orders=orders))

    graded = any(v.basis not in ("sign", "sliding") for v in found.variables)
    modules = {k: module_of(k) for k in range(1, (FINEST[len(names) - 1] if graded else 1) + 1)}
    effect = modules[max(modules)].EFFECT
    trial = replace(estimate, problem=replace(estimate.problem, effects={**known, name: effect}))
    whole = next(iter(named_candidates(trial, {name: effect})), None)
    if whole is None:
        return None
    tried = {k: score(space, [_part(whole, m)])[0] for k, m in modules.items()}
    orders = max(tried, key=lambda k: tried[k].bic)
    best = tried[orders]
    if not best.freedom:
        return None
    root = best.weights @ _scatter(space, best)
    return _Fitted(orders, modules[orders], best, best.weights @ best.amplitude, root)


def _part(whole: Candidate, module: ModuleType) -> Candidate:
    """The terms of a coarser shape among those of a finer one."""
    wanted = {p.name for p in module.EFFECT.parameters}
    chosen = [k for k, slot in enumerate(whole.slots) if slot.parameter in wanted]
    pieces = whole.columns.pieces if isinstance(whole.columns, Columns) else ()
    columns = Columns(tuple((start, block[:, chosen]) for start, block in pieces), len(chosen))
    slots = tuple(whole.slots[k] for k in chosen)
    return replace(whole, slots=slots, columns=columns, reasonable=None)  # its size is unknown


def _scatter(space: Space, s: Scored) -> Array:
    """A root ``(f, f)`` of the covariance of the amplitudes, from the influence of each unit of rows.

    A unit's residual is that of the fit without the unit (the jackknife), because the residual of the full fit is too
    small, the more so with few rows: r + B (1 - B'B)^-1 B'r with B the unit's rows of all orthonormal directions.
    """
    directions = s.directions(space.basis)
    left = space.residual - directions @ s.amplitude
    every = np.hstack([space.basis, directions])
    order = np.argsort(space.unit[: space.rows], kind="stable")  # a prior's pseudo-rows have no scatter
    edges = np.flatnonzero(np.diff(space.unit[order])) + 1
    pulls = []
    for rows in np.split(order, edges):
        B, r = every[rows], left[rows]
        K = (1.0 + SINGULAR) * np.eye(B.shape[1]) - B.T @ B
        alone = r + B @ np.linalg.solve(K, B.T @ r)
        pulls.append(directions[rows].T @ alone)
    values, vectors = np.linalg.eigh(np.transpose(pulls) @ np.array(pulls))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _curves(rows: Rows, found: Dependence, fitted: _Fitted, seed: int) -> Iterator[dict[str, Any]]:
    """The shape over its first variable, at several values of the other; axis by axis where the place has several."""
    measured = [_observed(v, rows) for v in found.variables]
    middle = _terms(fitted.module, found.variables, measured).mean(axis=0)
    first = next((k for k, v in enumerate(found.variables) if v.basis != "sign"), 0)
    grid = _grid(found.variables[first], measured[first])
    others = [k for k in range(len(measured)) if k != first]
    parameters = [slot.parameter for slot in fitted.scored.candidate.slots]
    terms = list(fitted.module.shape(*(0.0 for v in found.variables for _ in v.arguments)))
    sections = list(product(*(_sections(found.variables[k], measured[k]) for k in others)))
    for axis, unit in found.place.units.items():
        prefix = "" if len(found.place.units) == 1 else f"{axis}_"
        own = [parameters.index(prefix + term) for term in terms]
        factors, root = fitted.factors[own], fitted.root[own]
        tables = []
        for section in sections:
            at = [np.full(len(grid), np.nan)] * len(measured)
            at[first] = grid
            for k, value in zip(others, section, strict=True):
                at[k] = np.full(len(grid), value)
            tables.append(_terms(fitted.module, found.variables, at) - middle)
        wide = _width(np.vstack(tables) @ root, seed)
        for section, table in zip(sections, tables, strict=True):
            value, half = table @ factors, wide * np.linalg.norm(table @ root, axis=1)
            yield {
                "variable": found.variables[first].name,
                "variable_unit": found.variables[first].unit,
                "given": {found.variables[k].name: float(v) for k, v in zip(others, section, strict=True)},
                "axis": axis,
                "unit": unit,
                "x": grid.tolist(),
                "value": value.tolist(),
                "low": (value - half).tolist(),
                "high": (value + half).tolist(),
            }


def _width(root: Array, seed: int) -> float:
    """Half width, in standard errors, of a band that contains all points ``(G, f)`` at once with 95 % probability."""
    spread = np.linalg.norm(root, axis=1)
    varying = spread > 1e-12 * max(float(spread.max(initial=0.0)), 1e-300)
    if not varying.any():
        return 0.0
    draws = np.random.default_rng(seed).standard_normal((root.shape[1], BAND_DRAWS))
    largest = np.abs((root[varying] / spread[varying, None]) @ draws).max(axis=0)
    return float(np.quantile(largest, COVERED))


def _grid(v: Variable, values: Array) -> Array:
    """Values of a variable at which the curve is drawn: over the range of the rows, or both directions."""
    if v.basis == "sign":
        return np.array([-1.0, 1.0])
    low, high = np.quantile(values, EDGES)
    return np.linspace(low, high, GRID_POINTS)


def _sections(v: Variable, values: Array) -> list[float]:
    """Values of the other variable at which the curve is drawn."""
    if v.basis == "sign":
        return [-1.0, 1.0]
    return [float(q) for q in np.unique(np.quantile(values, SECTIONS))]


def _terms(module: ModuleType, variables: Sequence[Variable], values: Sequence[Array]) -> Array:
    """The terms ``(N, k)`` of a shape at values ``(N,)`` of its variables, SI."""
    arguments = []
    for v, x in zip(variables, values, strict=True):
        if v.basis == "sliding":
            arguments.append(ca.DM(np.sign(x)))
        arguments.append(ca.DM(x / v.scale))
    found: Mapping[str, Any] = module.shape(*arguments)
    return np.column_stack([np.asarray(term).ravel() for term in found.values()])


def _observed(v: Variable, rows: Rows) -> Array:
    """The values ``(N,)`` of a variable in the rows, SI."""
    signal = v.signals[-1]
    if signal == "torque":
        return _load(v, rows)
    values = np.asarray(rows.signals[signal], dtype=float)
    return values if v.index is None else values[:, v.index]


def _load(v: Variable, rows: Rows) -> Array:
    """The load of a joint in poses, of a motor elsewhere: from the description, or measured by a clamped motor."""
    index = v.index or 0
    if rows.kind.points:
        return np.asarray(rows.signals["gravity_torque"][:, index])
    if rows.kind.moving:
        return np.asarray((rows.signals["gravity_torque"] @ np.asarray(rows.robot.transmission).T)[:, index])
    return np.asarray(rows.measured[:, index])
