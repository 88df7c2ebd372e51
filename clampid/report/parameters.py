"""The model with standard errors, effect by effect, in units for people; and what these data cannot determine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from clampid.display import Scale, fixed, number, scale_for, with_std
from clampid.effect import Effect
from clampid.fitting.observability import index_words
from clampid.models.correlations import PAIRS_SHOWN, STRONG, correlations
from clampid.models.model import Model, StageModel
from clampid.report.evidence import BEYOND_LIMIT, UNCERTAIN, explained_marks
from clampid.report.stage_data import in_order, stage_title
from clampid.report.style import Figure, Section, Table, Weak, as_table
from clampid.role_slots import has_role, role_of
from clampid.roles import FRAMES, Role
from clampid.slots import beyond_limit, find_parameter, fixed_slots, has_value, on_bound, unit_of
from clampid.stages.fit_problem import parameter_of
from kinematics.robot import RobotDescription

__all__ = ["NOT_IDENTIFIABLE", "parameters_section"]

NOT_IDENTIFIABLE = "not identifiable"
_ON_BOUND, _BEYOND = "limit", "below zero"
SIGNIFICANT = 2.0  # standard errors from zero
_PARTS: Mapping[Role, str] = {"base_frame": "base", "target_point": "targets", "flange_frame": "flange"}
_MANY = 40  # parameters of an effect at a place: more are not listed one by one
_WIDE = 3  # an effect with more parameters at a place has a table of its own


def parameters_section(model: Model, effects: Mapping[str, Effect], robot: RobotDescription) -> Section:
    """Section "The model with standard errors"."""
    blocks: list[str | Table | Figure] = []
    notes: list[str] = []
    open_ones = 0
    for stage in in_order(model.stages):
        stage_model = model.stages[stage]
        many = {name for name in {s.effect for s in stage_model.slots} if len(effects[name].parameters) > _MANY}
        single = [k for k, slot in enumerate(stage_model.slots) if slot.effect not in many]
        open_ones += sum(not _shown(stage_model, effects, k) for k in single)
        blocks.append(stage_title(stage))
        if stage_model.base:
            blocks.append(_base(stage_model))
        notes += [f"{stage_title(stage)}: {name} is drawn as curves, not listed number by number." for name in many]
        groups = _groups(stage_model, effects, robot)
        blocks += [_pivot(stage_model, effects, robot, indices) for indices in groups]
        active = [effects[name] for name in dict.fromkeys(s.effect for s in stage_model.slots)]
        notes += [f"{stage_title(stage)}: {e.name}: {e.caveat}." for e in active if e.caveat]
        if stage_model.observability:
            notes.append(f"{stage_title(stage)}: {index_words(stage_model.observability)}")
        notes += [f"{stage_title(stage)}: {text}" for text in stage_model.null_directions]
        blocks += _correlated(stage_model)
    text = (
        "Value ± one standard error. Grey: within two standard errors of zero or, for masses and geometry, "
        "of what the description says."
    )
    if open_ones:
        text += (
            f" “{NOT_IDENTIFIABLE}”: the data do not narrow the parameter's plausible range ({open_ones} parameters). "
            "Other values than those in the model file fit equally well."
        )
    text += explained_marks(
        [cell for block in blocks if isinstance(block, Table) for row in block.rows for cell in row]
    )
    if any(_rests(s, effects, k) for s in model.stages.values() for k in range(len(s.slots))):
        text += (
            f" “({_ON_BOUND})”: the value is at its physical limit, such as a friction or a clearance of zero. Without "
            "the limit, the data would put it there or beyond. Of its interval only the part within the limit is "
            "possible."
        )
    if any(_outside(s, effects, k) for s in model.stages.values() for k in range(len(s.slots))):
        text += (
            f" “({_BEYOND})”: the fit gives a value below zero, which is not physical for a friction or a clearance. "
            "The standard error says how poorly these data determine it."
        )
    return Section(
        "model",
        "The model with standard errors",
        (text,),
        tuple(blocks),
        tuple(notes),
        "What is not identifiable from these data",
    )


def _correlated(stage: StageModel) -> list[Table]:
    """The strongest correlations of identified parameters, if any are strong."""
    found = correlations(stage)
    if not found:
        return []
    which = f"the strongest {PAIRS_SHOWN} of {len(found)}" if len(found) > PAIRS_SHOWN else "all"
    caption = (
        f"Correlations of the errors of identified parameters beyond ±{STRONG:g}, {which}. Of such a pair "
        "only a combination is well known."
    )
    rows = [(c.first.label, c.second.label, fixed(c.r, 4)) for c in found[:PAIRS_SHOWN]]
    return [as_table(("Parameter", "With", "r#"), rows, caption)]


def _base(stage: StageModel) -> Table:
    """Base parameters: what the torques determine of the masses, with the description's values."""
    rows = []
    for p in stage.base:
        scale = scale_for(p.unit, [p.value])
        worded = with_std(p.value, p.std, scale, unit=False) if p.known else NOT_IDENTIFIABLE
        rows.append((p.name, worded, number(p.described, 4), scale.unit))
    caption = (
        "Base parameters of the arm, without the declared tool: the combinations of masses, first moments and inertias "
        "that these torques determine; the terms of one combination are not separable. First moments and "
        "inertias count from a point on the link's own joint, in base axes at the zero pose. Gautier 1991."
    )
    return as_table(("Base parameter", "Identified#", "Described#", "Unit"), rows, caption)


def _groups(stage: StageModel, effects: Mapping[str, Effect], robot: RobotDescription) -> list[list[int]]:
    """Slots that share a table: small effects at the same kind of place; others, and parts of the geometry, alone.

    Joints that slide have tables of their own: their angles are lengths.
    """
    groups: dict[tuple[str, ...], list[int]] = {}
    for k, slot in enumerate(stage.slots):
        effect = effects[slot.effect]
        if len(effect.parameters) > _MANY:
            continue
        kind = slot.place.rstrip("0123456789")
        alone = has_role(slot, *FRAMES, effects=effects) or len(effect.parameters) > _WIDE
        part = _PARTS.get(role_of(slot, effects), "")
        slides = "" if unit_of(slot, effects, robot) == find_parameter(slot, effects).unit else "slides"
        key = (slot.effect, part, slides) if alone else ("", kind, slides)
        groups.setdefault(key, []).append(k)
    return list(groups.values())


def _pivot(stage: StageModel, effects: Mapping[str, Effect], robot: RobotDescription, indices: Sequence[int]) -> Table:
    """Places by parameters."""
    at = {(stage.slots[k].place, stage.slots[k].effect, stage.slots[k].parameter): k for k in indices}
    columns = list(dict.fromkeys((stage.slots[k].effect, stage.slots[k].parameter) for k in indices))
    order = {
        (e, p.name): i
        for i, (e, p) in enumerate((e, p) for e in dict.fromkeys(c[0] for c in columns) for p in effects[e].parameters)
    }
    columns.sort(key=lambda c: order[c])
    places = list(dict.fromkeys(stage.slots[k].place for k in indices))
    single = len({effect for effect, _ in columns}) == 1
    scales = {
        c: _scale(stage, effects, robot, [k for k in indices if (stage.slots[k].effect, stage.slots[k].parameter) == c])
        for c in columns
    }
    heads = []
    for effect, name in columns:
        known = effects[effect].by_name[name]
        short = known.axis if known.role in _PARTS else name
        unit = scales[effect, name].unit
        heads.append(f"{short if single else f'{effect} {short}'}{f', {unit}' if unit else ''}#")
    rows = [
        (place, *(_cell(stage, effects, robot, at.get((place, *c)), scales[c]) for c in columns))
        for place in sorted(places, key=_natural)
    ]
    return as_table(("At", *heads), rows, _caption(effects, columns))


def _natural(place: str) -> tuple[str, int]:
    head = place.rstrip("0123456789")
    return head, int(place[len(head) :] or 0)


def _scale(stage: StageModel, effects: Mapping[str, Effect], robot: RobotDescription, own: Sequence[int]) -> Scale:
    known = [k for k in own if _shown(stage, effects, k)] or list(own)
    values = [float(v) for k in known for v in (stage.theta[k], stage.std[k])]
    return scale_for(unit_of(stage.slots[own[0]], effects, robot), values)


def _shown(stage: StageModel, effects: Mapping[str, Effect], k: int) -> bool:
    return has_value(stage.slots[k], effects, float(stage.theta[k]), float(stage.std[k]), stage.identified[k])


def _cell(
    stage: StageModel, effects: Mapping[str, Effect], robot: RobotDescription, k: int | None, scale: Scale
) -> str:
    if k is None:
        return ""
    value, std = float(stage.theta[k]), 0.0 if fixed_slots(stage.slots, effects)[k] else float(stage.std[k])
    if not _shown(stage, effects, k):
        return NOT_IDENTIFIABLE
    worded = with_std(value, std, scale, unit=False)
    if _rests(stage, effects, k):
        return f"{worded} ({_ON_BOUND})"
    if beyond_limit(parameter_of(stage.slots[k], effects, robot), value):
        return f"{worded} ({BEYOND_LIMIT})"
    if not stage.identified[k]:
        return f"{worded} ({UNCERTAIN})"
    if _outside(stage, effects, k):
        worded = f"{worded} ({_BEYOND})"
    return Weak(worded) if abs(value) < SIGNIFICANT * std else worded


def _outside(stage: StageModel, effects: Mapping[str, Effect], k: int) -> bool:
    """Whether an identified value is below zero where none is physical: not every stage's fit is kept to that.

    Zero is the same for every gear; other limits are stated at the joint.
    """
    low = find_parameter(stage.slots[k], effects).bounds[0]
    return bool(stage.identified[k]) and low == 0.0 > float(stage.theta[k])


def _rests(stage: StageModel, effects: Mapping[str, Effect], k: int) -> bool:
    return bool(stage.identified[k]) and on_bound(stage.slots[k], float(stage.theta[k]), effects)


def _caption(effects: Mapping[str, Effect], columns: Sequence[tuple[str, str]]) -> str:
    parts = []
    for name in dict.fromkeys(effect for effect, _ in columns):
        effect = effects[name]
        own = [p for e, p in columns if e == name]
        if "link_frame" in effect.roles:
            what = next(
                (w for role, w in _PARTS.items() if effect.by_name[own[0]].role == role),
                "links: the motion of each link's far end, base axes at the zero pose",
            )
            parts.append(f"geometry, {what}. {effect.equation}.")
        else:
            meanings = "; ".join(f"{p.name}: {p.meaning}" for p in effect.parameters if p.name in own and p.meaning)
            parts.append(f"{name}: {effect.equation}" + (f" ({meanings})." if meanings else "."))
    return " ".join(parts)
