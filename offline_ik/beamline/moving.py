"""Requests about the linked robot: `move`, `moved`, `robot`, `hold`, `release`, `confirm` and `stop`."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from clampid.plain_json import finite
from clampid.wrong_call import CallError
from offline_ik.beamline.robot import STOOD_STILL, LinkedRobot
from offline_ik.exchange.asked import sides_of, simulated_at_once, simulation_of
from offline_ik.exchange.requests import RequestError, number, switch
from offline_ik.exchange.session import Later, Reply, Session
from offline_ik.motion.simulation import Simulation

if TYPE_CHECKING:
    from offline_ik.server.protocol import Speaker

__all__ = ["MOVING"]

LONGEST_WAIT = 3600.0  # s that a client may wait for the end of a motion
Given = Mapping[str, str]


def _linked(speaker: Speaker, word: str, what: str) -> LinkedRobot:
    if speaker.robot is None:
        raise RequestError(f"{word}: no robot is linked; {what}")
    return speaker.robot


def _move(speaker: Speaker, given: Given, session: Session) -> Later:
    robot, waits = _linked(speaker, "move", "this server only computes"), switch(given, "wait")
    robot.check_free(session)
    stops, before = robot.stops, robot.number
    here = speaker.detector.check_posture(robot.link.posture(), "the robot's posture")

    def then(simulation: Simulation) -> Reply | Later:
        ways, way = simulation.ways, simulation.way
        if way is None or not simulation.safe:
            robot.refuse("; ".join(simulation.reasons))
            return speaker.reply_of({**finite(ways.to_json()), "moving": False}, ways.answer)
        if session.closed:
            raise RequestError("move: the connection was closed before the move was checked; nothing moves")
        if robot.stops != stops:
            raise RequestError("move: the robot was stopped while its way was checked")
        if robot.number != before or not np.abs(robot.link.posture() - here).max() <= STOOD_STILL:
            raise RequestError("move: the robot moved while its way was checked; ask again when it stands")
        robot.check_free(session)
        asked = {name: value for name, value in ways.answer.asked.items() if value is not None}
        asked.setdefault("roll_rad", way.solution.roll)
        number = robot.begin(session, asked, here, way.postures)
        speed = speaker.detector.cell.speed

        def sent(_: Any) -> Reply | Later:
            if robot.stops != stops:
                raise RequestError("move: the robot was stopped as this motion began")
            data = {**finite(ways.to_json()), "moving": True, "number": number}
            if not waits:
                return speaker.reply_of(data, ways.answer)
            then = lambda _: speaker.reply_of(data | {"moving": False} | ended(speaker, number), ways.answer)  # noqa: E731
            return _until(robot, number, LONGEST_WAIT, then)

        if robot.begins_at_once:  # a thread would only make it later
            robot.send(way.postures, speed)
            return sent(None)
        return Later(lambda _: robot.send(way.postures, speed), sent, "link")

    sides = sides_of(speaker.detector, given)
    brief = simulated_at_once(speaker.detector, given, here, sides)
    if brief is not None:  # begun after what else has come: the end of the connection, a stop
        return Later(lambda _: brief, then, "soon")
    return Later(simulation_of(given, here, sides), then)


def _until(robot: LinkedRobot, number: int, patience: float, then: Callable[[Any], Reply]) -> Later:
    return Later(lambda _: robot.wait(number, patience), then, "wait", number, patience)


def ended(speaker: Speaker, number: int) -> dict[str, Any]:
    """How a motion ended, and where."""
    robot = _linked(speaker, "moved", "nothing moves")
    end = robot.ends.get(number)
    return {"ended": None if end is None else end.to_json(), "at": robot.place(speaker.detector)[2]}


def status_of(speaker: Speaker) -> dict[str, Any]:
    """The robot's state for a beamline."""
    robot = _linked(speaker, "robot", "there is none to see")
    moving = robot.refresh()
    here, place, reply = robot.place(speaker.detector)
    last = next(reversed(robot.ends.values()), None)
    return {
        "moving": moving,
        "holder": robot.holder(),
        "number": robot.number,
        "ended": None if last is None else last.to_json(),
        "setpoint": robot.setpoint(here, place, moving),
        "at": reply,
        "last_refusal": robot.refusal,
        "refusals": robot.refusals,
        "link": finite(dict(robot.link.state())),
    }


def _robot(speaker: Speaker, given: Given, session: Session) -> Reply:
    return Reply({**status_of(speaker), "convention": speaker.convention})


def _moved(speaker: Speaker, given: Given, session: Session) -> Reply | Later:
    robot, patience = _linked(speaker, "moved", "nothing moves"), number(given, "timeout", LONGEST_WAIT)
    if not (math.isfinite(patience) and 0 <= patience <= LONGEST_WAIT):
        raise RequestError(f"timeout: expected seconds from 0 to {LONGEST_WAIT:g}, found {patience:g}")
    under_way = robot.number if robot.refresh() and robot.mover is not None else 0
    asked = number(given, "number", under_way)
    if not (0 <= asked <= robot.number and asked == int(asked)):
        raise RequestError(f"number: expected a motion from 1 to {robot.number}, found {asked:g}")
    which = int(asked)

    def then(_: Any) -> Reply:
        found = {**status_of(speaker), "convention": speaker.convention}
        if "number" in given:
            end = robot.ends.get(which)
            found["ended"] = None if end is None else end.to_json()
        return Reply(found)

    return _until(robot, which, patience, then)


def _hold(speaker: Speaker, given: Given, session: Session) -> Reply:
    robot = _linked(speaker, "hold", "there is none to hold")
    robot.hold(session)
    return Reply({"holder": robot.holder()})


def _release(speaker: Speaker, given: Given, session: Session) -> Reply:
    robot = _linked(speaker, "release", "there is none to release")
    robot.release(session)
    return Reply({"holder": robot.holder()})


def _confirm(speaker: Speaker, given: Given, session: Session) -> Later:
    """A person has looked at the robot: what the link asks about is settled."""
    robot = _linked(speaker, "confirm", "there is nothing to confirm")
    confirm = getattr(robot.link, "confirm", None)
    if confirm is None:
        raise RequestError("confirm: this link never asks")
    if robot.refresh():
        raise RequestError("confirm: the robot moves; look at it when it stands")
    return Later(lambda _: confirm(), lambda _: _after(speaker, robot), "link")


def _after(speaker: Speaker, robot: LinkedRobot) -> Reply:
    """The link's state, and the robot's position if known."""
    reply: dict[str, Any] = {"link": finite(dict(robot.link.state()))}
    with suppress(CallError):  # a stop is answered all the same
        reply["at"] = robot.place(speaker.detector)[2]
    return Reply(reply)


def _stop(speaker: Speaker, given: Given, session: Session) -> Reply | Later:
    robot = _linked(speaker, "stop", "there is nothing to stop")
    robot.stops += 1  # at once: what is being checked does not begin any more

    if robot.stops_at_once:  # a thread would only make it later
        robot.stop()
        return _after(speaker, robot)
    return Later(lambda _: robot.stop(), lambda _: _after(speaker, robot), "stop")


MOVING: Mapping[str, Callable[[Speaker, Given, Session], Reply | Later]] = {
    "move": _move,
    "moved": _moved,
    "robot": _robot,
    "hold": _hold,
    "release": _release,
    "confirm": _confirm,
    "stop": _stop,
}
"""What answers these requests."""
