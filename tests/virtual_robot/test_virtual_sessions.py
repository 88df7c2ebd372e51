"""A second session: the robot is the same to the last number, and nothing of the day, the tool or the instrument is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments.virtual_robot import Hidden, Measured, measure
from kinematics.description import load_robot

OF_THE_SESSION = {
    "geometry.targets",
    "instrument.rotation",
    "instrument.origin",
    *(f"heat.{key}" for key in ("start", "ambient", "swing", "period", "phase")),
}
HIDDEN = (Hidden("gear_eccentricity", "joint2"), Hidden("instrument_scale"))
TABLES = ("free_air", "poses", "verification")


def numbers(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Every field of a plant that is not itself a set of fields, with its path."""
    for field in fields(value):
        inner = getattr(value, field.name)
        path = f"{name}.{field.name}".lstrip(".")
        if is_dataclass(inner):
            yield from numbers(inner, path)
        else:
            yield path, np.array(list(inner.values())) if field.name in ("targets", "outside") else inner


@pytest.fixture(scope="module")
def sessions() -> tuple[Measured, ...]:
    robot = load_robot("kuka_kr20_r1810")
    return tuple(measure(robot, HIDDEN, seed=7, session=session, poses=20, tables=TABLES) for session in (1, 2, 3))


@pytest.mark.parametrize("which", ["plant", "baseline"])
@pytest.mark.parametrize("pair", [(0, 1), (1, 2)])
def test_the_robot_is_the_same_and_what_is_of_the_session_is_not(
    sessions: tuple[Measured, ...], which: str, pair: tuple[int, int]
) -> None:
    one, other = (dict(numbers(getattr(sessions[k].truth, which))) for k in pair)
    assert {path for path in one if not np.array_equal(one[path], other[path])} == OF_THE_SESSION
    for path in OF_THE_SESSION:  # not one number of them is the same
        assert not np.any(np.equal(one[path], other[path])), path
    assert sessions[pair[0]].hidden == sessions[pair[1]].hidden


def test_no_posture_is_visited_in_both(sessions: tuple[Measured, ...]) -> None:
    q = [f"q{i}_rad" for i in range(1, 7)]
    for table in ("poses", "verification"):
        first, second = (m.tables[table][q].drop_duplicates().to_numpy() for m in sessions[:2])
        apart = np.abs(first[:, None] - second).max(axis=2)
        assert apart.min() > 0.01  # rad
    assert not np.array_equal(sessions[0].tables["free_air"][q[0]], sessions[1].tables["free_air"][q[0]])


def test_noise_is_the_session_s_own(sessions: tuple[Measured, ...]) -> None:
    def noise(measured: Measured) -> np.ndarray:
        read = measured.tables["verification"][["x_m", "y_m", "z_m"]].to_numpy()
        return (read - measured.truth.noise_free["verification"]).ravel()

    one, two = noise(sessions[0]), noise(sessions[1])
    assert abs(np.corrcoef(one, two)[0, 1]) < 4 / np.sqrt(len(one))


def test_the_first_session_is_what_the_seed_alone_gives(sessions: tuple[Measured, ...]) -> None:
    plain = measure(load_robot("kuka_kr20_r1810"), HIDDEN, seed=7, poses=20, tables=TABLES)
    for name in TABLES:
        pd.testing.assert_frame_equal(plain.tables[name], sessions[0].tables[name])


def test_sessions_are_counted_from_1() -> None:
    with pytest.raises(ValueError, match="session: expected 1 or more, found 0"):
        measure(load_robot("ur10"), session=0, tables=("poses",))
