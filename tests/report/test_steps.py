"""Every step and every rejected alternative, as the ledger has them."""

from __future__ import annotations

from typing import Any

from clampid.models.model import Model, Round
from clampid.report.steps import steps_section
from clampid.report.style import Table
from clampid.slots import Layout


def step(*added: str, **evidence: Any) -> Round:
    return Round("poses", ("geometry", *added), added, 1e-4, 1e-4, 1e-4, evidence)


def model(*rounds: Round) -> Model:
    return Model("robot", Layout(6), {"poses": None}, (), rounds)  # type: ignore[dict-item]


def test_steps_and_what_was_rejected_beside_each() -> None:
    refused = {"name": "base_tilt", "where": ["base"], "p_value": 1e-5, "p_familywise": 0.005, "p_held_out": 0.4}
    refused |= {"heldout_rms_after": 3e-4, "reason": "the held-out error does not fall"}
    passed = {"name": "dress_pack", "where": ["joint3"], "p_value": 1e-4, "p_familywise": 0.01, "reason": "less"}
    alike = [{"effect": "link_bending", "where": ["link1"], "cos2": 0.98, "aliased": False}]
    first = step("bearing_tilt@joint1", p_familywise=0.005, stability=0.8, heldout_rms_before=2e-4,
                 heldout_rms_after=1.5e-4, confusable_with=alike, rejected=[refused, passed])  # fmt: skip
    by_hand = step("backlash@joint1", heldout_rms_before=1.5e-4, heldout_rms_after=1.1e-4)
    section = steps_section(model(step(), first, by_hand), None)
    assert section is not None
    title, steps, rejected = section.blocks
    assert title == "Poses"
    assert isinstance(steps, Table)
    assert isinstance(rejected, Table)
    listed = [dict(zip(steps.columns, row, strict=True)) for row in steps.rows]
    assert [row["Added"] for row in listed] == ["bearing_tilt@joint1", "backlash@joint1"]
    assert [row["Held out before#"] for row in listed] == ["200 µm", "150 µm"]
    assert listed[0]["First in folds#"] == "80 %"
    assert listed[0]["Confusable with"] == "link_bending @ link1"
    assert listed[1]["p, family-wise#"] == "–"
    why = [dict(zip(rejected.columns, row, strict=True)) for row in rejected.rows]
    assert [(row["Step#"], row["Rejected"], row["Why"]) for row in why] == [
        ("1", "base_tilt", "the held-out error does not fall"),
        ("1", "dress_pack", "less"),
    ]
    assert [row["Held out after#"] for row in why] == ["300 µm", "–"]


def test_a_step_that_is_known_from_its_prior_is_marked() -> None:
    """On held-out rows of the UR10 cross-coupled stiffness has p = 0.23, which else would confirm nothing."""
    by_prior = step("cross_coupled_stiffness@joint4", p_held_out=0.231, from_prior=0.52, rejected=[])
    by_rows = step("bearing_tilt@joint4", p_held_out=0.001, from_prior=0.52, rejected=[])
    section = steps_section(model(step(), by_prior, by_rows), None)
    assert section is not None
    table = section.blocks[1]
    assert isinstance(table, Table)
    held_out = [row[table.columns.index("p, held out#")] for row in table.rows]
    assert held_out == ["0.23 (prior)", "0.0010"]
    assert "(prior)" in table.caption
    section = steps_section(model(step(), by_rows), None)
    assert section is not None
    assert "(prior)" not in section.blocks[1].caption  # type: ignore[union-attr]


def test_what_was_added_by_hand_has_no_such_section() -> None:
    assert steps_section(model(step(), step("backlash@joint1", heldout_rms_before=1e-4)), None) is None
    assert steps_section(model(step(p_familywise=0.005, rejected=[])), None) is None  # nothing was added
