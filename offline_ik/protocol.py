"""The language of the server: one request a line, one answer a line, without any socket.

A request is a word and ``key=value`` pairs, separated by blanks; an answer is a JSON object. What is malformed gets an
answer with ``"ok": false`` and changes nothing. docs/server.md has the list.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt
import orjson

from clampid.verbs.errors import CallError
from clampid.verbs.output import finite
from offline_ik.answer import Answer
from offline_ik.approach import approach_through
from offline_ik.cell_values import COLDEST, HOTTEST
from offline_ik.detector import Detector
from offline_ik.errors import TargetError
from offline_ik.link import RobotLink
from offline_ik.place import place_of
from offline_ik.pyfai import pyfai_geometry
from offline_ik.reach import nearest_steps
from offline_ik.requests import WORDS, RequestError, number, numbers, parse, switch
from offline_ik.safety import check_path, move_time
from offline_ik.ways import Ways, ways_to
from offline_ik.wording import members_of

__all__ = ["RobotLink", "Session", "Speaker", "Steps"]

Array = npt.NDArray[np.float64]

Steps = Generator[None, None, bytes]
"""An answer that takes its time: to be advanced until it ends, its value the line."""


class Told(NamedTuple):
    """What a request is answered with.

    Attributes
    ----------
    data
        Members of the answer.
    missed
        The position that cannot be reached, whose nearest one is still to be found.
    """

    data: dict[str, Any]
    missed: Answer | None = None


@dataclass
class Session:
    """What one client has said: the posture that its stream is at."""

    here: Array | None = None
    done: bool = False
    count: int = 0


@dataclass
class Speaker:
    """Answers requests about one detector.

    Parameters
    ----------
    detector
        Temperatures may be changed by a request; nothing else.
    link
        A robot to move, if there is one.
    """

    detector: Detector
    link: RobotLink | None = None
    answered: int = 0
    refused: int = 0
    _convention: dict[str, Any] = field(init=False)

    def __post_init__(self) -> None:
        self._convention = self.detector.cell.convention.to_json()

    def answer(self, line: bytes, session: Session) -> bytes:
        """The answer to one line, newline included; never raises for what a client may send."""
        found = self.begin(line, session)
        while not isinstance(found, bytes):
            try:
                next(found)
            except StopIteration as end:
                found = cast(bytes, end.value)
        return found

    def begin(self, line: bytes, session: Session) -> bytes | Steps:
        """As :meth:`answer`, but what takes long comes as steps, between which others can be answered."""
        given: dict[str, str] = {}
        try:
            word, given = parse(line)
            told = self._verbs[word](self, given, session)
        except CallError as error:
            self.refused += 1
            return _line({"ok": False, **_id(given), "error": str(error)})
        self.answered += 1
        if told.missed is not None:
            return self._with_nearest(word, given, told, told.missed)
        return _line({"ok": True, "do": word, **_id(given), **told.data})

    def _with_nearest(self, word: str, given: Mapping[str, str], told: Told, missed: Answer) -> Steps:
        nearest = yield from nearest_steps(self.detector, missed.target, missed.asked["roll_rad"] or 0.0)
        return _line({"ok": True, "do": word, **_id(given), **told.data, "nearest": nearest})

    def refuse(self, reason: str) -> bytes:
        """An answer to what is not even a line."""
        self.refused += 1
        return _line({"ok": False, "error": reason})

    def _where(self, given: Mapping[str, str], session: Session) -> Told:
        answer = self._located(given, numbers(given, "near"))
        data: dict[str, Any] = {}
        if answer.reachable and switch(given, "approach"):
            way = approach_through(self.detector, answer, near=numbers(given, "near"))
            answer, data = way.answer, {"approach": way.to_json()}
        if answer.reachable and switch(given, "pyfai"):
            data["pyfai"] = pyfai_geometry(self.detector.cell.convention, answer.target).to_json()
        return self._told(data, answer)

    def _located(self, given: Mapping[str, str], near: Array | None) -> Answer:
        roll = None if given.get("roll") == "free" else number(given, "roll", 0.0)
        return self.detector.locate(
            number(given, "gamma"), number(given, "delta"), number(given, "r"), roll,
            near=near, branch=given.get("branch", "nearest"), direction=None if near is None else "moved",
            nearest=False,
        )  # fmt: skip

    def _path(self, given: Mapping[str, str], session: Session) -> Told:
        start = numbers(given, "from")
        if start is None:
            start = self._posture(session)
        start = self.detector.check_posture(start, "from")
        to = numbers(given, "to")
        if to is not None:
            beside = [key for key in given if key not in ("to", "from", "id")]
            if beside:
                raise RequestError(f"path: expected to= or a detector position, found to= beside {beside[0]}=")
            path = check_path(self.detector, [start, self.detector.check_posture(to, "to")])
            return Told({"path": finite(path.to_json()), "convention": self._convention})
        ways = self._ways(given, start)
        told = self._told(finite(ways.to_json()), ways.answer)
        if given.get("branch") == "all":
            for solution, way in zip(told.data["solutions"], ways.chosen, strict=True):
                solution.update(finite(way.to_json()))
        return told

    def _ways(self, given: Mapping[str, str], start: Array) -> Ways:
        branch, approach = given.get("branch", "nearest"), switch(given, "approach")
        return ways_to(self.detector, self._located(given, start), start=start, branch=branch, approach=approach)

    def _told(self, data: dict[str, Any], answer: Answer) -> Told:
        told = {**data, "convention": self._convention, **members_of(answer)}
        return Told({**told, "nearest": None}) if answer.reachable else Told(told, answer)

    def _posture(self, session: Session) -> Array:
        if self.link is not None:
            return self.link.posture()
        if session.here is None:
            raise TargetError(
                "expected a posture to start from: give from=q1,q2,… (at: q=q1,q2,…) or say start q=q1,q2,… first"
            )
        return session.here

    def _start(self, given: Mapping[str, str], session: Session) -> Told:
        q = numbers(given, "q")
        if q is None:
            raise RequestError("start: expected q=q1,q2,…")
        session.here = self.detector.check_posture(q, "q")
        return Told({"q_rad": session.here.tolist()})

    def _stream(self, given: Mapping[str, str], session: Session) -> Told:
        """One target of a stream: nearest to the last one, and no faster than the joints can."""
        dt = number(given, "dt", math.inf)
        if not dt > 0:
            raise TargetError(f"dt: expected a time in seconds, found {dt:g}")
        answer = self._located(given, session.here)
        data: dict[str, Any] = {}
        if answer.reachable:
            q = answer.solutions[0].q
            if session.here is not None:
                needs = move_time(self.detector, np.array([session.here, q]))
                data["needs_s"] = needs
                if needs > dt:
                    raise TargetError(f"stream: the joints need {needs:.3f} s for this step, dt is {dt:.3f} s")
                path = check_path(self.detector, [session.here, q])
                if not path.safe:
                    raise TargetError(f"stream: {'; '.join(path.reasons)}")
            session.here = q
            session.count += 1
        data["number"] = session.count
        return self._told(data, answer)

    def _temperature(self, given: Mapping[str, str], session: Session) -> Told:
        found = {k: numbers(given, k) for k in ("link", "motor")}
        if all(v is None for v in found.values()):
            raise RequestError("temperature: expected link=t1,t2,… or motor=t1,t2,… in degC")
        for name, values in found.items():
            if values is None:
                continue
            if len(values) != self.detector.arm.n or not ((values > COLDEST) & (values < HOTTEST)).all():
                raise TargetError(f"{name}: expected {self.detector.arm.n} temperatures in degC, found {given[name]}")
        self.detector = self.detector.at_temperature(found["link"], found["motor"])
        return Told(self._temperatures())

    def _temperatures(self) -> dict[str, Any]:
        still = self.detector.still
        return {
            "link_C": (still.link_temperature + 20.0).tolist(),
            "motor_C": (still.motor_temperature + 20.0).tolist(),
            "notes": list(self.detector.notes),
        }

    def _at(self, given: Mapping[str, str], session: Session) -> Told:
        """The other way round than ``where``: what a posture means on the sphere."""
        q = numbers(given, "q")
        there = self.detector.check_posture(self._posture(session) if q is None else q, "q")
        place = place_of(self.detector, there, numbers(given, "near"))
        return Told({"q_rad": there.tolist(), **place.to_json(), "convention": self._convention})

    def _stop(self, given: Mapping[str, str], session: Session) -> Told:
        if self.link is None:
            raise RequestError("stop: no robot is linked; there is nothing to stop")
        self.link.stop()
        return Told({"link": finite(dict(self.link.state()))})

    def _move(self, given: Mapping[str, str], session: Session) -> Told:
        if self.link is None:
            raise RequestError("move: no robot is linked; this server only computes")
        here = self.detector.check_posture(self.link.posture(), "the robot's posture")
        ways = self._ways(given, here)
        safe = bool(ways.chosen) and ways.chosen[0].path.safe
        if safe:
            self.link.move(ways.chosen[0].postures, self.detector.cell.speed)
        return self._told({**finite(ways.to_json()), "moving": safe}, ways.answer)

    def _state(self, given: Mapping[str, str], session: Session) -> Told:
        cell = self.detector.cell
        state = {
            "robot": self.detector.robot.name,
            "cell": finite(cell.to_json()),
            **self._temperatures(),
            "limits_rad": [self.detector.lower.tolist(), self.detector.upper.tolist()],
            "answered": self.answered,
            "refused": self.refused,
            "at_q_rad": None if session.here is None else session.here.tolist(),
            "link": None if self.link is None else finite(dict(self.link.state())),
            "convention": self._convention,
        }
        return Told(state)

    def _help(self, given: Mapping[str, str], session: Session) -> Told:
        return Told({"requests": {word: list(keys) for word, keys in WORDS.items()}, "every": ["id"]})

    def _quit(self, given: Mapping[str, str], session: Session) -> Told:
        session.done = True
        return Told({})

    _verbs: Mapping[str, Callable[[Speaker, Mapping[str, str], Session], Told]] = field(
        init=False,
        repr=False,
        default_factory=lambda: {
            "where": Speaker._where,
            "path": Speaker._path,
            "stream": Speaker._stream,
            "start": Speaker._start,
            "temperature": Speaker._temperature,
            "at": Speaker._at,
            "move": Speaker._move,
            "stop": Speaker._stop,
            "state": Speaker._state,
            "help": Speaker._help,
            "quit": Speaker._quit,
        },
    )


def _id(given: Mapping[str, str]) -> dict[str, str]:
    return {"id": given["id"][:64]} if "id" in given else {}


def _line(data: dict[str, Any]) -> bytes:
    """By orjson: what the standard library takes to write an answer is more than the solver takes to find it."""
    return orjson.dumps(data, option=orjson.OPT_APPEND_NEWLINE | orjson.OPT_SERIALIZE_NUMPY)
