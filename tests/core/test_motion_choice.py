"""How speeds and accelerations are taken from a log: its torques choose the window, and the columns."""

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pandas as pd
import pytest

from clampid.comparison.compare import compare
from clampid.identification.identify import identify, standard_effects
from clampid.loop.auto import auto
from clampid.stages import motion_choice
from clampid.stages.log_facts import WINDOW_S, LogFacts, facts_of, log_parts
from clampid.stages.motion_choice import BLOCKS, Regression, Way
from experiments.campaign import Campaign, read_campaign
from experiments.log_windows import windows
from experiments.second_world import draw_robot, measure

REAL = Path(__file__).parents[3] / "shared" / "real"
BAR = (0.985, 0.998, 0.995, 0.991, 0.970, 0.981, 0.945)
"""R² of raw torques on the last fifth of the Panda log after ordinary least squares on the first four."""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    folder = tmp_path_factory.mktemp("log") / "arm"
    robot = draw_robot("small6", seed=7)
    measure(robot, folder, noise="white", log="fourier_1khz", tables=("free_air",), seed=7)
    return read_campaign(folder)


def with_log(campaign: Campaign, table: pd.DataFrame) -> Campaign:
    return replace(campaign, tables=MappingProxyType({**campaign.tables, "free_air": table}))


def with_jitter(campaign: Campaign, std_rad: float, seed: int) -> Campaign:
    """The same log without speeds, of positions with errors, one sample in sixteen written twice."""
    rng, table = np.random.default_rng(seed), campaign.tables["free_air"].copy()
    table = table[[c for c in table if not c.startswith("qd")]]
    q = [c for c in table if c.startswith("q")]
    table[q] += std_rad * rng.standard_normal((len(table), len(q)))
    again = np.flatnonzero(rng.random(len(table)) < 1 / 16)
    again = again[again > 0]
    table.iloc[again, [table.columns.get_loc(c) for c in q]] = table[q].to_numpy()[again - 1]
    return with_log(campaign, table)


def facts(campaign: Campaign) -> LogFacts:
    return facts_of(log_parts([campaign]))


def test_where_no_torque_was_measured_none_is_predicted(log: Campaign, monkeypatch: pytest.MonkeyPatch) -> None:
    """Plans are seen as logs without torques, one for each program that is tried: no way is looked for in them."""
    unmeasured = with_log(log, log.tables["free_air"].assign(**{f"tau{j}_Nm": 0.0 for j in range(1, 7)}))
    monkeypatch.setattr("clampid.stages.log_facts.chosen_way", lambda *_: pytest.fail("it looks for a way"))
    found = facts(unmeasured)
    assert found.motions.way == Way(logged=True, window_s=WINDOW_S)
    assert np.all(np.isinf(found.regression))
    with pytest.raises(pytest.fail.Exception):
        facts(replace(log, fingerprint="measured"))


def test_noise_of_positions_asks_for_a_longer_window(log: Campaign) -> None:
    noisy, clean = facts(with_jitter(log, 2e-4, 1)), facts(log)
    assert noisy.motions.way.window_s > 2.0 * WINDOW_S
    # The torques are then predicted nearly as well as from speeds without that noise.
    assert np.all(noisy.regression < 1.3 * clean.regression)


def test_accelerations_of_the_chosen_window_are_the_arms(log: Campaign) -> None:
    def accelerations(campaign: Campaign, window_s: float | None) -> np.ndarray:
        found = facts(campaign)
        motions = found.motions
        if window_s is not None:
            motions = type(motions)(motions.n, motions.step, replace(motions.way, window_s=window_s))
        parts = log_parts([campaign])
        got = [
            motions.at(w).acceleration[w.start : w.stop]
            for w in windows(parts[0].table, motions.columns, 1 << 15, 2000)
        ]
        return np.concatenate(got)

    truth, noisy = accelerations(log, None), with_jitter(log, 2e-4, 1)
    inner = slice(400, -400)
    error, before = (np.sqrt(np.mean((accelerations(noisy, w) - truth)[inner] ** 2)) for w in (None, WINDOW_S))
    assert error < 0.1 * before
    assert error < 0.2 * truth.std()


def test_a_log_of_ten_hertz_keeps_the_shortest_window(tmp_path: Path) -> None:
    measure(draw_robot("uncoupled6", seed=3), tmp_path / "arm", log="trapezoids_10hz", tables=("free_air",), seed=3)
    assert facts(read_campaign(tmp_path / "arm")).motions.way.window_s == WINDOW_S


def test_accelerated_logs_get_the_inertia_of_rotors_and_links(log: Campaign) -> None:
    names = {term.effect for term in standard_effects([log])["free_air"]}
    assert {"inertia", "link_inertia"} <= names


@pytest.mark.slow
def test_the_floor_has_no_part_of_the_model_in_it(log: Campaign) -> None:
    """Torques of acceleration that a model lacks last for seconds: taken from its residual, they would be noise."""
    poor = identify(log, {"free_air": ["gravity", "coulomb_friction", "inertia@joint1"]})
    good = identify(log)
    motors = [compare(m, log).tables["free_air"]["per_motor"] for m in (poor, good)]
    floors = np.array([[m["noise_floor_Nm"] for m in of] for of in motors])
    errors = np.array([[m["rms_Nm"] for m in of] for of in motors])
    most = np.argmax(errors[0] / errors[1])
    assert errors[0, most] > 3.0 * errors[1, most]
    assert np.all(floors[0] < 1.2 * floors[1])
    assert np.all(errors[1] < 1.1 * floors[1])


@pytest.mark.skipif(not (REAL / "panda_log").is_dir(), reason="../shared/real is not there")
@pytest.mark.parametrize(
    "way",
    [
        pytest.param("identify with offsets", marks=pytest.mark.slow),
        pytest.param("auto", marks=pytest.mark.study),
    ],
)
def test_dynamics_of_a_real_arm(way: str) -> None:
    """Franka Panda: all joints as well as by least squares that has offsets of the torque sensors.

    `auto` is told nothing of these, and finds them. `identify` stays behind by 0.005 at joint 5: 0.0248 of its variance
    is above 20 Hz, and least squares with the same columns and motion leave 0.0033 to 0.0045.
    """
    whole = read_campaign(REAL / "panda_log")
    table = whole.tables["free_air"]
    cut = int(0.8 * len(table))
    first = with_log(whole, table.iloc[:cut].reset_index(drop=True))
    names = [t.label for t in standard_effects([first])["free_air"]]
    assert {"inertia", "link_inertia"} <= set(names)
    model = auto(first)[0] if way == "auto" else identify(first, {"free_air": [*names, "torque_offset"]})
    last = with_log(whole, table.iloc[cut:].reset_index(drop=True))
    last = replace(last, fingerprint="the last fifth")
    motors = compare(model, last).tables["free_air"]["per_motor"]
    found = np.array([m["r2"] for m in motors])
    missed = {} if way == "auto" else {4: 0.006}
    assert np.all(found > np.array(BAR) - [missed.get(k, 0.0) for k in range(len(BAR))]), found


def test_columns_of_a_single_fold_are_not_rounding_errors() -> None:
    """Three columns are next to nothing but in one fold, as of joints that move once; the rest predicts that fold."""
    rng = np.random.default_rng(3)
    block = np.repeat(np.arange(BLOCKS), 40)
    both = rng.standard_normal((len(block), 6))
    both[block % 5 != 2, 2:5] *= 1e-10
    every = np.ones(len(block), dtype=bool)
    left = motion_choice._squares(both, block, every, every)
    assert np.all(np.isfinite(left))
    assert np.all(left < 3.0)


def test_rows_that_are_resolved_about_as_well_count_together() -> None:
    """A twentieth of the rows, of one move, has a misfit a tenth smaller than most others."""
    found = object.__new__(Regression)
    misfit = np.r_[np.full(50, 1.0e-4), np.linspace(1.1e-4, 1.2e-4, 750), np.geomspace(1e-3, 1e-1, 200)]
    found.__dict__["unresolved"], found._moving = misfit, np.ones((len(misfit), 2), dtype=bool)
    assert found.limits()[0] == pytest.approx(1.2e-4, rel=0.01)
    found.__dict__["unresolved"] = np.geomspace(1e-4, 1e-1, 1000)
    limits = found.limits()
    assert limits == sorted(limits)
    assert limits[-1] / limits[0] > 50.0  # misfits that differ stay apart
    best = np.quantile(found.unresolved, 0.05, method="lower")
    assert len(np.unique(np.floor(np.log2(np.array(limits) / best)))) == len(limits)
