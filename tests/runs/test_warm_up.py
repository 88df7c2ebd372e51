"""Swings between measurements over sockets; a warm-up ends when the robot is warm; after a break it goes on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from run_controller import Controller

from clampid.planning.returns import ReturnWishes, plan_fixed
from clampid.planning.scene import Scene
from clampid.planning.warm_up import WarmUp, plan_warm_up
from experiments.campaign import read_campaign
from experiments.plans import Cell, Limits, Plan
from experiments.plans.model import Steady
from experiments.runs.errors import RunStopped
from experiments.runs.runner import run
from experiments.runs.warmth import steady_since, steady_words

HOME = np.array([0.0, -1.3, 1.5, 0.3, 0.8, 0.0])


@pytest.fixture(scope="module")
def warm_up(cell: Cell, limits: Limits) -> Plan:
    returns = ReturnWishes(np.array([0.0, 0.0, -1.0]), ("T1",), True, measure_time=0.5)
    warm = WarmUp((0,), swing=0.1, repetitions=3, every=3.0, cool=10.0 / 3600.0)
    return plan_warm_up(cell, limits, Scene.floor_only(cell), returns, warm, HOME)


def test_swings_are_made_and_the_reference_is_measured(controller: Controller, warm_up: Plan, tmp_path: Path) -> None:
    before = len(controller.executions())
    outcome = run(warm_up, tmp_path / "C", controller.asked())
    visits = warm_up.visits
    assert outcome.rows == {"poses": sum(bool(v.targets) for v in visits)}
    moves = sum(2 * v.times for v in visits)  # to via, to q, and back for every further swing
    assert len(controller.executions()) - before in (moves, moves + 1)  # and there, at first
    time = read_campaign(tmp_path / "C").tables["poses"]["time_s"].to_numpy()
    rests = [v.wait for v in visits if v.targets]
    assert np.all(np.diff(time) >= rests[1:])


def test_a_fixed_point_is_measured_without_a_move(
    controller: Controller, cell: Cell, limits: Limits, tmp_path: Path
) -> None:
    returns = ReturnWishes(np.array([0.0, 0.0, -1.0]), ("T1",), True, measure_time=0.5)
    plan = plan_fixed(cell, limits, Scene.floor_only(cell), returns, HOME, readings=6, pause=1.0)
    before = len(controller.executions())
    assert run(plan, tmp_path / "C", controller.asked()).rows == {"poses": 6}
    assert len(controller.executions()) - before <= 2  # there, and the last move
    table = read_campaign(tmp_path / "C").tables["poses"]
    spread = table[["x_m", "y_m", "z_m"]].to_numpy().std(axis=0, ddof=1)
    assert np.all(spread < 12e-6)  # 28 µm of one reading, 3 µm of the median of 120


def test_what_was_swung_before_a_break_is_not_swung_again(
    controller: Controller, warm_up: Plan, tmp_path: Path
) -> None:
    asked = controller.asked()
    asked.progress = lambda done, text: controller.operate("mode T1") if "pose 2, visit 2" in text else None
    with pytest.raises(RunStopped, match="mode"):
        run(warm_up, tmp_path / "C", asked)
    controller.operate("mode EXT")
    before = len(controller.executions())
    outcome = run(warm_up, tmp_path / "C", controller.asked(resume=True))
    assert outcome.rows == {"poses": sum(bool(v.targets) for v in warm_up.visits)}
    at = next(k for k, v in enumerate(warm_up.visits) if (v.pose, v.visit) == (2, 2))
    assert len(controller.executions()) - before <= sum(2 * v.times for v in warm_up.visits[at:]) + 1
    assert set(controller.executions().values()) == {1}


def warming(hours: float, tau: float, noise: float = 0.02, air: float = 0.0) -> list[dict]:
    """Rows every five minutes of a robot that warms by 10 K with a time constant, h; the air by ``air`` K/h."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, hours * 3600.0, 300.0)
    ambient = 20.0 + air * t / 3600.0
    body = ambient + 10.0 * (1 - np.exp(-t / 3600.0 / tau))
    return [
        {
            "what": "row",
            "row": {
                "time_s": float(a),
                "temp_link1_C": float(b + noise * rng.standard_normal()),
                "temp_ambient_C": float(c),
            },
        }
        for a, b, c in zip(t, body, ambient, strict=True)
    ]


def test_warm_when_the_slope_says_so() -> None:
    tau, rate = 1.5, 0.5
    entries = warming(12.0, tau)
    time = np.array([e["row"]["time_s"] for e in entries])
    rise = np.array([[e["row"]["temp_link1_C"] - e["row"]["temp_ambient_C"]] for e in entries])
    since = steady_since(time, rise, rate)
    # The slope in the middle of the window, half an hour ago, was 10/τ·exp(-t/τ).
    expected = (tau * np.log(10.0 / tau / rate) + 0.5) * 3600.0
    assert since == pytest.approx(expected, abs=900.0)


def test_a_warm_up_ends_an_hour_after() -> None:
    wanted = Steady(0.5, 3600.0)
    entries = warming(12.0, 1.5)
    ends = next(k for k in range(1, len(entries)) if steady_words(entries[:k], wanted))
    assert entries[ends - 1]["row"]["time_s"] / 3600.0 == pytest.approx(1.5 * np.log(10 / 1.5 / 0.5) + 1.5, abs=0.4)
    assert "against the air for 1.0 h" in steady_words(entries[:ends], wanted)


def test_air_that_warms_is_taken_off_and_short_records_say_nothing() -> None:
    wanted = Steady(0.5, 3600.0)
    assert steady_words(warming(12.0, 1.5, air=1.0), wanted)
    assert not steady_words(warming(0.7, 1e-3), wanted)
    assert not steady_words([], wanted)
    bare = warming(12.0, 1.5, air=1.0)
    for entry in bare:
        del entry["row"]["temp_ambient_C"]
    assert not steady_words(bare, wanted)
    for entry in bare:
        del entry["row"]["temp_link1_C"]
    assert not steady_words(bare, wanted)
