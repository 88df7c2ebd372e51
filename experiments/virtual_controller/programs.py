"""The KRL programs on the controller: they collect a program, check it, move, answer, and stop.

All reactions are computed for the time at which they are due, in the order of time, even if the process is late.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from experiments.virtual_controller.arm import AXES, Arm, rows_at
from experiments.virtual_controller.clock import Clock
from experiments.virtual_controller.codes import Event, Kind, Mode, Reason
from experiments.virtual_controller.documents import Value
from experiments.virtual_controller.errors import ControllerError
from experiments.virtual_controller.moves import beyond
from experiments.virtual_controller.recording import Recording, Sample
from experiments.virtual_robot.description import Array

__all__ = ["MAX_POINTS", "WATCHDOG_S", "Controller"]

MAX_POINTS = 60  # of one program
WATCHDOG_S = 2.0  # s of the wall clock without a question, after which a running program is aborted
SAMPLES = 4  # in one answer
INTEGER = 2**32  # KRL's INT has 32 bits: its timer runs over


@dataclass(frozen=True)
class Point:
    """One point of a program: axis angles, rad, (6,), and the share of the top speeds, 0 … 1."""

    target: Array
    share: float


@dataclass
class Collected:
    """A program that is coming in."""

    id: int
    count: int
    points: list[Point] = field(default_factory=list)


Notify = Callable[[Mapping[str, Any]], None]


class Controller:
    """The controller's programs and its safety.

    Parameters
    ----------
    arm
        The robot.
    clock
        Simulated time; the watchdog runs on its wall clock.
    boot
        Number of this start of the programs.
    tell
        Gets every event as it happens: ``event``, ``boot``, ``id``, ``point``, ``reason`` and what belongs to it.
    """

    def __init__(self, arm: Arm, clock: Clock, *, boot: int = 1, notify: Notify = lambda event: None) -> None:
        self.arm, self.clock = arm, clock
        self._notify = notify
        self.mode, self.drives, self.estop = Mode.EXT, True, False
        self.override = 100.0  # %, $OV_PRO
        self._start(boot)

    def _start(self, boot: int) -> None:
        now = self.clock.now()
        self.boot = boot
        self.accepted = self.running = self.finished = self.aborted = self.point = 0
        self.reason = Reason.NONE
        self.stopped = False
        self._collected: Collected | None = None
        self._ignored: tuple[int, int] | None = None  # boot and id of a refused program whose points still come
        self._ends: deque[tuple[float, int]] = deque()  # when points of the running program are reached
        self._last = 0  # its number of points
        self._fed = self.clock.wall()
        self.arm.boot_noise(boot)
        self.recording = Recording(self.arm, now)
        self.recording.power(self.brakes, now)

    @property
    def brakes(self) -> bool:
        """Whether the brakes are released."""
        return self.drives and not self.estop

    def standing(self) -> bool:
        """Whether the robot stands still."""
        return self.arm.track.end <= self.clock.now()

    # The motion channel.

    def take_point(self, record: Mapping[str, Value]) -> None:
        """Take one point of a program, as the motion program gets it from its channel."""
        self.due()
        boot, number, point, count = (int(record[f"Move/{name}"]) for name in ("Boot", "Id", "Point", "Count"))
        if self._ignored == (boot, number) and point != 1:
            return
        self._ignored = None
        if self._collected is not None and number != self._collected.id:
            self._refuse(self._collected.id, Reason.POINTS)
            self._collected = None
        reason = self._fault(boot, number, point, count)
        target = np.radians([float(record[f"Move/Axis/@A{k}"]) for k in range(1, AXES + 1)])
        speed = float(record["Move/Speed"])
        if reason is Reason.NONE and beyond(self.arm.limits, target):
            reason = Reason.RANGE
        if reason is Reason.NONE and not 0.0 < speed <= 100.0:
            reason = Reason.SPEED
        if reason is not Reason.NONE:
            self._collected, self._ignored = None, (boot, number)
            self._refuse(number, reason)
            return
        if self._collected is None:
            self._collected = Collected(number, count)
        self._collected.points.append(Point(target, speed / 100.0))
        if point == count:
            whole, self._collected = self._collected, None
            self._begin(whole)

    def _fault(self, boot: int, number: int, point: int, count: int) -> Reason:
        """The error of a point, apart from its place and speed."""
        expected = 1 if self._collected is None else len(self._collected.points) + 1
        if boot != self.boot:
            return Reason.BOOT
        if number <= self.accepted:
            return Reason.ID
        if self.running:
            return Reason.BUSY
        if not 1 <= count <= MAX_POINTS or point != expected or point > count:
            return Reason.POINTS
        if self._collected is not None and count != self._collected.count:
            return Reason.POINTS
        return Reason.NONE

    def _begin(self, program: Collected) -> None:
        reason = self._forbidden()
        if reason is not Reason.NONE:
            self._refuse(program.id, reason)
            return
        now = self.clock.now()
        self.arm.tidy(now)
        self.accepted = self.running = program.id
        self.point, self._last = 0, len(program.points)
        self._fed = self.clock.wall()
        begin = max(now, self.arm.track.end)
        origin = self.arm.track.target
        for number, point in enumerate(program.points, 1):
            share = point.share * self.override / 100.0
            self._ends.append((self.arm.go(now, point.target, share), number))
        self._say(
            Event.ACCEPTED, program.id, time=begin, origin=np.degrees(origin).tolist(),
            points=[np.degrees(p.target).tolist() for p in program.points],
        )  # fmt: skip

    def _forbidden(self) -> Reason:
        """Why nothing may move now."""
        if self.estop:
            return Reason.EMERGENCY
        if self.mode not in (Mode.AUT, Mode.EXT):
            return Reason.MODE
        if not self.drives:
            return Reason.DRIVES
        if self.stopped:
            return Reason.LATCH
        return Reason.NONE

    def motion_closed(self) -> None:
        """Forget a program that was not whole when its channel closed."""
        self._ignored = None
        if self._collected is not None:
            self._refuse(self._collected.id, Reason.CLOSED)
            self._collected = None

    def _refuse(self, number: int, reason: Reason) -> None:
        self.reason = reason
        self._say(Event.REFUSED, number, reason=reason)

    # The state channel.

    def ask(self, record: Mapping[str, Value]) -> dict[str, Value]:
        """Answer a question, as the submit program does; every question feeds the watchdog."""
        self.due()
        self._fed = self.clock.wall()
        kind = int(record["Ask/Kind"])
        if kind == Kind.STOP:
            self.stop()
        elif kind == Kind.RELEASE and self.standing():
            self.stopped = False
        first = int(record["Ask/From"]) if kind == Kind.RECORDING else None
        return self.state(int(record["Ask/Sequence"]), first)

    def state(self, sequence: int = 0, first: int | None = None) -> dict[str, Value]:
        """Return the values of the state channel's answer, by path; ``first`` is the sample that is asked for."""
        now = self.clock.now()
        self.arm.tidy(now)
        rows = rows_at([now], self.recording.since)
        read = self.arm.read([now], rows, self.brakes)
        values: dict[str, Value] = {
            "Sequence": sequence, "Boot": self.boot, "Accepted": self.accepted, "Running": self.running,
            "Finished": self.finished, "Aborted": self.aborted, "Point": self.point, "Reason": int(self.reason),
            "Stopped": self.stopped, "Mode": int(self.mode), "Drives": self.drives, "Brakes": self.brakes,
            "Estop": self.estop, "Clock": milliseconds(now), "Oldest": self.recording.oldest(now),
            "Newest": self.recording.newest(now),
        }  # fmt: skip
        values = {f"Robot/State/@{key}": value for key, value in values.items()}
        kelvin = self.arm.motor_kelvin(now)
        for k in range(AXES):
            values[f"Robot/Axis/@A{k + 1}"] = float(read.axis[0, k])
            values[f"Robot/Torque/@A{k + 1}"] = float(read.torque[0, k])
            values[f"Robot/Current/@A{k + 1}"] = float(read.current[0, k])
            values[f"Robot/Temperature/@A{k + 1}"] = float(kelvin[k])
        samples = [] if first is None else self.recording.samples(first, SAMPLES, now)
        values["Robot/Samples/@Count"] = len(samples)
        for place in range(SAMPLES):
            values |= _sample(place + 1, samples[place] if place < len(samples) else None)
        return values

    # Safety, and people.

    def stop(self) -> None:
        """Brake at once; nothing moves until the latch is released."""
        self.stopped = True
        self._halt(self.clock.now(), Reason.LATCH)

    def press_estop(self, pressed: bool) -> None:
        """Press or release the emergency stop; the drives stay off after it."""
        self.due()
        self.estop = pressed
        if pressed:
            self.drives = False
            self._halt(self.clock.now(), Reason.EMERGENCY)
        self.recording.power(self.brakes, self.clock.now())

    def switch_mode(self, mode: Mode) -> None:
        """Turn the mode switch; a running program is aborted."""
        self.due()
        if mode is not self.mode:
            self._halt(self.clock.now(), Reason.MODE)
        self.mode = mode

    def switch_drives(self, on: bool) -> None:
        """Switch the drives; they do not come on while the emergency stop is pressed."""
        self.due()
        self.drives = on and not self.estop
        if not on:
            self._halt(self.clock.now(), Reason.DRIVES)
        self.recording.power(self.brakes, self.clock.now())

    def clamp(self, closed: bool) -> None:
        """Clamp the flange or open the clamp, as a person does it at a robot that stands.

        Raises
        ------
        ControllerError
            The robot moves, or it is so already.
        """
        self.due()
        now = self.clock.now()
        if not self.standing():
            raise ControllerError("the robot moves: expected it at rest")
        if closed == (self.arm.clamped(now) is not None):
            raise ControllerError(f"the flange is {'clamped' if closed else 'free'} already")
        if closed:
            self.arm.clamp(now)
        else:
            self.arm.release(now)
        self._notify({"event": "clamped" if closed else "released", "boot": self.boot, "time": now})

    def slip(self, shift: Sequence[float]) -> None:
        """Let the block that holds the flange slip, m along the base's axes.

        Raises
        ------
        ControllerError
            The flange is not clamped.
        """
        self.due()
        self.arm.slip(self.clock.now(), shift)
        self._notify({"event": "slipped", "boot": self.boot, "time": self.clock.now(), "shift_m": list(shift)})

    def rock(self, tilt: Sequence[float]) -> None:
        """Let the block that holds the flange rock from now on, m along the base's axes; raises as `slip`."""
        self.due()
        self.arm.rock(self.clock.now(), tilt)
        self._notify({"event": "rocks", "boot": self.boot, "time": self.clock.now(), "tilt_m": list(tilt)})

    def restart(self) -> None:
        """Start the controller's programs anew: the robot brakes, the boot number rises, numbers begin again."""
        self.due()
        self.arm.track.brake(self.clock.now())
        if self.running:
            self._say(Event.ABORTED, self.running, point=self.point, restart=True)
        self._start(self.boot + 1)

    # Time.

    def due(self) -> None:
        """Do what was due until now."""
        now, wall = self.clock.now(), self.clock.wall()
        while self._ends:
            end, number = self._ends[0]
            starved = self.clock.at(self._fed + WATCHDOG_S) if wall > self._fed + WATCHDOG_S else np.inf
            if starved <= min(end, now):
                self._halt(float(starved), Reason.WATCHDOG)
                return
            if end > now:
                return
            self._ends.popleft()
            self.point = number
            at = np.degrees(self.arm.track.at([end]).q[0]).tolist()
            self._say(Event.POINT, self.running, point=number, time=end, at=at)
            if number == self._last:
                self.finished, self.running = self.running, 0
                self._say(Event.FINISHED, self.finished, point=number, time=end)

    def next_due(self) -> float | None:
        """How long until something is due, s of the wall clock; None while nothing moves."""
        if not self._ends:
            return None
        return min(self.clock.left(self._ends[0][0]), self._fed + WATCHDOG_S - self.clock.wall())

    def span(self, point: int) -> tuple[float, float] | None:
        """Return when the move to a point of the running program begins and ends, s; None if there is none."""
        ends = {number: end for end, number in self._ends}
        if point not in ends:
            return None
        return ends.get(point - 1, min(self.clock.now(), ends[point])), ends[point]

    def _halt(self, time: float, reason: Reason) -> None:
        """Brake at a time, and abort the running program."""
        self.arm.track.brake(time)
        self._ends.clear()
        if self.running:
            self.aborted, self.running, self.reason = self.running, 0, reason
            stands = np.degrees(self.arm.track.target).tolist()
            self._say(Event.ABORTED, self.aborted, point=self.point, reason=reason, time=time, at=stands)

    def _say(self, event: Event, number: int, point: int = 0, reason: Reason = Reason.NONE, **more: Any) -> None:
        more.setdefault("time", self.clock.now())
        self._notify({"event": event, "boot": self.boot, "id": number, "point": point, "reason": reason, **more})


def _sample(place: int, sample: Sample | None) -> dict[str, Value]:
    at = f"Robot/S{place}/@"
    values: dict[str, Value] = {f"{at}N": 0, f"{at}T": 0}
    if sample is not None:
        values = {f"{at}N": sample.number, f"{at}T": milliseconds(sample.time)}
    for letter, name in (("Q", "axis"), ("M", "torque"), ("I", "current")):
        row = (0.0,) * AXES if sample is None else getattr(sample, name)
        values |= {f"{at}{letter}{k}": value for k, value in enumerate(row, 1)}
    return values


def milliseconds(time: float) -> int:
    """Return a time in ms as a KRL timer has it: 32 bits, which run over after 24.8 days."""
    return (round(time * 1000) + INTEGER // 2) % INTEGER - INTEGER // 2
