"""Rows of a log count only where it is sampled closely enough to show how the arm moves."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clampid.cli import main
from clampid.display import count_text
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.stages.log_facts import LogFacts, facts_of, log_parts
from experiments.campaign import Campaign, read_campaign
from experiments.second_world import draw_robot, measure
from experiments.second_world.session import open_session, torques
from experiments.signals import misfit

STEP = 0.1


def test_a_cubic_has_no_misfit_and_a_ramp_between_samples_has_one() -> None:
    t = STEP * np.arange(40)
    run = np.zeros(40, dtype=np.int64)
    cubic = (0.3 * t**3 - t)[:, None]
    found = misfit(cubic, t, run, 2, 0.02, STEP)[2:-2]
    assert np.all(found < 1e-9)
    begins = np.maximum(t - 2.05, 0.0)[:, None]  # at rest, then 1 rad/s, from one sample to the next
    found = misfit(begins, t, run, 2, 0.02, STEP)[:, 0]
    assert np.flatnonzero(np.isfinite(found) & (found > 1.0)).tolist() == [19, 20, 21, 22]
    assert np.all(found[2:19] < 1e-9)
    assert np.all(np.isinf(found[[0, 1, -2, -1]]))


def test_no_misfit_is_stated_across_the_end_of_a_run_or_a_gap() -> None:
    t = STEP * np.arange(40)
    run = np.repeat([0, 1], 20)
    assert np.flatnonzero(np.isinf(misfit(t[:, None], t, run, 1, 0.02, STEP)[2:-2, 0]) == 1).tolist() == [
        16,
        17,
        18,
        19,
    ]
    late = t + np.where(t > 1.95, 1.0, 0.0)
    inside = misfit(late[:, None], late, np.zeros(40, dtype=np.int64), 1, 0.02, STEP)[2:-2, 0]
    assert np.flatnonzero(np.isinf(inside)).tolist() == [16, 17, 18, 19]


@pytest.fixture(scope="module", params=[("uncoupled6", "trapezoids_10hz", 4), ("big6", "two_warmths", 5)])
def seldom(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Campaign, np.ndarray, np.ndarray]:
    """A log of ten rows a second of moves that speed up in 0.25 s; its noise-free torques, and its accelerations."""
    name, log, seed = request.param
    folder = tmp_path_factory.mktemp("log") / "arm"
    robot = draw_robot(name, seed=seed)
    measure(robot, folder, noise="white", log=log, tables=("free_air",), seed=seed)
    session = open_session(robot, "many", log, "white", seed)
    return read_campaign(folder), torques(session, session.motion, []), session.motion.qdd


def used_rows(campaign: Campaign, true: np.ndarray) -> np.ndarray:
    """Rows that count ``(N, n)``; of each motor there are enough, and what a fit leaves of them is their noise."""
    opened = on_campaign(identify(campaign), campaign)
    estimate = opened.refit("free_air", opened.rows("free_air")).estimate
    rows = estimate.problem.rows
    noise = (rows.measured - true).std(axis=0)
    assert rows.used.sum(axis=0).min() > 200
    for motor in range(rows.robot.n):
        used = rows.used[:, motor]
        assert np.sqrt(np.mean(estimate.residual[used, motor] ** 2)) < 1.1 * noise[motor]
    return np.asarray(rows.used)


@pytest.mark.slow
def test_rows_that_speed_up_count_where_moves_are_trapezoids(seldom: tuple[Campaign, np.ndarray, np.ndarray]) -> None:
    campaign, true, qdd = seldom
    # A campaign of its own: what is known of a log is kept with it.
    used = used_rows(replace(campaign), true).any(axis=1)
    speeding = np.abs(qdd).max(axis=1) > 1e-9
    assert used[speeding].mean() > 0.9


@pytest.mark.usefixtures("of_another_shape")
def test_what_is_left_of_a_log_of_ten_hertz_is_its_noise(seldom: tuple[Campaign, np.ndarray, np.ndarray]) -> None:
    """With all rows of clear motion the same fits leave some fifty times as much."""
    campaign, true, qdd = seldom
    used = used_rows(replace(campaign), true).any(axis=1)
    # Rows count where the joints turn evenly.
    assert np.mean(np.abs(qdd[used]).max(axis=1) < 1e-9) > 0.97


@pytest.mark.usefixtures("of_another_shape")
def test_the_screen_says_how_many_rows_show_the_motion(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    measure(
        draw_robot("big6", seed=5), tmp_path / "arm", noise="white", log="two_warmths", tables=("free_air",), seed=5
    )
    with pytest.raises(SystemExit) as ended:
        main(["identify", "arm", "-o", "model.json", "--json", "model_out.json"])
    assert not ended.value.code
    told = json.loads(Path("model_out.json").read_text(encoding="utf-8"))["stages"]["free_air"]["resolution"]
    assert 0 < told["rows"] < 0.6 * told["moving"]
    assert told["step_s"] == pytest.approx(STEP)
    words = " ".join(capsys.readouterr().out.split())
    counted = " ".join(f"{count_text(told['rows'])} of {count_text(told['moving'])} rows in motion count".split())
    assert counted in words
    assert "100 ms apart. Record more often, or speed up more slowly." in words


def facts(campaign: Campaign) -> LogFacts:
    return facts_of(log_parts([campaign]))


def test_all_rows_count_where_none_is_predicted_better_without_others(simulated: Callable[..., Campaign]) -> None:
    assert facts(simulated(seed=3, tables=("free_air", "wrist"))).motions.way.trusted == ()


@pytest.mark.slow
@pytest.mark.skipif(
    not (REAL := Path(__file__).parents[3] / "shared" / "real").exists(), reason="needs ../shared, which is not here"
)
@pytest.mark.parametrize("name", ["panda_log", "tx40_current_log"])
def test_all_rows_of_the_real_logs_count(name: str) -> None:
    assert facts(read_campaign(REAL / name)).motions.way.trusted == ()
