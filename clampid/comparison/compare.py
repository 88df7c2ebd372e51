"""Comparison of a model with a campaign: errors of each table, on fitted and on held-out rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from clampid.comparison.compensation import Compensation, compensation_of
from clampid.comparison.placing import placing
from clampid.comparison.table_errors import table_errors
from clampid.effect import Stage
from clampid.fitting.accuracy import cross_validated, noise_floor, predicted
from clampid.fitting.fit import fit, without_outlying
from clampid.identification.fitted_stage import fit_stage
from clampid.identification.identify import held_out_folds
from clampid.identification.model_on_campaign import ModelOnCampaign, on_campaign
from clampid.models.agreement import Agreement, agreement_of, shared_drives
from clampid.models.curves import angle_errors, shared_curve
from clampid.models.model import Model, ModelError, StageModel
from clampid.models.ranges import beyond_rows
from clampid.progress import in_parts
from clampid.role_slots import slot_of
from clampid.shown import Shown
from clampid.slots import Prior, Slot, unit_of
from clampid.stages.fit_problem import fit_problem
from clampid.stages.rows import Array, Bools, Rows
from clampid.stages.stage_kind import kind_of, known_of, only_of
from clampid.threads import single_threaded
from experiments.campaign import Campaign

__all__ = ["Comparison", "compare"]


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """Errors of a model on a campaign.

    Attributes
    ----------
    model, campaign
        Names of the robot and of the campaign.
    tables
        Table → its errors, SI, as in the JSON of ``compare``.
    drives, drives_p
        Agreement of clamped sweeps and poses on springs and clearances, and the p-value of all together; empty and
        None if the model or the campaign does not have both.
    compensation
        The share of the model's deflections in the poses, and a mistake in their compensation; None if unknown.
    units
        Slot → unit of the parameters in ``drives``, on this robot.
    """

    model: str
    campaign: str
    tables: dict[str, dict[str, Any]]
    drives: tuple[Agreement, ...] = ()
    drives_p: float | None = None
    compensation: Compensation | None = None
    units: Mapping[Slot, str] = field(default_factory=dict)

    def title(self) -> str:
        """The comparison in one line."""
        return f"{self.model} against {self.campaign}: {', '.join(self.tables)}"

    def records(self) -> list[dict[str, Any]]:
        """The errors of each table as records, on all its rows and on held-out rows."""
        keys = ("rows", "rms", "mean", "max", "p95")
        out = []
        for name, table in self.tables.items():
            for which, part in (("all", table), ("held out", table.get("heldout") or {})):
                numbers = {key: part.get(key) for key in keys}
                out.append({"table": name, "rows_of": which, "unit": table["unit"], **numbers,
                            "noise_floor": table.get("noise_floor")})  # fmt: skip
        return out

    def errors(self) -> dict[str, tuple[str, dict[str, float | None]]]:
        """Table → unit and rms errors."""
        return {
            name: (t["unit"], {"all rows": t.get("rms"), "held out": (t.get("heldout") or {}).get("rms"),
                               "noise floor": t.get("noise_floor")})
            for name, t in self.tables.items()
        }  # fmt: skip

    def to_json(self) -> dict[str, Any]:
        """The comparison for JSON."""
        data: dict[str, Any] = {"model": self.model, "campaign": self.campaign, "tables": self.tables}
        if self.drives:
            each = [{**a.to_json(), "unit": self.units[a.slot]} for a in self.drives]
            data["drives"] = {"p_value": self.drives_p, "parameters": each}
        if self.compensation is not None:
            data["compensation"] = self.compensation.to_json()
        return data


@single_threaded
def compare(
    model: Model,
    campaign: Campaign,
    *,
    refit: Sequence[str] = (),
    refit_fraction: float = 0.2,
    seed: int = 0,
    user_effects: Path | None = None,
    sample: Sequence[float] | None = None,
) -> Comparison:
    """Compare a model with a campaign: errors of fitted and held-out rows, and the noise floor.

    Parameters
    ----------
    model, campaign
        The model and the campaign.
    refit
        ``base``, ``tool`` or both: only these are fitted to the campaign's poses.
    refit_fraction
        Share of whole poses for this fit, between 0 and 1; all others are held out.
    seed
        For the choice of held-out rows and cross-validation.
    user_effects
        File or folder of the user's own effects.
    sample
        Position x, y, z of a sample, m, robot base frame: held-out errors of poses are split into their radial and
        tangential parts about it.

    Raises
    ------
    ModelError
        The model cannot be applied to the campaign.
    ValueError
        ``refit`` names something else, the share is not between 0 and 1, or ``sample`` is given without poses.
    """
    for part in refit:
        if part not in ("base", "tool"):
            raise ValueError(f"refit: expected base or tool, found {part!r}")
    if refit and not 0.0 < refit_fraction < 1.0:
        raise ValueError(f"refit_fraction: expected a share between 0 and 1, found {refit_fraction}")
    opened = on_campaign(model, campaign, user_effects)
    tables: dict[str, dict[str, Any]] = {}
    for stage in in_parts(opened.stages, str):
        if not any(t in campaign.tables for t in kind_of(stage).tables):
            continue
        if kind_of(stage).points and (refit or opened.session is None):
            if not refit and opened.session is None:
                raise ModelError(
                    f"the model was not fitted on {campaign.name}: the positions of its instrument and targets are "
                    "unknown; use --refit base,tool"
                )
            tables |= _refitted(opened, refit, refit_fraction, seed, sample)
        else:
            tables |= _as_fitted(opened, stage, seed, sample)
    if sample is not None and "poses" not in tables:
        raise ValueError(f"sample: expected a campaign with poses, {campaign.name} has none that the model predicts")
    drives: tuple[Agreement, ...] = ()
    drives_p = None
    own = None if refit else _independent_drives(opened)
    if own is not None:
        drives, drives_p = agreement_of(*own)
    units = {a.slot: unit_of(a.slot, opened.effects, campaign.robot) for a in drives}
    return Comparison(model.robot, campaign.name, tables, drives, drives_p, compensation_of(opened), units)


def _independent_drives(opened: ModelOnCampaign) -> tuple[StageModel, StageModel] | None:
    """The clamped stage and the pose stage, fitted independently of each other; None if one of them is missing."""
    here = {s: m for s, m in opened.stages.items() if s in opened.campaign.tables}
    clamped, poses = known_of(here, "solved"), known_of(here, "points")
    if clamped is None or poses is None or opened.session is None:
        return None
    if not shared_drives(clamped.slots, poses.slots):
        return None
    before = {name: stage for name, stage in opened.stages.items() if name not in (clamped.stage, poses.stage)}
    alone = []
    for stage in (clamped, poses):
        if stage is clamped and stage.carried_prior is None:  # fitted stage by stage, it is independent of the poses
            alone.append(stage)
            continue
        rows, held_out = opened.rows(stage.stage), opened.held_out(stage.stage)
        alone.append(fit_stage(rows, opened.effects, stage.terms, before, stage.values(), held_out).model)
    return alone[0], alone[1]


def _as_fitted(
    opened: ModelOnCampaign, stage: Stage, seed: int, sample: Sequence[float] | None
) -> dict[str, dict[str, Any]]:
    """Table → errors of a stage with the model's values."""
    model = opened.stages[stage]
    rows = opened.rows(stage)
    bad = np.zeros(len(rows), dtype=bool)
    for _, table, row in model.outliers:
        bad |= (rows.table == table) & (rows.row == row)
    rows = rows.without(bad)
    trial = opened.fit_problem(stage, rows)
    residual = predicted(trial, model.theta)
    floor = noise_floor(rows, residual)
    held_out = opened.held_out(stage)
    fitted = ~rows.in_folds(held_out) if opened.session is not None else np.zeros(len(rows), dtype=bool)
    verification = opened.verification() if kind_of(stage).points else None

    @cache
    def kept_out() -> tuple[Rows, Array, Bools]:
        """Rows, their residual, and which are held out; by cross-validation if the model was fitted on all rows."""
        if opened.session is None or any(held_out):
            return rows, residual, ~fitted
        estimate = opened.refit(stage, settled=True).with_best_weights(seed).estimate
        test, left = cross_validated(estimate, estimate.problem.rows, seed)
        return test, left, np.ones(len(test), dtype=bool)

    out = {}
    for table in kind_of(stage).tables:
        if table not in opened.campaign.tables:
            continue
        own = rows.table == table
        shown = own & (fitted if fitted.any() else True)
        if table == stage and verification is not None:
            test_residual = predicted(trial.with_rows(verification), model.theta)
            test = without_outlying(verification, test_residual, rows, residual)
            chosen = np.ones(len(test), dtype=bool)
        else:
            test, test_residual, tested = kept_out()
            chosen = tested & (test.table == table)
        if kind_of(stage).points:
            floor = noise_floor(rows.take(own), residual[own])
        out[table] = table_errors(rows, residual, shown, test, test_residual, chosen, floor)
        if kind_of(stage).points:
            out[table] |= _extrapolation(opened, test, chosen)
        if kind_of(stage).points and table == stage:
            out[table] |= _placed(opened, rows, residual, test, test_residual, chosen, sample)
    return out


def _placed(
    opened: ModelOnCampaign,
    rows: Rows,
    residual: Array,
    test: Rows,
    test_residual: Array,
    chosen: Bools,
    sample: Sequence[float] | None,
) -> dict[str, Any]:
    """The fields for measured points, without distances."""
    kept = ~test.ranged
    found = test_residual[kept], chosen[kept]
    return placing(rows.points, residual[~rows.ranged], test.points, *found, opened.effects, sample)


def _refitted(
    opened: ModelOnCampaign, refit: Sequence[str], share: float, seed: int, sample: Sequence[float] | None
) -> dict[str, dict[str, Any]]:
    """Table → errors of the poses, with only base, tool or both fitted on a share of whole poses."""
    model, rows = only_of(opened.stages, "points"), opened.rows("poses")
    held_out = held_out_folds(rows, 1.0 - share, seed)
    out = rows.in_folds(held_out)
    if not (~out).any() or not out.any():
        raise ModelError(f"{opened.campaign.name}: too few poses to refit on a share of {share:g} of them")
    moved = _refitted_slots(opened, rows, refit)
    slots = (*(s for s in model.slots if s not in moved), *moved)
    known = model.values()
    values = np.array([known.get(s, 0.0) for s in slots])
    fixed = tuple(s for s in slots if s not in moved)
    # All other parameters are fixed at the model's values, by a prior as narrow as rounding allows.
    trial = fit_problem(rows.take(~out), opened.effects, slots, model.lean)
    size = trial.sizes()[: len(fixed)]
    prior = Prior(fixed, values[: len(fixed)], np.diag((1e-7 * size) ** 2))
    estimate = fit(trial, (prior,), dict(zip(slots, values.tolist(), strict=True)))
    residual = predicted(trial.with_rows(rows), estimate.theta)
    found: dict[str, dict[str, Any]] = {}
    for table in dict.fromkeys(rows.table.tolist()):
        own = rows.table == table
        floor, chosen = noise_floor(rows.take(own), residual[own]), own & out
        found[table] = table_errors(rows, residual, own & ~out, rows, residual, chosen, floor)
        found[table] |= _extrapolation(opened, rows, chosen)
        if table == rows.stage:
            found[table] |= _placed(opened, rows, residual, rows, residual, chosen, sample)
    return found


def _extrapolation(opened: ModelOnCampaign, rows: Rows, chosen: Bools) -> dict[str, Any]:
    """Fields on extrapolation: held-out rows outside the ranges that the model was identified on.

    A field is missing if the model has no ranges, or no curves of angle errors.
    """
    curves = _curve_extrapolation(opened, rows, chosen)
    entry: dict[str, Any] = {} if curves is None else {"extrapolated": curves}
    stage = only_of(opened.stages, "points")
    if stage.ranges is not None:
        far, found = beyond_rows(stage.ranges, rows.take(chosen), stage.slots, opened.effects)
        quantities = [{**one.to_json(), "rows": count} for one, count in found]
        entry["extrapolating"] = {"rows": int(far.sum()), "of": len(far), "quantities": quantities}
    return entry


def _curve_extrapolation(opened: ModelOnCampaign, rows: Rows, chosen: Bools) -> dict[str, Any] | None:
    """Share of the held-out rows at joint angles far from all fitted poses, in all and for each joint.

    For joints that share one curve, a pose of any of them counts for all. None if the model has no curves of angle
    errors.
    """
    q = rows.signals["q"][chosen]
    found = angle_errors(only_of(opened.stages, "points"), opened.effects, opened.layout, rows.robot, q)
    if not found.active.any() or not len(q):
        return None
    far = found.extrapolated
    joints = {f"joint{j + 1}": float(far[:, j].mean()) for j in np.flatnonzero(far.any(axis=0))}
    one = shared_curve(only_of(opened.stages, "points"), opened.effects, np.zeros(1))
    together = {} if one is None else {"one_curve": [f"joint{j + 1}" for j in one.joints]}
    return {"share": float(far.any(axis=1).mean()), "joints": joints, **together}


def _refitted_slots(opened: ModelOnCampaign, rows: Rows, refit: Sequence[str]) -> tuple[Slot, ...]:
    """The slots of base or tool that are fitted to this campaign."""
    found: list[Slot] = []
    session = opened.layout.sessions[0]
    if "base" in refit:  # anchors are fixed to the instrument, so they are fitted with the base
        found += [slot_of("anchor_point", anchor, a) for anchor in opened.layout.anchors for a in "xyz"]
    if "base" in refit and not rows.ranged.all():
        found += [slot_of("base_frame", session, a) for a in ("x", "y", "z", "rx", "ry", "rz")]
    if "tool" in refit:
        if rows.oriented:
            found += [slot_of("flange_frame", session, a) for a in ("x", "y", "z", "rx", "ry", "rz")]
        found += [slot_of("target_point", t, a) for t in opened.layout.targets for a in "xyz"]
    return tuple(found)
