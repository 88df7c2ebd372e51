"""What appendix_data/DERIVATION.md states, checked against the printed tables themselves."""

import csv
from fractions import Fraction
from importlib import resources

import numpy as np
import pytest

from kinematics import DHRow, DHTable, Transmission, load_robot, poe_from_dh, space_jacobian
from kinematics.dh import forward as dh_forward
from kinematics.poe import forward


def table(name: str) -> list[dict[str, str]]:
    with resources.files("appendix_data").joinpath(name).open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def angle(text: str) -> float:
    sign = -1.0 if text.startswith("-") else 1.0
    text = text.lstrip("+-")
    if text in ("", "0"):
        return 0.0
    return sign * np.pi / float(text.removeprefix("pi").removeprefix("/") or 1)


def dh_table(name: str) -> DHTable:
    rows = []
    for i, row in enumerate(table(name), 1):
        sign, offset = row["theta"].split(f"theta{i}")
        rows.append(
            DHRow(-1 if sign == "-" else 1, angle(offset), float(row["d_m"]), float(row["a_m"]), angle(row["alpha"]))
        )
    return DHTable(tuple(rows))


@pytest.fixture(scope="module")
def T() -> list[list[Fraction]]:
    return [[Fraction(row[f"joint{j}"]) for j in range(1, 7)] for row in table("transmission_printed.csv")]


@pytest.fixture(scope="module")
def robot():
    return load_robot("kuka_kr20_r1810")


def test_printed_dh_table_taken_literally_contradicts_the_machine(robot):
    screws, _ = poe_from_dh(dh_table("dh_nominal_printed.csv"))
    shoulder = np.cross(screws[1, :3], screws[1, 3:])
    np.testing.assert_allclose(shoulder, [0.160, 0.0, -0.520], atol=1e-15)  # below the base
    np.testing.assert_allclose(screws[5, :3], [1.0, 0.0, 0.0], atol=1e-15)  # joint 6 the other way round
    np.testing.assert_allclose(robot.screws[5, :3], [-1.0, 0.0, 0.0], atol=1e-15)


def test_a_base_transform_hides_the_first_error_but_not_the_second(robot, rng):
    printed, q = dh_table("dh_nominal_printed.csv"), rng.uniform(-3, 3, (40, 6))
    lifted = np.eye(4)
    lifted[2, 3] = 1.040
    poses, truth = dh_forward(DHTable(printed.rows, base=lifted), q), forward(robot.screws, robot.flange, q)
    np.testing.assert_allclose(poses[:, :3, 3], truth[:, :3, 3], atol=1e-14)
    relative = np.swapaxes(poses[:, :3, :3], -1, -2) @ truth[:, :3, :3]
    assert np.ptp(relative, axis=0).max() > 1  # no constant tool makes up for it


def test_consistent_dh_table_is_the_machine(robot, rng):
    consistent, q = dh_table("dh_nominal_consistent.csv"), rng.uniform(-3, 3, (40, 6))
    np.testing.assert_allclose(dh_forward(consistent, q), forward(robot.screws, robot.flange, q), atol=1e-12)
    screws, home = poe_from_dh(consistent)
    np.testing.assert_allclose(screws, robot.screws, atol=1e-15)
    np.testing.assert_allclose(home, robot.flange, atol=1e-15)


def test_only_two_rows_differ():
    printed, consistent = table("dh_nominal_printed.csv"), table("dh_nominal_consistent.csv")
    assert [i for i, (a, b) in enumerate(zip(printed, consistent, strict=True), 1) if a != b] == [1, 6]
    assert {key for key in printed[0] if printed[0][key] != consistent[0][key]} == {"d_m"}
    assert printed[5]["d_m"] == consistent[5]["d_m"]


def test_reach(robot):
    assert 0.160 + 0.780 + np.hypot(0.860, 0.150) == pytest.approx(1.813, abs=5e-5)
    straight = np.arctan2(0.150, 0.860)
    wrist = forward(robot.screws, robot.flange, [0.0, 0.0, straight, 0.0, 0.0, 0.0]) @ [0.0, 0.0, -0.153, 1.0]
    assert np.hypot(wrist[0], wrist[1]) == pytest.approx(1.813, abs=5e-5)


def test_description_has_the_printed_transmission(robot, T):
    np.testing.assert_array_equal(robot.transmission, np.array(T, dtype=float))
    np.testing.assert_array_equal(
        robot.motor_spring, [float(row["k_Nm_rad_at_the_motor"]) for row in table("motor_springs_printed.csv")]
    )


def test_off_diagonal_entries_are_products_of_clean_ratios(T):
    F = Fraction
    assert F(98, 7095) / F(7, 387) == F(42, 55)
    # θ_joint = Tᵀ·θ_motor: column j of T says what each motor does to joint j.
    theta4 = [T[i][3] for i in range(6)]
    theta5 = [T[i][4] for i in range(6)]
    theta6 = [T[i][5] for i in range(6)]
    motor = [[F(i == k) for i in range(6)] for k in range(6)]
    assert theta4 == [F(37, 2940) * m for m in motor[3]]
    assert theta5 == [-F(7, 387) * a - F(98, 7095) * m for a, m in zip(theta4, motor[4], strict=True)]
    assert theta6 == [
        F(23, 990) * a - F(368, 17787) * (b - m) for a, b, m in zip(theta5, theta4, motor[5], strict=True)
    ]


def test_small_angles_are_at_the_joint(T):
    assert all(0 < abs(T[i][i]) < Fraction(1, 40) for i in range(6))


def test_turning_joint_4_alone_turns_5_and_6_if_their_motors_stand_still(robot):
    gears = Transmission(robot.transmission)
    q = gears.joint_from_motor([0.0, 0.0, 0.0, 100.0, 0.0, 0.0])
    assert q[4] == pytest.approx(-7 / 387 * q[3])
    assert q[5] == pytest.approx(23 / 990 * q[4] - 368 / 17787 * q[3])


def test_worked_example_of_the_thesis(robot):
    torque, lever = 8.03, 0.153
    alone = (98 / 7095) ** 2 / 1.28 * torque * lever
    assert alone == pytest.approx(183.12e-6, abs=5e-9)
    compliance = Transmission(robot.transmission).joint_compliance(robot.motor_spring)
    assert compliance[4, 4] == pytest.approx((98 / 7095) ** 2 / 1.28 + (37 / 162540) ** 2 / 2.07)
    assert compliance[4, 4] * torque * lever == pytest.approx(183.15e-6, abs=5e-9)
    # The same as a displacement of the flange: at the zero pose joints 4 and 6 turn about a line through it.
    twist = space_jacobian(robot.screws, np.zeros(6)) @ compliance @ [0, 0, 0, 0, torque, 0]
    moved = twist[3:] + np.cross(twist[:3], robot.flange[:3, 3])
    assert np.linalg.norm(moved) == pytest.approx(183.15e-6, abs=5e-9)


def test_joint_springs(robot):
    k = robot.motor_spring / np.diag(robot.transmission) ** 2
    np.testing.assert_allclose(k / 1e3, [157, 396, 255, 13.1, 6.7, 1.3], rtol=0.01)
