"""The robot behind a link, as a run needs it: move, stand, and read joint angles and motor torques.

Every motion is written to the journal before it is sent, and its end after it. A program is sent once. What became of
it is what the link says; where that is not *finished*, the run stops, and a person looks.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from experiments.links.protocol import Link, LinkError, LinkLostError, Program, Recording, Status
from experiments.plans.errors import PlanError
from experiments.plans.motion import Array
from experiments.runs.errors import RunStopped
from experiments.runs.journal import Journal
from kinematics.description import RobotDescription

__all__ = ["ARRIVED", "LinkedRobot", "Reading", "share_of"]

ARRIVED = 2e-4  # rad: above the rounding of encoders, commands and four-byte floats
FRESH = 0.5  # s: age of a status that is believed
CONNECT = 30.0  # s that a broken connection may take to come back
POLL = 0.005  # s
GRACE = 30.0  # s on the wall clock that a motion may take longer than planned
TOP_SPEED = 1.0  # rad/s, where a description has none
LEAST_SHARE = 0.01
WRAP = 2**32 / 1000.0  # s after which the controller's 32-bit timer begins anew
LEAST_SAMPLES = 8  # of a reading
SAMPLES_AT_ONCE = 400  # samples asked for in one call


def share_of(robot: RobotDescription, travel: Array, duration: float, ramp: float) -> float:
    """Share of the top speeds, in whole percents, with which a controller does a move no faster than planned.

    Parameters
    ----------
    travel
        ``(n,)`` rad.
    duration, ramp
        Of the planned move, s: its peak speed is travel / (duration - ramp).
    """
    top = np.array([TOP_SPEED if joint.max_speed is None else joint.max_speed for joint in robot.joints])
    peak = np.abs(travel) / max(duration - ramp, 1e-9)
    return max(math.floor(100.0 * min(float(np.max(peak / top)), 1.0) + 1e-6) / 100.0, LEAST_SHARE)


@dataclass(frozen=True, eq=False)
class Reading:
    """Means over the samples of a robot at rest.

    Attributes
    ----------
    time
        Campaign clock at the last sample, s.
    joints, torque
        ``(n,)`` rad and Nm.
    torque_std
        Scatter of one sample ``(n,)``, Nm.
    count
        Of samples.
    """

    time: float
    joints: Array
    torque: Array
    torque_std: Array
    count: int


class LinkedRobot:
    """One robot over one link, with the campaign's clock.

    Parameters
    ----------
    link
        The link.
    robot
        The described robot.
    journal
        Where motions are written to.
    offset
        What is added to the controller's clock, s; see `experiments.runs.clock`.
    """

    def __init__(self, link: Link, robot: RobotDescription, journal: Journal, say: Callable[[str], None]) -> None:
        can = link.capabilities
        if not can.executes:
            raise PlanError(f"--link: expected one that moves the robot, found {can.scheme}, which only reads")
        self.link, self.robot, self.journal, self._say = link, robot, journal, say
        self.offset = 0.0
        self._last_clock = -math.inf
        self.moves = 0

    def status(self) -> Status:
        """A status that is no older than half a second.

        Raises
        ------
        LinkLostError
            None came for half a minute.
        """
        end = time.monotonic() + CONNECT
        while True:
            found = self.link.status()
            if found.age < FRESH:
                return found
            if time.monotonic() > end:
                raise LinkLostError(f"the last status is {found.age:.1f} s old")
            time.sleep(POLL)

    def next_status(self) -> Status:
        """A status that came after this call."""
        since = time.monotonic()
        while (found := self.status()).received <= since:
            time.sleep(POLL)
        return found

    def now(self, status: Status | None = None) -> float:
        """The campaign's clock, s."""
        found = self.status() if status is None else status
        return self.campaign_time(math.nan if found.clock is None else found.clock)

    def campaign_time(self, clock: float) -> float:
        """A time of the controller's clock on the campaign's, s; goes on where the controller's timer runs over."""
        time_ = clock + self.offset
        if time_ < self._last_clock - WRAP / 2:
            self.offset += WRAP
            time_ += WRAP
        self._last_clock = max(self._last_clock, time_)
        return time_

    def rest(self) -> Status:
        """Wait until no program runs and the joints do not change; give the status then.

        Raises
        ------
        RunStopped
            The robot does not come to rest.
        """
        end = time.monotonic() + 2 * GRACE
        before = self.next_status()
        while time.monotonic() < end:
            time.sleep(4 * POLL)
            found = self.next_status()
            if not found.running and np.max(np.abs(found.joints - before.joints)) < ARRIVED / 4:
                return found
            before = found
        raise RunStopped("the robot does not come to rest")

    def pause(self, seconds: float) -> None:
        """Wait on the controller's clock."""
        end = self.now() + seconds
        while self.now() < end:
            time.sleep(POLL)

    def go(self, to: Array, share: float, step: str) -> Status:
        """Move to one posture ``(n,)``, rad; returns when the robot stands there.

        Raises
        ------
        LinkError
            The program was refused, interrupted, not executed, or its fate is unknown.
        RunStopped
            The robot is elsewhere afterwards.
        """
        here = self.status()
        if np.max(np.abs(to - here.joints)) < 1e-7:
            return here
        program = Program(to, share)
        self._wait_ready()
        self.journal.add("move", step=step, origin=here.joints.tolist(), to=np.asarray(to).tolist(), share=share)
        number = self.link.execute(program)
        self.journal.add("sent", step=step, program=number, boot=here.boot)
        self.moves += 1
        fate = self._wait(number, step)
        found = self.link.status()  # a program counts as finished once a status of the robot at rest has come
        off = np.abs(found.joints - to)
        if np.max(off) > ARRIVED:
            found = self.next_status()
            off = np.abs(found.joints - to)
        if np.max(off) > ARRIVED:
            j = int(np.argmax(off))
            raise RunStopped(
                f"{step}: expected joint {j + 1} at {math.degrees(to[j]):.4f} deg after program {fate}, found "
                f"{math.degrees(found.joints[j]):.4f} deg"
            )
        return found

    def _wait_ready(self) -> None:
        """A link that has just been cut connects again by itself; nothing has been sent, so waiting is safe."""
        trouble = getattr(self.link, "trouble", dict)
        end = time.monotonic() + CONNECT
        while any(trouble().values()) and time.monotonic() < end:
            time.sleep(POLL)

    def _wait(self, number: int, step: str) -> int:
        """Wait for a program's end; a motion may be long, a silent robot is not waited for."""
        silent = time.monotonic() + GRACE
        while True:
            try:
                fate = self.link.wait(number, 1.0)
                self.journal.add("moved", step=step, program=number, boot=self.link.status().boot)
                return fate.id
            except LinkLostError:  # it is still on its way
                if self.link.status().age < FRESH:
                    silent = time.monotonic() + GRACE
                elif time.monotonic() > silent:
                    raise
            except LinkError as error:
                phase = self.link.fate(number).phase
                self.journal.add("ended", step=step, program=number, phase=str(phase), words=str(error))
                raise

    def samples(self, first: int, last: int | None = None) -> Recording:
        """What the controller recorded from a number on, to a number, or else until now.

        Raises
        ------
        LinkLostError
            The controller does not answer any more, or was started again.
        """
        until = (self.next_status().newest or 0) if last is None else last
        parts: list[Recording] = []
        lost: tuple[int, int] | None = None
        following = first
        while following <= until:
            part = self.link.recording(following, min(SAMPLES_AT_ONCE, until - following + 1))
            if part.lost is not None:
                lost = (part.lost[0] if lost is None else lost[0], part.lost[1])
                following = max(following, part.lost[1] + 1)
            if len(part.number):
                parts.append(part)
                following = int(part.number[-1]) + 1
            elif part.lost is None:
                time.sleep(POLL)
        if not parts:
            raise LinkLostError(f"recording: expected samples {first} to {until}, found none")
        return Recording(
            np.concatenate([part.number for part in parts]),
            np.concatenate([part.time for part in parts]),
            np.concatenate([part.joints for part in parts]),
            np.concatenate([part.torque for part in parts]),
            np.concatenate([part.current for part in parts]),
            lost,
            parts[-1].newest,
        )

    def read(self, settle: float, dwell: float) -> Reading:
        """Means over the samples of a robot that stands, from ``settle`` to ``dwell`` s from now, at least eight."""
        period = next(signal.period or POLL for signal in self.link.capabilities.signals if signal.name == "torque")
        now = self.link.status().newest or 0
        first = now + 1 + math.ceil(settle / period)
        found = self.samples(first, max(now + math.ceil(dwell / period), first + LEAST_SAMPLES - 1))
        return Reading(
            self.campaign_time(float(found.time[-1])),
            found.joints.mean(axis=0),
            found.torque.mean(axis=0),
            found.torque.std(axis=0),
            len(found.number),
        )
