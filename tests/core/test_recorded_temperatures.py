"""Every recorded temperature is a signal: effects may need it, probes name it, and a drift by it is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pandas as pd
import pytest

from clampid.catalogue import catalogue
from clampid.chain.chain import build_chain
from clampid.diagnosis.dependence import dependence
from clampid.diagnosis.diagnose import diagnose
from clampid.effect import SIGNALS, Effect, EffectError, Parameter, signal
from clampid.identification.identify import identify
from clampid.slots import Slot
from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import join_rows, pose_rows
from clampid.stages.poses import constants_of
from clampid.stages.stage_kind import kind_of
from clampid.stages.temperatures import temperatures
from experiments.campaign import Campaign

Simulated = Callable[..., Campaign]


def changed(campaign: Campaign, **tables: pd.DataFrame) -> Campaign:
    return replace(campaign, tables=MappingProxyType({**campaign.tables, **tables}))


def hall(time: np.ndarray) -> np.ndarray:
    """°C: a hall whose doors open and close."""
    return np.asarray(23.0 + 3.0 * np.sin(2 * np.pi * time / 900.0) + 1.0 * np.sin(2 * np.pi * time / 2100.0))


def test_columns_become_signals():
    table = pd.DataFrame({"temp_ambient_C": [21.0, 19.0], "temp_link1_C": [30.0, 20.0], "temp_column_C": [25.0, 26.0]})
    found = temperatures(table, 2)
    np.testing.assert_allclose(found["ambient_temperature"], [1.0, -1.0])
    np.testing.assert_allclose(found["link_temperature"], [[10.0, 0.0], [0.0, 0.0]])
    np.testing.assert_allclose(found["temp_column"], [5.0, 6.0])
    assert set(found) == {"link_temperature", "motor_temperature", "ambient_temperature", "temp_column"}


def test_names_of_sensors_are_signals_and_those_of_links_have_their_own():
    assert signal("temp_column") is not None
    assert all(signal(name) is None for name in ("temp_link2", "temp_motor1", "temp_ambient", "temp_", "temperature"))
    assert {"link_temperature", "motor_temperature", "ambient_temperature"} <= set(SIGNALS)
    for name, read in (("temp_ambient", "ambient_temperature"), ("temp_column", "temp_column")):
        assert dependence([name], "base", "poses").variables[0].signals == (read,)
    with pytest.raises(EffectError, match="temp_link"):
        dependence(["temp_link"], "base", "poses")


def test_an_effect_may_need_any_sensor_and_says_where_there_is_none(simulated: Simulated):
    effect = Effect(
        name="wall", family="wall", acts={"base_twist": lambda p, x: p.k * x.temp_wall * np.eye(6)[3]},
        parameters=(Parameter("k", "m/K", 1e-5, meaning="what the wall pushes the base"),), needs=("temp_wall",),
        stages=("poses",), equation="dx = k T", source=("own measurements",), at="base",
    )  # fmt: skip
    campaign = simulated(seed=5, poses=12, tables=("poses",))
    poses = campaign.tables["poses"]
    warm = changed(campaign, poses=poses.assign(temp_wall_C=np.linspace(20.0, 30.0, len(poses))))
    slots, layout = (Slot("wall", "k", "base"),), layout_of([campaign, warm])
    chain = build_chain(kind_of("poses"), slots, {"wall": effect}, layout, constants_of(campaign.robot))
    both = pose_rows([campaign, warm], layout, "poses")  # one session has no such sensor
    moved = chain.evaluate(np.array([1e-3]), both.signals).values[:, chain.offsets["base_twist"]][:, 3]
    np.testing.assert_allclose(moved, np.r_[np.zeros(len(poses)), np.linspace(0.0, 0.01, len(poses))], atol=1e-12)
    alone = pose_rows([campaign], layout, "poses")
    assert len(join_rows([alone, alone])) == 2 * len(poses)
    with pytest.raises(EffectError, match="temp_wall_C"):
        chain.evaluate(np.array([1e-3]), alone.signals)


@pytest.mark.slow
def test_an_error_that_follows_a_sensor_of_no_link_is_said_to(simulated: Simulated):
    """A bench that a sensor was put on: nothing of the catalogue acts there, and the variable is named."""
    campaign = simulated(seed=6, poses=60, tables=("poses",))
    poses = campaign.tables["poses"].copy()
    visit = np.unique(poses[["pose", "visit"]].to_numpy(), axis=0, return_inverse=True)[1]
    bench = 22.0 + np.random.default_rng(6).normal(0.0, 2.0, visit.max() + 1)[visit]
    poses["temp_bench_C"] = np.round(bench, 2)
    for axis, per_kelvin in zip("xyz", (4e-5, -3e-5, 2e-5), strict=True):
        poses[f"{axis}_m"] += per_kelvin * (bench - 22.0)
    campaign = changed(campaign, poses=poses)
    found = diagnose(identify(campaign), campaign).stages["poses"]
    assert found.verdict == "unknown"
    assert found.depends_on == ["temp_bench"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.study)])
def test_a_torque_that_follows_the_ambient_temperature_is_named(seed: int, simulated: Simulated):
    campaign, motor = simulated(seed=seed, tables=("free_air", "wrist")), seed + 1
    still = campaign.tables["free_air"][f"tau{motor}_Nm"].iloc[3:15]
    per_kelvin = 0.25 * float(np.std(np.diff(still)))
    logs = {}
    for k, (name, table) in enumerate(campaign.tables.items()):
        air = hall(table["time_s"].to_numpy() + 1000.0 * k)
        sensor = np.round(air + np.random.default_rng([seed, k]).normal(0.0, 0.02, len(table)), 2)
        drifted = table[f"tau{motor}_Nm"] + per_kelvin * (air - 22.0)
        logs[name] = table.assign(**{"temp_ambient_C": sensor, f"tau{motor}_Nm": drifted})
    campaign = changed(campaign, **logs)
    found = diagnose(identify(campaign), campaign).stages["free_air"]
    assert found.verdict == "missing"
    first = found.candidates[0]
    assert (first["effect"], first["where"]) == ("torque_offset", [f"joint{motor}"])
    assert "ambient_temperature" in catalogue()[first["name"]].needs
    drift = next(p for p in first["parameters"] if p["unit"] == "Nm/K")
    assert abs(drift["value"] - per_kelvin) < 4.0 * drift["std"] < 2.0 * per_kelvin
    assert found.after < found.before
