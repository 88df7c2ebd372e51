"""A fourth kind of row, inclinations, measured on the virtual robot: a stage in a file of its own.

The truth is that of the virtual robot, which knows nothing of the effects that the fit has.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from clampid.catalogue import catalogue
from clampid.diagnosis.diagnose import diagnose
from clampid.effect import STAGES
from clampid.identification.identify import identify, stage_rows
from clampid.models.model import load_model, save_model
from clampid.slots import slots_of
from clampid.stages.fit_problem import fit_problem
from clampid.stages.layout import layout_of
from experiments.campaign import Campaign, CampaignError, read_campaign
from experiments.simulate import simulate
from experiments.virtual_robot.bodies import Bodies
from experiments.virtual_robot.plant import Plant
from experiments.virtual_robot.rotations import rotation_matrix
from experiments.virtual_robot.structure import deformation
from kinematics.screws import log_so3

STD = 2e-6  # rad, of a reading
ROWS = 120
TILT = 1e-7  # rad/Nm: the pedestal of an arm of 20 kg
Level = Callable[..., Path]


def tilting(plant: Plant) -> Plant:
    return replace(plant, structure=replace(plant.structure, base=TILT))


def bending(plant: Plant) -> Plant:
    stiff = np.zeros_like(plant.structure.bending)
    stiff[1] = 2e-6  # 1/(Nm^2)
    return replace(plant, structure=replace(plant.structure, bending=stiff))


@pytest.fixture
def level(tmp_path: Path) -> Level:
    """A campaign of points and inclinations, of an individual with deformations of one's choice."""

    def measured(alter: Callable[[Plant], Plant], at: str = "base", seed: int = 3) -> Path:
        made: list[Plant] = []

        def remembered(plant: Plant) -> Plant:
            made.append(alter(plant))
            return made[-1]

        folder = simulate(
            tmp_path / f"level{seed}", seed=seed, poses=12, tables=("poses",), file_format="csv", alter=remembered
        )
        rng = np.random.default_rng(seed)
        campaign = read_campaign(folder)
        lower, upper = np.maximum(campaign.robot.lower, -2.0), np.minimum(campaign.robot.upper, 2.0)
        q = rng.uniform(0.5 * lower, 0.5 * upper, (ROWS, campaign.robot.n))
        turn = turns(made[-1], q, at) + STD * rng.standard_normal((ROWS, 2))
        table = pd.DataFrame(
            {"time_s": 10.0 * np.arange(ROWS), **{f"q{i + 1}_rad": q[:, i] for i in range(q.shape[1])}}
        )
        table["at"], table["about_x_rad"], table["about_y_rad"] = at, turn[:, 0] - turn[0, 0], turn[:, 1] - turn[0, 1]
        table.to_csv(folder / "inclination.csv", index=False)
        text = (folder / "campaign.toml").read_text()
        own = 'inclination = "inclination.csv"\n'
        text = text.replace("[tables]\n", f"[tables]\n{own}")
        (folder / "campaign.toml").write_text(f"{text}\n[inclinometer]\nstd_rad = {STD:g}\n")
        return folder

    return measured


def turns(plant: Plant, q: np.ndarray, at: str) -> np.ndarray:
    """About x and y ``(N, 2)``, rad, what the virtual robot's base or link has turned by against its first row."""
    bodies = Bodies(plant.geometry, plant.masses)
    found = deformation(plant, bodies, q, np.full(q.shape, 20.0))
    R = rotation_matrix(found.base)
    if at != "base":
        number = int(at.removeprefix("link"))
        bent, steps = rotation_matrix(found.rotation), bodies.steps(q)[:, :, :3, :3]
        for k in range(number):
            R = R @ bent[:, k] @ steps[:, k]
        R = R @ bent[:, number]
    return np.asarray(log_so3(R @ R[0].T)[:, :2])


def test_the_stage_is_known_by_its_line_in_the_standard_sets() -> None:
    assert STAGES[-1] == "inclination"


def test_a_pedestal_is_identified_from_inclinations_alone(level: Level, tmp_path: Path) -> None:
    model = identify(only_inclination(read_campaign(level(tilting))))
    stage = model.stages["inclination"]
    assert list(model.stages) == ["inclination"]
    values, std = stage.values(), dict(zip(stage.slots, stage.std.tolist(), strict=True))
    for slot in stage.slots:
        truth = 0.0 if slot.parameter == "cxy" else TILT
        assert abs(values[slot] - truth) < 4.0 * std[slot]
        assert std[slot] < 0.1 * TILT
    save_model(model, tmp_path / "m.json")
    assert load_model(tmp_path / "m.json").stages["inclination"].values() == values


def only_inclination(campaign: Campaign) -> Campaign:
    return replace(campaign, tables={"inclination": campaign.tables["inclination"]})


def test_points_and_inclinations_are_fitted_and_diagnosed_together(level: Level) -> None:
    campaign = read_campaign(level(tilting))
    model = identify(campaign, {"poses": ["geometry", "joint_compliance"], "inclination": ["base_creep"]})
    found = diagnose(model, only_inclination(campaign)).stages["inclination"]
    assert found.candidates[0]["effect"] == "base_tilt"
    assert found.verdict == "missing"


def test_nothing_is_missed_where_nothing_is_hidden(level: Level) -> None:
    campaign = only_inclination(read_campaign(level(tilting, seed=4)))
    assert diagnose(identify(campaign), campaign).stages["inclination"].verdict == "adequate"


@pytest.mark.parametrize("at", ["base", "link2", "link5"])
def test_derivatives_are_differences(level: Level, at: str) -> None:
    campaign = read_campaign(level(bending, at))
    rows, effects = stage_rows([campaign], layout_of([campaign]), "inclination"), catalogue()
    names = ("base_tilt", "link_bending", "joint_compliance")
    slots = [slot for name in names for slot in slots_of(effects[name], rows.layout)]
    problem = fit_problem(rows, effects, slots)
    rng = np.random.default_rng(0)
    theta = 0.3 * problem.sizes() * rng.uniform(0.5, 1.0, len(problem.sizes()))
    problem = problem.with_flanks(theta)
    step = 1e-3 * problem.sizes()
    _, jacobian = problem.residual(theta)
    for k in range(len(theta)):
        e = np.eye(len(theta))[k] * step
        difference = -(problem.error(theta + e) - problem.error(theta - e)) / 2.0
        np.testing.assert_allclose(
            jacobian[:, :, k] * step[k], difference, atol=1e-12 + 1e-5 * np.abs(difference).max()
        )


def test_a_link_turns_as_its_commands_say(level: Level) -> None:
    """Of a described robot without errors nothing is left but those of the individual: a thousandth of a radian."""
    campaign = read_campaign(level(lambda plant: plant, "link3"))
    rows = stage_rows([campaign], layout_of([campaign]), "inclination")
    problem = fit_problem(rows, catalogue(), [])
    assert np.abs(rows.measured).max() > 0.5
    assert np.abs(problem.error(problem.start())).max() < 5e-3


@pytest.mark.parametrize(("cell", "words"), [("link9", "base or link1 … link6"), ("flange", "base or link1 … link6")])
def test_a_body_that_does_not_exist_is_refused(level: Level, cell: str, words: str) -> None:
    folder = level(tilting)
    table = pd.read_csv(folder / "inclination.csv")
    table.loc[4, "at"] = cell
    table.to_csv(folder / "inclination.csv", index=False)
    with pytest.raises(CampaignError, match=words) as caught:
        read_campaign(folder)
    assert "row 5" in str(caught.value)
    assert cell in str(caught.value)
