"""Temperatures and what follows from them."""

import numpy as np

from experiments.virtual_robot.heat import read_sensors, session


def test_without_work_everything_goes_to_ambient(plant):
    history = session(plant.heat, np.array([60_000.0]), np.zeros((1, 6)))
    assert np.max(np.abs(history.link[-1] - history.ambient[-1])) < 2 * plant.heat.swing


def test_with_steady_work_a_motor_rises_by_its_rise(plant):
    from dataclasses import replace

    heat = replace(plant.heat, swing=0.0)
    history = session(heat, np.array([60_000.0]), np.ones((1, 6)))
    np.testing.assert_allclose(history.motor[-1] - heat.ambient, heat.motor_rise, rtol=1e-6)
    share = heat.link_time / (heat.link_time + heat.contact_time)
    np.testing.assert_allclose(history.link[-1] - heat.ambient, heat.motor_rise * share, rtol=1e-3)


def test_sensors_are_quantised_and_hardly_noisy(plant):
    history = session(plant.heat, np.array([3000.0]), np.ones((1, 6)))
    true = history.at(np.linspace(0, 3000, 4000))
    columns = read_sensors(true, 0.02, np.random.default_rng(0))
    assert next(iter(columns)) == "temp_link1_C"
    assert len(columns) == 13
    error = columns["temp_motor3_C"] - true.motor[:, 2]
    assert 0.018 < error.std() < 0.023
    np.testing.assert_allclose(columns["temp_motor3_C"] * 100, np.round(columns["temp_motor3_C"] * 100))


def test_links_warm_by_five_to_fifteen_kelvin_during_the_poses(robot):
    from experiments.virtual_robot import measure

    table = measure(robot, seed=1, tables=["poses"]).tables["poses"]
    rises = np.array([np.ptp(table[f"temp_link{i}_C"]) for i in range(1, 7)])
    assert 5 < np.median(rises) < 15
