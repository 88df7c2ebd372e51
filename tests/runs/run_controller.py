"""Virtual controllers in processes of their own, and small plans for them."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from free_ports import free_port

from clampid.planning.clamping import planned_sweep
from clampid.planning.press import Press, press_limits, stiffness_of
from experiments.instruments import connect_instrument
from experiments.links.address import open_link
from experiments.plans import Cell, Course, Limits, Plan, Run, Sweep, Visit
from experiments.plans.limits import course_of
from experiments.plans.press import rated_motor_torque
from experiments.runs.people import VirtualOperator, Yes
from experiments.runs.runner import Asked

CLAMPED = np.array([0.0, -1.2, 1.6, 0.5, 0.9, 0.0])


@dataclass
class Controller:
    """A running ``clampid virtual-robot``."""

    truth: Path
    options: tuple[str, ...] = ()
    ports: dict[str, int] = field(default_factory=dict)
    process: subprocess.Popen | None = None

    def start(self) -> Controller:
        places = {name: self.ports.get(name) or free_port() for name in ("listening", "tracker", "operator")}
        command = [sys.executable, "-m", "clampid", "virtual-robot", "--truth", str(self.truth)]
        for name, port in places.items():
            command += ["--listen" if name == "listening" else f"--{name}", f"127.0.0.1:{port}"]
        self.process = subprocess.Popen([*command, *self.options], stdout=subprocess.PIPE, text=True)
        while len(self.ports) < 3 or not self.ports.get("up"):
            line = self.process.stdout.readline()
            assert line, "the virtual controller ended"
            found = re.match(r"(\w+) on 127\.0\.0\.1:(\d+)", line)
            self.ports[found[1]] = int(found[2])
            self.ports["up"] = int(found[1] == "operator")
        return self

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(20)
        self.process.stdout.close()
        self.ports["up"] = 0

    def stop(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            self.process.wait(20)
        self.process.stdout.close()

    def operate(self, line: str) -> dict:
        with socket.create_connection(("127.0.0.1", self.ports["operator"]), 10) as peer:
            peer.sendall(f"{line}\n".encode())
            return json.loads(peer.makefile("r", encoding="utf-8").readline())

    @property
    def link(self) -> str:
        return f"eki://127.0.0.1:{self.ports['listening']}?torque=Nm"

    @property
    def tracker(self) -> str:
        return f"tcp://127.0.0.1:{self.ports['tracker']}"

    def asked(self, **more: object) -> Asked:
        said: list[str] = []
        person = VirtualOperator(f"127.0.0.1:{self.ports['operator']}", Yes(said.append))
        asked = Asked(lambda: open_link(self.link), lambda: connect_instrument(self.tracker), person, **more)
        asked.say = said.append
        asked.said = said
        return asked

    def journal(self) -> list[dict]:
        file = self.truth.with_suffix(".journal.jsonl")
        return [json.loads(line) for line in file.read_text().splitlines()]

    def executions(self) -> Counter:
        """How often each program was accepted, by boot and number."""
        return Counter((e["boot"], e["id"]) for e in self.journal() if e["event"] == 1)


def visit_of(
    cell: Cell,
    limits: Limits,
    table: str,
    pose: int,
    number: int,
    before: np.ndarray | None,
    q: np.ndarray,
    side: np.ndarray,
) -> Visit:
    via = q - 0.05 * side
    course = course_of(cell.robot, limits, np.array([via if before is None else before, via, q]))
    return Visit(table, pose, number, via, q, course.duration, course.ramp, ("T1", "T2", "T3"))


def poses_plan(cell: Cell, limits: Limits, count: int = 6) -> Plan:
    """Six poses or more, one of them twice, and one for verification."""
    rng = np.random.default_rng(5)
    places = [np.array([0.0, -1.3, 1.5, 0.3, 0.8, 0.0]) + 0.4 * rng.uniform(-1, 1, 6) for _ in range(count + 1)]
    order = [("poses", k, 1) for k in range(1, count + 1)] + [("poses", 2, 2), ("verification", 1, 1)]
    visits, before = [], None
    for table, pose, number in order:
        q = places[count] if table == "verification" else places[pose - 1]
        visits.append(visit_of(cell, limits, table, pose, number, before, q, rng.choice([-1.0, 1.0], 6)))
        before = q
    return Plan("poses", cell, limits, 60.0, visits=tuple(visits), measure_time=0.5)


def free_air_plan(cell: Cell, limits: Limits, moves: int = 3) -> Plan:
    """Three moves or more, at two speeds."""
    rng = np.random.default_rng(6)
    start = np.array([0.0, -1.3, 1.5, 0.3, 0.8, 0.0])
    knots = np.array([start, *(start + 0.4 * rng.uniform(-1, 1, 6) for _ in range(moves - 1)), start])
    courses: list[Course] = [course_of(cell.robot, limits, knots, speed_share=s, dwell=0.5) for s in (0.2, 0.1)]
    runs = tuple(Run(course, share) for course, share in zip(courses, (0.2, 0.1), strict=True))
    return Plan("free_air", cell, limits, sum(c.length for c in courses), runs=runs)


def clamping_plan(
    cell: Cell, limits: Limits, sweeps: list[tuple[int, int, np.ndarray]], share: float = 0.2, margin: float = 1.6
) -> Plan:
    """Sweeps as (clamping, joint from 0, posture)."""
    rated = rated_motor_torque(cell.robot)
    stiffness = stiffness_of(cell.robot, rated)[0]
    press = Press(np.full(6, share), rated, stiffness, margin, 0.4)
    blank = Plan("clamping", cell, press_limits(limits, rated), 600.0, stiffness=margin * stiffness)
    made: list[Sweep] = []
    for clamping, joint, posture in sweeps:
        made.append(replace(planned_sweep(blank, press, posture, joint, 8), clamping=clamping))
    return replace(blank, sweeps=tuple(made))
