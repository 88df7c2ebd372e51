"""DH and Hayati tables say the same as screws, however parallel the axes are, or are refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinematics import (
    DHError,
    DHRow,
    DHTable,
    forward,
    hayati_from_poe,
    load_robot,
    poe_from_dh,
    robot_names,
    standard_from_poe,
)
from kinematics import dh as dh_module
from kinematics.dh_conversion import HAYATI_BELOW, reconstruction_error
from kinematics.screws import exp_se3, exp_so3, prismatic_screw, screw

few = settings(derandomize=True, max_examples=150, deadline=None)
LIMIT = 1e-12


def unit(v):
    return v / np.linalg.norm(v)


@st.composite
def chains(draw, kinds=("random", "parallel", "anti-parallel", "nearly", "nearly anti")):
    """Chains of 2 to 7 joints whose neighbours are related in every way that matters."""
    n = draw(st.integers(2, 7))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    axis, S = unit(rng.normal(size=3)), []
    for _ in range(n):
        S.append(screw(axis, rng.uniform(-1, 1, 3)))
        kind = draw(st.sampled_from(kinds))
        if kind == "random":
            axis = unit(rng.normal(size=3))
        if "anti" in kind:
            axis = -axis
        if "nearly" in kind:
            axis = exp_so3(10 ** draw(st.floats(-9, -3)) * unit(rng.normal(size=3))) @ axis
            axis = unit(axis)
    return np.array(S), exp_se3(rng.normal(size=6))


def worst(table, S, home):
    q = np.random.default_rng(7).uniform(-3, 3, (50, len(S)))
    return np.abs(dh_module.forward(table, q) - forward(S, home, q)).max()


@few
@given(chains())
def test_hayati_is_exact(chain):
    S, home = chain
    table = hayati_from_poe(S, home)
    assert worst(table, S, home) < LIMIT
    assert all(row.d == 0.0 for row in table.rows if row.beta != 0.0)


@few
@given(chains())
def test_hayati_comes_back_as_the_same_screws(chain):
    S, home = chain
    screws, pose = poe_from_dh(hayati_from_poe(S, home))
    np.testing.assert_allclose(screws, S, atol=LIMIT)
    np.testing.assert_allclose(pose, home, atol=LIMIT)


@few
@given(chains(kinds=("random", "parallel", "anti-parallel")))
def test_standard_is_as_exact_as_its_offsets_are_small(chain):
    S, home = chain
    table = standard_from_poe(S, home)
    assert all(row.beta == 0.0 for row in table.rows)
    # Random axes may come near each other; what may be lost then is stated, not hidden.
    longest = max(1.0, *(abs(row.d) for row in table.rows))
    assert worst(table, S, home) < 1e-14 * longest * 10


@few
@given(chains())
def test_standard_loses_no_more_than_it_says_or_refuses(chain):
    S, home = chain
    try:
        table = standard_from_poe(S, home)
    except DHError as error:
        assert "from parallel" in str(error)  # noqa: PT017 (both outcomes are right)
        return
    assert worst(table, S, home) < 1e-6


@pytest.mark.parametrize("angle", [1e-12, 1e-11])
@pytest.mark.parametrize("flip", [1, -1])
def test_standard_refuses_what_costs_more_than_a_micrometre(angle, flip):
    tilted = flip * np.array([0.0, np.sin(angle), np.cos(angle)])
    S = np.stack([screw([0, 0, 1], [0, 0, 0]), screw(tilted, [0.3, 0.5, 0.1]), screw([1, 0, 0], [0.5, 0.5, 0.9])])
    home = exp_se3([0.1, 0.2, 0.3, 1, 1, 1])
    with pytest.raises(DHError, match=r"lose .* m by cancellation.*axes 1 and 2 are.*d of row 1 is .*e\+1\d m.*Hayati"):
        standard_from_poe(S, home)
    assert worst(hayati_from_poe(S, home), S, home) < LIMIT


@pytest.mark.parametrize(("angle", "length"), [(1e-3, 1e3), (1e-6, 1e6), (1e-9, 1e9)])
def test_offsets_grow_like_one_over_the_angle(angle, length):
    S = np.stack([screw([0, 0, 1], [0, 0, 0]), screw([0, np.sin(angle), np.cos(angle)], [0.3, 0.5, 0.1])])
    home = exp_se3([0.1, 0.2, 0.3, 1, 1, 1])
    table = standard_from_poe(S, home)
    assert abs(table.rows[0].d) == pytest.approx(0.5 * length, rel=1e-3)
    stated = reconstruction_error(table, S, home)
    assert worst(table, S, home) <= stated < 1e-6


@pytest.mark.parametrize("convert", [standard_from_poe, hayati_from_poe])
@pytest.mark.parametrize("name", robot_names())
def test_nominal_robots(convert, name):
    robot = load_robot(name)
    for like in (None, robot.dh):
        table = convert(robot.screws, robot.flange, like)
        assert worst(table, robot.screws, robot.flange) < LIMIT
        np.testing.assert_allclose(table.base, np.eye(4), atol=1e-15)
        np.testing.assert_allclose(table.tool, np.eye(4), atol=1e-15)


@pytest.mark.parametrize("name", ["kuka_kr20_r1810", "kuka_kr16_2", "kuka_kr30_3", "ur10"])
@pytest.mark.parametrize("convert", [standard_from_poe, hayati_from_poe])
def test_printed_tables_come_out_as_printed(name, convert):
    robot = load_robot(name)
    table = convert(robot.screws, robot.flange, robot.dh)
    for found, printed in zip(table.rows, robot.dh.rows, strict=True):
        assert found.sign == printed.sign
        for key in ("theta_offset", "d", "a", "alpha", "beta"):
            assert getattr(found, key) == pytest.approx(getattr(printed, key), abs=1e-14), key


def test_reference_robot_comes_out_as_printed_without_being_told():
    robot = load_robot("kuka_kr20_r1810")
    table = standard_from_poe(robot.screws, robot.flange)
    for found, printed in zip(table.rows, robot.dh.rows, strict=True):
        assert found.sign == printed.sign
        assert (found.d, found.a, found.alpha) == pytest.approx((printed.d, printed.a, printed.alpha), abs=1e-14)
        assert np.exp(1j * found.theta_offset) == pytest.approx(np.exp(1j * printed.theta_offset), abs=1e-14)


def test_calibrated_table_stays_near_the_nominal_one(rng):
    robot = load_robot("kuka_kr20_r1810")
    S = np.array(
        [
            screw(exp_so3(1e-4 * rng.normal(size=3)) @ joint.axis, joint.point + 1e-4 * rng.normal(size=3))
            for joint in robot.joints
        ]
    )
    home = robot.flange @ exp_se3(1e-4 * rng.normal(size=6))
    table = hayati_from_poe(S, home, robot.dh)
    assert worst(table, S, home) < LIMIT
    for found, printed in zip(table.rows, robot.dh.rows, strict=True):
        assert found.sign == printed.sign
        for key in ("theta_offset", "d", "a", "alpha", "beta"):
            difference = getattr(found, key) - getattr(printed, key)
            difference = np.remainder(difference + np.pi, 2 * np.pi) - np.pi
            assert abs(difference) < 2e-3, key
    np.testing.assert_allclose(table.tool, np.eye(4), atol=2e-3)
    # Here axes 2 and 3 are 1e-4 rad apart: a standard table has kilometres in it, and still serves.
    standard = standard_from_poe(S, home, robot.dh)
    assert max(abs(row.d) for row in standard.rows) > 1000
    assert worst(standard, S, home) < 1e-9


def test_hayati_rows_only_where_axes_are_nearly_parallel():
    robot = load_robot("kuka_kr20_r1810")
    S = np.array(robot.screws)
    S[2] = screw(exp_so3([1e-3, 0, 0]) @ robot.joints[2].axis, robot.joints[2].point)
    rows = hayati_from_poe(S, robot.flange).rows
    assert rows[1].d == 0.0
    assert rows[1].beta != 0.0 or rows[1].alpha != 0.0
    for i, row in enumerate(rows[:-1]):
        if np.linalg.norm(np.cross(S[i, :3], S[i + 1, :3])) > HAYATI_BELOW:
            assert row.beta == 0.0


def test_table_to_screws_and_forward_agree(rng):
    rows = tuple(DHRow(int(rng.choice([-1, 1])), *rng.normal(size=5), prismatic=i == 2) for i in range(5))
    table = DHTable(rows, exp_se3(rng.normal(size=6)), exp_se3(rng.normal(size=6)), "hayati")
    assert worst(table, *poe_from_dh(table)) < LIMIT


def test_the_formula_of_the_interface():
    row, q = DHRow(-1, 0.3, 0.4, 0.5, 0.6, 0.7), 0.9

    def rotation(axis, angle):
        T = np.eye(4)
        T[:3, :3] = exp_so3(angle * np.eye(3)[axis])
        return T

    def shift(axis, length):
        T = np.eye(4)
        T[axis, 3] = length
        return T

    expected = rotation(2, -0.9 + 0.3) @ shift(2, 0.4) @ shift(0, 0.5) @ rotation(0, 0.6) @ rotation(1, 0.7)
    np.testing.assert_allclose(dh_module.row_transform(row, q), expected, atol=1e-15)


@pytest.mark.parametrize("convert", [standard_from_poe, hayati_from_poe])
@pytest.mark.parametrize("kinds", ["rrpr", "prr", "rpp", "ppp", "rrp"])
def test_prismatic_joints(convert, kinds, rng):
    S = np.array(
        [
            screw(unit(rng.normal(size=3)), rng.normal(size=3))
            if kind == "r"
            else prismatic_screw(unit(rng.normal(size=3)))
            for kind in kinds
        ]
    )
    home = exp_se3(rng.normal(size=6))
    table = convert(S, home)
    assert [row.prismatic for row in table.rows] == [kind == "p" for kind in kinds]
    assert worst(table, S, home) < LIMIT


def test_scara_with_parallel_slide(rng):
    S = np.stack(
        [screw([0, 0, 1], [0, 0, 0]), screw([0, 0, 1], [0.4, 0, 0]), prismatic_screw([0, 0, -1]),
         screw([0, 0, -1], [0.7, 0, 0])]
    )  # fmt: skip
    home = np.diag([1.0, -1.0, -1.0, 1.0])
    home[:3, 3] = 0.7, 0, 0.2
    for convert in (standard_from_poe, hayati_from_poe):
        assert worst(convert(S, home), S, home) < LIMIT


def test_refusals_say_why():
    S = np.stack([screw([0, 0, 1], [0, 0, 0]), screw([0, 1, 0], [0, 0, 1], 0.01)])
    with pytest.raises(DHError, match=r"joint 2: a DH row cannot describe a helical joint, found a pitch of 0\.01"):
        hayati_from_poe(S, np.eye(4))
    with pytest.raises(DHError, match="joint 1: expected a screw of unit length"):
        hayati_from_poe(2 * S, np.eye(4))
    with pytest.raises(DHError, match="expected 2 rows, found 6"):
        hayati_from_poe(S, np.eye(4), load_robot("ur10").dh)
    with pytest.raises(ValueError, match="one value per row"):
        dh_module.forward(load_robot("ur10").dh, np.zeros(5))
