"""Runs that repeat a motion: their stretches are one unit of evidence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clampid.fitting.accuracy import noise_floor
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.stages.repeats import repeated_noise, with_repeats
from experiments.campaign import Campaign

BLOCK_S = 2.0


def log(programs: list[int], step: float = 0.1, late: float = 0.0) -> tuple[np.ndarray, ...]:
    """Unit, run, time and angles of runs of 10 s, each of one of some programs and later than the last by ``late``."""
    units, runs, times, angles = [], [], [], []
    for number, program in enumerate(programs):
        t = np.arange(0.0, 10.0, step)
        moved = np.random.default_rng(program).uniform(-1.0, 1.0, (2, 3))
        q = moved[0] * np.sin(t + late * number)[:, None] + moved[1] * np.cos(0.7 * (t + late * number))[:, None]
        units.append(np.floor(t / BLOCK_S).astype(np.int64) + 100 * number)
        runs.append(np.full(len(t), number))
        times.append(t + 37.0 * number)
        angles.append(q)
    return tuple(map(np.concatenate, (units, runs, times, angles)))


@given(st.lists(st.integers(0, 3), min_size=1, max_size=6))
@settings(max_examples=50, deadline=None)
def test_runs_of_one_program_share_the_units_of_the_first(programs: list[int]) -> None:
    unit, run, time, q = log(programs)
    found = with_repeats(unit, run, time, q)
    for number, program in enumerate(programs):
        first = programs.index(program)
        np.testing.assert_array_equal(found[run == number], unit[run == first])


@pytest.mark.parametrize(("late", "alike"), [(0.004, True), (0.3, False)])
def test_a_program_repeats_within_milliseconds(late: float, alike: bool) -> None:
    unit, run, time, q = log([1, 1], late=late)
    found = with_repeats(unit, run, time, q)
    assert np.array_equal(found[run == 1], unit[run == 0]) == alike
    if not alike:
        np.testing.assert_array_equal(found, unit)


def test_a_run_sampled_otherwise_is_the_same_motion() -> None:
    unit, run, time, q = log([2])
    more, _, faster, finer = log([2], step=0.05)
    both = with_repeats(
        np.r_[unit, more + 100], np.r_[run, np.ones_like(more)], np.r_[time, faster + 60.0], np.vstack([q, finer])
    )
    np.testing.assert_array_equal(both[len(unit) :][::2], unit)


def test_runs_of_a_resting_arm_are_not_said_to_repeat() -> None:
    unit, run = np.arange(10), np.repeat([0, 1], 5)
    found = with_repeats(unit, run, np.arange(10.0), np.zeros((10, 3)))
    np.testing.assert_array_equal(found, unit)


def torques_of(programs: list[int], sigma: float, seed: int) -> tuple[np.ndarray, ...]:
    """Run, time, angles, and torques that are a law of the posture, which no model has, and noise."""
    _, run, time, q = log(programs)
    noise = sigma * np.random.default_rng(seed).standard_normal(q.shape)
    return run, time, q, 5.0 * np.sin(7.0 * q) + noise


@pytest.mark.parametrize("programs", [[0, 0], [0, 1, 0, 2, 2], [3, 3, 3, 3]])
def test_the_noise_of_repeated_runs_is_that_of_the_readings(programs: list[int]) -> None:
    found = [repeated_noise(*torques_of(programs, 0.3, seed)) for seed in range(20)]
    assert np.all(np.array(found) > 0.27)
    assert 0.3 < np.mean(found) < 0.36  # upper ends of intervals, from 100 repeated rows on


def test_without_a_repeated_run_the_noise_is_not_known() -> None:
    run, time, q, torque = torques_of([0, 1, 2], 0.3, 0)
    assert np.all(np.isinf(repeated_noise(run, time, q, torque)))
    run, time, q, torque = torques_of([1, 1], 0.3, 0)
    torque[run == 1] = torque[run == 0]  # a copy: nothing was measured again
    assert np.all(np.isinf(repeated_noise(run, time, q, torque)))
    torque[run == 1, 2] += 0.1  # of one motor alone something was measured again
    assert np.isinf(repeated_noise(run, time, q, torque)).tolist() == [True, True, False]
    short = np.flatnonzero(time - 37.0 * run < 5.0)
    assert np.all(np.isinf(repeated_noise(run[short], time[short], q[short], torque[short])))


def test_rounding_that_repeats_is_noise_too() -> None:
    run, time, q, torque = torques_of([1, 1, 1], 1e-4, 0)
    found = repeated_noise(run, time, q, np.round(torque / 0.5) * 0.5)
    assert np.all(found >= (1.0 - 1e-9) * 0.5 / np.sqrt(12.0))


@pytest.mark.slow
def test_what_a_model_lacks_of_a_repeated_motion_is_not_in_the_floor(simulated: Callable[..., Campaign]) -> None:
    """A torque that changes within degrees of joint 2, in a log that was driven twice."""
    campaign = simulated(seed=7, tables=("free_air",))
    once = campaign.tables["free_air"]
    sigma, twice = 2.0, []
    for again in range(2):
        frame = once.assign(run=once["run"] + 100 * again, time_s=once["time_s"] + 1e4 * again)
        noise = sigma * np.random.default_rng(again).standard_normal(len(frame))
        twice.append(frame.assign(tau2_Nm=frame["tau2_Nm"] + noise + 3.0 * sigma * np.sin(60.0 * frame["q2_rad"])))
    campaign = replace(campaign, tables=MappingProxyType({"free_air": pd.concat(twice, ignore_index=True)}))
    fitted = on_campaign(identify(campaign), campaign).refit("free_air").estimate
    floor = noise_floor(fitted.problem.rows, fitted.residual)
    assert floor.source == "repeated_runs"
    assert floor.sigma[1] == pytest.approx(sigma, rel=0.1)
    assert np.std(fitted.residual[fitted.problem.rows.used[:, 1], 1]) > 2.0 * sigma
