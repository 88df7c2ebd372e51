"""Comparison: model against measurement, table by table, fitted rows and held-out rows apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from clampid.comparison.compensation import Compensation, compensation_of
from clampid.comparison.placing import placing
from clampid.effect import Stage
from clampid.fitting.accuracy import Floor, cross_validated, noise_floor, predicted, size_of
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
    tables
        Table → what INTERFACE's JSON of ``compare`` has for it; SI.
    drives, drives_p
        Whether clamped sweeps and poses agree on springs and clearances, joint by joint, and the p-value of all
        together; empty and None where the model or the campaign does not have both.
    compensation
        How much of the model's deflections stands in the poses, and what mistake in a compensation that is.
    units
        Of the parameters in ``drives``, on this robot.
    """

    model: str
    campaign: str
    tables: dict[str, dict[str, Any]]
    drives: tuple[Agreement, ...] = ()
    drives_p: float | None = None
    compensation: Compensation | None = None
    units: Mapping[Slot, str] = field(default_factory=dict)

    def title(self) -> str:
        """What it is, in a line."""
        return f"{self.model} against {self.campaign}: {', '.join(self.tables)}"

    def records(self) -> list[dict[str, Any]]:
        """The errors of each table, on all its rows and on those held out."""
        keys = ("rows", "rms", "mean", "max", "p95")
        out = []
        for name, table in self.tables.items():
            for which, part in (("all", table), ("held out", table.get("heldout") or {})):
                numbers = {key: part.get(key) for key in keys}
                out.append({"table": name, "rows_of": which, "unit": table["unit"], **numbers,
                            "noise_floor": table.get("noise_floor")})  # fmt: skip
        return out

    def errors(self) -> dict[str, tuple[str, dict[str, float | None]]]:
        """Table → its errors."""
        return {
            name: (t["unit"], {"all rows": t.get("rms"), "held out": (t.get("heldout") or {}).get("rms"),
                               "noise floor": t.get("noise_floor")})
            for name, t in self.tables.items()
        }  # fmt: skip

    def to_json(self) -> dict[str, Any]:
        """For programs."""
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
    refit
        ``base``, ``tool`` or both: only these are fitted to the campaign's poses, on a share of whole poses; the rest
        is held out.
    sample
        x, y, z, m, robot base frame: a point about which held-out errors of poses are split into radial ones and those
        along the sphere.

    Raises
    ------
    ModelError
        The model does not fit the campaign.
    ValueError
        ``refit`` names something else, or the share is not between 0 and 1.
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
                    f"the model was not fitted on {campaign.name}, so that nothing says where its instrument and "
                    "targets stand: use --refit base,tool"
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
    """The clamped stage and the poses, fitted so that neither knows of the other; None where one of them is missing."""
    here = {s: m for s, m in opened.stages.items() if s in opened.campaign.tables}
    clamped, poses = known_of(here, "solved"), known_of(here, "points")
    if clamped is None or poses is None or opened.session is None:
        return None
    if not shared_drives(clamped.slots, poses.slots):
        return None
    before = {name: stage for name, stage in opened.stages.items() if name not in (clamped.stage, poses.stage)}
    alone = []
    for stage in (clamped, poses):
        if stage is clamped and stage.carried_prior is None:  # stage by stage it knows nothing of the poses anyway
            alone.append(stage)
            continue
        rows, held_out = opened.rows(stage.stage), opened.held_out(stage.stage)
        alone.append(fit_stage(rows, opened.effects, stage.terms, before, stage.values(), held_out).model)
    return alone[0], alone[1]


def _as_fitted(
    opened: ModelOnCampaign, stage: Stage, seed: int, sample: Sequence[float] | None
) -> dict[str, dict[str, Any]]:
    """Every table of a stage at the model's own values."""
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
        """Rows of these tables that no fit has seen, or each predicted by a fit without it."""
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
        out[table] = _table(rows, residual, shown, test, test_residual, chosen, floor)
        if kind_of(stage).points:
            out[table] |= _beyond(opened, test, chosen)
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
    """What is reported for points only."""
    kept = ~test.ranged
    found = test_residual[kept], chosen[kept]
    return placing(rows.points, residual[~rows.ranged], test.points, *found, opened.effects, sample)


def _table(
    rows: Rows,
    residual: Array,
    shown: Bools,
    test: Rows,
    test_residual: Array,
    chosen: Bools,
    floor: Floor,
) -> dict[str, Any]:
    poses, counts = rows.kind.points, rows.used.any(axis=1)
    entry: dict[str, Any] = {
        "unit": "m" if poses else "sigma",
        "rows": int((shown & counts).sum()),
        **_numbers(rows, residual, shown, floor),
        "noise_floor": floor.norm if poses else 1.0,
        "noise_source": floor.source,
    }
    if poses and rows.ranged[shown].any():
        entry["measured"] = "distances"
    seen = test.used.any(axis=1)
    entry["heldout"] = {"rows": int((chosen & seen).sum()), **_numbers(test, test_residual, chosen, floor)}
    wrong = chosen & ~seen & (test.table == "verification")
    if wrong.any():
        whole = np.linalg.norm(test_residual[chosen, :3], axis=1)
        entry["heldout"] |= {
            "outliers": test.row[wrong].tolist(),
            "rms_with_outliers": float(np.sqrt(np.mean(whole**2))),
        }
    if rows.kind.moving or rows.kind.solved:
        entry["per_motor"] = [
            {
                **_motor(rows, residual, shown, c),
                "noise_floor_Nm": float(floor.sigma[c]),
                "heldout": _motor(test, test_residual, chosen, c),
            }
            for c in range(rows.robot.n)
        ]
    return entry


def _numbers(rows: Rows, residual: Array, chosen: Bools, floor: Floor) -> dict[str, float | None]:
    size, counts = size_of(rows, residual, floor)
    picked = np.abs(size[chosen][counts[chosen]])
    if not picked.size:
        return {"rms": None, "mean": None, "max": None, "p95": None}
    return {
        "rms": float(np.sqrt(np.mean(picked**2))),
        "mean": float(np.mean(picked)),
        "max": float(np.max(picked)),
        "p95": float(np.quantile(picked, 0.95)),
    }


def _motor(rows: Rows, residual: Array, chosen: Bools, motor: int) -> dict[str, float | None]:
    used = chosen & rows.used[:, motor]
    if used.sum() < 2:
        return {"rms_Nm": None, "r2": None}
    r, y = residual[used, motor], rows.measured[used, motor]
    spread = float(np.sum((y - y.mean()) ** 2))
    r2 = 1.0 - float(np.sum(r**2)) / spread if spread > 0 else None
    return {"rms_Nm": float(np.sqrt(np.mean(r**2))), "r2": r2}


def _refitted(
    opened: ModelOnCampaign, refit: Sequence[str], share: float, seed: int, sample: Sequence[float] | None
) -> dict[str, dict[str, Any]]:
    """The poses with only base, tool or both fitted anew on a share of whole poses; the rest is held out."""
    model, rows = only_of(opened.stages, "points"), opened.rows("poses")
    held_out = held_out_folds(rows, 1.0 - share, seed)
    out = rows.in_folds(held_out)
    if not (~out).any() or not out.any():
        raise ModelError(f"{opened.campaign.name}: too few poses to refit on a share of {share:g} of them")
    moved = _moved_slots(opened, rows, refit)
    slots = (*(s for s in model.slots if s not in moved), *moved)
    known = model.values()
    values = np.array([known.get(s, 0.0) for s in slots])
    fixed = tuple(s for s in slots if s not in moved)
    # What is not fitted anew is fixed where the model has it, as tightly as numbers allow.
    trial = fit_problem(rows.take(~out), opened.effects, slots, model.lean)
    size = trial.sizes()[: len(fixed)]
    prior = Prior(fixed, values[: len(fixed)], np.diag((1e-7 * size) ** 2))
    estimate = fit(trial, (prior,), dict(zip(slots, values.tolist(), strict=True)))
    residual = predicted(trial.with_rows(rows), estimate.theta)
    found: dict[str, dict[str, Any]] = {}
    for table in dict.fromkeys(rows.table.tolist()):
        own = rows.table == table
        floor, chosen = noise_floor(rows.take(own), residual[own]), own & out
        found[table] = _table(rows, residual, own & ~out, rows, residual, chosen, floor)
        found[table] |= _beyond(opened, rows, chosen)
        if table == rows.stage:
            found[table] |= _placed(opened, rows, residual, rows, residual, chosen, sample)
    return found


def _beyond(opened: ModelOnCampaign, rows: Rows, chosen: Bools) -> dict[str, Any]:
    """How many of the held-out rows ask the model for what it was not identified on, and for what.

    Nothing of ranges that the model file does not have, nor of curves that the model does not have.
    """
    curves = _extrapolated(opened, rows, chosen)
    entry: dict[str, Any] = {} if curves is None else {"extrapolated": curves}
    stage = only_of(opened.stages, "points")
    if stage.ranges is not None:
        far, found = beyond_rows(stage.ranges, rows.take(chosen), stage.slots, opened.effects)
        quantities = [{**one.to_json(), "rows": count} for one, count in found]
        entry["extrapolating"] = {"rows": int(far.sum()), "of": len(far), "quantities": quantities}
    return entry


def _extrapolated(opened: ModelOnCampaign, rows: Rows, chosen: Bools) -> dict[str, Any] | None:
    """Which share of the held-out rows, joint by joint, stands at angles that no pose of the fit came near.

    Of joints on one curve a pose of any counts for all.

    None where the model has no angle errors that depend on where a joint stands.
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


def _moved_slots(opened: ModelOnCampaign, rows: Rows, refit: Sequence[str]) -> tuple[Slot, ...]:
    """The slots of base and tool in this campaign."""
    found: list[Slot] = []
    session = opened.layout.sessions[0]
    if "base" in refit:  # where anchors stand is as much the instrument's as that
        found += [slot_of("anchor_point", anchor, a) for anchor in opened.layout.anchors for a in "xyz"]
    if "base" in refit and not rows.ranged.all():
        found += [slot_of("base_frame", session, a) for a in ("x", "y", "z", "rx", "ry", "rz")]
    if "tool" in refit:
        if rows.oriented:
            found += [slot_of("flange_frame", session, a) for a in ("x", "y", "z", "rx", "ry", "rz")]
        found += [slot_of("target_point", t, a) for t in opened.layout.targets for a in "xyz"]
    return tuple(found)
