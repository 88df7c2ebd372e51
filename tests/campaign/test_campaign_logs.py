"""Faults of torque logs are found on the virtual robot's logs, and nothing is found where there is none."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.campaign import Campaign, read_campaign, write_campaign
from experiments.checks.check import Finding, check_campaign
from experiments.checks.friction import friction_findings
from experiments.checks.moving_log import moving_logs
from experiments.checks.torques import torque_shift
from experiments.signals import Shift, combine_shifts, time_shift
from experiments.virtual_robot import Hidden, Measured, measure
from kinematics.description import load_robot

KUKA = "kuka_kr20_r1810"
ROBOT = load_robot(KUKA)
T = ROBOT.transmission
RATED = np.abs(np.diag(T)) * [joint.rated_torque or np.nan for joint in ROBOT.joints]
Q, QD, TAU = ([p.format(i) for i in range(1, 7)] for p in ("q{}_rad", "qd{}_rad_s", "tau{}_Nm"))
Edit = Callable[[pd.DataFrame], pd.DataFrame]


@cache
def measured(robot: str, seed: int, hidden: str = "") -> Measured:
    effects = [Hidden.parse(hidden)] if hidden else []
    return measure(load_robot(robot), effects, seed=seed, tables=["free_air", "wrist"])


def campaign(
    folder: Path, edit: Edit | None = None, robot: str = KUKA, seed: int = 0, hidden: str = "", tables: str = "free_air"
) -> Campaign:
    logs = measured(robot, seed, hidden)
    frames = {name: logs.tables[name].copy() for name in tables.split()}
    changed = {name: edit(frame) if edit else frame for name, frame in frames.items()}
    return read_campaign(write_campaign(folder / "c", logs.header | {"robot": robot}, changed))


def serious(of: Campaign) -> list[Finding]:
    return [finding for finding in check_campaign(of) if finding.severity != "note"]


def only(of: Campaign, severity: str, words: str) -> Finding:
    (finding,) = serious(of)
    assert finding.severity == severity
    assert words in finding.message
    return finding


def friction_of(of: Campaign) -> list[Finding]:
    return list(friction_findings(of, moving_logs(of)))


@pytest.mark.parametrize("robot", [KUKA, "ur10"])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("speeds", [True, False])
def test_good_logs_have_nothing_but_notes(tmp_path: Path, robot: str, seed: int, speeds: bool) -> None:
    def edit(frame: pd.DataFrame) -> pd.DataFrame:
        return frame if speeds else frame.drop(columns=QD)

    assert serious(campaign(tmp_path, edit, robot, seed, tables="free_air wrist")) == []


@pytest.mark.parametrize(
    "hidden",
    [
        "payload:3", "gravity_compensator:3", "torque_offset:3", "stribeck_friction:2", "load_dependent_friction:2",
        "torque_ripple:2", "asymmetric_friction:2", "temperature_dependent_friction:2", "wrist_coupling_friction:2",
    ],
)  # fmt: skip
def test_physics_is_no_fault_of_the_log(tmp_path: Path, hidden: str) -> None:
    assert serious(campaign(tmp_path, hidden=hidden, tables="free_air wrist")) == []


def test_a_hose_that_pulls_like_a_weight_is_no_mirrored_torque(tmp_path: Path) -> None:
    assert serious(campaign(tmp_path, seed=5, hidden="dress_pack:3", tables="free_air wrist")) == []


class TestUnits:
    @pytest.mark.parametrize("seed", range(3))
    @pytest.mark.parametrize("table", ["free_air", "free_air wrist"])
    @pytest.mark.parametrize(("sign", "words"), [(1.0, ""), (-1.0, ", with the opposite sign")])
    def test_at_the_joint(self, tmp_path: Path, seed: int, table: str, sign: float, words: str) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            return frame.assign(**dict(zip(TAU, sign * np.linalg.solve(T, frame[TAU].to_numpy().T), strict=True)))

        for finding in serious(campaign(tmp_path, edit, seed=seed, tables=table)):
            assert finding.severity == "error"
            assert f"torques look like those at the joints, behind the gears{words};" in finding.message

    @pytest.mark.parametrize("seed", range(3))
    def test_per_cent(self, tmp_path: Path, seed: int) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            return frame.assign(**dict(zip(TAU, 100.0 * frame[TAU].to_numpy().T / RATED[:, None], strict=True)))

        only(campaign(tmp_path, edit, seed=seed), "error", "torques look like per cent of the motors' rated torque;")

    @pytest.mark.parametrize("seed", range(3))
    def test_signs(self, tmp_path: Path, seed: int) -> None:
        mirrored = campaign(tmp_path / "a", lambda f: f.assign(**{c: -f[c] for c in TAU}), seed=seed)
        only(mirrored, "error", "torques of all motors have the opposite sign")
        finding = only(campaign(tmp_path / "b", lambda f: f.assign(tau3_Nm=-f["tau3_Nm"]), seed=seed), "error", "")
        assert "torques of motor 3 have the opposite sign" in finding.message
        assert finding.column == "tau3_Nm"

    def test_an_unknown_unit(self, tmp_path: Path) -> None:
        found = serious(campaign(tmp_path, lambda f: f.assign(**{c: 0.01 * f[c] for c in TAU})))
        assert [f.severity for f in found] == ["warning"]
        assert "cannot be Nm at the motor shaft" in found[0].message
        assert "0.01 times" in found[0].message


def shifted(rows: int) -> Edit:
    def edit(frame: pd.DataFrame) -> pd.DataFrame:
        moved = frame.groupby("run")[TAU].shift(rows)
        return frame.assign(**{c: moved[c].groupby(frame["run"]).transform(lambda s: s.bfill().ffill()) for c in TAU})

    return edit


class TestShift:
    @pytest.mark.parametrize("rows", [-2, 1, 4])
    @pytest.mark.parametrize("robot", [KUKA, "ur10"])
    def test_it_is_found(self, tmp_path: Path, rows: int, robot: str) -> None:
        late = campaign(tmp_path, shifted(rows), robot)
        only(late, "warning", "after the positions" if rows > 0 else "before the positions")
        shift = torque_shift(late, "free_air")
        assert shift is not None
        assert abs(shift.seconds - 0.1 * rows) < 4.0 * shift.std_error

    @pytest.mark.slow
    def test_errors_are_honest(self, tmp_path: Path) -> None:
        # Of sound logs: scores of this and that robot are normal with a standard deviation near one.
        scores = []
        for robot in (KUKA, "ur10"):
            for seed in range(4):
                shift = torque_shift(campaign(tmp_path / f"{robot}{seed}", robot=robot, seed=seed), "free_air")
                assert shift is not None
                assert shift.std_error < 0.02
                scores.append(shift.seconds / shift.std_error)
        assert np.sqrt(np.mean(np.square(scores))) < 1.8  # one in a thousand for eight scores
        assert np.max(np.abs(scores)) < 4.0

    @pytest.mark.parametrize("shift", [-0.03, 0.0, 0.007, 0.2])
    def test_a_known_shift(self, shift: float) -> None:
        rng = np.random.default_rng(2)
        time, run = 0.01 * np.arange(6000), np.zeros(6000, dtype=np.int64)
        carrier = np.sin(0.9 * time) + np.sin(1.7 * time)
        log = 2.0 * (np.sin(0.9 * (time - shift)) + np.sin(1.7 * (time - shift))) + 1.0 + 0.1 * rng.normal(size=6000)
        used, move = np.ones(6000, dtype=bool), np.arange(6000) // 200
        args = (carrier[:, None], np.zeros((6000, 0)), np.ones((6000, 1)), time, run, used, move)
        found = time_shift(log, *args)
        assert found is not None
        assert abs(found.seconds - shift) < 4.0 * found.std_error < 0.01
        assert time_shift(rng.normal(size=6000), *args) is None  # nothing in common: no clock
        assert time_shift(log, *args[:-1], np.zeros(6000, dtype=np.int64)) is None  # one move

    def test_logs_that_disagree_say_less(self) -> None:
        same = combine_shifts([Shift(0.10, 0.01, 50.0), Shift(0.11, 0.01, 50.0), Shift(0.09, 0.01, 50.0)])
        apart = combine_shifts([Shift(0.10, 0.01, 50.0), Shift(0.50, 0.01, 50.0), Shift(-0.30, 0.01, 50.0)])
        assert same is not None
        assert apart is not None
        assert same.seconds == pytest.approx(0.1)
        assert same.std_error < 0.01 < 0.2 < apart.std_error
        assert same.freedom > 100 > 3 > apart.freedom
        assert combine_shifts([Shift(0.1, 0.01, 50.0)]) is None


def random_rows(frame: pd.DataFrame, share: float) -> np.ndarray:
    return np.sort(np.random.default_rng(0).choice(np.arange(1, len(frame)), int(share * len(frame)), replace=False))


class TestClock:
    @pytest.mark.parametrize("table", ["free_air", "wrist"])
    def test_dropped(self, tmp_path: Path, table: str) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            return frame.drop(index=random_rows(frame, 0.01)).reset_index(drop=True)

        of = campaign(tmp_path, edit, tables=table)
        lost = len(random_rows(measured(KUKA, 0).tables[table], 0.01))
        finding = only(of, "warning", " samples are missing in ")
        said = int(finding.message.split()[0])
        assert said == lost or said == lost - 1  # one may have been the last of its run
        steps = np.diff(of.tables[table]["time_s"].to_numpy(dtype=np.float64))
        assert finding.row == int(np.flatnonzero(steps > 0.15)[0]) + 2

    def test_repeated(self, tmp_path: Path) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            rows = random_rows(frame, 0.01)
            frame.loc[rows, Q + QD + TAU] = frame.loc[rows - 1, Q + QD + TAU].to_numpy()
            return frame

        only(campaign(tmp_path, edit), "warning", "rows repeat positions and torques of the row before")

    def test_held_positions(self, tmp_path: Path) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            even = (np.arange(len(frame)) // 2) * 2
            return frame.assign(**{c: frame[c].to_numpy()[even] for c in Q}).drop(columns=QD)

        found = serious(campaign(tmp_path, edit))
        assert any("the positions' source is slower than the log" in f.message for f in found)

    @pytest.mark.parametrize("jump", [-0.07, 0.43, 3.0])
    def test_jump(self, tmp_path: Path, jump: float) -> None:
        frame = measured(KUKA, 0).tables["free_air"]
        row = int(np.argmax(np.abs(frame["qd1_rad_s"].to_numpy()[:2000])))

        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            return frame.assign(time_s=frame["time_s"] + np.where(np.arange(len(frame)) >= row, jump, 0.0))

        finding = only(campaign(tmp_path, edit), "warning", "the clock jumps in 1 places")
        assert finding.row == row + 1
        assert f"by {jump:+.4g} s" in finding.message

    def test_irregular(self, tmp_path: Path) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            return frame.assign(time_s=frame["time_s"] + 0.02 * np.random.default_rng(0).uniform(-1, 1, len(frame)))

        of = campaign(tmp_path, edit)
        assert serious(of) == []
        assert any("time steps vary by 17%" in f.message for f in check_campaign(of))


def program(speed: Callable[[np.ndarray], np.ndarray]) -> Edit:
    """Joint 2 follows a speed of its own, as do its columns."""

    def edit(frame: pd.DataFrame) -> pd.DataFrame:
        frame = frame[frame["run"] == 1].iloc[:3000].reset_index(drop=True)
        qd = speed(np.arange(len(frame)) * 0.1)
        return frame.assign(q2_rad=-1.5 + np.cumsum(qd) * 0.1, qd2_rad_s=qd)

    return edit


class TestSpeeds:
    def words(self, of: Campaign) -> list[str]:
        return [f.message for f in serious(of) if f.column == "q2_rad"]

    def test_never_reverses(self, tmp_path: Path) -> None:
        (said,) = self.words(campaign(tmp_path, program(lambda t: 0.004 * (1.0 + np.sin(t / 5.0)))))
        assert "joint 2 never reverses" in said
        assert "its dry friction and its torque's offset are not separable" in said

    def test_one_speed(self, tmp_path: Path) -> None:
        # Two seconds each way at one speed, ramps of 0.3 s, and rests between.
        def speed(t: np.ndarray) -> np.ndarray:
            phase = t % 8.0
            shape = np.interp(phase % 4.0, [0.0, 0.3, 2.3, 2.6, 4.0], [0.0, 1.0, 1.0, 0.0, 0.0])
            return np.where(phase < 4.0, 0.3, -0.3) * shape

        (said,) = self.words(campaign(tmp_path, program(speed)))
        assert "joint 2 moves at one speed only (0.3 rad/s" in said
        assert "Coulomb and viscous friction are not separable" in said
        # A second run at 80 % is enough.
        two = program(lambda t: speed(t) * np.where(t < 150.0, 1.0, 0.8))
        assert self.words(campaign(tmp_path / "two", two)) == []

    @pytest.mark.parametrize("table", ["free_air", "wrist"])
    def test_standstill(self, tmp_path: Path, table: str) -> None:
        def edit(frame: pd.DataFrame) -> pd.DataFrame:
            return frame.assign(**{c: frame[c].iloc[0] for c in Q}, **dict.fromkeys(QD, 0.0))

        finding = only(campaign(tmp_path, edit, tables=table), "warning", f"nothing moves in {table} (standstill only)")
        assert finding.column == "q1_rad"


class TestFriction:
    """Friction takes energy, whatever the robot weighs."""

    @pytest.mark.parametrize("motor", [2, 5])
    def test_a_mirrored_torque_is_found_without_masses(self, motor: int, tmp_path: Path) -> None:
        def mirrored(frame: pd.DataFrame) -> pd.DataFrame:
            return frame.assign(**{f"tau{motor}_Nm": -frame[f"tau{motor}_Nm"]})

        found = friction_of(campaign(tmp_path, mirrored, seed=3))
        assert [f.column for f in found] == [f"tau{motor}_Nm"]
        assert found[0].severity == "warning"
        assert f"friction of motor {motor} drives it" in found[0].message

    @pytest.mark.parametrize("seed", range(4))
    def test_sound_logs_are_called_sound(self, seed: int, tmp_path: Path) -> None:
        sound = campaign(tmp_path, seed=seed, tables="free_air wrist")
        assert not friction_of(sound)
