"""The language of the server: one request a line, one answer a line, without any socket.

A request is a word and ``key=value`` pairs, separated by blanks; an answer is a JSON object. What is malformed gets an
answer with ``"ok": false`` and changes nothing. docs/reference/server.md has the list.
"""

from __future__ import annotations

import hmac
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import orjson

from clampid.plain_json import finite
from clampid.wrong_call import CallError
from experiments.temperatures import REFERENCE_TEMPERATURE
from offline_ik.beamline.moving import MOVING
from offline_ik.beamline.previews import PREVIEWS
from offline_ik.beamline.robot import LinkedRobot
from offline_ik.cell.pyfai import pyfai_geometry
from offline_ik.collision.safety import check_path, move_time
from offline_ik.errors import DetectorError, TargetError
from offline_ik.exchange.asked import asked_of, sides_of, simulation_of
from offline_ik.exchange.link import RobotLink
from offline_ik.exchange.requests import EVERY, GREETED, MOVES, WORDS, RequestError, number, numbers, parse, switch
from offline_ik.exchange.session import Job, Later, Reply, Session
from offline_ik.inverse.answer import Answer
from offline_ik.inverse.assumed import time_effects
from offline_ik.inverse.detector import Detector
from offline_ik.motion.approach import approach_through
from offline_ik.motion.simulation import Simulation
from offline_ik.motion.ways import Ways, ways_to
from offline_ik.reflections.place import place_of
from offline_ik.server.peak_request import sample_of
from offline_ik.server.wording import members_of

__all__ = ["Job", "RobotLink", "Session", "Speaker"]

Array = npt.NDArray[np.float64]

TICK = 1.0  # s, steps of a running time: short compared with any warm-up


@dataclass
class Speaker:
    """Answers requests about one detector.

    Parameters
    ----------
    detector
        Temperatures may be changed by a request; nothing else.
    link
        A robot to move, if there is one.
    token
        What `hello` has to bring along; None: nothing.
    answers_only
        Nothing moves, and nothing that others see changes: a network reaches the server, and there is no token.
    """

    detector: Detector
    link: RobotLink | None = None
    answered: int = 0
    refused: int = 0
    clock: Callable[[], float] = time.monotonic
    token: str | None = field(default=None, repr=False)
    answers_only: bool = False
    _since: float = field(init=False)
    _timed: bool = field(init=False)
    _robot: LinkedRobot | None = field(init=False, default=None)
    convention: dict[str, Any] = field(init=False)

    def __post_init__(self) -> None:
        self.convention = self.detector.cell.convention.to_json()
        self._timed = bool(time_effects(self.detector.arm))
        self._since = self.clock() - (self.detector.cell.running or 0.0)
        if self.link is not None:
            _refuse_other_robot(self.detector.robot.name, self.link.state().get("robot"), "the linked one is")

    @property
    def robot(self) -> LinkedRobot | None:
        """The linked robot."""
        if self.link is None:
            return None
        if self._robot is None or self._robot.link is not self.link:
            self._robot = LinkedRobot(self.link, self.clock)
        return self._robot

    def answer(self, line: bytes, session: Session) -> bytes:
        """The answer to one line, newline included; never raises for what a client may send."""
        found = self.begin(line, session)
        while isinstance(found, Job):
            found = found.end(found.run(self.detector))
        return found

    def begin(self, line: bytes, session: Session) -> bytes | Job:
        """As :meth:`answer`, but what takes long comes as a job, for a thread of its own."""
        word, given = "", dict[str, str]()
        try:
            word, given = parse(line)
            _refuse_other_robot(self.detector.robot.name, given.get("robot"), "the request is for")
            if word in GREETED and not session.greeted:
                raise RequestError(f"{word}: expected hello{'' if self.token is None else ' token=…'} before it")
            if self.answers_only and word in MOVES:
                raise RequestError(f"{word}: this server only answers: a network reaches it, and it has no token")
            self._tick()
            reply = self._verbs[word](self, given, session)
        except CallError as error:
            return self.refuse_request(word, error, given)
        return Job(self, word, given, reply) if isinstance(reply, Later) else self.line_of(word, given, reply)

    def line_of(self, word: str, given: Mapping[str, str], reply: Reply) -> bytes:
        """The line of an answer."""
        self.answered += 1
        return _line({"ok": True, "do": word, **_id(given), **reply.data})

    def _tick(self) -> None:
        """Let the robot's running time go on, where it is known and the model reads it."""
        running = self.detector.cell.running
        if self._timed and running is not None:
            now = self.clock() - self._since
            if now - running >= TICK:
                self.detector = self.detector.at_running(now)

    def overtaken(self, line: bytes) -> bytes:
        """The answer to a `move` after which a `stop` came before it was begun."""
        try:
            _, given = parse(line)
        except CallError as error:
            return self.refuse(str(error))
        return self.refuse_request("move", RequestError("move: a stop came after it; nothing moves"), given)

    def refuse_request(self, word: str, error: CallError, given: Mapping[str, str]) -> bytes:
        """The line of a refusal; of a `move`, the robot's last refusal is noted for everybody."""
        if word == "move" and self.robot is not None:
            self.robot.refuse(str(error))
        return self.refuse(str(error), given)

    def refuse(self, reason: str, given: Mapping[str, str] | None = None) -> bytes:
        """The line of a refusal; ``given``: the request's pairs, where it got as far."""
        self.refused += 1
        return _line({"ok": False, **_id(given or {}), "error": reason})

    def _where(self, given: Mapping[str, str], session: Session) -> Reply | Later:
        near, sides = numbers(given, "near"), sides_of(self.detector, given)
        approach, pyfai = switch(given, "approach"), switch(given, "pyfai")
        asked = asked_of(given, near, sides)
        data = {"direction_from": "asked" if sides is not None else "unknown" if near is None else "moved"}
        answer = None if approach else self.detector.at_once(**asked)
        if answer is not None:
            return self._located(data, answer, pyfai)

        def work(detector: Detector) -> tuple[dict[str, Any], Answer]:
            answer = detector.locate(**asked)
            if not (approach and answer.reachable):
                return data, answer
            way = approach_through(detector, answer, near=near, direction=sides)
            return {"direction_from": "approach", "approach": way.to_json()}, way.answer

        return Later(work, lambda found: self._located(found[0], found[1], pyfai))

    def _located(self, data: dict[str, Any], answer: Answer, pyfai: bool) -> Reply:
        if answer.reachable and pyfai:
            data["pyfai"] = pyfai_geometry(self.detector.cell.convention, answer.target).to_json()
        return self.reply_of(data, answer)

    def _path(self, given: Mapping[str, str], session: Session) -> Reply | Later:
        start = numbers(given, "from")
        if start is None:
            start = self.posture(session, "from")
        start = self.detector.check_posture(start, "from")
        to = numbers(given, "to")
        if to is not None:
            beside = [key for key in given if key not in ("to", "from", *EVERY)]
            if beside:
                raise RequestError(f"path: expected to= or a detector position, found to= with {beside[0]}=")
            way = [start, self.detector.check_posture(to, "to")]
            return Later(
                lambda detector: check_path(detector, way),
                lambda path: Reply({"path": finite(path.to_json()), "convention": self.convention}),
            )
        work = simulation_of(given, start, sides_of(self.detector, given))
        return Later(work, partial(self._checked, given.get("branch") == "all"))

    def _checked(self, every: bool, simulation: Simulation) -> Reply:
        ways = simulation.ways
        reply = self.reply_of(finite(ways.to_json()), ways.answer)
        if every:
            for solution, way in zip(reply.data["solutions"], ways.chosen, strict=True):
                solution.update(finite(way.to_json()))
        return reply

    def reply_of(self, data: dict[str, Any], answer: Answer) -> Reply:
        """What is reported of an answer's positions."""
        members = members_of(self.detector, answer)
        return Reply({**data, "convention": self.convention, **members, "nearest": answer.nearest})

    def posture(self, session: Session, key: str | None = None) -> Array:
        """Where the linked robot or the stream is; ``key``: what else would have said it."""
        if self.link is not None:
            return self.link.posture()
        if session.here is None:
            other = "" if key is None else f"give {key}=q1,q2,… or "
            raise TargetError(f"expected a posture to start from: {other}say start q=q1,q2,… first")
        return session.here

    def frames_at(self, q: Array) -> dict[str, Any]:
        """The frames that go beside joint angles ``(n,)``, rad: see :class:`offline_ik.cell.frames.Framing`."""
        return dict(self.detector.framing(self.detector.to_base(place_of(self.detector, q).pose), q))

    def _frames(self, session: Session) -> dict[str, Any] | None:
        """Those of where the stream or the linked robot is; None where that is not known."""
        try:
            return self.frames_at(self.detector.check_posture(self.posture(session), "the posture at hand"))
        except DetectorError:
            return None

    def _start(self, given: Mapping[str, str], session: Session) -> Reply:
        q = numbers(given, "q")
        if q is None:
            raise RequestError("start: expected q=q1,q2,…")
        session.here = self.detector.check_posture(q, "q")
        return Reply({"q_rad": session.here.tolist(), **self.frames_at(session.here)})

    def _stream(self, given: Mapping[str, str], session: Session) -> Later:
        """One target of a stream: nearest to the last one, and no faster than the joints can."""
        dt, sides = number(given, "dt", math.inf), sides_of(self.detector, given)
        if not dt > 0:
            raise TargetError(f"dt: expected a time in seconds, found {dt:g}")
        start = self.posture(session) if session.here is None else session.here
        here = self.detector.check_posture(start, "the posture at hand")
        asked = asked_of(given, here, sides)

        def work(detector: Detector) -> Ways:
            answer = detector.locate(**asked)
            if answer.reachable:
                needs = move_time(detector, np.array([here, answer.solutions[0].q]))
                if needs > dt:
                    raise TargetError(f"stream: the joints need {needs:.3f} s for this step, dt is {dt:.3f} s")
            ways = ways_to(detector, answer, start=here, direction=sides, others=False)
            if ways.chosen and not ways.chosen[0].path.safe:
                raise TargetError(f"stream: {'; '.join(ways.chosen[0].path.reasons)}")
            return ways

        def then(ways: Ways) -> Reply:
            data = finite(ways.to_json())
            if ways.chosen:
                session.here = ways.chosen[0].solution.q
                session.count += 1
                data["needs_s"] = ways.chosen[0].path.duration
            return self.reply_of({**data, "number": session.count}, ways.answer)

        return Later(work, then)

    def _temperature(self, given: Mapping[str, str], session: Session) -> Reply:
        found = {k: numbers(given, k) for k in ("link", "motor")}
        if all(v is None for v in found.values()) and "running" not in given:
            raise RequestError("temperature: expected link=t1,t2,… or motor=t1,t2,… in degC, or running= in s")
        detector = self.detector.at_temperature(found["link"], found["motor"])
        if "running" in given:
            running = number(given, "running")
            detector = detector.at_running(running)
            self._since = self.clock() - running
        self.detector = detector
        return Reply(self._temperatures())

    def _temperatures(self) -> dict[str, Any]:
        still = self.detector.still
        return {
            "link_C": (still.link_temperature + REFERENCE_TEMPERATURE).tolist(),
            "motor_C": (still.motor_temperature + REFERENCE_TEMPERATURE).tolist(),
            "running_s": still.elapsed,
            "notes": list(self.detector.notes),
        }

    def _at(self, given: Mapping[str, str], session: Session) -> Reply:
        """The inverse of ``where``: the detector position of a posture."""
        q = numbers(given, "q")
        there = self.detector.check_posture(self.posture(session, "q") if q is None else q, "q")
        place = place_of(self.detector, there, numbers(given, "near"))
        frames = self.detector.framing(self.detector.to_base(place.pose), there)
        return Reply({"q_rad": there.tolist(), **place.to_json(), **frames, "convention": self.convention})

    def _sample(self, given: Mapping[str, str], session: Session) -> Later:
        """Where the scattering point is, by reflections found."""
        return Later(lambda detector: sample_of(detector, given), lambda found: Reply(finite(found.to_json())))

    def _state(self, given: Mapping[str, str], session: Session) -> Reply:
        cell = self.detector.cell
        state = {
            "robot": self.detector.robot.name,
            "cell": finite(cell.to_json()),
            **self._temperatures(),
            "limits_rad": [self.detector.lower.tolist(), self.detector.upper.tolist()],
            "answered": self.answered,
            "refused": self.refused,
            "at_q_rad": None if session.here is None else session.here.tolist(),
            "frames": self._frames(session),
            "link": None if self.link is None else finite(dict(self.link.state())),
            "holder": None if self.robot is None else self.robot.holder(),
            "answers_only": self.answers_only,
            "convention": self.convention,
        }
        return Reply(state)

    def _hello(self, given: Mapping[str, str], session: Session) -> Reply:
        """The client greets this server on purpose: a browser, which speaks HTTP, cannot."""
        if self.token is not None and not hmac.compare_digest(given.get("token", "").encode(), self.token.encode()):
            session.done = True  # one attempt a connection
            raise RequestError(f"hello: expected token=…, found {'another' if 'token' in given else 'none'}")
        session.greeted, session.name = True, given.get("name", "")[:64]
        linked = self.link is not None
        reply = {"server": "clampid", "robot": self.detector.robot.name, "linked": linked}
        return Reply({**reply, "moves": self.robot is not None and self.robot.executes and not self.answers_only})

    def _help(self, given: Mapping[str, str], session: Session) -> Reply:
        return Reply({"requests": {word: list(keys) for word, keys in WORDS.items()}, "every": list(EVERY)})

    def _quit(self, given: Mapping[str, str], session: Session) -> Reply:
        session.done = True
        return Reply({})

    _verbs: Mapping[str, Callable[[Speaker, Mapping[str, str], Session], Reply | Later]] = field(
        init=False,
        repr=False,
        default_factory=lambda: {
            "hello": Speaker._hello,
            "where": Speaker._where,
            "path": Speaker._path,
            "stream": Speaker._stream,
            "start": Speaker._start,
            "temperature": Speaker._temperature,
            "at": Speaker._at,
            "sample": Speaker._sample,
            **MOVING,
            **PREVIEWS,
            "state": Speaker._state,
            "help": Speaker._help,
            "quit": Speaker._quit,
        },
    )


def _refuse_other_robot(own: str, named: object, whose: str) -> None:
    if named is not None and named != own:
        raise TargetError(f"the model is of the robot {own}, {whose} {str(named)[:64]!r}")


def _id(given: Mapping[str, str]) -> dict[str, str]:
    return {"id": given["id"][:64]} if "id" in given else {}


def _line(data: dict[str, Any]) -> bytes:
    """By orjson: what the standard library takes to write an answer is more than the solver takes to find it."""
    return orjson.dumps(data, option=orjson.OPT_APPEND_NEWLINE | orjson.OPT_SERIALIZE_NUMPY)
