"""Temperatures of logs, the noise of their readings averaged out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from experiments.log_windows import LogTable
from experiments.steady_temperatures import SteadyTemperatures

NOISE_K = 0.05
NAMES = ["run", "time_s", "temp_motor1_C"]


def warming(rise_K: float, constant_s: float, seed: int = 1, rate: float = 50.0) -> tuple[pd.DataFrame, np.ndarray]:
    """A log of one run in which a motor warms up, its readings noisy; and the true temperature ``(N,)``, °C."""
    time = np.arange(0.0, 300.0, 1.0 / rate)
    true = 25.0 + rise_K * (1.0 - np.exp(-time / constant_s))
    read = np.round(true + NOISE_K * np.random.default_rng(seed).standard_normal(len(time)), 2)
    return pd.DataFrame({"run": 1, "time_s": time, "temp_motor1_C": read}), true


def error_of(log: pd.DataFrame, true: np.ndarray) -> float:
    read = LogTable.of(log).steadied().frame(NAMES)["temp_motor1_C"].to_numpy()
    return float(np.sqrt(np.mean((read - true) ** 2)))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("rise_K", [0.0, 0.1, 10.0])
def test_the_noise_of_readings_is_averaged_out(rise_K: float, seed: int) -> None:
    """A second has 50 readings and a winding warms within minutes: a tenth of the noise is left at most."""
    assert error_of(*warming(rise_K, 300.0, seed=seed)) < 0.1 * NOISE_K


def test_a_quick_change_is_not_smeared() -> None:
    """Of a winding that follows within seconds only a second is averaged, and its neighbours."""
    log, true = warming(20.0, 4.0)
    read = LogTable.of(log).steadied().frame(NAMES)["temp_motor1_C"].to_numpy()
    assert np.max(np.abs(read - true)[50:]) < 0.1 * 20.0 * 1.0 / 4.0  # a tenth of what a second changes at most
    assert error_of(log, true) < 2.0 * NOISE_K


def test_runs_have_nothing_in_common() -> None:
    cold, warm = warming(0.0, 300.0)[0], warming(0.0, 300.0, seed=2)[0].assign(run=2)
    warm["temp_motor1_C"] += 8.0
    for log in (pd.concat([cold, warm]), pd.concat([cold, warm.assign(time_s=warm["time_s"] + 400.0)])):
        read = LogTable.of(log.reset_index(drop=True)).steadied().frame(NAMES)
        levels = read.groupby("run")["temp_motor1_C"]
        assert (levels.max() - levels.min()).max() < NOISE_K
        assert levels.mean().loc[2] - levels.mean().loc[1] == pytest.approx(8.0, abs=0.01)


def levels_of(log: pd.DataFrame) -> np.ndarray:
    return np.asarray(LogTable.of(log).steadied().frame(NAMES)["temp_motor1_C"], dtype=float)


@given(
    start=st.floats(-30.0, 100.0),
    slope=st.floats(-0.05, 0.05),
    rows=st.integers(1, 400),
    step=st.sampled_from([0.004, 0.1, 1.0, 7.0]),
)
def test_a_straight_line_is_left_as_it_is(start: float, slope: float, rows: int, step: float) -> None:
    time = 5.0 + step * np.arange(rows)
    line = start + slope * time
    read = levels_of(pd.DataFrame({"run": 1, "time_s": time, "temp_motor1_C": line}))
    assert np.max(np.abs(read - line)) <= abs(slope) * 1.0 + 1e-9  # constant before the first mean and after the last
    inside = (time >= time[0] + 1.0) & (time <= time[-1] - 1.0)
    np.testing.assert_allclose(read[inside], line[inside], atol=1e-7)


def test_a_log_in_a_file_is_smoothed_like_one_in_memory(tmp_path: Path) -> None:
    log, _ = warming(5.0, 300.0)
    log.to_parquet(tmp_path / "free_air.parquet")
    table = LogTable.of(tmp_path / "free_air.parquet").steadied()
    np.testing.assert_allclose(table.frame(NAMES), LogTable.of(log).steadied().frame(NAMES), atol=1e-12)
    pieces = [{n: log[n].to_numpy(float)[k : k + 777] for n in NAMES} for k in range(0, len(log), 777)]
    whole = SteadyTemperatures.of([{n: log[n].to_numpy(float) for n in NAMES}])
    np.testing.assert_allclose(SteadyTemperatures.of(pieces).values["temp_motor1_C"], whole.values["temp_motor1_C"])


def test_what_was_recorded_is_read_if_nothing_else_is_asked() -> None:
    log, _ = warming(5.0, 300.0)
    np.testing.assert_array_equal(LogTable.of(log).frame(NAMES)["temp_motor1_C"], log["temp_motor1_C"])
