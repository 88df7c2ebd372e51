"""A link as the robot of the server: never waits, says stale data, words errors as refusals."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import orjson
import pytest
from fake_controller import FakeController
from variable_server import VariableServer

from clampid.plain_json import finite
from experiments.links.eki import EkiLink
from experiments.links.protocol import Program, RefusedError
from experiments.links.varproxy import connect as connect_varproxy
from offline_ik.errors import DetectorError
from offline_ik.exchange.link import LinkedRobot

HOME = np.radians([0.0, -90.0, 90.0, 0.0, 45.0, 0.0])


@pytest.fixture
def robot(link: EkiLink) -> LinkedRobot:
    return LinkedRobot(link, "eki://here")


def until(holds: Callable[[], object]) -> None:
    end = time.monotonic() + 5.0
    while not holds():
        assert time.monotonic() < end, "it never came to be"
        time.sleep(0.002)


def test_a_move_and_its_state(controller: FakeController, robot: LinkedRobot) -> None:
    np.testing.assert_allclose(robot.posture(), HOME, atol=1e-12)
    goal = HOME + 0.1
    robot.move(np.array([HOME, goal]), 0.1)
    until(lambda: robot.state()["program"]["phase"] == "finished")
    until(lambda: np.allclose(robot.posture(), goal, atol=1e-9))
    found = orjson.loads(orjson.dumps(finite(dict(robot.state()))))
    assert found["address"] == "eki://here"
    assert (found["program"]["point"], found["stale"], found["question"], found["mode"]) == (2, False, None, "EXT")
    assert [v["Speed"] for v in controller.target] == [10.0, 10.0]
    assert robot.capabilities()["executes"]


def test_no_call_waits_for_a_controller_that_does_not_answer(controller: FakeController, robot: LinkedRobot) -> None:
    controller.lock.acquire()
    try:
        time.sleep(0.6)
        begun = time.perf_counter()
        with pytest.raises(DetectorError, match="the robot's posture is not known: its last status is 0"):
            robot.posture()
        assert robot.state()["stale"]
        with pytest.raises(DetectorError, match="too old to move by"):
            robot.move(HOME[None, :], 0.1)
        robot.stop()
        assert time.perf_counter() - begun < 0.05
    finally:
        controller.lock.release()
    until(lambda: controller.stopped)


def test_a_move_after_an_own_stop_lifts_it(controller: FakeController, robot: LinkedRobot) -> None:
    controller.point_s = 5.0
    robot.move(HOME[None, :], 0.1)
    assert robot.state()["moving"]
    until(lambda: robot.state()["program"]["phase"] == "running")
    robot.stop()
    robot.stop()
    until(lambda: not robot.state()["moving"])
    assert (robot.state()["program"]["phase"], robot.state()["failed"]) == ("interrupted", None)
    controller.point_s = 0.0
    robot.move(HOME[None, :], 0.1)
    until(lambda: robot.state()["program"]["phase"] == "finished")
    assert controller.begun == 2


def test_a_stop_of_before_the_server_began_is_lifted_by_a_move(controller: FakeController, link: EkiLink) -> None:
    link.stop()
    until(lambda: link.status().stopped and not link._state.stop_wanted)
    with pytest.raises(RefusedError, match="not released"):
        link.execute(Program(HOME[None, :], 0.1))
    robot = LinkedRobot(link, "eki://here")
    robot.move(HOME[None, :], 0.1)
    until(lambda: robot.state()["program"]["phase"] == "finished")


def test_a_stop_while_a_stop_is_lifted_refuses_the_move(controller: FakeController, robot: LinkedRobot) -> None:
    robot.stop()
    release = robot.link.release

    def stopped_again() -> None:
        release()
        robot.stop()

    robot.link.release = stopped_again
    with pytest.raises(DetectorError, match="could not be lifted"):
        robot.move(HOME[None, :], 0.1)
    assert not controller.begun


def test_what_a_person_has_to_look_at_is_asked_and_settled(controller: FakeController, robot: LinkedRobot) -> None:
    controller.point_s = 5.0
    robot.move(HOME[None, :], 0.1)
    until(lambda: robot.state()["program"]["phase"] == "running")
    controller.restart()
    until(lambda: robot.state()["failed"])
    assert "started again" in robot.state()["failed"]
    until(lambda: not robot.state()["stale"])
    with controller.lock:
        controller.stopped = True  # by somebody else
    until(lambda: robot.state()["stopped"])
    with pytest.raises(DetectorError):
        robot.move(HOME[None, :], 0.1)
    robot.confirm()
    assert robot.state()["question"] is None
    controller.point_s = 0.0
    until(lambda: robot.link._motion.ready)
    robot.move(HOME[None, :], 0.1)
    until(lambda: robot.state()["program"]["phase"] == "finished")


def test_a_link_that_only_reads_is_a_robot_that_refuses_to_move() -> None:
    values = {"$AXIS_ACT_MEAS": "{E6AXIS: A1 0, A2 -90, A3 90, A4 0, A5 45, A6 0}"}
    server = VariableServer("127.0.0.1", 0, values.get)
    from experiments.links.address import LinkAddress

    robot = LinkedRobot(connect_varproxy(LinkAddress("varproxy", "127.0.0.1", server.port)), "v")
    try:
        np.testing.assert_allclose(robot.posture(), HOME)
        with pytest.raises(DetectorError, match="reads only"):
            robot.move(HOME[None, :], 0.1)
        with pytest.raises(DetectorError, match="the controller's own stop"):
            robot.stop()
        assert robot.state()["accepted"] is None
        assert not robot.executes
        until(lambda: robot.link.status().moves is False)
        values["$AXIS_ACT_MEAS"] = values["$AXIS_ACT_MEAS"].replace("A2 -90", "A2 -88")
        until(lambda: robot.state()["moving"])  # by whoever
        until(lambda: not robot.state()["moving"])
    finally:
        robot.close()
        server.close()
